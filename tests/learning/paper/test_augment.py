"""Chairs that are turned, mirrored or scaled are assembled alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.augmentation import FrameChange, augmented
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.oracle_dataset import Labeler


@pytest.fixture(scope="module")
def course() -> SampleSet:
    furniture = catalogue.make("three_legged", 1, with_grasps=True)
    clouds = np.array([surface_points(p.mesh, 96) for p in furniture.parts], np.float32)
    hands = Observer(furniture, len(furniture.parts), MAX_POINTS, 1).grasp_poses
    lessons = Labeler(furniture, clouds).rollout(np.random.default_rng(0)).states
    n = int(lessons[1].free.sum())
    valued = replace(lessons[1], q_values=np.random.default_rng(1).normal(size=(n, n, 6)).astype(np.float16))
    return SampleSet(furniture.name, clouds, (lessons[0], valued, *lessons[2:]), hands)


def test_a_change_by_hand() -> None:
    """Mirrored along x, then turned by 90°: +x goes to -x and on to -y; +y goes to -x."""
    change = FrameChange(quarter_turns=1, mirrored=True)
    assert np.allclose(change.matrix @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    assert np.allclose(change.matrix @ [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0])
    assert np.allclose(change.matrix @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0])


def test_sizes_scale_and_nothing_turns(course: SampleSet) -> None:
    other = augmented(course, FrameChange(scale=1.25))
    assert np.allclose(other.clouds, 1.25 * course.clouds, atol=1e-6)
    before, after = course.samples[1], other.samples[1]
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
