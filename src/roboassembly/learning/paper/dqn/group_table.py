"""Groups of one chair by shape, so that what is known of one leg is known of all equal legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Int32

from roboassembly.furniture.model import SAME_POINT, Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.task.rules.groups import Group, TaskState, part_from_points
from roboassembly.task.setting import Task

_SAME_AXIS = 1e-2
"""Largest difference between unit vectors of equal points."""
TypeKey = tuple[tuple[int, int], ...]
"""Slots of a group's parts in ascending order, each with the number of the symmetry that its part is turned by."""


@dataclass(frozen=True, eq=False)
class GroupType:
    """A group that has occurred, whichever of equal parts it consists of."""

    slots: tuple[int, ...]
    """Slots of the parts."""
    poses: tuple[SE3, ...]
    """Poses of the parts in the group's frame."""
    world: SE3
    """World pose where the group came to rest the first time."""
    free: Int[np.ndarray, "f"]
    """Free points, as numbers among the points of the parts in the order of slots."""


@dataclass(frozen=True, eq=False)
class TypedGroup:
    """A group of particular parts."""

    type_id: int
    """Number of the group's type."""
    parts: tuple[int, ...]
    """Parts in the order of the type's slots."""
    rows: Int[np.ndarray, "r"]
    """Rows of all points of the parts, in the same order."""


class RowTable:
    """Rows of integers that are only ever appended."""

    def __init__(self, width: int) -> None:
        self._rows: Int32[np.ndarray, "k w"] = np.zeros((256, width), np.int32)
        self.count = 0

    def append(self, *row: int) -> None:
        """Append a row."""
        if self.count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self.count] = row
        self.count += 1

    def since(self, first: int) -> Int[np.ndarray, "k w"]:
        """Return the rows from the `first` on, as a view."""
        return self._rows[first : self.count]


def point_counts(furniture: Furniture) -> Int[np.ndarray, "P"]:
    """Return how many points each part may have: a joined part has those of the part whose slot it takes."""
    own = np.array([len(part.points) for part in furniture.parts])
    return np.array([own[list(furniture.classes[c].members)].max() for c in furniture.class_of])


def equal_parts(furniture: Furniture) -> Int[np.ndarray, "P"]:
    """Return for each part the first part that equals it in shape and in connection points."""
    points = [np.array([[p.position, p.normal, p.tangent] for p in part.points]) for part in furniture.parts]
    out = np.arange(len(points))
    for i, own in enumerate(points):
        for j in range(i):
            other = points[j]
            if (
                furniture.class_of[i] == furniture.class_of[j]
                and own.shape == other.shape
                and (
                    not own.size
                    or (
                        np.abs(own[:, 0] - other[:, 0]).max() < SAME_POINT
                        and np.abs(own - other)[:, 1:].max() < _SAME_AXIS
                    )
                )
            ):
                out[i] = out[j]
                break
    return out


