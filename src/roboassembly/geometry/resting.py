"""Resting poses of a convex body after a random drop, by quasi-static tumbling.

Goldberg et al. 1999, "Part Pose Statistics: Estimators and Experiments". The body lands on a face of its hull with the
probability of the solid angle under which its centre of mass sees that face. From a face beyond which the centre of
mass lies, it topples over an edge to the next one. `trimesh.poses.compute_stable_poses` computes the same numbers, but
takes several times as long, with a library for graphs and a transformed copy of the hull for each pose.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    import trimesh

_SAME_NORMAL = 3
"""Decimals of the normals of faces that give one pose."""


def stable_poses(
    hull: trimesh.Trimesh, center_of_mass: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n"]]:
    """Return the orientations in which a body comes to rest, and their probabilities, the likeliest first.

    Slivers of the hull can make both NaN.

    Args:
        hull: convex hull of the body.
        center_of_mass: inside the hull [m].
    """
    probabilities = _landing_probabilities(hull, center_of_mass)
    _tumble(probabilities, _toppled_onto(hull, center_of_mass))
    normals: dict[tuple[float, ...], Float[np.ndarray, "3"]] = {}
    likely: dict[tuple[float, ...], float] = {}
    keys = np.around(hull.face_normals, decimals=_SAME_NORMAL)
    for face in np.flatnonzero(probabilities > 0.0):
        key = tuple(keys[face].tolist())
        normals.setdefault(key, hull.face_normals[face])
        likely[key] = likely.get(key, 0.0) + float(probabilities[face])
    rotations = np.array([_face_down(normal) for normal in normals.values()]).reshape(-1, 3, 3)
    found = np.array(list(likely.values()))
    order = np.argsort(-found)
    return rotations[order], found[order]


def _landing_probabilities(hull: trimesh.Trimesh, center: Float[np.ndarray, "3"]) -> Float[np.ndarray, "f"]:
    """Return the share of the sphere around the centre that each face covers (L'Huilier's formula)."""
    rays = np.asarray(hull.vertices) - center
    rays = rays / np.sqrt(np.vecdot(rays, rays))[:, None]
    corners = rays[hull.faces]
    a, b, c = (
        np.arccos(np.clip(np.vecdot(corners[:, i], corners[:, j]), -1.0, 1.0)) for i, j in ((0, 1), (1, 2), (2, 0))
    )
    s = (a + b + c) / 2.0
    tangents = np.tan(s / 2) * np.tan((s - a) / 2) * np.tan((s - b) / 2) * np.tan((s - c) / 2)
    return 1.0 / np.pi * np.arctan(np.sqrt(tangents))


def _toppled_onto(hull: trimesh.Trimesh, center: Float[np.ndarray, "3"]) -> dict[int, int]:
    """Return the face onto which the body topples from each face on which it does not stay."""
    from trimesh.triangles import points_to_barycentric

    normals, triangles = hull.face_normals, hull.triangles
    heights = np.einsum("ij,ij->i", normals, center - triangles[:, 0])
    below = center - heights[:, None] * normals
    unstable = np.asarray((points_to_barycentric(triangles, below) < 0).any(axis=1))
    pairs, ends = hull.face_adjacency, hull.vertices[hull.face_adjacency_edges]
    face, neighbor = pairs.T.ravel(), pairs[:, ::-1].T.ravel()
    order = np.argsort(face, kind="stable")
    order = order[unstable[face[order]]]
    face, neighbor, ends = face[order], neighbor[order], ends[order % len(pairs)]
    out: dict[int, int] = {}
    settled: set[int] = set()
    crossed = _over_edge(hull.triangles_center[face], normals[face], ends, below[face])
    for here, there, over in zip(face.tolist(), neighbor.tolist(), crossed.tolist(), strict=True):
        if here not in settled:
            out[here] = there
        if over:
            settled.add(here)
    return out


def _over_edge(
    middle: Float[np.ndarray, "n 3"],
    normal: Float[np.ndarray, "n 3"],
    ends: Float[np.ndarray, "n 2 3"],
    goal: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, "n"]:
    """Return whether a goal in the plane of a face lies beyond an edge, in its wedge as seen from the face's middle."""
    first, second = ends[:, 0], ends[:, 1]
    backward = np.einsum("ij,ij->i", np.cross(first - middle, second - middle), normal)[:, None] < 0
    first, second = np.where(backward, second, first), np.where(backward, first, second)
    return (_side(middle, first, first + normal, goal) >= 0) & (_side(middle, second + normal, second, goal) >= 0)


def _side(
    a: Float[np.ndarray, "n 3"],
    b: Float[np.ndarray, "n 3"],
    c: Float[np.ndarray, "n 3"],
    point: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Return a number that is positive for points on one side of the plane of a, b and c, and negative on the other."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = ((corner - point).T for corner in (a, b, c))
    return ax * (by * cz - bz * cy) + bx * (cy * az - cz * ay) + cx * (ay * bz - az * by)


def _tumble(probabilities: Float[np.ndarray, "f"], onto: dict[int, int]) -> None:
    """Move the probability of each face along the faces onto which the body topples, to where it stays."""
    reached = set(onto.values())
    faces = [face for face in range(len(probabilities)) if face not in reached]
    for _ in range(len(probabilities) + 1):
        moved: list[int] = []
        for face in faces:
            if face in onto:
                probabilities[onto[face]] += probabilities[face]
                probabilities[face] = 0.0
                moved.append(onto[face])
        faces = moved


def _face_down(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation that turns a normal downwards."""
    z = -normal
    x = np.array([-z[1], z[0], 0.0])
    length = np.linalg.norm(x)
    x = np.array([1.0, 0.0, 0.0]) if length == 0.0 else x / length
    y = np.cross(z, x)
    return np.array([x, y / np.linalg.norm(y), z])
