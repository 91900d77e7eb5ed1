"""Experts: Double-DQN targets by hand, outcomes remembered and fresh, resuming, and a small chair mastered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import FurnitureRef, furniture_refs
from roboassembly.envs.observation import Observation, part_clouds
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.geometry.poses import SE3
from roboassembly.learning import checkpoint
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.dqn import network
from roboassembly.learning.paper.dqn.exploration import PlanExplorer
from roboassembly.learning.paper.dqn.memoized_env import Action, MemoizedEnv, State
from roboassembly.learning.paper.dqn.network import ChairInputs, ExpertPolicy, chair_inputs, encode_state, run_expert
from roboassembly.solvers.mate_checks import BLOCKED, FAILS, MERGES, UNKNOWN
from roboassembly.task.full.failure import Failure
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.groups import Group

jax = pytest.importorskip("jax")
from roboassembly.learning.paper import imitation as paper_imitation  # noqa: E402
from roboassembly.learning.paper.aggregation import policy_samples  # noqa: E402
from roboassembly.learning.paper.dqn import losses, results  # noqa: E402
from roboassembly.learning.paper.dqn.agent import AgentConfig, DQNAgent  # noqa: E402
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer  # noqa: E402
from roboassembly.learning.paper.dqn.train import ExpertRun, ExpertTraining, demonstration, partial_file  # noqa: E402
from roboassembly.learning.paper.examples import Augmentation, examples_of  # noqa: E402
from roboassembly.learning.paper.expert_dataset import expert_samples  # noqa: E402


@pytest.mark.parametrize("branches", [(6,), (3, 2)])
def test_bootstrap_of_double_q(branches: tuple[int, ...]) -> None:
    """The online network chooses the next action among those that exist, and the target network tells its worth."""
    rng, n = np.random.default_rng(0), 12
    online, target = (network.init(rng, n, 5, branches) for _ in range(2))
    features, part = rng.normal(size=(n, 5)).astype(np.float32), np.repeat(np.arange(4, dtype=np.int32), 3)
    joined = np.tile(np.eye(20, dtype=np.float32), (3, 1, 1))
    joined[1, 0, 1] = joined[1, 1, 0] = 1
    free = (rng.random((3, n)) < 0.8).astype(np.float32)
    actions = np.array([[[0, 3, 1]], [[4, 9, 5]], [[8, 2, 0]]], np.int32)
    reward, done = np.array([[0.1], [0.1], [0.5]], np.float32), np.array([[False], [False], [True]])
    none = np.zeros((3, n, n, 6), bool)
    batch = {
        "features": features, "part": part, "joined": joined, "free": free, "fails": none, "whole": none,
        "actions": actions, "rewards": reward, "done": done, "bound": np.zeros((3, 1), np.float32),
        "real": np.ones((3, 1), np.float32), "next_joined": joined[::-1], "next_free": free[::-1],
    }  # fmt: skip
    after = features, part, batch["next_joined"], batch["next_free"]
    exists = network.existing_pairs(part, *after[2:])[..., None] & np.ones(6, bool)
    chosen = np.where(exists, network.apply(online, *after), -np.inf).reshape(3, -1).argmax(1)
    worth = network.apply(target, *after).reshape(3, -1)[np.arange(3), chosen]
    aim = np.clip(reward[:, 0] + np.where(done[:, 0], 0, worth), 0, 1)
    q = network.apply(online, features, part, joined, free)[np.arange(3), *actions[:, 0].T]
    assert float(losses.loss(online, target, batch)) == pytest.approx(2 * np.mean((q - aim) ** 2), rel=1e-4)


@pytest.mark.parametrize("branches", [(6,), (3, 2)])
def test_value_of_one_action_is_that_among_all(branches: tuple[int, ...]) -> None:
    rng, n = np.random.default_rng(1), 12
    params = network.init(rng, n, 5, branches)
    state = (
        rng.normal(size=(n, 5)).astype(np.float32), np.repeat(np.arange(4, dtype=np.int32), 3),
        np.tile(np.eye(20, dtype=np.float32), (4, 1, 1)), np.ones((4, n), np.float32),
    )  # fmt: skip
    actions = rng.integers([0, 0, 0], [n, n, 6], (4, 3))
    all_values = network.apply(params, *state)
    assert network.values_of(params, *state, actions) == pytest.approx(all_values[np.arange(4), *actions.T], abs=1e-5)


def test_a_target_is_at_least_the_return_reached_and_within_bounds_by_hand() -> None:
    # 0.2 is raised to the 0.5 that was reached; 0.7 stays, for what was reached is a lower bound, not a replacement;
    # an overestimated 1.3 is cut to the largest return, and -0.1 to 0.
    target, reached = np.array([0.2, 0.7, 1.3, -0.1]), np.array([0.5, 0.5, 0.5, 0.0])
    assert losses.bounded_target(target, reached) == pytest.approx([0.5, 0.7, 1.0, 0.0])


def test_best_action_is_the_best_combination_of_choices() -> None:
    rng = np.random.default_rng(0)
    each = [rng.normal(size=(5, 4, 4, ways)) for ways in (3, 2)]
    exists = rng.random((5, 4, 4)) < 0.5
    q = np.where(exists[..., None], (each[0][..., :, None] + each[1][..., None, :]).reshape(5, 4, 4, 6), -np.inf)
    best = np.stack(np.unravel_index(q.reshape(5, -1).argmax(1), (4, 4, 6)), axis=1)
    assert np.array_equal(losses.best_actions(each, exists), best)


def test_margin_loss_by_hand() -> None:
    # Four actions in each of three states.
    q = np.array([[0.5, 0.7, 0.3, 0.9], [0.5, 0.2, 0.3, 0.1], [0.9, 0.2, 0.3, 0.1]]).reshape(3, 2, 2, 1)
    exists = np.array([[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1]], bool).reshape(q.shape)
    whole = np.array([[1, 0, 1, 0], [0, 0, 0, 0], [1, 0, 0, 0]], bool).reshape(q.shape)
    # 0.7 + 0.1 is above 0.5, the better of two that lead to the whole (0.9 is of an action that does not exist); with
    # no such action nothing is asked; and 0.3 + 0.1 is below 0.9.
    assert losses.margin_loss([q], exists, whole) == pytest.approx([0.3, 0.0, 0.0])


def test_transitions_on_a_complete_path_are_marked() -> None:
    task = _task()
    chair = _chair(task)
    agent = DQNAgent(ReplayBuffer(MemoizedEnv(task, 3), chair), AgentConfig(), np.random.default_rng(0))
    buffer, m, n = agent.buffer, chair.points, len(chair.part)
    while not agent.finished_once:
        assert len(buffer.states) == 1 or not buffer.sample(agent.rng, 24, 2)["whole"].any()
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    batch, path = buffer.sample(agent.rng, 300, 2), buffer.best_path()
    start = (batch["joined"] == buffer.joined[0]).all(axis=(1, 2))
    assert start.any()
    for whole in batch["whole"][start]:
        assert whole.any()
        for action in np.argwhere(whole).tolist():
            states = [buffer.states[0]]
            # Take the best merges from there on: they do end with the chair.
            states.append(buffer.states[buffer.merges[0][tuple(action)]])
            while len(states[-1]) > 1:
                known = buffer.merges[buffer.index[states[-1]]]
                states.append(buffer.states[max(known.values(), key=buffer.reached)])
            assert len(states) == chair.parts
    assert len(path) == chair.parts - 1
    assert not batch["whole"][:, m:].any()


def _buffer_and_demonstration() -> tuple[ReplayBuffer, list[Action]]:
    task = ObjectCentricTask(catalogue.make("plank", 1, with_grasps=False))
    buffer = ReplayBuffer(MemoizedEnv(task, 3), _chair(task))
    return buffer, demonstration(task, buffer.env.table)


def test_a_demonstration_is_asked_for_once() -> None:
    """A search that finds nothing is not repeated after each episode."""
    buffer, _ = _buffer_and_demonstration()
    n, asked = len(buffer.inputs.part), [0]

    def nothing() -> list[Action]:
        asked[0] += 1
        return []

    agent = DQNAgent(buffer, AgentConfig(demonstrate_after=50), np.random.default_rng(0), nothing)
    for _ in range(150):
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    assert not agent.demonstrated
    assert asked == [1]


def test_an_agent_that_is_shown_an_assembly_has_finished_once() -> None:
    buffer, shown = _buffer_and_demonstration()
    n = len(buffer.inputs.part)
    agent = DQNAgent(buffer, AgentConfig(demonstrate_after=50), np.random.default_rng(0), lambda: shown)
    for _ in range(50):
        assert not agent.demonstrated
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    for _ in range(50):
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    assert agent.demonstrated
    assert agent.finished_once
    at = 0
    for action in shown:
        assert buffer.finishes(buffer.states[at], action)
        at = buffer.merges[at][action]


@pytest.mark.slow
def test_what_fails_of_a_demonstration_is_tried_in_other_ways() -> None:
    buffer, shown = _buffer_and_demonstration()
    n = len(buffer.inputs.part)
    buffer.env.step(buffer.states[0], shown[0])
    buffer.env.mark_failed(buffer.states[0], shown[0])
    agent = DQNAgent(buffer, AgentConfig(demonstrate_after=50), np.random.default_rng(0), lambda: shown)
    for _ in range(100):
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    assert agent.demonstrated
    assert not agent.finished_once
    while not agent.finished_once and agent.steps < 4_000:
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    assert agent.finished_once


def _task() -> ObjectCentricTask:
    return ObjectCentricTask(catalogue.make("cantilever", 1))


def _chair(task: ObjectCentricTask) -> ChairInputs:
    return chair_inputs(task, np.eye(len(task.furniture.parts), 8, dtype=np.float32))


def _play_at_random(env: MemoizedEnv, rng: np.random.Generator, episodes: int) -> None:
    for _ in range(episodes):
        state = env.start
        while len(state) > 1:
            known, exists = env.known(state), env.exists(state)[..., None] & np.ones(env.choices, bool)
            options = np.argwhere(exists & (known < FAILS))
            if not len(options):
                break
            works = np.argwhere(known == MERGES)
            options = works if len(works) and rng.random() < 0.5 else options
            row, column, w = options[rng.integers(len(options))].tolist()
            after = env.step(state, (row, column, w))
            if after is None:
                break
            state = after


def test_equal_parts_with_other_points_can_be_learnt() -> None:
    # In a throne one of two equal parts touches one more: whichever part takes its slot has that point then.
    task = ObjectCentricTask(catalogue.make("throne", 7, with_grasps=False))
    counts = [len(p.points) for p in task.furniture.parts]
    chair = _chair(task)
    assert chair.points == sum(counts) + 1
    env = MemoizedEnv(task, 0)
    assert np.array_equal(chair.part[: chair.points], env.part)
    agent = DQNAgent(ReplayBuffer(env, chair), AgentConfig(), np.random.default_rng(0))
    n = len(chair.part)
    for _ in range(300):
        agent.step(lambda: np.zeros((n, n, 6), np.float32))
    assert agent.buffer.sample(agent.rng, 24, 2)["fails"].any()
    expert = ExpertPolicy(chair, network.init(np.random.default_rng(0), n, chair.features.shape[1]))
    assert run_expert(expert, task, 0)


@pytest.mark.parametrize("family", ["cantilever", "three_legged"])
def test_cached_outcomes_equal_fresh_steps(family: str) -> None:
    task = ObjectCentricTask(catalogue.make(family, 1))
    env, rng = MemoizedEnv(task, 3), np.random.default_rng(0)
    _play_at_random(env, rng, 60)
    checked = differing = index = 0
    states = [env.start]
    while index < min(len(states), 8):
        state, index = states[index], index + 1
        known, exists = env.known(state), env.exists(state)
        before = env.laid_out(state)
        for verdict, count in ((MERGES, 4), (FAILS, 8)):
            some = np.argwhere(((known == verdict) | ((known > FAILS) & (verdict == FAILS))) & exists[..., None])
            for row, column, w in some[rng.permutation(len(some))[:count]].tolist():
                names = (env.part[row], env.part[column], env.point[row], env.point[column], w)
                fresh = task.step(before, tuple(int(n) for n in names), 0)
                alike = (fresh.verdict is ObjectCentricVerdict.MERGED) == (verdict == MERGES)
                checked, differing = checked + 1, differing + (not alike)
                if verdict == MERGES and alike:
                    after = env.step(state, (row, column, w))
                    assert after is not None
                    joined, free = encode_state(task, fresh.state)
                    np.testing.assert_array_equal(env.joined(after), joined)
                    np.testing.assert_array_equal(env.owners(after) >= 0, free)
                    states.append(after)
    assert checked > 30
    # Equal parts are equal to a tolerance, and where things lie may decide in a close case. Three legs turned by 120°
    # wait differently with their slots' x axis up: 24 of 600 outcomes in a longer count of this piece.
    assert differing <= 0.05 * checked


@pytest.mark.slow
def test_cached_grasp_outcomes_equal_fresh_tests() -> None:
    """250 outcomes: all tests but the arms' depend on the groups alone, so that nothing may differ."""
    task = FullTask(catalogue.make("three_legged", 24))
    env, rng = MemoizedEnv(task, 3), np.random.default_rng(0)
    _play_at_random(env, rng, 150)
    states, asked = [env.start], {MERGES: 100, FAILS: 50, BLOCKED: 100}
    checked = dict.fromkeys(asked, 0)
    for state in states:
        known, exists = env.known(state), env.exists(state)[..., None]
        before = env.laid_out(state)
        for verdict, most in asked.items():
            actions = np.argwhere((known == verdict) & exists)
            for row, column, way in actions[rng.permutation(len(actions))[: most - checked[verdict]]].tolist():
                ends = (env.part[row], env.part[column], env.point[row], env.point[column])
                fresh = task.mate_grasp(before, (*(int(n) for n in ends), *divmod(way, 8)))
                assert isinstance(fresh, Failure) == (verdict != MERGES)
                checked[verdict] += 1
                if verdict == MERGES:
                    after = env.step(state, (row, column, way))
                    assert after is not None
                    states += [after] if len(after) > 1 and after not in states else []
    assert checked == asked