class GroupTable:
    """The groups of one chair that have occurred, by number, and their types.

    Args:
        task: task of the chair.
        start: its parts alone, where they begin.
        turned: whether groups whose parts are turned differently in their slots have different types.
    """

    def __init__(self, task: Task[Any, Any], start: Sequence[Group], turned: bool) -> None:
        self.furniture, self._rules, self._turned = task.furniture, task.rules, turned
        counts = point_counts(task.furniture)
        self.part: Int[np.ndarray, "n"] = np.repeat(np.arange(len(counts)), counts)
        """Part of each row; a row is the number of a point among all points of the chair."""
        self.point: Int[np.ndarray, "n"] = np.concatenate([np.arange(int(n)) for n in counts])
        """Number of each row's point in its part."""
        self._first = np.cumsum([0, *counts])
        self.equal_part: Int[np.ndarray, "P"] = equal_parts(task.furniture)
        """First part that equals each part."""
        self.equal_row: Int[np.ndarray, "n"] = self._first[self.equal_part[self.part]] + self.point
        """Row of the same point of the first part that equals each row's part."""
        self.types: list[GroupType] = []
        """Types by number."""
        self.type_ids: dict[TypeKey, int] = {}
        """Numbers of types by `key`."""
        self.groups: list[TypedGroup] = []
        """Groups by number."""
        self._group_ids: dict[tuple[int, tuple[int, ...]], int] = {}
        self._start = {g.parts[0]: g for g in start}

    def row(self, part: int, point: int) -> int:
        """Return the row of a part's point."""
        return int(self._first[part]) + point

    def owner(self, state: Sequence[int], row: int) -> int:
        """Return the number of the group of a state that a point belongs to."""
        part = self.part[row]
        return next(group_id for group_id in state if part in self.groups[group_id].parts)

    def group(self, group_id: int) -> Group:
        """Return a group where its type came to rest first."""
        typed = self.groups[group_id]
        if len(typed.parts) == 1:
            return self._start[typed.parts[0]]
        kind = self.types[typed.type_id]
        order: list[int] = np.argsort(typed.parts).tolist()
        return Group(
            tuple(typed.parts[i] for i in order),
            tuple(kind.slots[i] for i in order),
            tuple(kind.poses[i] for i in order),
            kind.world,
        )

    def local(self, group_id: int, row: int) -> int:
        """Return a row's number among the points of its group."""
        return int(np.flatnonzero(self.groups[group_id].rows == row)[0])

    def free(self, group_id: int) -> Int[np.ndarray, "f"]:
        """Return a group's free points, as numbers among the points of its parts."""
        return self.types[self.groups[group_id].type_id].free

    def frames(
        self, group_id: int, points: Int[np.ndarray, "r"]
    ) -> tuple[Float[np.ndarray, "r 3 3"], Float[np.ndarray, "r 3"], Float[np.ndarray, "r"]]:
        """Return rotation, origin [m] and gap [m] of some points of a group in its frame."""
        furniture, typed = self.furniture, self.groups[group_id]
        slots = self.types[typed.type_id].slots if len(typed.parts) > 1 else typed.parts
        slot_of = dict(zip(typed.parts, slots, strict=True))
        turns: list[np.ndarray] = []
        origins: list[np.ndarray] = []
        gaps: list[float] = []
        for row in typed.rows[points]:
            slot = slot_of[int(self.part[row])]
            point = furniture.parts[slot].points[int(self.point[row])]
            frame = furniture.assembled[slot] * point.frame
            turns.append(frame.rotation)
            origins.append(frame.translation)
            gaps.append(point.gap)
        return np.array(turns), np.array(origins), np.array(gaps)

    def single_part(self, part: int) -> int:
        """Return the number of the group that a part alone is."""
        group = self._start[part]
        return self.group_id(self.type_id(group, ((-1, int(self.equal_part[part])),)), (part,))

    def key(self, merged: Group) -> TypeKey:
        """Return the key of a group's type.

        Which of equal parts fill the slots makes no difference: they have the points of their slots then. A gripper
        holds a part at the part's own grasps, so that in the full setting it matters how it is turned in its slot.
        """
        turns = (self._symmetry(merged, part) if self._turned else -1 for part in merged.parts)
        return tuple(sorted(zip(merged.slots, turns, strict=True)))

    def _symmetry(self, group: Group, part: int) -> int:
        """Return the number of the symmetry of its shape by which a part is turned in its slot."""
        furniture = self.furniture
        symmetries = furniture.classes[furniture.class_of[part]].symmetries
        return int(np.argmax(np.einsum("nij,ij->n", symmetries, part_from_points(furniture, group, part).rotation)))

    def type_id(self, group: Group, key: TypeKey) -> int:
        """Return the number of a group's type, which has a key; adds the type if it is new."""
        if key not in self.type_ids:
            self.type_ids[key] = len(self.types)
            order: list[int] = np.argsort(group.slots).tolist()
            free_points = self._rules.free_points(TaskState((group,)))
            parts = [group.parts[i] for i in order]
            free = np.flatnonzero(np.concatenate([free_points[p, : len(self._rows(p))] for p in parts]))
            slots = tuple(group.slots[i] for i in order)
            poses = tuple(group.furniture_from_part[i] for i in order)
            self.types.append(GroupType(slots, poses, group.world_from_furniture, free))
        return self.type_ids[key]

    def _rows(self, part: int) -> range:
        return range(int(self._first[part]), int(self._first[part + 1]))

    def group_id(self, type_id: int, parts: tuple[int, ...]) -> int:
        """Return the number of the group of some parts, in the order of the type's slots; adds it if it is new."""
        if (type_id, parts) not in self._group_ids:
            self._group_ids[type_id, parts] = len(self.groups)
            rows = np.concatenate([np.array(self._rows(p), dtype=int) for p in parts])
            self.groups.append(TypedGroup(type_id, parts, rows))
        return self._group_ids[type_id, parts]
