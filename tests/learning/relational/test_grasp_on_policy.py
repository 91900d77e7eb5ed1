"""Grasp samples of the policy's own episodes: their labels are those of fresh tests and of the outcomes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from relational_cases import TINY

import shapes
from roboassembly.datasets import catalogue
from roboassembly.envs.observation import Observer
from roboassembly.furniture import storage
from roboassembly.furniture.model import PAPER_POINTS
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import CollectResult
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import NO, UNKNOWN, YES, GraspSamples
from roboassembly.learning.relational.grasps.on_policy import collect_on_policy, label_outcome, probe_grasps
from roboassembly.learning.relational.policy import GRASP_PARAMS
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.task import FullTask


@pytest.mark.slow
def test_an_outcome_labels_the_grasps_of_its_action() -> None:
    task = FullTask(shapes.stand())
    state = task.initial_state(np.random.default_rng(0))
    observer = Observer(task.furniture, len(task.furniture.parts), PAPER_POINTS, 1)
    rng, verdicts = np.random.default_rng(1), set[FullVerdict]()
    right = [
        a for a in np.argwhere(task.existing_actions(state.groups)).tolist() if task.merge(state.groups, tuple(a[:4]))
    ]
    for index in rng.permutation(len(right))[:14]:
        action = tuple(right[index])
        fresh, outcome = task.mate_grasp(state.groups, action), task.step(state, action, 5)
        sample = label_outcome(task, state, observer, action, outcome)
        u, v, k, l, g_a, g_b = action  # noqa: E741
        assert sample.pair == (u, k, v, l)
        # At most one label each, and what is known before anything moves is what a fresh test says.
        assert all((labels != UNKNOWN).sum() <= 1 for labels in (sample.fit, sample.reach, sample.finish))
        assert sample.fit[g_a, g_b] == (YES if isinstance(fresh, MateGrasp) else NO)
        assert (sample.finish[g_a, g_b] == YES) == (outcome.verdict is FullVerdict.MERGED)
        picks = sample.pick[[0, 1], [g_a, g_b]]
        labels = [sample.fit[g_a, g_b], sample.reach[g_a, g_b], *picks, sample.finish[g_a, g_b]]
        assert labels.count(NO) == (outcome.verdict is not FullVerdict.MERGED)
        # Nothing is known after the first NO.
        assert set(labels[labels.index(NO) + 1 :] if NO in labels else ()) <= {UNKNOWN}
        verdicts.add(outcome.verdict)
    assert FullVerdict.MERGED in verdicts
    assert len(verdicts) > 1


@pytest.mark.slow
def test_probes_label_actions_as_fresh_tests_do() -> None:
    task = FullTask(shapes.stand())
    state = task.initial_state(np.random.default_rng(0))
    observer = Observer(task.furniture, len(task.furniture.parts), PAPER_POINTS, 1)
    actions = [tuple(a) for a in np.argwhere(task.existing_actions(state.groups)).tolist()]
    right = [a for a in actions if task.merge(state.groups, a[:4])]
    wrong = [a for a in actions if not task.merge(state.groups, a[:4])]
    samples = probe_grasps(task, state, observer, [*wrong[:5], *right[::4]], np.random.default_rng(1))
    assert {sample.pair for sample in samples} == {(a[0], a[2], a[1], a[3]) for a in right[::4]}
    probed = 0
    for sample in samples:
        u, k, v, l = sample.pair  # noqa: E741
        for g_a, g_b in np.argwhere(sample.fit != UNKNOWN).tolist():
            mate = task.mate_grasp(state.groups, (u, v, k, l, g_a, g_b))
            assert sample.fit[g_a, g_b] == (YES if isinstance(mate, MateGrasp) else NO)
            probed += 1
        for g_a, g_b in np.argwhere(sample.reach != UNKNOWN).tolist():
            mate = task.mate_grasp(state.groups, (u, v, k, l, g_a, g_b))
            assert isinstance(mate, MateGrasp)
            assert sample.reach[g_a, g_b] == task.can_mate(state, mate, 2)
            assert sample.pick[0, g_a] == task.can_pick(state, u, mate.grip_a, 0, 3)
            assert sample.pick[1, g_b] == task.can_pick(state, v, mate.grip_b, 1, 4)
        assert (sample.finish == UNKNOWN).all()
    assert probed == len(right[::4])
    # Arms are tested for the first few that fit.
    assert sum(int((sample.reach != UNKNOWN).sum()) for sample in samples) == 3


@pytest.mark.parametrize("more", [[], pytest.param(["three_legged:24"], marks=pytest.mark.slow)])
def test_samples_are_written_once_and_are_reproducible(more: list[str], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    params = {**relational.init(rng, TINY), GRASP_PARAMS: grasping.init(rng)}
    policy, names = tmp_path / "policy.npz", [*more, "upholstered:14", "imported"]
    checkpoint.save(policy, checkpoint.Checkpoint(relational.KIND, params, {"network": asdict(TINY)}, {}))
    folders = {"imported": tmp_path / "imported"}
    storage.save(catalogue.make("cantilever", 1), folders["imported"])

    def collected(out: str) -> dict[str, CollectResult]:
        results = collect_on_policy(names, tmp_path / out, policy, episodes=1, seed=3, jobs=1, folders=folders)
        return {result.name: result for result in results}

    first = collected("a")
    # No gripper can hold an upholstered chair.
    assert first["upholstered:14"].states == 0
    assert first["imported"].states > 0
    assert not collected("a")
    again = collected("b")
    for name, result in first.items():
        assert (result.states, result.mistakes) == (again[name].states, again[name].mistakes)
        samples = GraspSamples.load(dataset_file(tmp_path / "a", name)).samples
        assert len(samples) == result.states
        assert sum(int((sample.finish == YES).sum()) for sample in samples) == result.choices - result.mistakes
