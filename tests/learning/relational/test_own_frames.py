"""Own part frames: the same tokens but for what only aligned frames say, and values that follow the frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from relational_cases import TINY, labeled

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import ObservationConfig, Observer
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.examples import examples_of, load_examples
from roboassembly.learning.relational.features import ALIGNED
from roboassembly.learning.relational.own_frames import in_own_frames
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import tokens_of, tokens_of_sample
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import UP_AXES


@pytest.fixture(scope="module")
def same_clouds(cantilever: SampleSet) -> SampleSet:
    """Samples whose resampled clouds are the shared ones."""
    return replace(cantilever, resampled=cantilever.clouds)


def test_only_what_aligned_frames_say_differs(same_clouds: SampleSet) -> None:
    own = in_own_frames(same_clouds, np.random.default_rng(0))
    for before, after in zip(same_clouds.samples, own.samples, strict=True):
        a, b = tokens_of_sample(same_clouds, before), tokens_of_sample(own, after)
        assert np.array_equal(a.matches, b.matches)
        assert np.abs(a.patch.astype(int) - b.patch).max() <= 1
        np.testing.assert_allclose(a.features[:, :ALIGNED], b.features[:, :ALIGNED], atol=0.02)
        assert a.features[:, ALIGNED].all()
        assert not b.features[:, ALIGNED:].any()


def test_noise_moves_clouds_and_imprecision_moves_points(same_clouds: SampleSet) -> None:
    plain, noisy = (
        in_own_frames(same_clouds, np.random.default_rng(0), *sizes) for sizes in ((0.0, 0.0), (0.001, 0.0004))
    )
    assert 0.0005 < np.abs(noisy.clouds - plain.clouds).mean() < 0.0015
    a, b = plain.samples[0].points, noisy.samples[0].points
    exists = a.any(axis=2)
    assert np.array_equal(exists, b.any(axis=2))
    assert 0.0001 < np.abs(a - b)[exists][:, :3].mean() < 0.0008
    assert np.array_equal(a[..., 3:], b[..., 3:])


def test_values_follow_the_axes_that_w_names() -> None:
    """The 24 rotations of a box change what `w` names, and nothing else."""
    furniture = catalogue.make("three_legged", 1)
    task = ObjectCentricTask(furniture)
    state = task.initial_state(np.random.default_rng(0))
    params = relational.init(np.random.default_rng(0), TINY)
    views: list[PolicyView] = []
    frames: list[np.ndarray] = []
    for seed in (0, 1):
        observer = Observer(furniture, *furniture.padding, 128, ObservationConfig("own"), np.random.default_rng(seed))
        mask = task.existing_actions(state, *furniture.padding)
        views.append(PolicyView.from_observation(observer.observe(state), mask, "own"))
        frames.append(observer.frames.part_from_own)
    assert not np.allclose(frames[0], frames[1])
    first, second = (tokens_of(view) for view in views)
    a, b = (relational.values(params, tokens) for tokens in (first, second))
    for column, part in enumerate(first.part):
        order = np.argmax((UP_AXES @ frames[0][part].T) @ (UP_AXES @ frames[1][part].T).T, axis=1)
        np.testing.assert_allclose(a[:, column], b[:, column][:, order], atol=2e-2)


def test_labels_of_own_frames_are_those_of_the_axes() -> None:
    """Boards along the furniture's axes have principal axes among them, so both kinds of `w` name the same poses."""
    named = 0
    for samples in map(labeled, ("carcass:2", "carcass:5", "shelf_open:1")):
        assert samples.principal is not None
        assert samples.structure is not None
        classes = samples.structure.classes.tolist()
        for sample in samples.samples:
            assert sample.own_w is not None
            for mate, own_w in zip(sample.mates, sample.own_w, strict=True):
                axes = UP_AXES @ samples.principal[mate[2]].T
                # Aligned frames of parts with equals need not be parallel to the furniture's.
                alone = classes.count(classes[mate[2]]) == 1 and not sample.connections[mate[2]].any()
                if alone and np.abs(axes).max(axis=1).min() > 0.9999:
                    order = np.argmax(axes @ UP_AXES.T, axis=1)
                    assert np.array_equal(own_w, mate[5:][order] > 0)
                    named += 1
    assert named


def test_examples_are_kept_as_they_are(cantilever: SampleSet, tmp_path: Path) -> None:
    cantilever.save(tmp_path / "a.npz")
    loaded = SampleSet.load(tmp_path / "a.npz")
    for frames in ("aligned", "own"):
        first, again = (load_examples(tmp_path, ["a"], 1, frames) for _ in range(2))
        assert [f.name for f in (tmp_path / "examples").glob(f"a.{frames}.npz")]
        for one, other in zip(first, again, strict=True):
            assert np.array_equal(one.viable, other.viable)
    for kept, fresh in zip(load_examples(tmp_path, ["a"], 1, "aligned"), examples_of([loaded]), strict=True):
        for name in ("patch", "features", "frame", "axes", "bounds", "exits", "matches", "cycles_3", "group"):
            assert np.array_equal(getattr(kept.tokens, name), getattr(fresh.tokens, name)), name
        assert np.array_equal(kept.fits, fresh.fits)
        assert np.array_equal(kept.viable, fresh.viable)
