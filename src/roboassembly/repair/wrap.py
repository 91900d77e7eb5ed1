"""Wrapping: a solid around triangles that do not close, from a distance field on a grid."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy import ndimage
from scipy.spatial import KDTree

from roboassembly.geometry.triangles import scaled_normals, winding_number
from roboassembly.repair.surface import Surface, sample

MAX_NODES = 6_000_000
"""Largest number of grid nodes."""
MAX_NEAR = 300_000
"""Largest number of grid nodes near the surface, where distances are computed."""
FINEST = 0.0015
"""Smallest grid spacing [m]."""
_LAYERS = 7
"""Number of nodes across the band around the surface."""
_PROBES = 24
"""Largest number of nodes of an enclosed region whose winding number is computed."""

# Six tetrahedra fill a cube, around its main diagonal, so that neighbouring cubes agree on their common faces.
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
_TETRAHEDRA = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])

_BLOCK = np.ones((3, 3, 3), dtype=bool)
"""Node and its 26 neighbours."""


def wrap(surface: Surface, closed: Surface | None = None) -> tuple[m3.Manifold, float]:
    """Return a solid whose skin follows the outer side of `surface`, and the grid spacing used [m].

    Space that cannot be reached from outside through openings wider than two grid steps counts as inside. A single
    sheet without an inside becomes a plate two grid steps thick.

    Args:
        surface: surface to wrap.
        closed: the same surface oriented and with its holes filled, if available; it may cross itself. An enclosed
            region is then inside if this surface winds around it, and outside otherwise.
    """
    skin = surface if closed is None else closed
    low, high = skin.vertices.min(axis=0), skin.vertices.max(axis=0)
    size = high - low
    step = max(FINEST, float(np.sqrt(_LAYERS * skin.area / MAX_NEAR)))
    while np.prod(np.ceil(size / step) + 9) > MAX_NODES:
        step *= 1.05
    shape = (np.ceil(size / step) + 9).astype(int)
    origin = low - 4 * step + 0.5 * (size - np.ceil(size / step) * step)
    field = _signed(skin, origin, step, shape, wound=closed is not None)
    points, owner = sample(surface, step)
    solid = np.asarray(ndimage.binary_dilation(field < 0, _BLOCK, iterations=2), dtype=bool)
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
    """Return the distance of each grid node to the surface, at most three steps, the nodes near it and their feet."""
    points, owner = sample(surface, step)
    near = np.zeros(shape, dtype=bool)
    near[tuple(np.rint((points - origin) / step).astype(int).T)] = True
    near = np.asarray(ndimage.binary_dilation(near, _BLOCK, iterations=3), dtype=bool)
    where = np.argwhere(near)
    nodes = origin + where * step
    _, found = KDTree(points).query(nodes, k=3)
    best, nearest = np.full(len(nodes), np.inf), nodes.copy()
    for column in np.minimum(found, len(points) - 1).T:
        closest = trimesh.triangles.closest_point(surface.corners[owner[column]], nodes)
        away = np.nan_to_num(np.linalg.norm(nodes - closest, axis=1), nan=np.inf)
        better = away < best
        best[better], nearest[better] = away[better], closest[better]
    out = np.full(shape, 3.0 * step, dtype=np.float32)
    out[near] = np.minimum(best, 3.0 * step)
    return out, where, nearest


def _signed(
    surface: Surface, origin: Float[np.ndarray, "3"], step: float, shape: Int[np.ndarray, "3"], *, wound: bool
) -> Float[np.ndarray, "x y z"]:
    """Return the signed distance, negative inside: where a ball of one grid step from outside cannot reach.

    With `wound`, the surface must also wind around an inside region.
    """
    distance, where, nearest = _distance(surface, origin, step, shape)
    label = np.zeros(shape, dtype=np.int32)
    ndimage.label(distance > step, output=label)
    outer = np.zeros(int(label.max()) + 1, dtype=bool)
    outer[label[0, 0, 0]] = True
    for region, box in enumerate(ndimage.find_objects(label) if wound else [], start=1):
        if not outer[region]:
            nodes = np.argwhere(label[box] == region)
            nodes = nodes[np.linspace(0, len(nodes) - 1, min(len(nodes), _PROBES)).astype(int)]
            nodes = origin + (nodes + [part.start for part in box]) * step
            outer[region] = np.median(np.abs(_winding(surface, nodes))) < 0.5
    outside = outer[label]
    # A node too close to the surface for the ball is outside if the ball reaches a point further along the normal.
    shy = ~outside[tuple(where.T)]
    node, foot = origin + where[shy] * step, nearest[shy]
    along = node - foot
    length = np.linalg.norm(along, axis=1, keepdims=True)
    probe = foot + along / np.maximum(length, 1e-12) * 1.6 * step
    met = ndimage.map_coordinates(outside.astype(np.float32), ((probe - origin) / step).T, order=1, mode="nearest")
    outside[tuple(where[shy].T)] = (met > 0.5) & (length[:, 0] < 1.6 * step)
    return np.where(outside, distance, -distance)


def _winding(surface: Surface, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Return the winding number of the surface around each point (solid angles of van Oosterom and Strackee)."""
    return np.array([winding_number(surface.corners - point) for point in points])


def _march(field: Float[np.ndarray, "x y z"]) -> tuple[Float[np.ndarray, "v 3"], np.ndarray]:
    """Return the zero surface of `field` by marching tetrahedra, in grid coordinates; it is closed and manifold."""
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
    triangles: list[Int[np.ndarray, "n 3 2"]] = []
    for single in range(4):
        a, b, c = (k for k in range(4) if k != single)
        t = tetra[(code == 1 << single) | (code == 15 - (1 << single))]
        triangles.append(np.stack([t[:, [single, a]], t[:, [single, b]], t[:, [single, c]]], axis=1))
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
    # A face points out of the solid if the field grows along its normal.
    normal = scaled_normals(vertices[faces])
    grow = np.where((u < 0)[:, None], q - p, p - q)[faces].sum(axis=1)
    wrong = np.einsum("ij,ij->i", normal, grow) < 0
    faces[wrong] = faces[wrong][:, ::-1]
    return vertices, faces
