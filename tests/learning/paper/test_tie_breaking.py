"""Which of equally good actions counts: the first one, and the agent finds out which that is."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

pytest.importorskip("jax")

from roboassembly.datasets import catalogue
from roboassembly.learning.paper.dqn.agent import AgentConfig, DQNAgent
from roboassembly.learning.paper.dqn.memoized_env import Action, MemoizedEnv, State
from roboassembly.learning.paper.dqn.network import TIE, chair_inputs, first_best
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.solvers.mate_checks import FAILS
from roboassembly.task.object_centric.task import ObjectCentricTask


def test_the_first_of_nearly_equal_values_is_taken() -> None:
    values = np.full((3, 3, 2), -np.inf, np.float32)
    values[0, 1] = [0.2, 0.5]
    values[1, 0] = [0.94, 0.97]
    values[2, 1] = [0.96, 1.0]
    assert first_best(values) == (1, 0, 1)  # 0.94 is more than a tie below 1.0, 0.97 is not
    assert first_best(values, tie=0.0) == (2, 1, 1)
    assert pytest.approx(0.05) == TIE


def _agent(family: str, seed: int) -> DQNAgent:
    task = ObjectCentricTask(catalogue.make(family, seed, with_grasps=False))
    inputs = chair_inputs(task, np.eye(len(task.furniture.parts), 8, dtype=np.float32))
    return DQNAgent(ReplayBuffer(MemoizedEnv(task, 3), inputs), AgentConfig(), np.random.default_rng(0))


def _settled(agent: DQNAgent) -> DQNAgent:
    n = len(agent.buffer.inputs.part)
    for _ in range(20_000):
        if agent.settled:
            return agent
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    raise AssertionError("the agent did not settle")


@pytest.mark.parametrize(("family", "seed"), [("upholstered", 14), ("cantilever", 1)])
def test_the_agent_finds_the_first_episode_that_finishes(family: str, seed: int) -> None:
    buffer = _settled(_agent(family, seed)).buffer
    env, state = buffer.env, buffer.env.start

    @cache
    def can_finish(at: State) -> bool:
        return len(at) == 1 or any(can_finish(after) for after in _followers(at))

    def _followers(at: State) -> list[State]:
        known, exists = env.known(at), env.exists(at)
        actions = np.argwhere(exists[..., None] & (known < FAILS)).tolist()
        return [after for a in actions if (after := env.step(at, tuple(a))) is not None]

    while len(state) > 1:
        chosen = buffer.finishing_action(state)
        assert chosen is not None
        # By brute force: nothing that comes before leads to the whole.
        for earlier in np.argwhere(env.exists(state)[..., None] & (env.known(state) < FAILS)).tolist():
            action: Action = tuple(earlier)
            if action >= chosen:
                break
            after = env.step(state, action)
            assert after is None or not can_finish(after), (action, chosen)
        follower = env.step(state, chosen)
        assert follower is not None
        state = follower


def test_versions_of_a_chair_settle_on_the_same_episode_and_soon() -> None:
    def episode(agent: DQNAgent) -> list[tuple[int, int]]:
        state, out = agent.buffer.env.start, []
        while len(state) > 1:
            action = agent.buffer.finishing_action(state)
            assert action is not None
            out.append(action[:2])
            state = agent.buffer.states[agent.buffer.merges[agent.buffer.index[state]][action]]
        return out

    def version(number: int) -> DQNAgent:
        task = ObjectCentricTask(catalogue.make("cantilever", 1, number, with_grasps=False))
        inputs = chair_inputs(task, np.eye(len(task.furniture.parts), 8, dtype=np.float32))
        return DQNAgent(ReplayBuffer(MemoizedEnv(task, 3), inputs), AgentConfig(), np.random.default_rng(1))

    source = _settled(version(0))
    alone, helped = version(1), version(1)
    helped.start_from(source.to_arrays())
    assert episode(_settled(alone)) == episode(_settled(helped)) == episode(source)
    assert helped.steps <= alone.steps


def test_a_restored_agent_goes_on_alike() -> None:
    first, second = _agent("cantilever", 1), _agent("cantilever", 1)
    n = len(first.buffer.inputs.part)
    while not first.finished_once:
        first.step(lambda: np.zeros((n, n, 6), np.float32))
    second.restore(first.to_arrays())
    _settled(first)
    _settled(second)
    assert first.steps == second.steps
    assert first.buffer.best_pairs() == second.buffer.best_pairs()
