"""Tests of the oracle against the task: viable mates can be planned and lead to complete furniture."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.planning.problem import Budget
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.groups import TaskState


def after(state: TaskState, joint) -> TaskState:
    gone = (state.groups[state.group_of[joint.u]], state.groups[state.group_of[joint.v]])
    return TaskState((*(g for g in state.groups if not any(g is x for x in gone)), joint.merge.merged))


@pytest.mark.parametrize(
    "name", ["garden:1", "throne:2", *(pytest.param(n, marks=pytest.mark.slow) for n in ("ladder:3", "panel:1"))]
)
def test_every_episode_of_viable_mates_completes(name: str) -> None:
    family, seed = name.split(":")
    task = ObjectCentricTask(catalogue.make(family, int(seed)))
    oracle = Oracle(task)
    rng = np.random.default_rng(5)
    state = task.initial_state(rng)
    merges = 0
    while not state.complete:
        good = [j for j in oracle.mates(state) if j.viable]
        assert good, f"{name}: nothing good after {merges} merges"
        state = after(state, good[rng.integers(len(good))])
        merges += 1
    assert merges == len(task.furniture.parts) - 1


def test_right_pairs_are_those_that_the_task_accepts() -> None:
    task = ObjectCentricTask(catalogue.make("three_legged", 1))
    oracle = Oracle(task)
    state = task.initial_state(np.random.default_rng(0))
    found = {(j.u, j.k, j.v, j.l) for j in oracle.mates(state)}
    free = task.free_points(state)
    ends = [tuple(end) for end in np.argwhere(free).tolist()]
    accepted = {
        (u, k, v, m) for u, k in ends for v, m in ends if u != v and task.prepare(state, (u, v, k, m, 0)) is not None
    }
    assert found == accepted


@pytest.mark.parametrize(
    "name", ["cantilever:1", "folding:2", *(pytest.param(n, marks=pytest.mark.slow) for n in ("windsor:1", "bench:1"))]
)
def test_feasible_w_are_planned_by_retreats(name: str) -> None:
    """The planner plans at least 19 of 20 feasible actions of an episode by a straight retreat."""
    family, seed = name.split(":")
    task = ObjectCentricTask(catalogue.make(family, int(seed)))
    oracle = Oracle(task)
    rng = np.random.default_rng(1)
    state = task.initial_state(rng)
    verdicts = []
    while not state.complete:
        good = [j for j in oracle.mates(state) if j.viable]
        joint = good[rng.integers(len(good))]
        w = int(rng.choice(np.flatnonzero(joint.feasible_w)))
        outcome = task.step(state, (joint.u, joint.v, joint.k, joint.l, w), 0, Budget(states=0))
        verdicts.append(outcome.verdict)
        state = outcome.state if outcome.verdict is ObjectCentricVerdict.MERGED else after(state, joint)
    assert sum(v is ObjectCentricVerdict.MERGED for v in verdicts) >= 0.95 * len(verdicts), verdicts


def test_mates_into_a_dead_end_are_not_viable() -> None:
    """Rungs in blind holes of both sides cannot be inserted once the seat joins the sides."""
    task = ObjectCentricTask(catalogue.make("ladder", 1))
    oracle = Oracle(task)
    state = task.initial_state(np.random.default_rng(0))
    seen = False
    while not state.complete:
        joints = oracle.mates(state)
        bad = [j for j in joints if j.feasible_w.any() and not j.solvable]
        if bad:
            seen = True
            assert not oracle.state_solvable(after(state, bad[0]))
        state = after(state, next(j for j in joints if j.viable))
    assert seen


@pytest.mark.parametrize("family", ["three_legged", pytest.param("splat", marks=pytest.mark.slow)])
def test_answers_with_robots_do_not_depend_on_earlier_ones(family: str) -> None:
    """What the oracle concludes from groups with more or fewer parts is what it finds of these groups alone."""
    task, rng = FullTask(catalogue.make(family, 77)), np.random.default_rng(0)
    oracle, state = HandOracle(task), task.initial_state(rng).groups
    pairs = set[tuple[frozenset[int], frozenset[int]]]()
    while not state.complete:
        mates = oracle.mates(state)
        pairs |= {(mate.moving, mate.waiting) for mate in mates}
        viable = [mate for mate in mates if mate.viable]
        state = after(state, viable[rng.integers(len(viable))])
    answers = {pair: oracle.feasible_w(*pair).any() for pair in pairs}
    assert len(answers) > 20
    assert answers == {pair: HandOracle(task).feasible_w(*pair).any() for pair in pairs}
