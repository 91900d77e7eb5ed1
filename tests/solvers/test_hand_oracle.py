"""Tests of the oracle of the full setting against the checks of the task."""

from __future__ import annotations

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.options import fitting
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.task import FullTask


def test_the_hand_oracle_agrees_with_the_task() -> None:
    task = FullTask(catalogue.make("stool", 3))
    oracle = HandOracle(task)
    rng = np.random.default_rng(0)
    state = task.initial_state(rng).groups
    mates = oracle.mates(state)
    assert any(mate.viable for mate in mates)
    for index in rng.permutation(len(mates))[:12]:
        mate = mates[index]
        pairs = [((mate.u, mate.k), (mate.v, mate.l))]
        found = next(fitting(task, state, pairs), None)
        if found is not None:
            assert mate.feasible_w.all()
            assert isinstance(task.mate_grasp(state, found), MateGrasp)
        if not mate.feasible_w.any():
            assert found is None
        assert mate.feasible_w.all() == mate.feasible_w.any()
