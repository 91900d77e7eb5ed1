"""Edges of triangles, and numbers for edges and triangles that have the same vertices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int


def half_edges(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "e"]]:
    """Return the directed edges of all faces, and the face of each."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return directed, np.tile(np.arange(len(faces)), 3)


def numbered(rows: Int[np.ndarray, "n k"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "u"]]:
    """Return a number for each row, the same for rows with the same vertices in any order, and the size of each class.

    The numbers are in the order of the sorted rows.
    """
    number = np.zeros(len(rows), dtype=np.int64)
    count = np.zeros(0, dtype=np.int64)
    for column in np.sort(rows, axis=1).T:
        # The number of the row so far, then the vertex: one sort of plain integers for each column.
        keys = number * (int(rows.max(initial=0)) + 1) + column
        _, number, count = np.unique(keys, return_inverse=True, return_counts=True)
    return number, count