def test_rotation_in_a_slot_matters_only_with_robots() -> None:
    furniture = catalogue.make("three_legged", 24)
    part = next(p for p, c in enumerate(furniture.class_of) if len(furniture.classes[c].symmetries) > 1)
    other = next(
        c.part_b if c.part_a == part else c.part_a for c in furniture.connections if part in (c.part_a, c.part_b)
    )
    parts = tuple(sorted((part, other)))
    turn = furniture.classes[furniture.class_of[part]].symmetries[-1]
    groups = []
    for rotation in (np.eye(3), turn):
        turned = {part: furniture.assembled[part] * SE3(rotation, np.zeros(3)), other: furniture.assembled[other]}
        groups.append(Group(parts, parts, tuple(turned[p] for p in parts), SE3.Identity()))
    assert not np.allclose(turn, np.eye(3))
    hands, flying = MemoizedEnv(FullTask(furniture), 0), MemoizedEnv(ObjectCentricTask(furniture), 0)
    assert len({hands.table.key(g) for g in groups}) == 2
    assert len({flying.table.key(g) for g in groups}) == 1


def test_an_expert_plays_with_robots() -> None:
    task = FullTask(catalogue.make("three_legged", 24))
    chair = _chair(task)
    assert chair.branches == (8, 8)
    n = len(chair.part)
    agent = DQNAgent(ReplayBuffer(MemoizedEnv(task, 0), chair), AgentConfig(), np.random.default_rng(0))
    for _ in range(40):
        agent.step(lambda: np.zeros((n, n, 64), np.float32))
    batch = agent.buffer.sample(agent.rng, 24, 2)
    assert batch["fails"].shape[1:] == (n, n, 64)
    expert = ExpertPolicy(chair, network.init(np.random.default_rng(0), n, chair.features.shape[1], chair.branches))
    moves = run_expert(expert, task, 0)
    assert moves
    # What the two hands add is added up.
    joined, free = encode_state(task, task.initial_state(np.random.default_rng(0)).groups)
    q = expert.values(joined, free)
    assert q.shape == (chair.points, chair.points, 64)
    u, v = np.argwhere(np.isfinite(q).all(axis=2))[0]
    grid = q[u, v].reshape(8, 8)
    np.testing.assert_allclose(grid - grid[:1] - grid[:, :1] + grid[0, 0], 0.0, atol=1e-5)


