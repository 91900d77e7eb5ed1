"""Vertex normals of meshes: crisp edges where faces meet at an angle, smooth shading on curved surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.triangles import scaled_normals

CREASE_ANGLE = float(np.radians(30.0))
"""Angle between two faces [rad] above which their common edge is crisp."""


@dataclass(frozen=True, eq=False)
class ShadedMesh:
    """Mesh whose faces share a vertex only if they belong to one smooth surface."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    """Unit normal of each vertex."""
    faces: Int[np.ndarray, "f 3"]


def shade(mesh: Mesh, crease: float = CREASE_ANGLE) -> ShadedMesh:
    """Return the mesh with vertices split along edges sharper than `crease` radians and without degenerate faces."""
    # Meshes from files often repeat a vertex in every face; vertices at the same position are merged.
    positions, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    corners = positions[faces]
    weighted = scaled_normals(corners)
    double_area = np.linalg.norm(weighted, axis=1)
    solid = double_area > 1e-16
    faces, unit = faces[solid], weighted[solid] / double_area[solid, None]
    surface = _surfaces(faces, unit, crease)
    key = np.stack([faces.reshape(-1), np.repeat(surface, 3)], axis=1)
    pairs, corner = np.unique(key, axis=0, return_inverse=True)
    corner = corner.reshape(-1)
    # Weighted by angle, so that the triangulation of a strip does not show.
    angles = _corner_angles(positions[faces])
    normals = np.zeros((len(pairs), 3))
    np.add.at(normals, corner, unit[:, None].repeat(3, axis=1).reshape(-1, 3) * angles.reshape(-1, 1))
    length = np.linalg.norm(normals, axis=1)
    # The normals of opposite faces of one surface cancel; any direction is as good there.
    normals = np.where(length[:, None] > 1e-9, normals / np.maximum(length, 1e-9)[:, None], [0.0, 0.0, 1.0])
    return ShadedMesh(positions[pairs[:, 0]], normals, corner.reshape(-1, 3))


def _corner_angles(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    return np.arctan2(np.linalg.norm(np.cross(ahead, back), axis=2), np.einsum("fci,fci->fc", ahead, back))


def _surfaces(faces: Int[np.ndarray, "f 3"], unit: Float[np.ndarray, "f 3"], crease: float) -> Int[np.ndarray, "f"]:
    """Return a label per face; two faces share a label if they meet at an edge bent by less than `crease`."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    _, edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    order = np.argsort(edge, kind="stable")
    order = order[count[edge[order]] == 2]
    a, b = owner[order[0::2]], owner[order[1::2]]
    flat = np.einsum("ij,ij->i", unit[a], unit[b]) > np.cos(crease)
    a, b = a[flat], b[flat]
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))
    labels: Int[np.ndarray, "f"] = connected_components(graph, directed=False)[1]
    return labels
