"""Oracle of the full setting: it also requires that two grippers can hold the groups that are joined."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.options import End, fitting
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.failure import Failure
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.groups import Group, TaskState

_MAX_PARTS = 16
"""Largest number of parts: the grasp tests grow exponentially with it."""


class HandOracle(Oracle):
    """Memoized oracle of one piece of furniture that checks grippers, but no arms.

    Two sub-assemblies can be joined if they can be separated along a straight line and if a gripper at each of them
    passes the cheap tests of the full setting. Nothing stands on the ground, so either all `w` are feasible or none.
    """

    def __init__(self, task: FullTask) -> None:
        super().__init__(ObjectCentricTask(task.furniture))
        self._grasp_task = task
        self._joinable: dict[tuple[Parts, Parts], bool] = {}
        self._last_grasps: dict[frozenset[End], tuple[int, int]] = {}
        """Grasps that joined two points last, the grasp at the part with the lower index first."""
        self._joined: defaultdict[tuple[End, End], list[tuple[Parts, Parts]]] = defaultdict(list)
        """Moving and waiting groups between which grippers join two points."""
        self._not_joined: defaultdict[tuple[End, End], list[tuple[Parts, Parts]]] = defaultdict(list)
        """Moving and waiting groups between which no grippers join two points."""

    @property
    def grasp_task(self) -> FullTask:
        """Task whose grasps the oracle tests."""
        return self._grasp_task

    def feasible_along(self, moving: Parts, waiting: Parts, axes: Float[np.ndarray, "w 3"]) -> Bool[np.ndarray, "w"]:
        """Return whether R_a can bring `moving` to `waiting`, which R_b holds; equal values for all axes."""
        key = (moving, waiting)
        if key not in self._joinable:
            self._joinable[key] = len(self.graphs.straight_exits(moving, waiting)) > 0 and self._grippers_join(
                moving, waiting
            )
        return np.full(len(axes), self._joinable[key])

    def _grippers_join(self, moving: Parts, waiting: Parts) -> bool:
        """Return whether a gripper at each group has room at one of the joints between them.

        What two grippers can do at a joint, they can do with fewer parts around it. So most answers follow from others.
        """
        joints = [
            joint
            for joint in self.furniture.joints_between(moving, waiting)
            if not any(u <= moving and v <= waiting for u, v in self._not_joined[joint])
        ]
        if any(moving <= u and waiting <= v for joint in joints for u, v in self._joined[joint]):
            return True
        state = TaskState((self._group(moving), self._group(waiting)))
        found = next((joint for joint in joints if self._same_grasps_join(state, *joint)), None)
        found = found or self._joint_of_any_grasps(state, joints)
        if found is None:
            for joint in joints:
                self._not_joined[joint].append((moving, waiting))
            return False
        self._joined[found].append((moving, waiting))
        return True

    def _joint_of_any_grasps(self, state: TaskState, joints: list[tuple[End, End]]) -> tuple[End, End] | None:
        """Return a joint at which some grasps join two groups; None if there is none."""
        action = next(fitting(self._grasp_task, state, joints, lazy=True), None)
        if action is None:
            return None
        u, v, k, m, g_a, g_b = action
        self._last_grasps[frozenset(((u, k), (v, m)))] = (g_a, g_b) if u < v else (g_b, g_a)
        return (u, k), (v, m)

    def _same_grasps_join(self, state: TaskState, u_end: End, v_end: End) -> bool:
        """Return whether the grasps that joined two points before join them here too.

        A gripper that has room in a group mostly has room in similar groups.
        """
        grasps = self._last_grasps.get(frozenset((u_end, v_end)))
        if grasps is None:
            return False
        g_a, g_b = grasps if u_end[0] < v_end[0] else grasps[::-1]
        action = (u_end[0], v_end[0], u_end[1], v_end[1], g_a, g_b)
        return not isinstance(self._grasp_task.hands_merge(state, action), Failure)

    def _group(self, slots: Parts) -> Group:
        """Return a group of parts in their own slots."""
        parts = tuple(sorted(slots))
        return Group(parts, parts, tuple(self.furniture.assembled[p] for p in parts), SE3.Identity())


def hand_oracle(furniture: Furniture) -> HandOracle:
    """Return the oracle of a piece of furniture.

    Raises:
        InputError: the furniture does not suit the robots, or has too many parts.
    """
    if len(furniture.parts) > _MAX_PARTS:
        raise InputError(
            f"{furniture.name} has {len(furniture.parts)} parts; the full oracle takes at most {_MAX_PARTS}"
        )
    task = FullTask(furniture)
    task.check_furniture()
    return HandOracle(task)