@pytest.mark.slow
def test_what_locks_out_is_the_same_for_equal_parts() -> None:
    """Each part alone has the frame of its own slot; results that are kept for one leg must hold for the others."""
    task = ObjectCentricTask(catalogue.make("sled", 4, with_grasps=False))
    env = MemoizedEnv(task, 0)
    agent = DQNAgent(ReplayBuffer(env, _chair(task)), AgentConfig(), np.random.default_rng(0))
    n, locked = env.choices, 0
    for step in range(1_200):
        agent.step(lambda: np.zeros((env.part.size, env.part.size, n), np.float32))
        state = agent.buffer.states[agent.at]
        pairs = np.argwhere(np.triu(env.exists(state) & env.right_pairs))
        if step % 40 == 0 and len(pairs):
            kept = env.geometry.locked_out(state, pairs)
            env.geometry.forget_fits()
            # One pair at a time and in another order: other equal parts come first.
            for pair, count in list(zip(pairs, kept, strict=True))[::-1]:
                assert env.geometry.locked_out(state, pair[None]) == [count]
                env.geometry.forget_fits()
            locked += kept.sum()
    assert locked


def test_groups_with_a_part_missing_between_are_locked_out() -> None:
    sled = catalogue.make("sled", 4)
    env = MemoizedEnv(ObjectCentricTask(sled), 0)
    name = {part.name: i for i, part in enumerate(sled.parts)}
    first = np.searchsorted(env.part, np.arange(len(sled.parts)))

    def rows(one: str, two: str) -> tuple[int, int]:
        """Of the two points at which parts touch."""
        for c in sled.connections:
            for (a, k), (b, l) in ((c.part_a, c.point_a), (c.part_b, c.point_b)), (  # noqa: E741
                (c.part_b, c.point_b), (c.part_a, c.point_a),
            ):  # fmt: skip
                if (a, b) == (name[one], name[two]):
                    return int(first[a] + k), int(first[b] + l)
        raise AssertionError(f"{one} and {two} do not touch")

    def locked_out(state: State, pair: tuple[int, int]) -> int:
        return int(env.geometry.locked_out(state, np.array([pair]))[0])

    start = env.start
    across = rows("seat_rail_right", "post_right")
    # Nothing is known yet, so that nothing is known to belong anywhere.
    assert locked_out(start, across) == 0
    for c in sled.connections:
        row, column = rows(sled.parts[c.part_a].name, sled.parts[c.part_b].name)
        known = env.known(start)[row, column]
        for way in range(6):
            if not (known == MERGES).any():
                env.step(start, (row, column, way))
                known = env.known(start)[row, column]
    row, column = rows("seat_rail_right", "leg_front_right")
    way = next(
        (a, b, int(np.argmax(env.known(start)[a, b] == MERGES)))
        for a, b in ((row, column), (column, row))
        if (env.known(start)[a, b] == MERGES).any()
    )
    state = env.step(start, way)
    assert state is not None
    # With rail and leg joined, the post would lock the armrest out, which sits on the leg and butts against the post;
    # not the runner, onto which both stand from above. The runner would lock out the post, which then had to come from
    # behind and from above at once. Nothing belongs between the leg and a rail that goes across.
    assert locked_out(state, across) == 1
    assert locked_out(state, rows("runner_right", "leg_front_right")) == 1
    assert locked_out(state, rows("cross_rail_front", "leg_front_right")) == 0


