"""Actions of continuous control: numbers in [−1, 1] to commands of both robots, and back.

One robot has eleven numbers: x, y and yaw of its platform, seven for its arm, one for its hand; R_a comes first.

| mode | platform | arm |
|---|---|---|
| `joint_position` | place in the world, ±`PLACE_RANGE` m; yaw, ±π | joint angles, from lower to upper limit |
| `joint_delta` | change in the world, up to `PLATFORM_SPEED` | change of the joint angles, up to `JOINT_SPEEDS` |
| `end_effector_delta` | as `joint_delta` | change of the finger tips in the frame of the arm's mount, translation and \
rotation vector, up to `limits.TIP_SPEED` and `TIP_TURN`; then motion of the elbow alone, up to `ELBOW_SPEED` |

Changes are those of the last command, not of the measured state, so that a load does not make a robot sink. No command
changes faster than these speeds. The hand: −1 closes with force, 1 opens to 80 mm, between them is the distance between
the pads.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from gymnasium.error import InvalidAction
from jaxtyping import Float

from roboassembly.envs.arguments import shortened
from roboassembly.errors import ArgumentError
from roboassembly.robots import limits
from roboassembly.robots.gripper import MAX_OPENING
from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.tip_motion import follow_tip_motion, tip_motion
from roboassembly.simulation.control_physics import CONTROL_RATE

ControlName = Literal["joint_position", "joint_delta", "end_effector_delta"]
CONTROLS: tuple[ControlName, ...] = get_args(ControlName)
PLACE_RANGE = 10.0
"""Place of a platform along x and y that the actions 1 and −1 of `joint_position` stand for [m]."""
PLATFORM_SPEED = np.array([limits.DRIVE[0], limits.DRIVE[0], limits.TURN[0]])
"""Largest speed of a command of a platform [m/s, m/s, rad/s]."""
JOINT_SPEEDS = np.array(limits.JOINT_VELOCITIES)
"""Largest speed of a command of each joint [rad/s]."""
TIP_TURN, ELBOW_SPEED = 4.0, 2.5
"""Largest speed of a command of the finger tips against the platform, beside `limits.TIP_SPEED`, and of the joints as
the elbow moves alone [rad/s]."""
NUMBERS = 3 + JOINTS + 1
"""Numbers of an action that are one robot's."""
Commands = tuple[Float[np.ndarray, "2 10"], Float[np.ndarray, "2"]]
"""Configuration and opening [m] that each robot is told to have."""


class ActionCodec:
    """Turns actions into commands and commands into actions.

    Args:
        control: mode of control.

    Raises:
        ArgumentError: an unknown mode.
    """

    def __init__(self, control: ControlName) -> None:
        if control not in CONTROLS:
            raise ArgumentError(f"control is {shortened(control)}; expected {', '.join(map(repr, CONTROLS))}")
        self.control = control
        self._largest = np.concatenate([PLATFORM_SPEED, JOINT_SPEEDS]) / CONTROL_RATE
        self._tips = np.array([*[limits.TIP_SPEED] * 3, *[TIP_TURN] * 3, ELBOW_SPEED]) / CONTROL_RATE

    @property
    def names(self) -> list[str]:
        """Names of the numbers of an action."""
        arm_names = [f"q{j + 1}" for j in range(JOINTS)]
        if self.control == "end_effector_delta":
            arm_names = ["dx", "dy", "dz", "rx", "ry", "rz", "elbow"]
        return [f"{robot}/{name}" for robot in "ab" for name in ("x", "y", "yaw", *arm_names, "hand")]

    def decode(self, action: Float[np.ndarray, "22"], commands: Float[np.ndarray, "2 10"]) -> Commands:
        """Return the commands of an action.

        Args:
            action: numbers in [−1, 1].
            commands: configuration that each robot was last told to have.
        """
        rows = action.reshape(2, NUMBERS)
        if self.control == "joint_position":
            wished = np.array(rows[:, :-1])
            wished[:, :2] *= PLACE_RANGE
            wished[:, 2] = commands[:, 2] + _wrapped(np.pi * wished[:, 2] - commands[:, 2])
            wished[:, 3:] = arm().low + 0.5 * (wished[:, 3:] + 1.0) * (arm().high - arm().low)
            change = wished - commands
        else:
            change = rows[:, :-1] * self._largest
            if self.control == "end_effector_delta":
                moved = rows[:, 3:-1] * self._tips
                change[:, 3:] = [follow_tip_motion(q, m) - q for q, m in zip(commands[:, 3:], moved, strict=True)]
        change = np.clip(change, -self._largest, self._largest)
        reached = commands + change
        reached[:, 3:] = np.clip(reached[:, 3:], arm().low, arm().high)
        return reached, 0.5 * (rows[:, -1] + 1.0) * MAX_OPENING

    def encode(
        self, targets: Float[np.ndarray, "2 10"], openings: Float[np.ndarray, "2"], commands: Float[np.ndarray, "2 10"]
    ) -> Float[np.ndarray, "22"]:
        """Return the action whose commands are nearest to some targets; what is too fast is cut.

        Args:
            targets: configuration that each robot is to have.
            openings: distance between the pads of each hand [m]; 0 to close with force.
            commands: configuration that each robot was last told to have.
        """
        rows = np.empty((2, NUMBERS))
        rows[:, -1] = 2.0 * openings / MAX_OPENING - 1.0
        if self.control == "joint_position":
            rows[:, :2] = targets[:, :2] / PLACE_RANGE
            rows[:, 2] = _wrapped(targets[:, 2]) / np.pi
            rows[:, 3:-1] = 2.0 * (targets[:, 3:] - arm().low) / (arm().high - arm().low) - 1.0
        else:
            rows[:, :-1] = (targets - commands) / self._largest
            if self.control == "end_effector_delta":
                pairs = zip(commands[:, 3:], targets[:, 3:], strict=True)
                rows[:, 3:-1] = np.array([tip_motion(q, goal) for q, goal in pairs]) / self._tips
        return np.clip(rows, -1.0, 1.0).astype(np.float32).ravel()


def checked_numbers(action: object, names: list[str]) -> Float[np.ndarray, "22"]:
    """Return the numbers of an action, those beyond [−1, 1] cut to it.

    Raises:
        gymnasium.error.InvalidAction: a wrong shape, no numbers, or one that is not finite.
    """
    expected = f"{len(names)} numbers in [-1, 1]"
    try:
        values = np.asarray(action)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"action {shortened(action)} is no array; expected {expected}") from error
    if values.shape != (len(names),):
        raise InvalidAction(f"action {shortened(action)} has shape {values.shape}; expected {expected}")
    if not (np.issubdtype(values.dtype, np.floating) or np.issubdtype(values.dtype, np.integer)):
        raise InvalidAction(f"action {shortened(action)} has dtype {values.dtype}; expected {expected}")
    values = values.astype(float)
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        index = int(bad[0])
        raise InvalidAction(f"action[{index}] ({names[index]}) is {values[index]}; expected {expected}")
    return np.clip(values, -1.0, 1.0)


def _wrapped(angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Return equal angles from −π to π."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
