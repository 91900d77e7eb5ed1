"""Wrap: a solid around triangles that do not close, from a distance field on a grid."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.spatial import KDTree

from roboassembly.furniture.repair.surface import Surface, sample

MAX_NODES = 700_000
FINEST = 0.0015
"""Smallest grid spacing, in metres."""

# Six tetrahedra fill a cube, all around its main diagonal, so that neighbouring cubes agree on their common faces.
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
_TETRAHEDRA = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])


def wrap(surface: Surface) -> tuple[m3.Manifold, float]:
    """A solid whose skin follows the outer side of `surface`, and the grid spacing used, in metres.

    Space that cannot be reached from outside through openings wider than two grid steps counts as inside. Where
    the surface is a single sheet, with no inside, the result is a plate two grid steps thick around it.
    """
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    size = high - low
    step = FINEST
    while np.prod(np.ceil(size / step) + 9) > MAX_NODES:
        step *= 1.05
    shape = (np.ceil(size / step) + 9).astype(int)
    origin = low - 4 * step + 0.5 * (size - np.ceil(size / step) * step)
    field = _signed(surface, origin, step, shape)
    points, owner = sample(surface, step)
    solid = np.asarray(ndimage.binary_dilation(field < 0, np.ones((3, 3, 3)), iterations=2), dtype=bool)
    lost = ~solid[tuple(np.rint((points - origin) / step).astype(int).T)]
    if lost.any():
        sheet = Surface(surface.vertices, surface.faces[np.unique(owner[lost])]).compact()
        field = np.minimum(field, _distance(sheet, origin, step, shape)[0] - step)
    vertices, faces = _march(field)
    mesh = m3.Mesh64(np.ascontiguousarray(vertices * step + origin), np.ascontiguousarray(faces.astype(np.uint64)))
    return m3.Manifold(mesh), step


def _distance(
    surface: Surface, origin: Float[np.ndarray, "3"], step: float, shape: Int[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "x y z"], Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Distance from each grid node to the surface, capped at three steps; the nodes near it; their nearest points."""
    points, owner = sample(surface, step)
    near = np.zeros(shape, dtype=bool)
    near[tuple(np.rint((points - origin) / step).astype(int).T)] = True
    near = np.asarray(ndimage.binary_dilation(near, np.ones((3, 3, 3)), iterations=3), dtype=bool)
    where = np.argwhere(near)
    nodes = origin + where * step
    _, found = KDTree(points).query(nodes, k=3)
    best, nearest = np.full(len(nodes), np.inf), nodes.copy()
    for column in np.minimum(found, len(points) - 1).T:
        closest = trimesh.triangles.closest_point(surface.corners[owner[column]], nodes)
        away = np.nan_to_num(np.linalg.norm(nodes - closest, axis=1), nan=np.inf)
        better = away < best
        best[better], nearest[better] = away[better], closest[better]
    out = np.full(shape, 3.0 * step)
    out[near] = np.minimum(best, 3.0 * step)
    return out, where, nearest


def _signed(
    surface: Surface, origin: Float[np.ndarray, "3"], step: float, shape: Int[np.ndarray, "3"]
) -> Float[np.ndarray, "x y z"]:
    """Distance, negative inside: where a ball of one grid step, rolling in from the border, cannot get."""
    distance, where, nearest = _distance(surface, origin, step, shape)
    label = np.zeros(shape, dtype=np.int32)
    ndimage.label(distance > step, output=label)
    outside = label == label[0, 0, 0]
    # A node too near the surface for the ball is outside when the ball is met a little further along the normal.
    shy = ~outside[tuple(where.T)]
    node, foot = origin + where[shy] * step, nearest[shy]
    along = node - foot
    length = np.linalg.norm(along, axis=1, keepdims=True)
    probe = foot + along / np.maximum(length, 1e-12) * 1.6 * step
    met = ndimage.map_coordinates(outside.astype(np.float32), ((probe - origin) / step).T, order=1, mode="nearest")
    outside[tuple(where[shy].T)] = (met > 0.5) & (length[:, 0] < 1.6 * step)
    return np.where(outside, distance, -distance)


def _march(field: Float[np.ndarray, "x y z"]) -> tuple[Float[np.ndarray, "v 3"], np.ndarray]:
    """The zero surface of `field` by marching tetrahedra, in grid coordinates: closed and manifold by construction."""
    field = np.where(np.abs(field) < 1e-9, 1e-9, field)
    inside = field < 0
    a, b, c = (n - 1 for n in inside.shape)
    eight = [inside[x : x + a, y : y + b, z : z + c] for x, y, z in _CORNERS.tolist()]
    count = np.sum(eight, axis=0)
    cells = np.argwhere((count > 0) & (count < 8))
    shape = np.array(field.shape)
    corner = cells[:, None, :] + _CORNERS[None]
    flat = (corner[..., 0] * shape[1] + corner[..., 1]) * shape[2] + corner[..., 2]
    tetra = flat[:, _TETRAHEDRA].reshape(-1, 4)
    value = field.reshape(-1)
    code = ((value[tetra] < 0) * np.array([1, 2, 4, 8])).sum(axis=1)
    triangles = []
    for one in range(4):
        a, b, c = (k for k in range(4) if k != one)
        t = tetra[(code == 1 << one) | (code == 15 - (1 << one))]
        triangles.append(np.stack([t[:, [one, a]], t[:, [one, b]], t[:, [one, c]]], axis=1))
    for a, b in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        c, d = (k for k in range(4) if k not in (a, b))
        t = tetra[code == (1 << a) + (1 << b)]
        triangles.append(np.stack([t[:, [a, c]], t[:, [a, d]], t[:, [b, d]]], axis=1))
        triangles.append(np.stack([t[:, [a, c]], t[:, [b, d]], t[:, [b, c]]], axis=1))
    edges = np.sort(np.concatenate(triangles).reshape(-1, 2), axis=1).astype(np.int64)
    key, faces = np.unique(edges[:, 0] * field.size + edges[:, 1], return_inverse=True)
    unique = np.column_stack([key // field.size, key % field.size])
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    p, q = (np.column_stack(np.unravel_index(unique[:, k], tuple(shape))).astype(float) for k in (0, 1))
    u, v = value[unique[:, 0]], value[unique[:, 1]]
    share = np.clip(u / (u - v), 0.02, 0.98)
    vertices: np.ndarray = p + (q - p) * share[:, None]
    # A face points out of the solid when the field grows along its normal.
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    grow = np.where((u < 0)[:, None], q - p, p - q)[faces].sum(axis=1)
    wrong = np.einsum("ij,ij->i", normal, grow) < 0
    faces[wrong] = faces[wrong][:, ::-1]
    return vertices, faces
