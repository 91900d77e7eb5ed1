"""Oracle of the full setting: it also requires that two grippers can hold the groups that are joined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.blocking import Parts
from roboassembly.solvers.options import End, fitting
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.grips import MateGrasp
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
        self._joined: dict[tuple[End, End], list[tuple[int, int]]] = {}
        """Groups, as bit masks of slots, between which grippers join two points; the moving one first."""
        self._not_joined: dict[tuple[End, End], list[tuple[int, int]]] = {}
        """Groups between which no grippers join two points."""

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
        masks = _mask(moving), _mask(waiting)
        joints = [(u, v) for u, v in self.furniture.joints_between(moving, waiting) if not self._blocked(u, v, masks)]
        if any(self._free(u, v, masks) for u, v in joints):
            return True
        state = TaskState((self._group(moving), self._group(waiting)))
        for u_end, v_end in joints:
            if self._same_grasps_join(state, u_end, v_end):
                self._joined.setdefault((u_end, v_end), []).append(masks)
                return True
        found = next(fitting(self._grasp_task, state, joints, lazy=True), None) if joints else None
        if found is None:
            for joint in joints:
                self._not_joined.setdefault(joint, []).append(masks)
            return False
        u, v, k, m, g_a, g_b = found
        self._last_grasps[frozenset(((u, k), (v, m)))] = (g_a, g_b) if u < v else (g_b, g_a)
        self._joined.setdefault(((u, k), (v, m)), []).append(masks)
        return True

    def _free(self, u_end: End, v_end: End, masks: tuple[int, int]) -> bool:
        """Return whether grippers are known to join two points with these groups, or with more parts, around them."""
        joined = self._joined.get((u_end, v_end), ())
        return any(not masks[0] & ~u and not masks[1] & ~v for u, v in joined)

    def _blocked(self, u_end: End, v_end: End, masks: tuple[int, int]) -> bool:
        """Return whether grippers are known not to join two points with these groups, or with fewer parts."""
        not_joined = self._not_joined.get((u_end, v_end), ())
        return any(not u & ~masks[0] and not v & ~masks[1] for u, v in not_joined)

    def _same_grasps_join(self, state: TaskState, u_end: End, v_end: End) -> bool:
        """Return whether the grasps that joined two points before join them here too.

        A gripper that has room in a group mostly has room in similar groups.
        """
        grasps = self._last_grasps.get(frozenset((u_end, v_end)))
        if grasps is None:
            return False
        g_a, g_b = grasps if u_end[0] < v_end[0] else grasps[::-1]
        return isinstance(
            self._grasp_task.mate_grasp(state, (u_end[0], v_end[0], u_end[1], v_end[1], g_a, g_b)), MateGrasp
        )

    def _group(self, slots: Parts) -> Group:
        """Return a group of parts in their own slots."""
        parts = tuple(sorted(slots))
        return Group(parts, parts, tuple(self.furniture.assembled[p] for p in parts), SE3.Identity())


def _mask(slots: Parts) -> int:
    return sum(1 << slot for slot in slots)


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
