"""Dense reward: progress of the merge that comes next, from 0 with both groups far from all hands to 1 when joined."""

from __future__ import annotations

import numpy as np

from roboassembly.control.cell import ControlCell
from roboassembly.control.starts import MergeTask
from roboassembly.geometry.poses import pose_difference, transform_points
from roboassembly.solvers.disassembly import Disassembly, partition_of
from roboassembly.task.rules.groups import Group, TaskState

_REACH = 1.0
"""Distance of a hand from a grasp over which its share of the progress falls by most [m]."""
_JOINT, _TURN = 0.5, 1.0
"""Distance and angle from the joint over which its share falls by most [m, rad]."""


def progress(cell: ControlCell, first: int, second: int) -> float:
    """Return the progress of a merge: a quarter for each group that is gripped, a half for the way to the joint.

    A hand that is near a grasp of a group that it may take counts for part of the quarter. Either robot may take
    either group; a group on posts need not be gripped, if the other one is.

    Args:
        cell: present state.
        first: key of one group.
        second: key of the other group.
    """
    assignments = ((first, second), (second, first))
    gripped = max(sum(_gripped(cell, robot, key) for robot, key in enumerate(pair)) for pair in assignments)
    holders = [cell.physics.holders(key) for key in (first, second)]
    near = _nearness(cell, first, second) if all(holders) else 0.0
    return 0.25 * gripped + 0.5 * near


def _gripped(cell: ControlCell, robot: int, key: int) -> float:
    """Return 1 if a robot holds a group, less the farther its empty hand is from its grasps, 0 if it holds another."""
    grasped = cell.physics.grasped(robot)
    if grasped is not None:
        return float(grasped == key)
    points = grasp_points(cell, cell.group(key))
    tips = cell.physics.tips(robot).translation
    return 0.8 * (1.0 - float(np.tanh(np.linalg.norm(points - tips, axis=1).min() / _REACH)))


def grasp_points(cell: ControlCell, group: Group) -> np.ndarray:
    """Return the middles of all grasp regions of a group in the world [m], as rows."""
    parts = zip(group.parts, group.part_poses(), strict=True)
    rows: list[np.ndarray] = []
    for part, pose in parts:
        regions = cell.furniture.parts[part].grasps
        if regions:
            rows.append(transform_points(pose, np.array([region.position for region in regions])))
    return np.concatenate(rows)


def _nearness(cell: ControlCell, first: int, second: int) -> float:
    """Return how near two groups are to the nearest of their right joints, from 0 to 1."""
    reached = cell.physics.pose(second).actInv(cell.physics.pose(first))
    center = cell.physics.contents.bodies[first].center
    differences = [pose_difference(reached, goal, center) for goal in cell.joints(first, second).goals]
    off = [position / _JOINT + angle / _TURN for position, angle in differences]
    return 1.0 - float(np.tanh(min(off))) if off else 0.0


class NextMerge:
    """Progress of the merge that comes next, step by step.

    In the task `merge` it is the one that is to be made. In the task `piece` it is the first of an order that
    disassembly finds from the groups that are left.

    Args:
        cell: robots and groups of the episode.
        merge: merge that is to be made; None in the task `piece`.
    """

    def __init__(self, cell: ControlCell, merge: MergeTask | None) -> None:
        self._cell, self._merge = cell, merge
        self._disassembly = Disassembly(cell.furniture, lambda: False) if merge is None else None
        self._groups = self._choose()

    def progress(self) -> float:
        """Return the progress, from 0 to 1; 1 once there is nothing left to join."""
        return 1.0 if self._groups is None else progress(self._cell, *self._groups)

    def change(self, before: float, joined: bool) -> float:
        """Return the change of the progress in a step; up to 1 if a joint closed, and then the next merge counts.

        Args:
            before: progress before the step.
            joined: whether a joint closed in the step.
        """
        if joined:
            self._groups = self._choose()
            return 1.0 - before
        return self.progress() - before

    def _choose(self) -> tuple[int, int] | None:
        cell = self._cell
        if cell.complete:
            return None
        if self._merge is not None:
            by_parts = {group.parts: key for key, group in cell.groups.items()}
            first, second = (by_parts.get(parts) for parts in self._merge.groups)
            return None if first is None or second is None else (first, second)
        assert self._disassembly is not None
        state = TaskState(tuple(cell.groups.values()))
        for assigned in cell.rules.pairs.slot_assignments(state):
            order = self._disassembly.order(partition_of(assigned), set(), straight=False, exhaustive=False)
            if order:
                keys = {frozenset(g.slots): key for key, g in zip(cell.groups, assigned.groups, strict=True)}
                first, second = order[0]
                return keys[first], keys[second]
        return None
