"""Rotations that map one shape onto another: congruent parts, and the symmetries of one part.

Only proper rotations count: a mirror image is a different part.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from roboassembly.geometry.meshes import Mesh, all_within
from roboassembly.geometry.triangles import scaled_normals

TOLERANCE = 1e-4
"""Largest distance between corresponding corners of congruent shapes; below the smallest gap of a joint [m]."""
MAX_SYMMETRIES = 64
"""Largest number of symmetries of a shape; finer tessellation of a turned part would only cost time."""
_BENT = 1e-5
"""Smallest eigenvalue of the normals' scatter at a corner: a bend of 0.3° counts, rounding does not."""
_MAX_CANDIDATES, _MAX_FITS = 4096, 400
_AT_ONCE = 64
"""Number of corners whose distances to all others are computed in one batch."""
_PAIRS = 5
"""Number of pairs of corners that yield candidates."""
_REACH, _SLACK = 1e-3, 3e-4
"""Allowances beyond the tolerance [m]. The first is for corners before the fit, as two corners alone give an inexact
rotation, and for walls of bores, whose places in files are inexact. The second is for distances between corners."""
_CLOSER = 3.0
"""Largest distance of corresponding corners in the final fit, in multiples of the tolerance."""
_SAME_START, _SAME_ROTATION = 0.003, 0.01
"""Largest difference of entries between candidates that are fitted once, and between matrices of one rotation; the
symmetries of the finest shape differ by seven times as much."""
_FEW, _MAX_EDGES = 200, 2000
"""Number of corners in the first fit, and of edges tested at unmatched corners."""
_SAME_CORNER = 1e-6
"""Largest distance between a vertex and its rounded corner [m]."""
_MATCHED = 0.5
"""Smallest share of corners that have to coincide with corners of the other shape."""


def feature_vertices(mesh: Mesh) -> Float[np.ndarray, "k 3"]:
    """Return the corners of the surface: vertices whose adjacent faces have three independent normals.

    Vertices inside a flat face or along a straight edge depend on the triangulation, not the shape, and are left out.
    """
    corners, vertex_of = np.unique(np.round(mesh.vertices / 1e-7).astype(np.int64), axis=0, return_inverse=True)
    vertex_of = vertex_of.reshape(-1)[mesh.faces]
    normals = scaled_normals(mesh.vertices[mesh.faces])
    length = np.linalg.norm(normals, axis=1)
    keep = length > 1e-12
    normals, vertex_of = normals[keep] / length[keep, None], vertex_of[keep]
    scatter = np.zeros((len(corners), 3, 3))
    outer = normals[:, :, None] * normals[:, None, :]
    for column in range(3):
        np.add.at(scatter, vertex_of[:, column], outer)
    eigenvalues = np.linalg.eigvalsh(scatter)
    features = corners[eigenvalues[:, 0] > _BENT] * 1e-7
    return features if len(features) >= 4 else mesh.hull_vertices


def rotations_onto(source: Mesh, target: Mesh, tolerance: float = TOLERANCE) -> Float[np.ndarray, "n 3 3"]:
    """Return every rotation about the origin that maps `source` onto `target`, smallest angle first.

    Both meshes have their centre of mass at the origin of their frame. Shapes are congruent when each corner of one
    lies within `tolerance` metres of a corner of the other or of its surface, since cuts leave spurious corners.
    """
    if abs(source.radius - target.radius) > tolerance + 1e-3 * source.radius:
        return np.empty((0, 3, 3))
    if abs(source.volume - target.volume) > 0.01 * source.volume:
        return np.empty((0, 3, 3))
    a, b = feature_vertices(source), feature_vertices(target)
    candidates = _candidate_rotations(a, b, tolerance)
    if not len(candidates):
        return candidates
    tree_a, tree_b = KDTree(a), KDTree(b)
    few, probe = _few(a), a[np.linspace(0, len(a) - 1, min(len(a), 12)).astype(int)]
    most = tolerance + _REACH
    reach = np.asarray(tree_b.query(np.einsum("cij,pj->cpi", candidates, probe), distance_upper_bound=most)[0])
    found: list[np.ndarray] = []
    hopeful = np.flatnonzero((reach < most).mean(axis=1) > _MATCHED)
    # The closest candidates come first, so that an inexact one does not replace an exact one.
    off = np.minimum(reach[hopeful], most).mean(axis=1)
    left = candidates[hopeful[np.argsort(off.round(6), kind="stable")]]
    fits = 0
    while len(left) and fits < _MAX_FITS:
        rotation = left[0]
        left = left[np.abs(left - rotation).max(axis=(1, 2)) > _SAME_START]
        if _among(rotation, found, probe, tolerance):
            continue
        fits += 1
        matrix = _fitted(rotation, few, b, tree_b, tolerance)
        if matrix is None or _among(matrix, found, probe, tolerance):
            continue
        if len(few) < len(a):
            # Scanned shapes have thousands of corners; a few of them reject most rotations.
            if not _near(few @ matrix.T, tree_b, target, 2.0 * tolerance):
                continue
            matrix = _fitted(matrix, a, b, tree_b, tolerance)
            if matrix is None:
                continue
        if _lies_on(source, a, matrix, tree_b, target, tolerance) and _lies_on(
            target, b, matrix.T, tree_a, source, tolerance
        ):
            found.append(matrix)
    if not found:
        return np.empty((0, 3, 3))
    angles = np.linalg.norm(Rotation.from_matrix(np.array(found)).as_rotvec(), axis=1)
    order = np.argsort(angles.round(6), kind="stable")[:MAX_SYMMETRIES]
    return np.array(found)[order]


