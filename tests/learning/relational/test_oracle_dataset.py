"""Samples labelled by the oracle: consistent labels, corrected mistakes, dead ends."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.oracle_dataset import Labeler, targets_of
from roboassembly.learning.relational.tokens import Tokens, tokens_of_sample
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.task.full.task import FullTask


def test_each_state_has_viable_actions_and_these_fit(cantilever: SampleSet) -> None:
    assert len(cantilever.samples) == len(cantilever.clouds) - 1
    for sample in cantilever.samples:
        tokens = tokens_of_sample(cantilever, sample)
        fits, viable = targets_of(tokens, sample)
        assert viable.any()
        assert (viable.any(axis=2) <= fits.astype(bool)).all()
        different = tokens.group[:, None] != tokens.group[None]
        assert different[fits.astype(bool)].all()
        assert fits.sum() == len(sample.mates)


def test_mistakes_of_a_policy_are_corrected(cantilever: SampleSet) -> None:
    labeler = Labeler(catalogue.make("cantilever", 1), cantilever.clouds)

    def hopeless(tokens: Tokens) -> tuple[int, int, int]:
        return 0, 0, 0

    episode = labeler.rollout(np.random.default_rng(0), hopeless)
    assert len(episode.states) == episode.mistakes == 3


def test_viable_actions_of_a_policy_are_carried_out(cantilever: SampleSet) -> None:
    labeler = Labeler(catalogue.make("cantilever", 1), cantilever.clouds)
    first = labeler.rollout(np.random.default_rng(0)).states[0]
    action = next(row for row in first.mates.tolist() if row[4] and any(row[5:]))
    u, k, v, l, _, *feasible = action  # noqa: E741
    chosen: list[tuple[int, int]] = []

    def knows_the_first(tokens: Tokens) -> tuple[int, int, int]:
        row = {(int(p), int(q)): i for i, (p, q) in enumerate(zip(tokens.part, tokens.point, strict=True))}
        if len(chosen):
            return 0, 0, 0
        chosen.append((u, v))
        return row[u, k], row[v, l], feasible.index(1)

    episode = labeler.rollout(np.random.default_rng(0), knows_the_first)
    assert episode.mistakes == len(episode.states) - 1
    assert episode.states[1].group[u] == episode.states[1].group[v]


def test_dead_ends_have_no_viable_action() -> None:
    furniture = catalogue.make("windsor", 0)
    clouds = np.array([surface_points(p.mesh, 64) for p in furniture.parts], np.float32)
    episode = Labeler(furniture, clouds).rollout(np.random.default_rng(1))
    assert len(episode.states) == len(furniture.parts) - 1
    assert len(episode.dead_ends) > 2
    for sample in episode.dead_ends:
        assert not sample.mates[:, 4].any()


@pytest.mark.slow
def test_viable_mates_of_the_full_setting_lead_to_the_finished_furniture() -> None:
    task = FullTask(catalogue.make("stool", 3))
    clouds = np.array([surface_points(p.mesh, 32) for p in task.furniture.parts], np.float32)
    episode = Labeler(task.furniture, clouds, HandOracle(task)).rollout(np.random.default_rng(0))
    assert len(episode.states) == len(task.furniture.parts) - 1
