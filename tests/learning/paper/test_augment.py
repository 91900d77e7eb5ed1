"""Chairs that are turned, mirrored or scaled are assembled alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.augmentation import FrameChange, augmented, stretch_axes, stretched
from roboassembly.learning.datasets import SampleSet, group_labels


def test_a_change_by_hand() -> None:
    """Mirrored along x, then turned by 90°: +x goes to -x and on to -y; +y goes to -x."""
    change = FrameChange(quarter_turns=1, mirrored=True)
    assert np.allclose(change.matrix @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    assert np.allclose(change.matrix @ [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0])
    assert np.allclose(change.matrix @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])


def test_augmentation_scales_without_turning(chair_samples: SampleSet) -> None:
    other = augmented(chair_samples, FrameChange(scale=1.25))
    assert np.allclose(other.clouds, 1.25 * chair_samples.clouds, atol=1e-6)
    before, after = chair_samples.samples[1], other.samples[1]
    assert np.allclose(after.points[..., :3], 1.25 * before.points[..., :3], atol=1e-6)
    assert np.allclose(after.points[..., 3:], before.points[..., 3:], atol=1e-6)
    assert np.allclose(after.connections[..., :3], 1.25 * before.connections[..., :3], atol=1e-6)
    assert np.allclose(after.connections[..., 3:], before.connections[..., 3:], atol=1e-6)
    assert np.array_equal(after.mates, before.mates)


def test_draws_are_within_bounds_and_reproducible() -> None:
    drawn = [FrameChange.draw(np.random.default_rng(seed)) for seed in range(60)]
    assert drawn[7] == FrameChange.draw(np.random.default_rng(7))
    assert {c.quarter_turns for c in drawn} == {0, 1, 2, 3}
    assert {c.mirrored for c in drawn} == {False, True}
    assert all(0.7 <= c.scale <= 1.4 for c in drawn)


def test_stretched_parts_still_meet(chair_samples: SampleSet) -> None:
    """Joined parts keep their relative pose in the world, and points that coincided still do."""
    factors = np.array([1.2, 0.9, 1.05])[stretch_axes(chair_samples)]
    met = 0
    for sample in chair_samples.samples:
        points, poses, connections = stretched(
            sample.points, sample.poses, sample.connections, group_labels(sample.connections), factors
        )
        assert np.allclose(points[..., :3], sample.points[..., :3] * factors, atol=1e-6)
        there = sample.points.any(axis=-1)
        assert np.allclose(np.linalg.norm(points[there][:, 3:6], axis=1), 1.0)
        assert not points[~there].any()
        for i, j in np.argwhere((sample.connections != 0).any(axis=-1)):
            before, after = _motion(sample.connections[i, j]), _motion(connections[i, j])
            a, b = _motion(poses[i]), _motion(poses[j])
            assert np.allclose(np.linalg.inv(a) @ b, after, atol=1e-5)
            for p, old_p in zip(points[i], sample.points[i], strict=True):
                for q, old_q in zip(points[j], sample.points[j], strict=True):
                    if old_p.any() and old_q.any() and np.allclose(_moved(before, old_q), old_p[:3], atol=1e-3):
                        met += 1
                        assert np.allclose(_moved(after, q), p[:3], atol=2e-3)
    assert met


def test_axes_that_a_turn_mixes_are_stretched_alike(chair_samples: SampleSet) -> None:
    """A stool of three legs, 120° apart; then the same without its joined legs, and with one turned about x."""
    assert stretch_axes(chair_samples).tolist() == [0, 0, 2]
    sample = chair_samples.samples[0]
    connections = np.zeros_like(sample.connections)
    assert stretch_axes(replace(chair_samples, samples=(replace(sample, connections=connections),))).tolist() == [
        0,
        1,
        2,
    ]
    connections[0, 1, 0], connections[0, 1, 3] = 0.3, np.pi / 2
    assert stretch_axes(replace(chair_samples, samples=(replace(sample, connections=connections),))).tolist() == [
        0,
        1,
        1,
    ]


def _motion(pose: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotations_from_euler(pose[3:].astype(float)), pose[:3]
    return out


def _moved(motion: np.ndarray, point: np.ndarray) -> np.ndarray:
    return motion[:3, :3] @ point[:3] + motion[:3, 3]