def test_outcomes_are_unknown_before_a_try() -> None:
    env = MemoizedEnv(_task(), 0)
    assert (env.known(env.start) == UNKNOWN).all()


def test_restored_exploration_continues_equally() -> None:
    first, second = MemoizedEnv(_task(), 0), MemoizedEnv(_task(), 0)
    _play_at_random(first, np.random.default_rng(0), 25)
    second.restore(first.to_arrays())
    for one in (first, second):
        _play_at_random(one, np.random.default_rng(1), 25)
    np.testing.assert_array_equal(first.known(first.start), second.known(second.start))
    assert first.planned == second.planned


def test_values_by_numpy_and_jax_agree_and_mask_what_does_not_exist() -> None:
    task = _task()
    chair = _chair(task)
    params = network.init(np.random.default_rng(0), len(chair.part), chair.features.shape[1])
    state = task.initial_state(np.random.default_rng(0))
    joined, free = encode_state(task, state)
    values = ExpertPolicy(chair, params).values(joined, free)
    part = chair.part[: chair.points]
    np.testing.assert_array_equal(np.isfinite(values[..., 0]), part[:, None] != part[None])
    padded = np.zeros((1, len(chair.part)), np.float32)
    padded[0, : chair.points] = free
    arrays = chair.features, chair.part, joined[None].astype(np.float32), padded
    compiled = jax.jit(network.apply)(params, *arrays)
    m = chair.points
    there = np.isfinite(values)
    np.testing.assert_allclose(np.asarray(compiled)[0, :m, :m][there], values[there], atol=1e-5)