def _among(
    rotation: Float[np.ndarray, "3 3"], found: list[np.ndarray], probe: Float[np.ndarray, "n 3"], tolerance: float
) -> bool:
    """Return whether a rotation was found before, up to the error of a fit."""
    if not found:
        return False
    difference = rotation - np.array(found)
    moved = np.linalg.norm(np.einsum("fij,pj->fpi", difference, probe), axis=2).max(axis=1)
    return bool((np.abs(difference).max(axis=(1, 2)) < _SAME_ROTATION).any() or (moved < _CLOSER * tolerance).any())


def _fitted(
    rotation: Float[np.ndarray, "3 3"], a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"], corners: KDTree,
    tolerance: float,
) -> Float[np.ndarray, "3 3"] | None:  # fmt: skip
    """Return the best rotation of corners of `a` onto near corners of `b`, refined on the nearest; None if too few."""
    before = np.empty(0, dtype=np.int64)
    for reach in (tolerance + _REACH, min(tolerance + _REACH, _CLOSER * tolerance)):
        # The tree gives a corner without a mate the index after the last.
        mate = np.asarray(corners.query(a @ rotation.T, distance_upper_bound=reach)[1])
        near = mate < len(b)
        if np.mean(near) < _MATCHED:
            return None
        # The same pairs give the same rotation.
        if not np.array_equal(mate, before):
            rotation = Rotation.align_vectors(b[mate[near]], a[near])[0].as_matrix()
        before = mate
    return rotation


def _near(points: Float[np.ndarray, "n 3"], corners: KDTree, mesh: Mesh, tolerance: float) -> bool:
    """Return whether all points lie at corners of a mesh or on its surface."""
    odd = points[~np.isfinite(corners.query(points, distance_upper_bound=tolerance)[0])]
    return all_within(mesh.bvh, odd, tolerance)


def _few(points: Float[np.ndarray, "n 3"], most: int = _FEW) -> Float[np.ndarray, "m 3"]:
    """Return at most `most` of the points, evenly spaced."""
    return points if len(points) <= most else points[np.linspace(0, len(points) - 1, most).astype(int)]


def _lies_on(
    moved: Mesh, own: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "3 3"], corners: KDTree, mesh: Mesh,
    tolerance: float,
) -> bool:  # fmt: skip
    """Return whether all corners of a rotated shape lie at corners of a mesh, or on its surface with their edges."""
    if not _near(_few(own) @ rotation.T, corners, mesh, tolerance):
        return False
    odd = own[~np.isfinite(corners.query(own @ rotation.T, distance_upper_bound=tolerance)[0])]
    if len(odd) > (1.0 - _MATCHED) * len(own):
        return False
    if not all_within(mesh.bvh, odd @ rotation.T, tolerance):
        return False
    # The rims of a bore also lie on the faces of a board without it; only the wall between them differs.
    middles = _edges(moved, odd) @ rotation.T
    # A near vertex is a quicker test where triangles are small.
    far = ~np.isfinite(KDTree(mesh.vertices).query(middles, distance_upper_bound=tolerance + _REACH)[0])
    return all_within(mesh.bvh, middles[far], tolerance + _REACH)


