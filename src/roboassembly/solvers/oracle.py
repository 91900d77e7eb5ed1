"""What every action is worth, found by disassembly in the mind: the targets that a policy can be taught with.

The search's own reasoning (blocking graphs, straight exits) without its planner: whether two sub-assemblies can be
joined and who may move is a matter of the furniture alone, so it is worked out once for each pair of sub-assemblies
and remembered. It is cautious: a merge that only a winding path can make counts as impossible here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import SAME_POINT
from roboassembly.solvers.blocking import BlockingGraphs, Parts
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.rules.pairs import Merge

_LEAST_RISE = -0.35
"""Least sine of the climb at which a group leaves: flatter or downward exits end on the ground."""
_PLACES = 24
"""Ways to tell which slots the groups take that are looked at; more differ in equal parts' names only."""
_SINK = 1e-3
"""Metres: a moving group that would reach further down than the waiting one ends up in the ground."""


@dataclass(frozen=True, eq=False)
class LabeledMate:
    """A right pair in some state, and what comes of it."""

    u: int
    k: int
    v: int
    l: int  # noqa: E741
    merge: Merge
    feasible_w: Bool[np.ndarray, "6"]
    """For each `w`, whether u's group can come to v's group along a straight exit above the ground."""
    solvable: bool
    """Whether the furniture can still be finished after this merge."""

    @property
    def viable(self) -> bool:
        """Whether some `w` of this ordered pair leads on."""
        return self.solvable and bool(self.feasible_w.any())


class Oracle:
    """Knows one piece of furniture by heart."""

    def __init__(self, task: ObjectCentricTask) -> None:
        self.task = task
        self.furniture = task.furniture
        self.graphs = BlockingGraphs(task.furniture)
        self._exits: dict[tuple[Parts, Parts], Float[np.ndarray, "n 3"]] = {}
        self._solvable: dict[frozenset[Parts], bool] = {}

    @cached_property
    def _mating_types(self) -> set[tuple[int, int, int, int]]:
        """Kinds of points that the furniture's connections join, both ways round."""
        out = set()
        for c in self.furniture.connections:
            a, b = self._kinds[c.part_a, c.point_a], self._kinds[c.part_b, c.point_b]
            out.update([(*a, *b), (*b, *a)])
        return out

    @cached_property
    def _kinds(self) -> dict[tuple[int, int], tuple[int, int]]:
        """Class and orbit of each point: points that a symmetry, or a swap of equal parts, lays on each other."""
        out = {}
        for index, shape_class in enumerate(self.furniture.classes):
            orbits: list[Float[np.ndarray, "s 3"]] = []
            for member in shape_class.members:
                for k, point in enumerate(self.furniture.parts[member].points):
                    apart = [np.linalg.norm(o - point.position, axis=1).min() for o in orbits]
                    if not apart or min(apart) > SAME_POINT:
                        apart.append(0.0)
                        orbits.append(shape_class.symmetries @ point.position)
                    out[member, k] = (index, int(np.argmin(apart)))
        return out

    def mates(self, state: TaskState) -> list[LabeledMate]:
        """Every right ordered pair `(u, k, v, l)` of a state."""
        taken = state.occupied(self.furniture)
        ends = [
            (part, k, self._kinds[slot, k])
            for group in state.groups
            for part, slot in zip(group.parts, map(group.slot_of_points, group.parts), strict=True)
            for k in range(len(self.furniture.parts[slot].points))
            if (part, k) not in taken
        ]
        ends.sort()
        out = []
        for v, l, kind_v in ends:  # noqa: E741
            for u, k, kind_u in ends:
                if state.group_of[u] == state.group_of[v] or (*kind_u, *kind_v) not in self._mating_types:
                    continue
                u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
                merge = self.task.pairs.judge(u_group, v_group, u, k, v, l)
                if merge is None:
                    continue
                slot_of = dict(zip(merge.merged.parts, merge.merged.slots, strict=True))
                moving = frozenset(slot_of[p] for p in u_group.parts)
                waiting = frozenset(slot_of[p] for p in v_group.parts)
                after = TaskState((*(g for g in state.groups if g is not u_group and g is not v_group), merge.merged))
                ways = self.feasible_w(moving, waiting)
                solvable = bool(ways.any()) and self.state_solvable(after)
                out.append(LabeledMate(u, k, v, l, merge, ways, solvable))
        return out

    def state_solvable(self, state: TaskState) -> bool:
        """Whether straight exits can finish the furniture from here.

        Told by slots alone. A loose part whose points differ from those of the slots that are left may be stuck all
        the same; a play that finds out takes its last move back.
        """
        places = islice(self.task.pairs.slot_assignments(state), _PLACES)
        told = {frozenset(frozenset(g.slots) for g in place.groups) for place in places}
        return any(self.solvable(partition) for partition in sorted(told, key=lambda t: sorted(map(sorted, t))))

    def feasible_w(self, moving: Parts, waiting: Parts) -> Bool[np.ndarray, "6"]:
        """For which `w` `moving` can come straight to `waiting`, above the ground on which that stands."""
        exits = self.exits(moving, waiting)
        if not len(exits):
            return np.zeros(6, bool)
        rises = (exits @ UP_AXES.T).max(axis=0)
        margin = self.graphs.lowest(moving) - self.graphs.lowest(waiting)
        return (margin > -_SINK) & (rises > _LEAST_RISE) & ((rises > -0.02) | (margin > 0.3))

    def exits(self, moving: Parts, waiting: Parts) -> Float[np.ndarray, "n 3"]:
        """Directions in which `moving` can leave `waiting` straight, all the way out."""
        key = (moving, waiting)
        if key not in self._exits:
            found = [
                d
                for index, (d, arcs) in enumerate(zip(self.graphs.directions, self.graphs.arcs, strict=True))
                if not any(arcs[p] & waiting for p in moving) and self.graphs.leaves(moving, waiting, index)
            ]
            self._exits[key] = np.array(found).reshape(-1, 3)
            self._exits[waiting, moving] = -self._exits[key]
        return self._exits[key]

    def solvable(self, partition: frozenset[Parts]) -> bool:
        """Whether the groups of a partition of some slots can be joined into one, straight exits only."""
        if len(partition) == 1:
            return True
        if partition not in self._solvable:
            self._solvable[partition] = any(
                self.solvable(one) and self.solvable(other) for one, other in self._halves(partition)
            )
        return self._solvable[partition]

    def _halves(self, partition: frozenset[Parts]) -> Iterator[tuple[frozenset[Parts], frozenset[Parts]]]:
        """Ways to take the union of some groups apart in two, as partitions of the halves."""
        whole = frozenset[int]().union(*partition)
        for closed in self.graphs.removable(whole, True, partition):
            if self.feasible_w(closed, whole - closed).any() or self.feasible_w(whole - closed, closed).any():
                one = frozenset(g for g in partition if g <= closed)
                yield one, partition - one
