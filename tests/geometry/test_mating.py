"""Mating geometry: two points that meet, one pair or many, and distinct directions."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from roboassembly.geometry.mating import (
    FACE_TO_FACE,
    distinct_directions,
    mated_frame,
    mating_pose,
    mating_poses,
    mating_rotations,
)
from roboassembly.geometry.poses import SE3
from shapes import random_pose

GAP = 0.003


def test_mated_points_oppose_their_normals_keep_the_tangent_and_leave_the_gap() -> None:
    rng = np.random.default_rng(0)
    v, u = random_pose(rng, 1.0), random_pose(rng, 1.0)
    met = mating_pose(v, u, GAP) * u
    assert met.rotation[:, 2] == pytest.approx(-v.rotation[:, 2])
    assert met.rotation[:, 0] == pytest.approx(v.rotation[:, 0])
    assert met.translation - v.translation == pytest.approx(GAP * v.rotation[:, 2])


def test_mating_is_mutual() -> None:
    rng = np.random.default_rng(1)
    v, u = random_pose(rng, 1.0), random_pose(rng, 1.0)
    there, back = mating_pose(v, u, GAP), mating_pose(u, v, GAP)
    assert np.allclose((there * back).homogeneous, np.eye(4), atol=1e-12)
    assert np.allclose(mated_frame(mated_frame(v, GAP), GAP).homogeneous, v.homogeneous, atol=1e-12)


def test_many_pairs_at_once_are_the_single_pairs() -> None:
    rng = np.random.default_rng(2)
    us, vs = [random_pose(rng, 1.0) for _ in range(3)], [random_pose(rng, 1.0) for _ in range(4)]
    gaps = rng.uniform(0.0, 0.01, (3, 4))
    rotations, shifts = mating_poses(
        np.array([p.rotation for p in us]), np.array([p.translation for p in us]),
        np.array([p.rotation for p in vs]), np.array([p.translation for p in vs]), gaps,
    )  # fmt: skip
    for i, u in enumerate(us):
        for j, v in enumerate(vs):
            pose = mating_pose(v, u, float(gaps[i, j]))
            assert np.allclose(rotations[i, j], pose.rotation)
            assert np.allclose(shifts[i, j], pose.translation)
    on_jax = mating_rotations(
        jnp.asarray([p.rotation for p in us]), jnp.asarray([p.rotation for p in vs])
    )  # fmt: skip
    assert np.allclose(np.asarray(on_jax), rotations, atol=1e-5)


def test_face_to_face_is_a_half_turn_about_the_tangent() -> None:
    assert np.array_equal(FACE_TO_FACE @ FACE_TO_FACE, np.eye(3))
    assert np.linalg.det(FACE_TO_FACE) == pytest.approx(1.0)
    assert np.array_equal(mated_frame(SE3.Identity()).rotation, FACE_TO_FACE)


def test_distinct_directions_keep_the_first_of_each() -> None:
    x, y = np.eye(3)[:2]
    near = np.array([1.0, 1e-4, 0.0]) / np.linalg.norm([1.0, 1e-4, 0.0])
    assert [d.tolist() for d in distinct_directions([x, near, y, x, -x])] == [x.tolist(), y.tolist(), (-x).tolist()]
