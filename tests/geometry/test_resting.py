from __future__ import annotations

import numpy as np
import pytest
import trimesh

from roboassembly.geometry.resting import stable_poses


def landed(hull: trimesh.Trimesh, center: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Drop a body with `down` below its centre of mass and follow it from face to face; returns the last normal."""
    heights = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0] - center)
    ahead = hull.face_normals @ down
    # It lands on the face that the ray from its centre of mass first leaves through.
    face = int(np.argmin(np.where(ahead > 1e-12, heights / np.where(ahead > 1e-12, ahead, 1.0), np.inf)))
    neighbors = np.concatenate([hull.face_adjacency, hull.face_adjacency[:, ::-1]])
    for _ in range(len(heights)):
        foot = center + heights[face] * hull.face_normals[face]
        around = neighbors[neighbors[:, 0] == face, 1]
        # It tumbles towards the face whose plane the foot of the centre of mass lies farthest beyond.
        beyond = np.einsum("ij,ij->i", hull.face_normals[around], foot - hull.triangles[around, 0])
        if beyond.max() < 1e-9:
            break
        face = int(around[np.argmax(beyond)])
    return hull.face_normals[face]


def test_a_tall_tetrahedron_by_hand() -> None:
    # A needle with a regular base: the centre of mass lies a quarter up, and the three steep faces are alike.
    base = [[np.cos(t), np.sin(t), 0.0] for t in (0.0, 2 * np.pi / 3, 4 * np.pi / 3)]
    hull = trimesh.Trimesh([*base, [0.0, 0.0, 6.0]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], process=False)
    rotations, likely = stable_poses(hull, np.array([0.0, 0.0, 1.5]))
    assert likely.sum() == pytest.approx(1.0)
    down = rotations.transpose(0, 2, 1) @ [0.0, 0.0, -1.0]
    assert np.allclose(down[3], [0.0, 0.0, -1.0])
    # Van Oosterom and Strackee: the base seen from 1.5 above its middle, as a share of the sphere.
    a, b, c = (np.array([x, y, -1.5]) for x, y, _ in base)
    length = np.linalg.norm(a)
    base_share = 2 * np.arctan2(abs(np.dot(a, np.cross(b, c))), length**3 + 3 * length * np.dot(a, b)) / (4 * np.pi)
    assert np.allclose(likely, [*[(1 - base_share) / 3] * 3, base_share])


@pytest.mark.parametrize("seed", range(3))
def test_poses_are_those_of_bodies_dropped_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(12, 3)) * [1.0, 1.5, 2.5])
    rotations, likely = stable_poses(hull, hull.center_mass)
    downs = rng.normal(size=(3000, 3))
    ends = np.array([landed(hull, hull.center_mass, d) for d in downs / np.linalg.norm(downs, axis=1, keepdims=True)])
    normals = rotations.transpose(0, 2, 1) @ [0.0, 0.0, -1.0]
    which = np.argmax(ends @ normals.T, axis=1)
    assert np.allclose((ends * normals[which]).sum(axis=1), 1.0, atol=1e-6)
    share = np.bincount(which, minlength=len(likely)) / len(downs)
    assert np.abs(share - likely).max() < 0.03
    assert (np.diff(likely) <= 0).all()