def test_best_returns_are_backed_up_through_merges() -> None:
    task = _task()
    buffer = ReplayBuffer(MemoizedEnv(task, 0), _chair(task))
    start = buffer.states[0]
    # Made-up states that differ from real ones in number only: what was joined does not matter here.
    one, two, whole = (buffer.add(start[:n]) for n in (3, 2, 1))
    buffer.add_merge(one, (0, 1, 0), two)
    buffer.add_merge(two, (0, 1, 0), whole)
    buffer.add_merge(0, (0, 1, 0), one)
    best = len(start) + 3.0
    assert buffer.best == pytest.approx([7.0 / best, 6.0 / best, 5.0 / best, 0.0])
    assert buffer.best_path() == [0, one, two]


def test_explorer_takes_working_actions_and_keeps_unused_ones() -> None:
    env = MemoizedEnv(_task(), 0)
    explorer = PlanExplorer(env, np.random.default_rng(0))
    least, state = len(env.start), env.start
    for _ in range(4_000):
        action = explorer.choose(state)
        after = None if action is None else env.step(state, action)
        if action is not None and after is not None:
            explorer.record_merge(state, action)
            state, least = after, min(least, len(after))
        if after is None or len(after) == 1:
            explorer.end_episode(state, action is None)
            state = env.start
        if least == 1:
            break
    assert least == 1


