"""Chairs that are turned, mirrored or scaled are assembled alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.augmentation import AUGMENTATIONS, FrameChange, augmented, up_axis_permutation
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.augmentation import augment_tokens
from roboassembly.learning.relational.features import up_axis_features
from roboassembly.learning.relational.oracle_dataset import Labeler, targets_of
from roboassembly.learning.relational.tokens import Tokens, pad, tokens_of_sample
from roboassembly.task.rules.connections import UP_AXES


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


def ways(tokens: Tokens) -> np.ndarray:
    return up_axis_features(pad([tokens], len(tokens.part)))[0]


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
@pytest.mark.parametrize("mirrored", [False, True])
def test_what_fits_what_stays_and_ways_follow_their_axes(course: SampleSet, turns: int, mirrored: bool) -> None:
    change = FrameChange(turns, mirrored)
    other = augmented(course, change)
    order = [int(np.argmax(UP_AXES @ (change.matrix @ axis))) for axis in UP_AXES]
    for before, after in zip(course.samples, other.samples, strict=True):
        a, b = tokens_of_sample(course, before), tokens_of_sample(other, after)
        # How other points would meet, and how high the groups would stand with each axis up.
        for name in ("matches", "cycles_3", "cycles_4"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
        assert np.allclose(ways(a), ways(b)[:, :, order], atol=2e-3)
        right, good = targets_of(a, before)
        right_after, good_after = targets_of(b, after)
        assert np.array_equal(right, right_after)
        assert np.array_equal(good, good_after[:, :, order])
        if before.q_values is not None and after.q_values is not None:
            assert np.array_equal(before.q_values, after.q_values[:, :, order])


@pytest.mark.parametrize("change", AUGMENTATIONS)
def test_tokens_can_be_changed_without_the_clouds(course: SampleSet, change: FrameChange) -> None:
    other = augmented(course, change)
    for before, after in zip(course.samples, other.samples, strict=True):
        told, wanted = augment_tokens(tokens_of_sample(course, before), change), tokens_of_sample(other, after)
        assert np.abs(told.patch.astype(int) - wanted.patch).max() <= 1
        for name in set(Tokens.__dataclass_fields__) - {"patch", "grasps", "clearance"}:
            assert np.allclose(getattr(told, name), getattr(wanted, name), atol=1e-5), name
        _, good = targets_of(tokens_of_sample(course, before), before)
        assert np.array_equal(targets_of(wanted, after)[1][:, :, up_axis_permutation(change)], good)
    with pytest.raises(ValueError, match="clouds"):
        augment_tokens(told, FrameChange(scale=2.0))


@pytest.mark.parametrize("change", AUGMENTATIONS)
def test_hands_are_mirrored_and_turned_with_the_parts(course: SampleSet, change: FrameChange) -> None:
    other = augmented(course, change)
    assert course.grasps is not None
    assert other.grasps is not None
    there = course.grasps.any(axis=2)
    assert there.any()
    assert np.array_equal(other.grasps.any(axis=2), there)
    np.testing.assert_allclose(other.grasps[there][:, :3], course.grasps[there][:, :3] @ change.matrix.T, atol=1e-6)
    for before, after in zip(course.samples, other.samples, strict=True):
        told, wanted = augment_tokens(tokens_of_sample(course, before), change), tokens_of_sample(other, after)
        for a, b in ((told.grasps, wanted.grasps), (told.clearance, wanted.clearance)):
            assert a is not None
            assert b is not None
            # The meshes of the two fingers are each other's mirror image but for a millimetre, a tenth of the scale.
            np.testing.assert_allclose(a.astype(float), b.astype(float), atol=0.1 if change.mirrored else 2e-3)


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
