"""Convex pieces that approximate a solid, for contact in physics: MuJoCo takes every mesh for its convex hull."""

from __future__ import annotations

from functools import lru_cache

import manifold3d as m3
import numpy as np

from roboassembly.geometry.meshes import Mesh

_EXCESS = 0.04
"""Share of its own volume by which the hull of a piece may exceed it."""
_SMALL = 1e-6
"""Volume by which a hull may exceed its piece in any case [m³]."""
_CUTS = 5
"""Number of times that a piece is halved at most."""
_SLIVER = 1e-9
"""Volume of a piece that is left out [m³]."""


@lru_cache(maxsize=1024)
def convex_pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Return convex pieces that cover a solid: halved along its longest side wherever its hull is much larger.

    Mortises and small hollows are closed. A mesh that is not solid is covered by its convex hull.

    Args:
        mesh: the solid.
    """
    solid = m3.Manifold(m3.Mesh64(np.array(mesh.vertices), np.array(mesh.faces, np.uint64)))
    if not mesh.is_solid or solid.status() is not m3.Error.NoError or solid.is_empty():
        return (Mesh.from_trimesh(mesh.hull),)
    found: list[Mesh] = []
    _halve(solid, _CUTS, found)
    return tuple(found)


def _halve(solid: m3.Manifold, cuts: int, found: list[Mesh]) -> None:
    for piece in solid.decompose():
        volume = piece.volume()
        if volume < _SLIVER:
            continue
        hull = piece.hull()
        if not cuts or hull.volume() - volume <= max(_SMALL, _EXCESS * volume):
            surface = hull.to_mesh64()
            found.append(Mesh(surface.vert_properties[:, :3], surface.tri_verts.astype(np.int64)))
            continue
        low, high = np.split(np.array(piece.bounding_box()), 2)
        axis = int(np.argmax(high - low))
        for half in piece.split_by_plane(np.eye(3)[axis], 0.5 * (low + high)[axis]):
            _halve(half, cuts - 1, found)
