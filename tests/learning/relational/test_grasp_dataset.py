"""Grasp samples of random grasps: their labels are those of fresh tests, and they survive a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import shapes
from roboassembly.errors import InputError
from roboassembly.learning.relational.grasps.dataset import NO, UNKNOWN, YES, GraspLabeler, GraspSamples
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import LabeledMate, RightPair
from roboassembly.task.full.failure import PICKING, FullVerdict
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.groups import TaskState


@pytest.mark.slow
def test_labels_are_those_of_fresh_tests(stand_grasps: GraspSamples) -> None:
    task = FullTask(shapes.stand())
    first = task.initial_state(np.random.default_rng(0))
    assert len(stand_grasps.samples) >= len(task.furniture.parts) - 1
    sample = stand_grasps.samples[0]
    u, k, v, l = sample.pair  # noqa: E741
    for g_a, g_b in np.argwhere(sample.fit != UNKNOWN).tolist():
        fresh = task.mate_grasp(first.groups, (u, v, k, l, g_a, g_b))
        assert isinstance(fresh, MateGrasp) == (sample.fit[g_a, g_b] == YES)
        assert sample.fit[g_a, g_b] == YES or sample.reach[g_a, g_b] == UNKNOWN
    # What cannot be picked fails when it is carried out.
    for g_a, g_b in np.argwhere(sample.fit == YES).tolist():
        picked = sample.pick[0, g_a] == YES == sample.pick[1, g_b]
        if not picked or sample.reach[g_a, g_b] == NO:
            outcome = task.step(first, (u, v, k, l, g_a, g_b), 5)
            assert outcome.failure is not None
            assert outcome.verdict is FullVerdict.NO_ARM_SOLUTION or outcome.failure.stage in PICKING
        if sample.finish[g_a, g_b] == YES:
            assert picked
            assert sample.reach[g_a, g_b] == YES


def test_a_file_keeps_the_samples_and_a_broken_one_is_refused(stand_grasps: GraspSamples, tmp_path: Path) -> None:
    stand_grasps.save(tmp_path / "a.npz")
    loaded = GraspSamples.load(tmp_path / "a.npz")
    assert loaded.name == stand_grasps.name
    assert np.array_equal(loaded.grasps, stand_grasps.grasps)
    for a, b in zip(loaded.samples, stand_grasps.samples, strict=True):
        assert a.pair == b.pair
        assert all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("pick", "fit", "reach", "finish"))
        assert np.array_equal(a.connections, b.connections)
    (tmp_path / "a.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="remove it"):
        GraspSamples.load(tmp_path / "a.npz")


def test_a_sample_is_seen_as_the_state_that_it_came_from(stand_grasps: GraspSamples) -> None:
    view = stand_grasps.view(stand_grasps.samples[0])
    assert view.group.tolist() == list(range(len(stand_grasps.clouds)))
    assert np.array_equal(view.grasps, stand_grasps.grasps.astype(float))
    assert stand_grasps.view(stand_grasps.samples[-1]).group.tolist() != view.group.tolist()


def test_pairs_are_labeled_only_until_enough_are_viable(monkeypatch: pytest.MonkeyPatch) -> None:
    """All right pairs of this stand are viable, and the first one of each state can be carried out."""
    task = FullTask(shapes.stand())
    oracle = HandOracle(task)
    labeler = GraspLabeler(task, 1, oracle)
    labeled: list[RightPair] = []

    def label(state: TaskState, pair: RightPair) -> LabeledMate:
        labeled.append(pair)
        return HandOracle.label(oracle, state, pair)

    monkeypatch.setattr(oracle, "label", label)
    samples = labeler.collect(np.random.default_rng(0), 1).samples
    state = task.initial_state(np.random.default_rng(0)).groups
    assert len(labeled) == len(samples) < sum(mate.viable for mate in HandOracle(task).mates(state))
    assert [(p.u, p.k, p.v, p.l) for p in labeled] == [sample.pair for sample in samples]
