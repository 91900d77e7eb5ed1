"""Surfaces of meshes prepared for drawing: common vertices, normals that mean something, and smooth neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.triangles import longest_edges, unit_normals

_SHARP = float(np.cos(np.deg2rad(33.0)))
"""Cosine between the normals of two faces below which their common edge is a line of the drawing."""
_CONVEX = 1e-6
"""Share of the hull that a convex solid may lack."""
_SLIVER = 2e-6
"""Height of a triangle below which its normal means nothing [m]."""
_FOLDED, _NEEDLE = -0.5, 2e-3
"""Cosine between the normals of two faces below which they are folded, and ratio of height to length of a needle."""
_GRAIN = 1e-6
"""Distance below which corners of triangles are one vertex [m]."""
_STEP = 5e-4
"""Height of a step between parallel flat faces that is not drawn; repair of imported parts leaves such steps [m]."""
_BULGE, _PARALLEL = 1e-4, 4e-3
"""Distance of a flat patch's vertices from its plane [m], and difference of the normals of parallel patches."""


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """Mesh with common vertices, and its pairs of faces that join smoothly."""

    vertices: Float[np.ndarray, "v 3"]
    """Vertices in the mesh's frame [m]."""
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "f 3"]
    """Unit normals of the faces; slivers have those of faces beside them."""
    smooth: Int[np.ndarray, "e 2"]
    """Pairs of faces whose common edge is no line of a drawing."""
    closed: bool
    """Whether the mesh is solid."""
    convex: bool
    """Whether it is a convex solid."""


@lru_cache(maxsize=2048)
def drawn_surface(mesh: Mesh) -> DrawnSurface:
    """Return the surface of a mesh, prepared for drawing."""
    grid = np.round(mesh.vertices / _GRAIN).astype(np.int64)
    _, first, renumbered = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    vertices, faces = mesh.vertices[first], renumbered.reshape(-1)[mesh.faces]
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    code = edges[:, 0] * len(vertices) + edges[:, 1]
    order = np.argsort(code, kind="stable")
    same = code[order][1:] == code[order][:-1]
    pairs = np.column_stack([order[:-1][same], order[1:][same]]) // 3
    vertices = _without_steps(vertices, faces, pairs)
    normals, areas = unit_normals(vertices[faces])
    longest = longest_edges(vertices[faces])
    known = 2.0 * areas > _SLIVER * longest
    normals[~known] = 0.0
    # Needles that are folded over, as simplified meshes have them, look the wrong way.
    folded = np.unique(pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) < _FOLDED])
    known[folded[2.0 * areas[folded] < _NEEDLE * longest[folded] ** 2]] = False
    ends = edges[order[:-1][same]]
    shared = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    along = shared[:, None] > 0.5 * longest[pairs]
    _spread_normals(normals, known, pairs, along)
    _spread_normals(normals, known, pairs, np.ones_like(along))
    smooth = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > _SHARP]
    convex = mesh.is_solid and mesh.volume > (1.0 - _CONVEX) * float(mesh.hull.volume)
    return DrawnSurface(vertices, faces, normals, smooth, mesh.is_solid, convex)


def _without_steps(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], pairs: Int[np.ndarray, "e 2"]
) -> Float[np.ndarray, "v 3"]:
    """Return the vertices with flat patches moved onto the largest parallel one that lies less than a step away.

    Args:
        vertices: of the mesh [m].
        faces: of the mesh.
        pairs: neighbouring faces.
    """
    normals, areas = unit_normals(vertices[faces])
    links = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > _SHARP]
    graph = coo_array((np.ones(len(links), bool), (links[:, 0], links[:, 1])), shape=(len(faces), len(faces)))
    count, patch = connected_components(graph, directed=False)
    area = np.maximum(np.bincount(patch, areas, count), 1e-30)
    normal = np.column_stack([np.bincount(patch, areas * normals[:, i], count) for i in range(3)]) / area[:, None]
    offset = np.bincount(patch, areas * np.einsum("ij,ij->i", normals, vertices[faces[:, 0]]), count) / area
    corners = np.unique(np.column_stack([faces.reshape(-1), np.repeat(patch, 3)]), axis=0)
    which = corners[:, 1]
    bulge = np.zeros(count)
    np.maximum.at(bulge, which, np.abs(np.einsum("ij,ij->i", vertices[corners[:, 0]], normal[which]) - offset[which]))
    flat = np.flatnonzero((bulge < _BULGE) & (area > _GRAIN**2))
    planes = np.column_stack([normal * (_STEP / _PARALLEL), offset])[flat]
    near = flat[KDTree(planes).query_pairs(_STEP, output_type="ndarray")]
    near = np.concatenate([near, near[:, ::-1]])
    near = near[area[near[:, 0]] < area[near[:, 1]]]
    # The largest neighbour of each patch stands last, and is the one kept.
    near = near[np.argsort(area[near[:, 1]], kind="stable")]
    target = np.arange(count)
    target[near[:, 0]] = near[:, 1]
    # A vertex follows each of its patches once, whatever the number of its triangles there.
    joined = np.isin(which, near)
    corners, onto = corners[joined], target[which[joined]]
    height = offset[onto] - np.einsum("ij,ij->i", vertices[corners[:, 0]], normal[onto])
    moved = vertices.copy()
    np.add.at(moved, corners[:, 0], height[:, None] * normal[onto])
    return moved


def _spread_normals(
    normals: Float[np.ndarray, "f 3"],
    known: Bool[np.ndarray, "f"],
    pairs: Int[np.ndarray, "e 2"],
    along: Bool[np.ndarray, "e 2"],
) -> None:
    """Give slivers, whose own normals mean nothing, the normals of faces beside them.

    Args:
        normals: of all faces; those of slivers are changed.
        known: whether each normal means something; changed too.
        pairs: neighbouring faces.
        along: whether the first face of each pair may get its normal from the second, and the second from the first.
    """
    both = np.concatenate([pairs[along[:, 1]], pairs[along[:, 0]][:, ::-1]])
    while True:
        reached = both[known[both[:, 0]] & ~known[both[:, 1]]]
        if not len(reached):
            return
        normals[reached[:, 1]] = normals[reached[:, 0]]
        known[reached[:, 1]] = True