def _edges(mesh: Mesh, corners: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Return the midpoints of edges at some corners of a mesh, at most `_MAX_EDGES`."""
    if not len(corners):
        return np.empty((0, 3))
    there = np.asarray(KDTree(corners).query(mesh.vertices, distance_upper_bound=_SAME_CORNER)[0]) < _SAME_CORNER
    edges = np.concatenate([mesh.faces[:, [k, k - 1]] for k in range(3)])
    edges = np.unique(np.sort(edges[there[edges].any(axis=1)], axis=1), axis=0)
    return _few(mesh.vertices[edges].mean(axis=1), _MAX_EDGES)


def symmetries(mesh: Mesh, tolerance: float = TOLERANCE) -> Float[np.ndarray, "n 3 3"]:
    """Return the rotations about the centre of mass that map the shape to itself; the first is the exact identity."""
    rotations = rotations_onto(mesh, mesh, tolerance)
    rotations = (
        rotations[[not np.allclose(r, np.eye(3), atol=1e-3) for r in rotations]] if len(rotations) else rotations
    )
    return np.concatenate([np.eye(3)[None], rotations])


def _candidate_rotations(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"], tolerance: float
) -> Float[np.ndarray, "c 3 3"]:
    """Return rotations that map two selected corners of `a` to corners of `b` at the same radii and distance.

    Several pairs are used, because cuts leave spurious corners.
    """
    radius_a, radius_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    slack = tolerance + _SLACK
    likely = np.array([(np.abs(radius_b - r) < slack).sum() for r in radius_a], dtype=float)
    # A corner without a counterpart gives no candidates.
    likely[likely == 0] = np.inf
    far = radius_a > 0.5 * radius_a.max()
    firsts = np.lexsort((-radius_a, np.where(far, likely, np.inf)))
    firsts = firsts[: max(1, int((far & np.isfinite(likely)).sum()))]
    out: list[Float[np.ndarray, "c 3 3"]] = []
    for first in firsts[np.unique(np.linspace(0, len(firsts) - 1, _PAIRS).astype(int))]:
        lever = np.linalg.norm(np.cross(a, a[first]), axis=1) / radius_a[first]
        clear = lever > 0.5 * lever.max()
        seconds = np.lexsort((-lever, np.where(clear, likely, np.inf)))
        second = seconds[0] if not out else seconds[int((clear & np.isfinite(likely)).sum()) // 2]
        out.append(_rotations_of_pair(a[first], a[second], b, radius_b, slack))
    return np.concatenate(out)


def _rotations_of_pair(
    first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"], b: Float[np.ndarray, "m 3"],
    radius_b: Float[np.ndarray, "m"], slack: float,
) -> Float[np.ndarray, "c 3 3"]:  # fmt: skip
    """Return rotations that map two points to corners of `b` at the same radii and distance."""
    span = np.linalg.norm(first - second)
    first_mates = np.flatnonzero(np.abs(radius_b - np.linalg.norm(first)) < slack)
    second_mates = np.flatnonzero(np.abs(radius_b - np.linalg.norm(second)) < slack)
    ends = [np.empty((0, 2), int)]
    # On a ball every corner is a counterpart: all pairs of them would take gigabytes.
    for begin in range(0, len(first_mates), _AT_ONCE):
        some = first_mates[begin : begin + _AT_ONCE]
        distance = np.linalg.norm(b[some][:, None] - b[second_mates][None], axis=2)
        i, j = np.nonzero(np.abs(distance - span) < 2 * slack)
        ends.append(np.stack([some[i], second_mates[j]], axis=1))
        if sum(map(len, ends)) >= _MAX_CANDIDATES:
            break
    pairs = np.concatenate(ends)[:_MAX_CANDIDATES]
    frame_a = _frames(first[None], second[None])[0]
    frames_b = _frames(b[pairs[:, 0]], b[pairs[:, 1]])
    rotations = frames_b @ frame_a.T
    return rotations[np.isfinite(rotations).all(axis=(1, 2))]


def _frames(p: Float[np.ndarray, "n 3"], q: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return right-handed frames with x along p and z along p × q."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x = p / np.linalg.norm(p, axis=1, keepdims=True)
        z = np.cross(p, q)
        z /= np.linalg.norm(z, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)
