"""Augmented tokens are the tokens of augmented furniture."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.learning.augmentation import AUGMENTATIONS, FrameChange, augmented, up_axis_permutation
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.augmentation import augment_tokens
from roboassembly.learning.relational.features import up_axis_features
from roboassembly.learning.relational.oracle_dataset import targets_of
from roboassembly.learning.relational.tokens import Tokens, pad, tokens_of_sample
from roboassembly.task.rules.connections import UP_AXES

CHANGES = [pytest.param(c, marks=pytest.mark.slow if c.quarter_turns in (0, 2) else ()) for c in AUGMENTATIONS]
"""The normal run leaves out those that follow from the others."""


def axis_features(tokens: Tokens) -> np.ndarray:
    return up_axis_features(pad([tokens], len(tokens.part)))[0]


@pytest.mark.parametrize("turns", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
@pytest.mark.parametrize("mirrored", [False, True])
def test_features_stay_and_up_axes_follow_the_change(chair_samples: SampleSet, turns: int, mirrored: bool) -> None:
    change = FrameChange(turns, mirrored)
    other = augmented(chair_samples, change)
    order = [int(np.argmax(UP_AXES @ (change.matrix @ axis))) for axis in UP_AXES]
    for before, after in zip(chair_samples.samples, other.samples, strict=True):
        a, b = tokens_of_sample(chair_samples, before), tokens_of_sample(other, after)
        # How other points would meet, and how high the groups would stand with each axis up.
        for name in ("matches", "cycles_3", "cycles_4"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
        assert np.allclose(axis_features(a)[..., :10], axis_features(b)[:, :, order, :10], atol=2e-3)
        fits, viable = targets_of(a, before)
        fits_after, viable_after = targets_of(b, after)
        assert np.array_equal(fits, fits_after)
        assert np.array_equal(viable, viable_after[:, :, order])
        if before.q_values is not None and after.q_values is not None:
            assert np.array_equal(before.q_values, after.q_values[:, :, order])


@pytest.mark.parametrize("change", CHANGES)
def test_tokens_change_as_the_clouds_do(chair_samples: SampleSet, change: FrameChange) -> None:
    other = augmented(chair_samples, change)
    for before, after in zip(chair_samples.samples, other.samples, strict=True):
        changed, expected = (
            augment_tokens(tokens_of_sample(chair_samples, before), change),
            tokens_of_sample(other, after),
        )
        assert np.abs(changed.patch.astype(int) - expected.patch).max() <= 1
        for name in set(Tokens.__dataclass_fields__) - {"patch", "exits"}:
            assert np.allclose(getattr(changed, name), getattr(expected, name), atol=1e-5), name
        # Points on the border between two pixels fall into another one.
        assert np.abs(changed.exits.astype(int) - expected.exits).mean() < 0.3
        _, viable = targets_of(tokens_of_sample(chair_samples, before), before)
        assert np.array_equal(targets_of(expected, after)[1][:, :, up_axis_permutation(change)], viable)
    with pytest.raises(ValueError, match="clouds"):
        augment_tokens(changed, FrameChange(scale=2.0))


@pytest.mark.parametrize("change", CHANGES)
def test_grasps_change_with_the_parts(chair_samples: SampleSet, change: FrameChange) -> None:
    other = augmented(chair_samples, change)
    assert chair_samples.grasps is not None
    assert other.grasps is not None
    exists = chair_samples.grasps.any(axis=2)
    assert exists.any()
    assert np.array_equal(other.grasps.any(axis=2), exists)
    np.testing.assert_allclose(
        other.grasps[exists][:, :3], chair_samples.grasps[exists][:, :3] @ change.matrix.T, atol=1e-6
    )
