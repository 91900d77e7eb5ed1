"""Groups as a rehearsal remembers them: by shape, so that what is known of one leg is known of all its like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from roboassembly.furniture.model import SAME_POINT, Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.task.rules.groups import Group, TaskState, part_from_points
from roboassembly.task.setting import Task

_SAME_AXIS = 1e-2
"""Of unit vectors of two points that count as equal, largest difference."""


@dataclass(frozen=True, eq=False)
class Kind:
    """A group that has come about, whichever of equal parts it is made of."""

    slots: tuple[int, ...]
    poses: tuple[SE3, ...]
    """Of the parts in the group's frame."""
    world: SE3
    """Where it came to rest the first time."""
    free: Int[np.ndarray, "f"]
    """Its free points, among the points of its parts in the order of slots."""


@dataclass(frozen=True, eq=False)
class Named:
    """A group of particular parts."""

    kind: int
    parts: tuple[int, ...]
    """In the order of the kind's slots."""
    rows: Int[np.ndarray, "r"]
    """Of all points of its parts, in that order."""


class Table:
    """Rows of integers that are only ever added to."""

    def __init__(self, width: int) -> None:
        self._rows = np.zeros((256, width), np.int32)
        self.count = 0

    def append(self, *row: int) -> None:
        """Add a row."""
        if self.count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self.count] = row
        self.count += 1

    def since(self, first: int) -> Int[np.ndarray, "k w"]:
        """Rows from the `first` on; not to be changed."""
        return self._rows[first : self.count]


def point_counts(furniture: Furniture) -> Int[np.ndarray, "P"]:
    """How many points each part may come to have: a joined part has those of the part whose slot it takes."""
    own = np.array([len(part.points) for part in furniture.parts])
    return np.array([own[list(furniture.classes[c].members)].max() for c in furniture.class_of])


def equals(furniture: Furniture) -> Int[np.ndarray, "P"]:
    """For each part the first one that equals it, in shape and in connection points."""
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


class Registry:
    """The groups of one chair that have come about, by name, and the kinds that they are of.

    Args:
        task: of the chair.
        start: its parts alone, where they begin.
        turned: whether groups are of different kinds whose parts are turned otherwise in their slots.
    """

    def __init__(self, task: Task[Any, Any], start: Sequence[Group], turned: bool) -> None:
        self.furniture, self._rules, self._turned = task.furniture, task.rules, turned
        counts = point_counts(task.furniture)
        self.part = np.repeat(np.arange(len(counts)), counts)
        """Part of each row; the chair's points are numbered through."""
        self.point = np.concatenate([np.arange(n) for n in counts])
        self._first = np.cumsum([0, *counts])
        self.like = equals(task.furniture)
        """The first part that equals each part."""
        self.row_like = self._first[self.like[self.part]] + self.point
        """For each row that of the part that its part equals."""
        self.kinds: list[Kind] = []
        self.kind_names: dict[tuple[tuple[int, int], ...], int] = {}
        """After `key`."""
        self.groups: list[Named] = []
        self._names: dict[tuple[int, tuple[int, ...]], int] = {}
        self._start = {g.parts[0]: g for g in start}

    def owner(self, state: Sequence[int], row: int) -> int:
        """Name of the group that a point belongs to."""
        part = self.part[row]
        return next(name for name in state if part in self.groups[name].parts)

    def group(self, name: int) -> Group:
        """It, where it came to rest first."""
        named = self.groups[name]
        if len(named.parts) == 1:
            return self._start[named.parts[0]]
        kind = self.kinds[named.kind]
        order = np.argsort(named.parts)
        return Group(
            tuple(named.parts[i] for i in order),
            tuple(kind.slots[i] for i in order),
            tuple(kind.poses[i] for i in order),
            kind.world,
        )

    def local(self, name: int, row: int) -> int:
        """A row's number among the points of its group."""
        return int(np.flatnonzero(self.groups[name].rows == row)[0])

    def free(self, name: int) -> Int[np.ndarray, "f"]:
        """A group's free points, among the points of its parts."""
        return self.kinds[self.groups[name].kind].free

    def frames(
        self, name: int, points: Int[np.ndarray, "r"]
    ) -> tuple[Float[np.ndarray, "r 3 3"], Float[np.ndarray, "r 3"], Float[np.ndarray, "r"]]:
        """Rotation, origin and gap of some points of a group in its frame."""
        furniture, named = self.furniture, self.groups[name]
        slots = self.kinds[named.kind].slots if len(named.parts) > 1 else named.parts
        slot_of = dict(zip(named.parts, slots, strict=True))
        turns, origins, gaps = [], [], []
        for row in named.rows[points]:
            slot = slot_of[int(self.part[row])]
            point = furniture.parts[slot].points[int(self.point[row])]
            frame = furniture.assembled[slot] * point.frame
            turns.append(frame.rotation)
            origins.append(frame.translation)
            gaps.append(point.gap)
        return np.array(turns), np.array(origins), np.array(gaps)

    def loose(self, part: int) -> int:
        """Name of a part alone."""
        group = self._start[part]
        return self.name(self.kind(group, ((-1, int(self.like[part])),)), (part,))

    def key(self, merged: Group) -> tuple[tuple[int, int], ...]:
        """Slots in order. Which equal parts fill them makes no difference: they have the points of their slots then.

        Hands hold a part where its own grasps are, so that to them it matters how it is turned in its slot.
        """
        turns = (self._turn(merged, part) if self._turned else -1 for part in merged.parts)
        return tuple(sorted(zip(merged.slots, turns, strict=True)))

    def _turn(self, group: Group, part: int) -> int:
        """By which symmetry of its shape a part is turned in its slot, as a number."""
        furniture = self.furniture
        symmetries = furniture.classes[furniture.class_of[part]].symmetries
        return int(np.argmax(np.einsum("nij,ij->n", symmetries, part_from_points(furniture, group, part).rotation)))

    def kind(self, group: Group, key: tuple[tuple[int, int], ...]) -> int:
        """The kind of a group, after `key`."""
        if key not in self.kind_names:
            self.kind_names[key] = len(self.kinds)
            order = np.argsort(group.slots)
            free_points = self._rules.free_points(TaskState((group,)))
            parts = [group.parts[i] for i in order]
            free = np.flatnonzero(np.concatenate([free_points[p, : len(self._points(p))] for p in parts]))
            slots, poses = (tuple(of[i] for i in order) for of in (group.slots, group.furniture_from_part))
            self.kinds.append(Kind(slots, poses, group.world_from_furniture, free))  # pyright: ignore[reportArgumentType]
        return self.kind_names[key]

    def _points(self, part: int) -> range:
        return range(self._first[part], self._first[part + 1])

    def name(self, kind: int, parts: tuple[int, ...]) -> int:
        """Of a group of some parts, in the order of the kind's slots."""
        if (kind, parts) not in self._names:
            self._names[kind, parts] = len(self.groups)
            rows = np.concatenate([np.array(self._points(p), dtype=int) for p in parts])
            self.groups.append(Named(kind, parts, rows))
        return self._names[kind, parts]
