"""Signatures of the relative pose of two parts, and which of them occur in joined groups.

A signature consists of distances: between the centres of both parts, and from the connection points of each to the
centre of the other. It is the same for all equal parts, does not tell mirror images apart, and needs no frames, so that
a part that looks the same when it is turned has the same signature.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_TOLERANCE = 0.004
"""Difference within which distances are equal [m]."""


@dataclass(frozen=True, eq=False)
class PlacedPart:
    """A part in its group's frame."""

    part_class: int
    """Number of its class; nothing tells parts of one class apart."""
    center: Float[np.ndarray, "3"]
    """Origin of the part [m]."""
    points: Float[np.ndarray, "k 3"]
    """Connection points [m]."""

    def moved(self, turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> PlacedPart:
        """Return the part in another frame."""
        return PlacedPart(self.part_class, turn @ self.center + shift, self.points @ turn.T + shift)


class RelativePoses:
    """Numbers of relative poses, and which of them were seen in joined groups."""

    def __init__(self) -> None:
        self._signatures: dict[tuple[int, int], list[Float[np.ndarray, "d"]]] = {}
        self._numbers: dict[tuple[int, int], list[int]] = {}
        self._seen: list[bool] = []

    def see(self, parts: list[PlacedPart]) -> None:
        """Record the parts of one joined group."""
        for number in (self.number(a, b) for a, b in itertools.combinations(parts, 2)):
            self._seen[number] = True

    def between(self, u_parts: list[PlacedPart], v_parts: list[PlacedPart]) -> list[int]:
        """Return the numbers of all relative poses between the parts of two groups."""
        return [self.number(a, b) for a in u_parts for b in v_parts]

    def novel_count(self, numbers: list[int]) -> int:
        """Return how many of some relative poses were never seen."""
        return sum(not self._seen[n] for n in numbers)

    def number(self, a: PlacedPart, b: PlacedPart) -> int:
        """Return the number of the relative pose of two parts; equal poses have the same number."""
        if a.part_class > b.part_class:
            a, b = b, a
        ends = [np.linalg.norm(p.points - q.center, axis=1) for p, q in ((a, b), (b, a))]
        # Two parts of one class have no order.
        ordered = (
            sorted((np.sort(e).tolist() for e in ends), key=sum) if a.part_class == b.part_class else map(np.sort, ends)
        )
        signature = np.concatenate([[np.linalg.norm(a.center - b.center)], *ordered])
        known = self._signatures.setdefault((a.part_class, b.part_class), [])
        for index, other in enumerate(known):
            if len(other) == len(signature) and np.abs(other - signature).max() < _TOLERANCE:
                return self._numbers[a.part_class, b.part_class][index]
        known.append(signature)
        self._numbers.setdefault((a.part_class, b.part_class), []).append(len(self._seen))
        self._seen.append(False)
        return len(self._seen) - 1
