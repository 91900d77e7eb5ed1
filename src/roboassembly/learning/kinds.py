"""Groups as a rehearsal remembers them: by shape, so that what is known of one leg is known of all its like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from roboassembly.furniture.model import SAME_POINT, Furniture
from roboassembly.poses import SE3

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
