"""In which order furniture can be put together, found by taking it apart in the mind.

A set of parts can be put together if it splits into two that can be separated and each can be put together itself: an
AND/OR search with memory over splits that blocking graphs offer. No path is planned; whoever does plan strikes out the
splits that turn out not to work, and asks again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.solvers.blocking import BlockingGraphs, Parts
from roboassembly.task.rules.groups import TaskState

Split = tuple[Parts, Parts]
"""Two sub-assemblies; the first is the one that leaves."""
Partition = frozenset[Parts]
"""What is joined so far."""


def partition_of(state: TaskState) -> Partition:
    """The groups of a state, by their slots."""
    return frozenset(frozenset(g.slots) for g in state.groups)


class Disassembly:
    """Ways to take one piece of furniture apart.

    Args:
        furniture: the piece.
        over: whether there is no time left to think.
    """

    def __init__(self, furniture: Furniture, over: Callable[[], bool]) -> None:
        self.furniture = furniture
        self.graphs = BlockingGraphs(furniture)
        self._over = over

    def order(
        self, partition: Partition, struck: set[frozenset[Parts]], straight: bool, exhaustive: bool
    ) -> list[Split] | None:
        """Merges, in an order in which they can be made, that build the whole from the groups of a partition.

        Args:
            partition: what is joined already.
            struck: splits that are out of the question.
            straight: only splits whose leaving part goes straight out.
            exhaustive: splits that blocking graphs do not offer, too.
        """
        memory: dict[Parts, list[Split] | None] = {}

        def build(parts: Parts) -> list[Split] | None:
            if parts in partition:
                return []
            if parts not in memory:
                memory[parts] = None
                memory[parts] = next(ways(parts), None)
            return memory[parts]

        def ways(parts: Parts) -> Iterator[list[Split]]:
            for leaving, staying in self._splits(parts, partition, straight, exhaustive):
                if self._over():
                    return
                if frozenset((leaving, staying)) in struck:
                    continue
                first = build(staying)
                second = build(leaving) if first is not None else None
                if first is not None and second is not None:
                    yield [*first, *second, (leaving, staying)]

        return build(frozenset().union(*partition))

    def _splits(self, parts: Parts, partition: Partition, straight: bool, exhaustive: bool) -> Iterator[Split]:
        """Ways to take `parts` in two that break no group: those that blocking graphs offer, then all others."""
        groups = [g for g in partition if g <= parts]
        offered: set[frozenset[Parts]] = set()
        for closed in self.graphs.removable(parts, straight, groups):
            offered.add(frozenset((closed, parts - closed)))
            yield closed, parts - closed
        for half in self._connected_halves(parts, groups) if exhaustive else ():
            if frozenset((half, parts - half)) not in offered:
                yield half, parts - half

    def _connected_halves(self, parts: Parts, groups: list[Parts]) -> Iterator[Parts]:
        """Connected unions of groups, up to half of them, whose complement is connected too; small ones first."""
        furniture = self.furniture
        layer = set(groups)
        for size in count(1):
            if 2 * size > len(groups):
                return
            for half in sorted(layer, key=sorted):
                if len(furniture.connected_components(parts - half)) == 1:
                    yield half
            reach = {h: frozenset().union(*(furniture.neighbours[p] for p in h)) & parts - h for h in layer}
            layer = {h | g for h in layer for g in groups if g & reach[h]}

    def exits(self, moving: Parts, waiting: Parts) -> list[np.ndarray]:
        """Directions along which no part of `moving` is held by a part of `waiting`."""
        return [
            d
            for d, arcs in zip(self.graphs.directions, self.graphs.arcs, strict=True)
            if not any(arcs[p] & waiting for p in moving)
        ]
