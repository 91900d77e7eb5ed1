"""Oracle: labels every right pair of a state by disassembly; the labels are training targets of a policy.

It uses blocking graphs and straight exits as the search does, without a planner. Whether two sub-assemblies can be
joined, and which one can move, depends on the furniture alone, so the result is computed once for each pair of
sub-assemblies. The oracle is conservative: a merge that needs a curved path counts as infeasible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import SAME_POINT
from roboassembly.solvers.blocking import BlockingGraphs, Parts
from roboassembly.solvers.disassembly import partition_of
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.rules.pairs import Merge

if TYPE_CHECKING:
    from roboassembly.task.full.task import FullTask

_LEAST_RISE = -0.35
"""Smallest sine of the angle of climb at which a group leaves; steeper descents end on the ground."""
_ASSIGNMENTS = 24
"""Number of slot assignments that are examined; further ones differ only in the names of equal parts."""
_SINK = 1e-3
"""Depth by which a moving group may reach below the waiting one [m]; below it, the group ends in the ground."""


@dataclass(frozen=True, eq=False)
class RightPair:
    """A right ordered pair of a state."""

    u: int
    k: int
    v: int
    l: int  # noqa: E741
    merge: Merge


@dataclass(frozen=True, eq=False)
class LabeledMate(RightPair):
    """A right ordered pair of a state with its labels."""

    feasible_w: Bool[np.ndarray, "6"]
    """Whether u's group can reach v's group along a straight line above the ground, for each `w`."""
    solvable: bool
    """Whether the furniture can still be finished after this merge."""
    moving: Parts
    """Slots of u's group."""
    waiting: Parts
    """Slots of v's group."""

    @property
    def viable(self) -> bool:
        """Whether the pair can be joined by some `w` and the furniture can still be finished after it."""
        return self.solvable and bool(self.feasible_w.any())


class Oracle:
    """Memoized oracle of one piece of furniture."""

    def __init__(self, task: ObjectCentricTask) -> None:
        self.task = task
        self.furniture = task.furniture
        self.graphs = BlockingGraphs(task.furniture)
        self._solvable: dict[frozenset[Parts], bool] = {}

    @property
    def grasp_task(self) -> FullTask | None:
        """Task whose grasps the oracle tests; None if it tests none."""
        return None

    @cached_property
    def _mating_types(self) -> set[tuple[int, int, int, int]]:
        """Pairs of point types that the furniture's connections join, in both orders."""
        out: set[tuple[int, int, int, int]] = set()
        for c in self.furniture.connections:
            a, b = self._point_types[c.part_a, c.point_a], self._point_types[c.part_b, c.point_b]
            out.update([(*a, *b), (*b, *a)])
        return out

    @cached_property
    def _point_types(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Type `(class, orbit)` of each point: symmetries and swaps of equal parts keep the type."""
        out: dict[tuple[int, int], tuple[int, int]] = {}
        for index, shape_class in enumerate(self.furniture.classes):
            orbits: list[Float[np.ndarray, "s 3"]] = []
            for member in shape_class.members:
                for k, point in enumerate(self.furniture.parts[member].points):
                    distances = [np.linalg.norm(o - point.position, axis=1).min() for o in orbits]
                    if not distances or min(distances) > SAME_POINT:
                        distances.append(0.0)
                        orbits.append(shape_class.symmetries @ point.position)
                    out[member, k] = (index, int(np.argmin(distances)))
        return out

    def mates(self, state: TaskState) -> list[LabeledMate]:
        """Return every right ordered pair `(u, k, v, l)` of a state."""
        return [self.label(state, pair) for pair in self.right_pairs(state)]

    def right_pairs(self, state: TaskState) -> list[RightPair]:
        """Return every right ordered pair of a state without its labels, which take most of the time."""
        occupied = state.occupied(self.furniture)
        ends = [
            (part, k, self._point_types[slot, k])
            for group in state.groups
            for part, slot in zip(group.parts, map(group.slot_of_points, group.parts), strict=True)
            for k in range(len(self.furniture.parts[slot].points))
            if (part, k) not in occupied
        ]
        ends.sort()
        out: list[RightPair] = []
        for v, l, type_v in ends:  # noqa: E741
            for u, k, type_u in ends:
                if state.group_of[u] == state.group_of[v] or (*type_u, *type_v) not in self._mating_types:
                    continue
                merge = self.task.pairs.judge_in(state, u, k, v, l)
                if merge is not None:
                    out.append(RightPair(u, k, v, l, merge))
        return out

    def label(self, state: TaskState, pair: RightPair) -> LabeledMate:
        """Return a right pair of a state with its labels."""
        merged = pair.merge.merged
        slot_of = dict(zip(merged.parts, merged.slots, strict=True))
        moving, waiting = (
            frozenset(slot_of[p] for p in state.groups[state.group_of[part]].parts) for part in (pair.u, pair.v)
        )
        feasible_w = self.feasible_w(moving, waiting)
        solvable = bool(feasible_w.any()) and self.state_solvable(state.after_merge(merged))
        return LabeledMate(pair.u, pair.k, pair.v, pair.l, pair.merge, feasible_w, solvable, moving, waiting)

    def state_solvable(self, state: TaskState) -> bool:
        """Return whether the furniture can be finished from a state with straight exits.

        Only slots are examined. A loose part whose points differ from those of the free slots may still not fit; an
        episode that finds this out undoes its last merge.
        """
        assignments = islice(self.task.pairs.slot_assignments(state), _ASSIGNMENTS)
        partitions = {partition_of(assigned) for assigned in assignments}
        return any(self.solvable(partition) for partition in sorted(partitions, key=lambda t: sorted(map(sorted, t))))

    def feasible_w(self, moving: Parts, waiting: Parts) -> Bool[np.ndarray, "6"]:
        """Return for each `w` whether `moving` can reach `waiting` along a straight line above the ground."""
        return self.feasible_along(moving, waiting, UP_AXES)

    def feasible_along(self, moving: Parts, waiting: Parts, axes: Float[np.ndarray, "w 3"]) -> Bool[np.ndarray, "w"]:
        """Return for each axis whether `moving` can reach `waiting` with that axis up; see `feasible_w`.

        Args:
            moving: slots of u's group.
            waiting: slots of v's group.
            axes: unit vectors in the furniture's frame.
        """
        exits = self.graphs.straight_exits(moving, waiting)
        if not len(exits):
            return np.zeros(len(axes), bool)
        rises = (exits @ axes.T).max(axis=0)
        margin = self.graphs.lowest_along(moving, axes) - self.graphs.lowest_along(waiting, axes)
        return (margin > -_SINK) & (rises > _LEAST_RISE) & ((rises > -0.02) | (margin > 0.3))

    def solvable(self, partition: frozenset[Parts]) -> bool:
        """Return whether the groups of a partition can be joined into one with straight exits."""
        if len(partition) == 1:
            return True
        if partition not in self._solvable:
            self._solvable[partition] = any(
                self.solvable(first) and self.solvable(second) for first, second in self._halves(partition)
            )
        return self._solvable[partition]

    def _halves(self, partition: frozenset[Parts]) -> Iterator[tuple[frozenset[Parts], frozenset[Parts]]]:
        """Yield the splits of the union of some groups into two, as partitions of the halves."""
        whole = frozenset[int]().union(*partition)
        for closed in self.graphs.removable(whole, True, partition):
            if self.feasible_w(closed, whole - closed).any() or self.feasible_w(whole - closed, closed).any():
                half = frozenset(g for g in partition if g <= closed)
                yield half, partition - half
