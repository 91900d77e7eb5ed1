"""How two connection points meet: normals opposed, tangents aligned. Works on NumPy and on JAX arrays."""

from __future__ import annotations

from roboassembly.learning.layers import Array

FLIP = (1.0, -1.0, -1.0)
"""Diagonal of the rotation between the frames of two mated points: the tangent stays, the normal turns."""


def mating_rotations(moving: Array, waiting: Array) -> Array:
    """Return (..., k, l, 3, 3) `waiting_from_moving` rotations of two groups, one for each pair of their points.

    Args:
        moving: (..., k, 3, 3) `group_from_point` rotations of points of the moving group.
        waiting: (..., l, 3, 3) the same of the waiting group.
    """
    xp = moving.__array_namespace__()
    # v_from_u = F_v flip F_u^T
    flip = xp.asarray(FLIP, dtype=moving.dtype)
    return xp.einsum("...lic,...kjc->...klij", waiting * flip, moving)
