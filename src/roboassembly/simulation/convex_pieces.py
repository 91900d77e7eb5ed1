"""Convex pieces that approximate a solid, for contact in physics: MuJoCo takes every mesh for its convex hull."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d as m3
import numpy as np

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.simulation.mobile_arms import between_pads, grasp_box

_EXCESS = 0.04
"""Share of its own volume by which the hull of a piece may exceed it."""
_SMALL = 1e-6
"""Volume by which a hull may exceed its piece in any case [m³]."""
_CUTS = 5
"""Number of times that a piece is halved at most."""
_SLIVER = 1e-9
"""Volume of a piece that is left out [m³]."""


def convex_pieces(mesh: Mesh, grasps: Sequence[tuple[SE3, float]] = ()) -> tuple[Mesh, ...]:
    """Return convex pieces that cover a solid: halved along its longest side wherever its hull is much larger.

    Around each grasp is one piece, the same that dynamic execution has between the pads. Mortises and small hollows are
    closed. A mesh that is not solid is covered by its convex hull.

    Args:
        mesh: the solid.
        grasps: `mesh_from_tips` of places where a hand may hold it, and the distance between the pads there [m].
    """
    solid = m3.Manifold(m3.Mesh64(np.array(mesh.vertices), np.array(mesh.faces, np.uint64)))
    if not mesh.is_solid or solid.status() is not m3.Error.NoError or solid.is_empty():
        return (Mesh.from_trimesh(mesh.hull),)
    found = [between_pads(mesh, frame, width) for frame, width in grasps]
    for frame, width in grasps:
        solid = solid - m3.Manifold.cube(grasp_box(width), True).transform(frame.homogeneous[:3])
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
