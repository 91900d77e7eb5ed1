"""Tests of recoveries: what an expert learns about states beside its first episode."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.learning.paper.dqn.agent import AgentConfig, DQNAgent
from roboassembly.learning.paper.dqn.memoized_env import Action, MemoizedEnv, State
from roboassembly.learning.paper.dqn.network import chair_inputs
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.solvers.mate_checks import FAILS, MERGES
from roboassembly.task.object_centric.task import ObjectCentricTask

_RECOVERIES = 12


def _settled(family: str, seed: int) -> DQNAgent:
    task = ObjectCentricTask(catalogue.make(family, seed, with_grasps=False))
    inputs = chair_inputs(task, np.eye(len(task.furniture.parts), 8, dtype=np.float32))
    config = AgentConfig(recoveries=_RECOVERIES)
    agent = DQNAgent(ReplayBuffer(MemoizedEnv(task, 3), inputs), config, np.random.default_rng(0))
    _run(agent, lambda: agent.settled)
    return agent


def _run(agent: DQNAgent, until: Callable[[], bool]) -> None:
    n = len(agent.buffer.inputs.part)
    for _ in range(20_000):
        if until():
            return
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    raise AssertionError("the agent did not get there")


def _recovered(family: str, seed: int) -> DQNAgent:
    agent = _settled(family, seed)
    agent.begin_recovery()
    _run(agent, lambda: agent.recovery_known)
    return agent


def test_preferred_actions_follow_the_order_of_the_first_episode() -> None:
    buffer = _recovered("cantilever", 1).buffer
    env = buffer.env
    order: list[Action] = []
    at = 0
    while len(buffer.states[at]) > 1:
        action = buffer.finishing_action(buffer.states[at])
        assert action is not None
        assert buffer.preferred[at] == action
        order.append(action)
        at = buffer.merges[at][action]
    assert len(buffer.preferred) > len(order)

    @cache
    def can_finish(at: State) -> bool:
        known, exists = env.known(at), env.exists(at)
        actions = np.argwhere(exists[..., None] & (known < FAILS)).tolist()
        afters = [after for a in actions if (after := env.step(at, (a[0], a[1], a[2]))) is not None]
        return len(at) == 1 or any(can_finish(after) for after in afters)

    for i, (row, column, choice) in buffer.preferred.items():
        state = buffer.states[i]
        assert buffer.finishes(state, (row, column, choice))
        # By brute force: no pair that comes earlier in the first episode leads to the whole.
        for earlier in order:
            if {earlier[0], earlier[1]} == {row, column}:
                break
            after = env.step(state, earlier) if env.exists(state)[earlier[:2]] else None
            assert after is None or not can_finish(after), (state, earlier)


def test_only_the_preferred_action_counts_as_leading_to_the_whole() -> None:
    buffer = _recovered("cantilever", 1).buffer
    several = [i for i in buffer.preferred if sum(buffer.finishes(buffer.states[i], a) for a in buffer.merges[i]) > 1]
    assert several
    batch = buffer.sample(np.random.default_rng(0), 60, 2)
    seen = 0
    for row in range(60):
        i = next(
            j for j in range(len(buffer.states))
            if np.array_equal(buffer.joined[j], batch["joined"][row] > 0)
            and np.array_equal(buffer.free[j], batch["free"][row] > 0)
        )  # fmt: skip
        if i in several:
            seen += 1
            assert [tuple(a) for a in np.argwhere(batch["whole"][row]).tolist()] == [buffer.preferred[i]]
            assert tuple(batch["actions"][row, 0].tolist()) == buffer.preferred[i]
    assert seen


def test_a_restored_recovery_goes_on_alike() -> None:
    first, second = _settled("cantilever", 1), _settled("cantilever", 1)
    first.begin_recovery()
    for _ in range(40):
        first.step(lambda: np.zeros((len(first.buffer.inputs.part),) * 2 + (6,), np.float32))
    second.restore(first.to_arrays())
    assert second.recovers
    for agent in (first, second):
        _run(agent, lambda agent=agent: agent.recovery_known)
    assert first.steps == second.steps
    assert first.buffer.preferred == second.buffer.preferred


def test_a_failure_in_the_real_environment_starts_recovery_anew() -> None:
    agent = _recovered("cantilever", 1)
    start = agent.buffer.env.start
    action = agent.buffer.preferred[0]
    before = [dict(merges) for merges in agent.buffer.merges]
    agent.mark_failed(start, action)
    # All merges that the environment still lets work are kept, in all states, and no others.
    working = [
        {a: j for a, j in merges.items() if agent.buffer.env.known(state)[a] == MERGES}
        for state, merges in zip(agent.buffer.states, before, strict=True)
    ]
    assert agent.buffer.merges == working
    assert sum(map(len, working)) < sum(map(len, before))
    assert not agent.recovers
    assert not agent.buffer.preferred
    _run(agent, lambda: agent.settled)
    agent.begin_recovery()
    assert agent.buffer.preferred[0] != action


def _types(agent: DQNAgent, at: int, action: Action) -> tuple[int, int]:
    """Return the types of the two groups that an action joins."""
    env, state = agent.buffer.env, agent.buffer.states[at]
    u, v = (env.table.groups[env.table.owner(state, row)].type_id for row in action[:2])
    return u, v


def test_a_failure_beside_the_first_episode_keeps_all_that_it_does_not_touch() -> None:
    agent = _recovered("cantilever", 1)
    buffer, episode = agent.buffer, agent.buffer.preferred_episode()
    taken = {_types(agent, at, action) for at, action in episode}
    known = dict(buffer.preferred)
    at, action = next((at, action) for at, action in known.items() if _types(agent, at, action) not in taken)
    agent.mark_failed(buffer.states[at], action)
    assert agent.recovery_known
    assert agent.settled
    assert agent.buffer.preferred_episode() == episode
    assert at not in buffer.preferred
    untouched = {i: a for i, a in known.items() if buffer.finishes(buffer.states[i], a)}
    assert buffer.preferred == untouched
    assert len(episode) < len(untouched) < len(known)


def test_a_third_of_the_updates_is_of_the_preferred_episode() -> None:
    agent = _recovered("cantilever", 1)
    buffer, episode = agent.buffer, [at for at, _ in agent.buffer.preferred_episode()]
    buffer.recent[:] = [next(i for i in range(len(buffer.states)) if i not in episode and buffer.merges[i])]
    batch = buffer.sample(np.random.default_rng(0), 60, 2)
    of_episode = [
        any(np.array_equal(buffer.joined[i], joined > 0) and np.array_equal(buffer.free[i], free > 0) for i in episode)
        for joined, free in zip(batch["joined"], batch["free"], strict=True)
    ]
    assert not any(of_episode[:20])
    assert all(of_episode[20:40])


def test_exploration_goes_on_from_the_first_episode_when_no_known_one_is_left() -> None:
    agent = _recovered("cantilever", 1)
    buffer, episode = agent.buffer, []
    while agent.finished_once:
        episode = [action for _, action in buffer.first_episode()]
        agent.mark_failed(buffer.env.start, episode[0])
    plan = [tuple(pair) for pair in agent.to_arrays()["explorer"]["plan"].tolist()]
    assert plan == [(min(action[:2]), max(action[:2])) for action in episode]
    _run(agent, lambda: agent.settled and agent.finished_once)
    assert buffer.first_episode()[0][1] != episode[0]
