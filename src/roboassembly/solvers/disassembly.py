"""Finds an order of merges by disassembly.

A set of parts can be assembled if it splits into two sets that can be separated and that can be assembled themselves:
a memoized AND/OR search over the splits that blocking graphs offer. It plans no path; a caller that plans rejects the
splits that fail, and asks again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Protocol

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.solvers.blocking import BlockingGraphs, Parts
from roboassembly.task.rules.groups import TaskState

Split = tuple[Parts, Parts]
"""Two sub-assemblies; the first one leaves."""
Partition = frozenset[Parts]
"""Groups that are joined so far, by their slots."""
_EXAMINED = 1_000
"""Number of sub-assemblies that a search for an order of least cost looks at before it takes the next best."""


def partition_of(state: TaskState) -> Partition:
    """Return the groups of a state, by their slots."""
    return frozenset(frozenset(g.slots) for g in state.groups)


class Joinability(Protocol):
    """Tests whether two sub-assemblies can be joined, whichever moves."""

    def may_join(self, first: Parts, second: Parts) -> bool:
        """Return False where they cannot, as far as that is known without much work."""
        ...

    def can_join(self, first: Parts, second: Parts) -> bool:
        """Return whether they can; asked for the splits of an order before any of its merges is tried."""
        ...


class Disassembly:
    """Splits and orders of merges of one piece of furniture.

    Args:
        furniture: the piece.
        over: returns whether the search must stop.
        cost: cost of a split, `(leaving, staying, straight)`, whose sum an order should keep low; 0 is the least. The
            first feasible order is as good as any other if None.
        joinable: returns whether two sub-assemblies, `(leaving, staying)`, can be joined at all; every split counts if
            None.
    """

    def __init__(
        self,
        furniture: Furniture,
        over: Callable[[], bool],
        cost: Callable[[Parts, Parts, bool], int] | None = None,
        joinable: Callable[[Parts, Parts], bool] | None = None,
    ) -> None:
        self.furniture = furniture
        self.graphs = BlockingGraphs(furniture)
        self._over = over
        self._cost = cost
        self._joinable = joinable

    def order(
        self, partition: Partition, rejected: set[frozenset[Parts]], straight: bool, exhaustive: bool
    ) -> list[Split] | None:
        """Return merges, in a feasible order, that build the furniture from a partition; None if none do.

        Args:
            partition: groups that are joined already.
            rejected: splits that must not be used.
            straight: use only splits whose leaving part moves straight out.
            exhaustive: also use splits that blocking graphs do not offer.
        """
        if self._cost is not None:
            return self._cheapest(partition, rejected, straight, exhaustive, self._cost)
        memory: dict[Parts, list[Split] | None] = {}

        def build(parts: Parts) -> list[Split] | None:
            if parts in partition:
                return []
            if parts not in memory:
                memory[parts] = None
                memory[parts] = next(orders(parts), None)
            return memory[parts]

        def orders(parts: Parts) -> Iterator[list[Split]]:
            for leaving, staying in self._splits(parts, partition, straight, exhaustive):
                if self._over():
                    return
                if frozenset((leaving, staying)) in rejected or not self._counts(leaving, staying):
                    continue
                first = build(staying)
                second = build(leaving) if first is not None else None
                if first is not None and second is not None:
                    yield [*first, *second, (leaving, staying)]

        return build(frozenset[int]().union(*partition))

    def _cheapest(
        self,
        partition: Partition,
        rejected: set[frozenset[Parts]],
        straight: bool,
        exhaustive: bool,
        cost: Callable[[Parts, Parts, bool], int],
    ) -> list[Split] | None:
        """Return an order of least cost; after `_EXAMINED` sub-assemblies the next best one.

        The arguments are those of `order`, and the cost of a split.
        """
        memory: dict[Parts, tuple[int, list[Split]] | None] = {}

        def build(parts: Parts) -> tuple[int, list[Split]] | None:
            if parts in partition:
                return 0, []
            if parts not in memory:
                memory[parts] = None
                memory[parts] = best(parts)
            return memory[parts]

        def best(parts: Parts) -> tuple[int, list[Split]] | None:
            out: tuple[int, list[Split]] | None = None
            offered = [
                (cost(*split, straight), split)
                for split in self._splits(parts, partition, straight, exhaustive)
                if frozenset(split) not in rejected and self._counts(*split)
            ]
            for own, (leaving, staying) in sorted(offered, key=lambda item: item[0]):
                if self._over() or (out is not None and (own >= out[0] or len(memory) > _EXAMINED)):
                    break
                first = build(staying)
                second = build(leaving) if first is not None else None
                if first is None or second is None:
                    continue
                total = own + first[0] + second[0]
                if out is None or total < out[0]:
                    out = total, [*first[1], *second[1], (leaving, staying)]
            return out

        found = build(frozenset[int]().union(*partition))
        return None if found is None else found[1]

    def _counts(self, leaving: Parts, staying: Parts) -> bool:
        return self._joinable is None or self._joinable(leaving, staying)

    def _splits(self, parts: Parts, partition: Partition, straight: bool, exhaustive: bool) -> Iterator[Split]:
        """Yield the splits of `parts` that break no group: those of the blocking graphs, then all others."""
        groups = [g for g in partition if g <= parts]
        offered: set[frozenset[Parts]] = set()
        for closed in self.graphs.removable(parts, straight, groups):
            offered.add(frozenset((closed, parts - closed)))
            yield closed, parts - closed
        for half in self._connected_halves(parts, groups) if exhaustive else ():
            if frozenset((half, parts - half)) not in offered:
                yield half, parts - half

    def _connected_halves(self, parts: Parts, groups: list[Parts]) -> Iterator[Parts]:
        """Yield connected unions of at most half of the groups whose complement is connected too; small ones first."""
        furniture = self.furniture
        layer = set(groups)
        for size in count(1):
            if 2 * size > len(groups):
                return
            for half in sorted(layer, key=sorted):
                if len(furniture.connected_components(parts - half)) == 1:
                    yield half
            reach = {h: frozenset[int]().union(*(furniture.neighbours[p] for p in h)) & parts - h for h in layer}
            layer = {h | g for h in layer for g in groups if g & reach[h]}

    def exits(self, moving: Parts, waiting: Parts) -> list[np.ndarray]:
        """Return the directions along which no part of `waiting` blocks a part of `moving`."""
        return [
            d
            for d, arcs in zip(self.graphs.directions, self.graphs.arcs, strict=True)
            if not any(arcs[p] & waiting for p in moving)
        ]
