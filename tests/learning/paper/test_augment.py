"""Chairs that are turned, mirrored or scaled are assembled alike."""

from __future__ import annotations

import numpy as np

from roboassembly.learning.augmentation import FrameChange, augmented
from roboassembly.learning.datasets import SampleSet


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
