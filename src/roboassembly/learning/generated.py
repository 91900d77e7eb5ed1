"""Names of generated furniture that no data set holds, for more training pieces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import cycle, islice

from roboassembly.generate import CHAIRS

EXTRA_SEEDS = 1_000_000_000
"""First seed of extra pieces; no data set reaches it."""
_FAMILIES = ("", "sunk", "fused", "", "fused", "lattice", "", "sunk", "fused", "", "fused", "carcass")
"""Families of extra pieces, in turn; empty stands for the next family of chairs."""


def extra_names(count: int, excluded: Sequence[str], first: int = EXTRA_SEEDS) -> list[str]:
    """Return names of `count` pieces that no data set holds: a third chairs of all families, two thirds simple frames.

    Args:
        count: number of names.
        excluded: families of chairs to leave out.
        first: first seed of each family.
    """
    chairs = cycle(f for f in CHAIRS if f not in excluded)
    used: Counter[str] = Counter()
    names: list[str] = []
    for family in islice(cycle(_FAMILIES), count):
        chosen = family or next(chairs)
        names.append(f"{chosen}:{first + used[chosen]}")
        used[chosen] += 1
    return names
