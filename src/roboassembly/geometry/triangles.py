"""Normals, areas and volumes of many triangles at once."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def scaled_normals(corners: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t 3"]:
    """Return the normals of triangles, each as long as twice the triangle's area [m²]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def areas(corners: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t"]:
    """Return the areas of triangles [m²]."""
    return 0.5 * np.linalg.norm(scaled_normals(corners), axis=1)


def unit_normals(
    corners: Float[np.ndarray, "t 3 3"],
) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t"]]:
    """Return the unit normals of triangles, zeros of those without area, and the areas [m²]."""
    normals = 0.5 * scaled_normals(corners)
    area = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(area, 1e-30)[:, None], area


def triple_products(corners: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t"]:
    """Return six times the signed volumes of the tetrahedra between triangles and the origin [m³]."""
    return np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))


def winding_number(corners: Float[np.ndarray, "t 3 3"]) -> float:
    """Return how often triangles wind around the origin: 1 inside a closed surface that faces outward, 0 outside.

    The sum of signed solid angles of van Oosterom and Strackee, The Solid Angle of a Plane Triangle (1983).
    """
    a, b, c = np.swapaxes(corners, 0, 1)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    half_angles = np.arctan2(triple_products(corners), la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(half_angles.sum() / (2.0 * np.pi))


def longest_edges(corners: Float[np.ndarray, "t 3 3"]) -> Float[np.ndarray, "t"]:
    """Return the length of the longest edge of each triangle."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
