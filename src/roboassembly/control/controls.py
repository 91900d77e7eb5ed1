"""Actions of continuous control: numbers in [−1, 1] to commands of both robots, and back.

One robot has eleven numbers: x, y and yaw of its platform, seven for its arm, one for its hand; R_a comes first.

| mode | platform | arm |
|---|---|---|
| `joint_position` | place in the world, ±`PLACE_RANGE` m; yaw, ±π | joint angles, from the lower limit to the upper one |
| `joint_delta` | change in the world, up to `PLATFORM_SPEED` | change of the joint angles, up to `JOINT_SPEEDS` |
| `end_effector_delta` | as `joint_delta` | change of the finger tips in the frame of the arm's mount, translation and \
rotation vector, up to `TIP_SPEED` and `TIP_TURN`; then motion of the elbow alone, up to `ELBOW_SPEED` |

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
from roboassembly.robots.gripper import MAX_OPENING
from roboassembly.robots.kinematics import JOINTS, arm, rotation_vectors
from roboassembly.simulation.control_physics import CONTROL_RATE

ControlName = Literal["joint_position", "joint_delta", "end_effector_delta"]
CONTROLS: tuple[ControlName, ...] = get_args(ControlName)
PLACE_RANGE = 10.0
"""Place of a platform along x and y that the actions 1 and −1 of `joint_position` stand for [m]."""
PLATFORM_SPEED = np.array([1.5, 1.5, 2.4])
"""Largest speed of a command of a platform [m/s, m/s, rad/s]."""
JOINT_SPEEDS = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
"""Largest speed of a command of each joint: Franka's limits of the Panda [rad/s]."""
TIP_SPEED, TIP_TURN, ELBOW_SPEED = 2.0, 4.0, 2.5
"""Largest speed of a command of the finger tips against the platform [m/s, rad/s], and of the joints as the elbow
moves alone [rad/s]."""
NUMBERS = 3 + JOINTS + 1
"""Numbers of an action that are one robot's."""
_SOLVER_STEPS = 3
"""Newton steps of the inverse kinematics of one command; a command moves the finger tips little."""
_DAMPING = 0.02
"""Damping of the inverse kinematics near singular postures."""

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
        self._tips = np.array([*[TIP_SPEED] * 3, *[TIP_TURN] * 3, ELBOW_SPEED]) / CONTROL_RATE

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
            wanted = np.array(rows[:, :-1])
            wanted[:, :2] *= PLACE_RANGE
            wanted[:, 2] = commands[:, 2] + _wrapped(np.pi * wanted[:, 2] - commands[:, 2])
            wanted[:, 3:] = arm().low + 0.5 * (wanted[:, 3:] + 1.0) * (arm().high - arm().low)
            change = wanted - commands
        else:
            change = rows[:, :-1] * self._largest
            if self.control == "end_effector_delta":
                change[:, 3:] = self._solve(rows[:, 3:-1] * self._tips, commands[:, 3:])
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
                rows[:, 3:-1] = _tip_change(commands[:, 3:], targets[:, 3:]) / self._tips
        return np.clip(rows, -1.0, 1.0).astype(np.float32).ravel()

    def _solve(self, change: Float[np.ndarray, "2 7"], q: Float[np.ndarray, "2 7"]) -> Float[np.ndarray, "2 7"]:
        """Return the change of the joint angles that moves finger tips and elbow."""
        start = arm().poses(q)
        goal_rotation = np.array([rotation_of(c[3:6]) for c in change]) @ start.rotation
        goal_position = start.translation + change[:, :3]
        reached = q + change[:, 6:] * null_motion(q)
        for _ in range(_SOLVER_STEPS):
            tips, jacobian = arm().jacobians(reached)
            off = goal_position - tips.translation
            turn = rotation_vectors(goal_rotation @ tips.rotation.transpose(0, 2, 1))
            error = np.concatenate([off, turn], axis=1)
            square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING**2 * np.eye(6)
            reached = reached + np.einsum("nij,ni->nj", jacobian, np.linalg.solve(square, error[..., None])[..., 0])
            reached = np.clip(reached, arm().low, arm().high)
        return reached - q


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


def null_motion(q: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 7"]:
    """Return the unit change of the joint angles that leaves the finger tips where they are and moves the elbow.

    Its numbers are the signed minors of the Jacobian, which change smoothly with the posture.
    """
    _, jacobian = arm().jacobians(q)
    signs = (-1.0) ** np.arange(JOINTS)
    minors = np.stack([np.linalg.det(np.delete(jacobian, j, axis=2)) for j in range(JOINTS)], axis=1) * signs
    return minors / np.maximum(np.linalg.norm(minors, axis=1, keepdims=True), 1e-9)


def _tip_change(q: Float[np.ndarray, "2 7"], goal: Float[np.ndarray, "2 7"]) -> Float[np.ndarray, "2 7"]:
    """Return translation and rotation vector of the finger tips, and motion of the elbow, between two postures."""
    here, there = arm().poses(q), arm().poses(goal)
    turn = rotation_vectors(there.rotation @ here.rotation.transpose(0, 2, 1))
    elbow = ((goal - q) * null_motion(q)).sum(axis=1, keepdims=True)
    return np.concatenate([there.translation - here.translation, turn, elbow], axis=1)


def rotation_of(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _wrapped(angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Return equal angles from −π to π."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