def _folder_pick(tmp_path: Path, family: str = "cantilever", seed: int = 1) -> FurnitureRef:
    folder = tmp_path / family
    if not folder.exists():
        storage.save(catalogue.make(family, seed, with_grasps=False), folder)
    return furniture_refs(f"folder:{folder}")[0]


def _extractor() -> dict[str, object]:
    return autoencoder.init(np.random.default_rng(0))


Trained = Callable[[str, int], tuple[FurnitureRef, Path]]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """`trained(family, seed)`: furniture and the file of an expert trained on it, once a module."""

    @cache
    def train(family: str, seed: int) -> tuple[FurnitureRef, Path]:
        folder = tmp_path_factory.mktemp("expert")
        chair = _folder_pick(folder, family, seed)
        training = ExpertTraining(steps=4_000, test_episodes=2)
        ExpertRun([chair], folder / "out", training, 1, _extractor(), {}).run(60.0)
        return chair, folder / "out" / f"{chair.name}.npz"

    return train


@pytest.mark.parametrize(
    ("family", "seed"), [("upholstered", 14), pytest.param("cantilever", 1, marks=pytest.mark.slow)]
)
def test_an_expert_masters_a_chair_and_teaches_it(trained: Trained, family: str, seed: int, tmp_path: Path) -> None:
    chair, path = trained(family, seed)
    result = results.read(path)
    assert result.mastered
    assert result.success_rate == 1.0
    assert not list(path.parent.glob("*.partial.npz"))
    task = ObjectCentricTask(chair.furniture())
    expert, buffer = results.load(path, task)
    course, finished = expert_samples(expert, buffer, task, chair.name, episodes=2, memories=3)
    assert finished >= 1
    of_episodes = finished * (len(task.furniture.parts) - 1)
    assert of_episodes < len(course.samples) <= of_episodes + 3
    # Both episodes take the same actions, and so does who imitates the expert in states that it met while it explored.
    taught = examples_of([course], _extractor(), Augmentation(copies=0, reductions=0))
    assert len(taught) == len(course.samples)
    merges = len(task.furniture.parts) - 1
    assert [e.best for e in taught[:merges]] == [e.best for e in taught[merges : 2 * merges]]
    assert all(e.best[0] >= 0 for e in taught)
    lesson = course.samples[0]
    n = int(lesson.free.sum())
    assert lesson.q_values is not None
    assert lesson.q_values.shape == (n, n, 6)
    # Whatever its network says of wrong pairs, they are worth nothing.
    part, point = np.nonzero(lesson.free)
    alone = task.initial_state(np.random.default_rng(0)).groups
    valued = np.argwhere((lesson.q_values != 0.0).any(axis=2))
    assert len(valued) >= len(task.furniture.connections)
    for row, column in valued:
        u, v = int(part[row]), int(part[column])
        assert task.pairs.judge(alone[u], alone[v], u, int(point[row]), v, int(point[column])) is not None
    best = len(task.furniture.parts) + 3.0
    # Values may overshoot; what is taught does not.
    taught = taught[0]
    exist = taught.group[:, None] != taught.group
    assert taught.max_return == best
    targets = paper_imitation.targets(paper_imitation.batch_of([taught], None))[0, : len(exist), : len(exist)]
    assert 0.75 * best <= float(targets[exist].max()) <= best
    course.save(tmp_path / "course.npz")
    other = ObjectCentricTask(catalogue.make("stool", 1))
    with pytest.raises(InputError, match="is an expert for"):
        results.load(path, other)


