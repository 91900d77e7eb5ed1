"""Observations of continuous control: what robots feel, where parts are, and what is to be done.

| key | shape | meaning | unit |
|---|---|---|---|
| `robots` | (2, 32) | one row for each robot, R_a first: see `ROBOT_FIELDS` | m, rad, m/s, rad/s, N |
| `parts` | (P, 7) | pose of each part in the world: x, y, z, then the quaternion w, x, y, z with w ≥ 0 | m, 1 |
| `groups` | (P,) | lowest number of a part in the same group | |
| `held` | (P, 2) | 1 where R_a, R_b holds the group of the part | |
| `assembled` | (P, 7) | pose of each part in the finished piece, in its frame | m, 1 |
| `goal` | (P,) | 1 for parts of the group that is to be joined, −1 for those that it is joined to, else 0 | |
| `goal_pose` | (7,) | pose of the first group's lowest part in the frame of the second one's, once joined | m, 1 |

P is `max_parts`. Rows of parts that do not exist are 0. `goal` and `goal_pose` are 0 in the task `piece`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation

from roboassembly.control.cell import ControlCell
from roboassembly.control.randomization import Variation
from roboassembly.geometry.poses import SE3, pose_to_seven

ROBOT_FIELDS = (
    "x", "y", "cos_yaw", "sin_yaw", *(f"q{j + 1}" for j in range(7)), "vx", "vy", "yaw_rate",
    *(f"q{j + 1}_speed" for j in range(7)), "opening", "left_force", "right_force", "holds", "tips_x", "tips_y",
    "tips_z", "tips_qw", "tips_qx", "tips_qy", "tips_qz",
)  # fmt: skip
"""Names of the numbers of one robot: place and yaw of the platform, joint angles, their speeds (of the platform in the
world), distance between the pads, force of each pad, whether the hand holds something, and pose of the finger tips in
the world."""
REACH = 1e3
"""Bound of all numbers of an observation."""
StateObservation = dict[str, Float32[np.ndarray, "..."]]


def state_space(max_parts: int) -> dict[str, spaces.Space[np.ndarray]]:
    """Return the spaces of the table above."""
    shapes = {
        "robots": (2, len(ROBOT_FIELDS)), "parts": (max_parts, 7), "groups": (max_parts,), "held": (max_parts, 2),
        "assembled": (max_parts, 7), "goal": (max_parts,), "goal_pose": (7,),
    }  # fmt: skip
    return {name: spaces.Box(-REACH, REACH, shape, np.float32) for name, shape in shapes.items()}


@dataclass(frozen=True, eq=False)
class Goal:
    """Merge that is to be made, as an observation names it."""

    first: tuple[int, ...]
    second: tuple[int, ...]
    pose: SE3
    """Pose of the first group's lowest part in the frame of the second group's lowest part, once joined."""


class StateObserver:
    """Makes the observations of one episode.

    Args:
        cell: what is observed.
        max_parts: padding P.
        goal: merge that is to be made; None in the task `piece`.
        variation: draws of the episode; its seed of sensors decides all noise.
    """

    def __init__(self, cell: ControlCell, max_parts: int, goal: Goal | None, variation: Variation) -> None:
        self._cell, self._max_parts, self._ranges = cell, max_parts, variation.ranges
        self._rng = np.random.default_rng(variation.sensors)
        self._assembled = np.zeros((max_parts, 7), np.float32)
        self._assembled[: len(cell.furniture.parts)] = [pose_to_seven(pose) for pose in cell.furniture.assembled]
        self._goal, self._goal_pose = np.zeros(max_parts, np.float32), np.zeros(7, np.float32)
        if goal is not None:
            self._goal[list(goal.first)], self._goal[list(goal.second)] = 1.0, -1.0
            self._goal_pose[:] = pose_to_seven(goal.pose)

    def observe(self) -> StateObservation:
        """Return the present observation in new arrays, with the noise of its sensors."""
        groups = np.zeros(self._max_parts, np.float32)
        grasped = np.zeros((self._max_parts, 2), np.float32)
        for key, group in self._cell.groups.items():
            rows = list(group.parts)
            groups[rows] = rows[0]
            for robot in self._cell.physics.holders(key):
                grasped[rows, robot] = 1.0
        return {
            "robots": self.robots(), "parts": self._parts(), "groups": groups, "held": grasped,
            "assembled": self._assembled.copy(), "goal": self._goal.copy(), "goal_pose": self._goal_pose.copy(),
        }  # fmt: skip

    def robots(self) -> Float32[np.ndarray, "2 32"]:
        """Return what both robots feel."""
        physics, rows = self._cell.physics, np.zeros((2, len(ROBOT_FIELDS)))
        for robot, row in enumerate(rows):
            at = physics.configuration(robot)
            if self._ranges.joint_noise:
                at = at + self._rng.normal(0.0, self._ranges.joint_noise, len(at))
            contact = physics.contact(robot)
            row[:4] = at[0], at[1], np.cos(at[2]), np.sin(at[2])
            row[4:11] = at[3:]
            row[11:21] = physics.velocity(robot)
            row[21] = physics.opening(robot)
            row[22:24] = (0.0, 0.0) if contact is None else contact.forces
            row[24] = physics.grasped(robot) is not None
            row[25:] = pose_to_seven(physics.tips(robot))
        return np.clip(rows, -REACH, REACH).astype(np.float32)

    def _parts(self) -> Float32[np.ndarray, "P 7"]:
        rows, poses = np.zeros((self._max_parts, 7)), self._cell.part_sevens()
        if self._ranges.pose_noise or self._ranges.angle_noise:
            poses = self._noisy(poses)
        rows[: len(poses)] = poses
        return np.clip(rows, -REACH, REACH).astype(np.float32)

    def _noisy(self, poses: Float[np.ndarray, "p 7"]) -> Float[np.ndarray, "p 7"]:
        off = self._rng.normal(0.0, 1.0, (len(poses), 6))
        turned = Rotation.from_rotvec(self._ranges.angle_noise * off[:, 3:]) * Rotation.from_quat(
            poses[:, 3:], scalar_first=True
        )
        quaternions = turned.as_quat(canonical=True, scalar_first=True)
        return np.concatenate([poses[:, :3] + self._ranges.pose_noise * off[:, :3], quaternions], axis=1)
