"""Exact groups of the rotations that map a delivered shape onto itself, which is symmetric only approximately."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

MAX_TURNS = 16
"""Largest order of a group; a part turned on a lathe is limited to evenly spaced rotations."""
SAME_TURN = 0.05
"""Largest entry of the difference of two matrices that count as one rotation."""
_STEPS = 4
"""Number of averaging steps; each squares the error of the group."""


def groups(turns: Float[np.ndarray, "n 3 3"]) -> list[Float[np.ndarray, "m 3 3"]]:
    """Return exact groups near the given rotations, the largest first and the trivial group last.

    The groups are all the rotations, if they form a group of at most `MAX_TURNS`, and the rotations about each axis.
    The identity comes first in each group.

    Args:
        turns: approximate symmetries of a shape about its centre.
    """
    found: list[np.ndarray] = []
    whole = _exact_group(turns) if len(turns) <= MAX_TURNS else None
    if whole is not None:
        found.append(whole)
    for axis, order in _axes(turns):
        # Every second or third rotation of a cyclic group that is too large also forms a group.
        order = next(n for n in range(min(order, MAX_TURNS), 0, -1) if order % n == 0)
        angles = 2.0 * np.pi * np.arange(order) / order
        found.append(Rotation.from_rotvec(angles[:, None] * axis).as_matrix())
    found = [g for k, g in enumerate(found) if len(g) > 1 and not any(_same_group(g, other) for other in found[:k])]
    return [*sorted(found, key=len, reverse=True), np.eye(3)[None]]


def _axes(turns: Float[np.ndarray, "n 3 3"]) -> list[tuple[Float[np.ndarray, "3"], int]]:
    """Return the rotation axes, and the order of the largest complete cyclic group about each."""
    vectors = Rotation.from_matrix(turns).as_rotvec()
    sizes = np.linalg.norm(vectors, axis=1)
    axes = vectors[sizes > SAME_TURN] / sizes[sizes > SAME_TURN, None]
    sizes = sizes[sizes > SAME_TURN]
    out: list[tuple[np.ndarray, int]] = []
    while len(axes):
        along = np.abs(axes @ axes[0]) > np.cos(SAME_TURN)
        for order in range(1 + int(along.sum()), 1, -1):
            steps = 2.0 * np.pi * np.arange(1, order // 2 + 1) / order
            if (np.abs(steps[:, None] - sizes[along]).min(axis=1) < SAME_TURN).all():
                mean = (np.sign(axes[along] @ axes[0])[:, None] * axes[along]).sum(axis=0)
                out.append((mean / np.linalg.norm(mean), order))
                break
        axes, sizes = axes[~along], sizes[~along]
    return out


def _exact_group(turns: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"] | None:
    """Return the exact group near the rotations; None if there is none.

    Each rotation g is replaced by the mean over h of the product of gh and the inverse of h, projected to a rotation.
    To first order, the remaining error is a rotation of the whole group, which is harmless (K. Grove, H. Karcher and
    E. A. Ruh, "Group actions and curvature", 1974).
    """
    table = _products(turns)
    if table is None:
        return None
    exact = turns
    for _ in range(_STEPS):
        u, _, vt = np.linalg.svd(np.einsum("ghij,hkj->gik", exact[table], exact))
        exact = u @ vt
    return exact[np.argsort([not np.allclose(r, np.eye(3), atol=1e-6) for r in exact], kind="stable")]


def _products(turns: Float[np.ndarray, "n 3 3"]) -> Int[np.ndarray, "n n"] | None:
    """Return the index of the product of each two rotations; None if a product is missing or ambiguous."""
    products = np.einsum("aij,bjk->abik", turns, turns)
    difference = np.abs(products[:, :, None] - turns[None, None]).max(axis=(3, 4))
    if not ((difference < SAME_TURN).sum(axis=2) == 1).all():
        return None
    return np.argmin(difference, axis=2)


def _same_group(first: Float[np.ndarray, "n 3 3"], second: Float[np.ndarray, "m 3 3"]) -> bool:
    return len(first) == len(second) and bool(
        (np.abs(first[:, None] - second[None]).max(axis=(2, 3)) < SAME_TURN).any(axis=1).all()
    )