class _Student:
    """Policy that takes the expert's action, or always the same."""

    name, cloud_points = "student", 1

    def __init__(self, expert: ExpertPolicy, always: Action | None = None) -> None:
        self.expert, self.always = expert, always
        self.poses: list[np.ndarray] = []

    def act(self, observation: Observation, mask: np.ndarray) -> np.ndarray:
        self.poses.append(observation["poses"])
        part = self.expert.inputs.part[: self.expert.inputs.points]
        point = np.arange(len(part)) - np.searchsorted(part, part)
        joined = (observation["connections"] != 0).any(axis=2) | np.eye(20, dtype=bool)
        values = self.expert.values(joined, mask.any(axis=(1, 3, *range(4, mask.ndim)))[part, point])
        row, column, choice = self.always or network.first_best(values)
        return np.array([part[row], part[column], point[row], point[column], *np.unravel_index(choice, mask.shape[4:])])


def _joined_parts(joined: np.ndarray) -> bytes:
    """Return which different parts are joined."""
    return (joined & ~np.eye(len(joined), dtype=bool)).tobytes()


@dataclass(frozen=True, eq=False)
class _Planned(ExpertPolicy):
    """Expert that values the actions of a plan above all others."""

    plan: dict[bytes, Action]
    """Action by the parts that are joined."""

    def values(self, joined: np.ndarray, free: np.ndarray) -> np.ndarray:
        q = super().values(joined, free)
        if (joined_parts := _joined_parts(joined)) in self.plan:
            q[self.plan[joined_parts]] = 100.0
        return q


def test_episodes_of_the_policy_become_samples_labelled_by_the_expert(trained: Trained) -> None:
    chair, path = trained("upholstered", 14)
    task = ObjectCentricTask(chair.furniture())
    merges = len(task.furniture.parts) - 1
    expert, buffer = results.load(path, task)
    # One that does as the expert does finishes, and meets one state for each merge; groups lie elsewhere each time.
    able = _Student(expert)
    samples, finished = policy_samples(able, expert, buffer, task, chair.name, 2, np.random.default_rng(0))
    assert finished == 2
    assert len(samples.samples) == 2 * merges
    assert not np.allclose(able.poses[0], able.poses[merges])
    # One that errs at once learns how to go on from there: the way of the expert.
    start = buffer.env.start
    fails = (buffer.env.known(start) >= FAILS) & buffer.env.exists(start)[..., None]
    row, column, choice = np.argwhere(fails)[0].tolist()
    errs = _Student(expert, always=(row, column, choice))
    samples, finished = policy_samples(errs, expert, buffer, task, chair.name, 1, np.random.default_rng(0))
    assert finished == 0
    assert len(errs.poses) == 1
    taught = examples_of([samples], _extractor(), Augmentation(copies=0, reductions=0))
    assert len(taught) == merges
    state = start
    for example in taught:
        row, column, choice = example.best
        rows = np.flatnonzero(buffer.env.owners(state) >= 0)
        after = buffer.env.step(state, (int(rows[row]), int(rows[column]), choice))
        assert after is not None
        state = after
    assert len(state) == 1


