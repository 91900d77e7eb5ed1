"""How two parts lie to each other, whichever of their like they are; and which of that has been seen in joined groups.

A relation is told by distances: between the centres of both parts, and from each one's connection points to the other's
centre. It does not tell mirror images apart, and needs no frames, so that a part that looks the same when it is turned
about has the same relations.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_SAME = 0.004
"""Metres: distances that differ less are the same."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A part in its group's frame."""

    like: int
    """Number of its class: parts of one class are told from each other by nothing."""
    center: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "k 3"]

    def moved(self, turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]) -> Placed:
        """The part in another frame."""
        return Placed(self.like, turn @ self.center + shift, self.points @ turn.T + shift)


class Relations:
    """Numbers for relations, and which of them have been seen."""

    def __init__(self) -> None:
        self._of: dict[tuple[int, int], list[Float[np.ndarray, "d"]]] = {}
        self._numbers: dict[tuple[int, int], list[int]] = {}
        self._seen: list[bool] = []

    def see(self, parts: list[Placed]) -> None:
        """Parts of one group, joined rightly."""
        for number in (self.number(a, b) for a, b in itertools.combinations(parts, 2)):
            self._seen[number] = True

    def between(self, one: list[Placed], two: list[Placed]) -> Int[np.ndarray, "n"]:
        """Numbers of all relations between the parts of two groups."""
        return np.array([self.number(a, b) for a in one for b in two])

    def strange(self, numbers: Int[np.ndarray, "n"]) -> int:
        """How many of some relations were never seen."""
        return sum(not self._seen[n] for n in numbers)

    def number(self, a: Placed, b: Placed) -> int:
        """Of the relation between two parts, the same for all that are the same."""
        if a.like > b.like:
            a, b = b, a
        ends = [np.linalg.norm(p.points - q.center, axis=1) for p, q in ((a, b), (b, a))]
        # Of two that are alike neither is the first.
        ordered = sorted((np.sort(e).tolist() for e in ends), key=sum) if a.like == b.like else map(np.sort, ends)
        told = np.concatenate([[np.linalg.norm(a.center - b.center)], *ordered])
        known = self._of.setdefault((a.like, b.like), [])
        for index, other in enumerate(known):
            if len(other) == len(told) and np.abs(other - told).max() < _SAME:
                return self._numbers[a.like, b.like][index]
        known.append(told)
        self._numbers.setdefault((a.like, b.like), []).append(len(self._seen))
        self._seen.append(False)
        return len(self._seen) - 1