@pytest.mark.slow
def test_episodes_with_robots_become_samples() -> None:
    task = FullTask(catalogue.make("three_legged", 24))
    inputs = network.chair_inputs(task, autoencoder.encode(_extractor(), part_clouds(task.furniture, CLOUD_POINTS)))
    env, plan = MemoizedEnv(task, 3), dict[bytes, Action]()
    state = env.start
    for action in demonstration(task, env.table):
        plan[_joined_parts(env.joined(state))] = action
        after = env.step(state, action)
        assert after is not None
        state = after
    weights = network.init(np.random.default_rng(0), len(inputs.part), inputs.features.shape[1], inputs.branches)
    expert = _Planned(inputs, weights, plan)
    buffer = ReplayBuffer(env, inputs)
    samples, finished = policy_samples(_Student(expert), expert, buffer, task, "", 2, np.random.default_rng(0))
    assert finished == 2
    assert len(samples.samples) == 2 * len(plan) == 2 * (len(task.furniture.parts) - 1)
    assert samples.grasps is not None


def test_an_expert_masters_a_chair_of_two_merges_soon(trained: Trained) -> None:
    # With eight steps between two looks, the looks could always fall into the middle of an episode.
    _, path = trained("upholstered", 14)
    result = results.read(path)
    assert result.mastered
    assert result.steps < 2_000


@pytest.mark.slow
def test_resumed_training_gives_the_same_weights(tmp_path: Path) -> None:
    chair = _folder_pick(tmp_path, "upholstered", 14)
    training = ExpertTraining(steps=100_000, agent=AgentConfig(batch=6))
    whole = ExpertRun([chair], tmp_path / "a", training, 1, _extractor(), {})
    for _ in range(24):
        whole.advance()
    whole.keep(0)
    stopped = ExpertRun([chair], tmp_path / "b", training, 1, _extractor(), {})
    for _ in range(11):
        stopped.advance()
    stopped.keep(0)
    resumed = ExpertRun([chair], tmp_path / "b", training, 1, _extractor(), {})
    for _ in range(13):
        resumed.advance()
    resumed.keep(0)
    one, other = (checkpoint.load(partial_file(tmp_path / n, chair.name), network.KIND) for n in ("a", "b"))
    assert one.params["agent"]["counts"].tolist() == other.params["agent"]["counts"].tolist()
    np.testing.assert_array_equal(one.params["agent"]["buffer"]["merges"], other.params["agent"]["buffer"]["merges"])
    np.testing.assert_allclose(one.params["online"]["slot"], other.params["online"]["slot"], atol=1e-6)
    with pytest.raises(InputError, match="trained otherwise"):
        ExpertRun([chair], tmp_path / "b", ExpertTraining(steps=5), 1, _extractor(), {})


def test_greedy_plays_choose_by_value_alone() -> None:
    task = _task()
    chair = _chair(task)
    agent = DQNAgent(ReplayBuffer(MemoizedEnv(task, 0), chair), AgentConfig(greedy_every=1), np.random.default_rng(0))
    n = len(chair.part)
    q = np.zeros((n, n, 6), np.float32)
    rows = np.argwhere(agent.buffer.env.exists(agent.buffer.states[0]))
    row, column = rows[7].tolist()
    q[row, column, 4] = 1.0
    agent.step(lambda: q)  # the first episode explores
    while not agent.greedy:
        agent.step(lambda: q)
    known_before = agent.buffer.env.planned
    agent.step(lambda: q)
    agent.step(lambda: q)
    # However often it fails, a play by Q takes what Q says.
    assert agent.buffer.env.planned <= known_before + 1


def test_real_plays_stop_at_the_first_failure() -> None:
    task = _task()
    chair = _chair(task)
    params = network.init(np.random.default_rng(0), len(chair.part), chair.features.shape[1])
    moves = run_expert(ExpertPolicy(chair, params), task, 0)
    assert all(m.merged for m in moves[:-1])
    assert not network.finished(moves, chair) or moves[-1].merged
