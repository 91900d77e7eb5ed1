"""The paper's policy: its padded state, its network, the two imitation losses on hand-computed numbers, training."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import shapes
from roboassembly.datasets import catalogue
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning import checkpoint, layers
from roboassembly.learning.datasets import LabeledState, SampleSet, group_labels
from roboassembly.learning.paper import autoencoder, imitation
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.examples import Augmentation, PaperExample, exact_returns, examples_of, scattered
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.network import PaperConfig, PaperPolicy, PaperState
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational.oracle_dataset import Labeler
from roboassembly.settings import SETTINGS
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName

STATE = paper.state_size(False)
SMALL = PaperConfig(hidden=24, feature=16, slot=8)
ENCODER = autoencoder.init(np.random.default_rng(1))


@pytest.fixture(scope="module")
def chair() -> Furniture:
    """Four parts, the fewest there are."""
    return catalogue.make("cantilever", 1)


@pytest.fixture(scope="module")
def course(chair: Furniture) -> SampleSet:
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in chair.parts], np.float32)
    teacher = Labeler(chair, clouds)
    lessons = {}
    for seed in range(8):
        for lesson in teacher.rollout(np.random.default_rng(seed)).states:
            lessons.setdefault(lesson.group.tobytes(), lesson)
    return teacher.sample_set(tuple(lessons.values()))


@pytest.fixture(scope="module")
def examples(course: SampleSet) -> list[PaperExample]:
    return examples_of([course], ENCODER, Augmentation(copies=2, noise=0.003, stretch=0.0, reductions=0))


def test_the_state_vector_is_padded_section_by_section() -> None:
    rng = np.random.default_rng(0)
    features, points = rng.normal(size=(3, 48)), rng.normal(size=(3, 10, 9))
    points[1, 4:] = 0.0  # a part with four points
    poses, connections = rng.normal(size=(3, 6)), np.zeros((3, 3, 6))
    connections[0, 2], connections[2, 0] = rng.normal(size=(2, 6))
    vector = np.zeros(STATE, np.float32)
    free = np.zeros((3, 10, 1))
    free[2, 7] = 1.0
    PaperState(features, points, free, poses, connections).write(vector)
    assert STATE == 20 * 48 + 20 * 10 * 9 + 20 * 10 + 20 * 6 + 20 * 20 * 6 == 5480
    assert vector[48 + 5] == np.float32(features[1, 5])
    assert not vector[3 * 48 : 20 * 48].any()
    assert vector[960 + 90 + 3 * 9 + 8] == np.float32(points[1, 3, 8])
    assert not vector[960 + 90 + 4 * 9 : 960 + 2 * 90].any()
    assert vector[960 + 2 * 90] == np.float32(points[2, 0, 0])
    assert not vector[960 + 3 * 90 : 2760].any()
    assert np.flatnonzero(vector[2760:2960]).tolist() == [27]
    assert vector[2960 + 2 * 6 + 1] == np.float32(poses[2, 1])
    assert not vector[2960 + 3 * 6 : 3080].any()
    assert vector[3080 + (0 * 20 + 2) * 6 + 4] == np.float32(connections[0, 2, 4])
    assert vector[3080 + (2 * 20 + 0) * 6 + 4] == np.float32(connections[2, 0, 4])
    assert np.count_nonzero(vector[3080:]) == 12
    # Fewer points than ten on every part: the same vector.
    fewer = np.zeros(STATE, np.float32)
    PaperState(features[1:2], points[1:2, :4], free[1:2, :4], poses[1:2], connections[1:2, 1:2]).write(fewer)
    assert fewer[960 + 3 * 9 + 8] == vector[960 + 90 + 3 * 9 + 8]
    assert not fewer[960 + 4 * 9 : 2760].any()


def test_inputs_are_normalised_by_existing_parts() -> None:
    states = np.zeros((2, STATE), np.float32)
    states[0, 0], states[0, 48], states[1, 0] = 1.0, 3.0, 5.0  # channel 0 of the features of three parts
    states[0, 1] = states[0, 49] = states[1, 1] = 7.0  # a constant channel
    states[0, 2], states[0, 50], states[1, 2] = 7.0, 7.00001, 7.0  # constant, up to rounding
    inputs = paper.normalization(states)
    deviation = (8.0 / 3.0) ** 0.5  # of 1, 3, 5
    for part in (0, 1, 19):
        assert inputs["mean"][48 * part] == pytest.approx(3.0)
        assert inputs["scale"][48 * part] == pytest.approx(1.0 / deviation)
        assert inputs["mean"][48 * part + 1] == pytest.approx(7.0)
        assert inputs["scale"][48 * part + 1] == inputs["scale"][48 * part + 2] == 0.0
    assert not inputs["scale"][960:].any()


def test_both_losses_on_hand_computed_numbers() -> None:
    q = jnp.array([[1.0, 4.0, 2.0, 9.0], [3.0, 1.0, 2.5, 9.0]])
    target = jnp.array([[0.0, 1.0, 5.0, 7.0], [6.0, 0.0, 6.0, 7.0]])
    exists = jnp.array([[True, True, True, False]] * 2)
    best = jnp.array([2, 0])
    l1, l2 = imitation.imitation_losses(q, target, exists, best)
    # 1 + 9 + 9, and the student's best has 4 where the expert's has 2
    # 9 + 1 + 12.25; the first and third are equally good, the first of them is to be taken, and is
    assert l1 == pytest.approx([19.0**0.5, 22.25**0.5])
    assert l2 == pytest.approx([2.0, 0.0])
    _, l2 = imitation.imitation_losses(q.at[1, 2].set(3.4), target, exists, best)
    assert l2[1] == pytest.approx(0.4)  # the third would be as good, but is not the one to imitate
    # What does not exist has no influence, whatever it says; a state without a best action has no second loss.
    again = imitation.imitation_losses(q.at[:, 3].set(-1e6), target.at[:, 3].set(1e6), exists, best)
    assert again[0] == pytest.approx(l1)
    assert again[1] == pytest.approx([2.0, 0.0])
    nowhere = jnp.array([-1, -1])
    assert not imitation.imitation_losses(q, target, exists, nowhere)[1].any()
    none = imitation.imitation_losses(q, target, jnp.zeros_like(exists), nowhere)
    assert none[0] == pytest.approx([1e-3, 1e-3])
    assert not none[1].any()

    def total(x: jax.Array) -> jax.Array:
        a, b = imitation.imitation_losses(x, target, exists, best)
        return (a + 50.0 * b).sum()

    gradient = jax.grad(total)(q)
    assert gradient[0] == pytest.approx([1.0 / 19.0**0.5, 3.0 / 19.0**0.5 + 50.0, -3.0 / 19.0**0.5 - 50.0, 0.0])
    for x in (q, target):  # where both agree, too
        assert np.isfinite(jax.grad(lambda y: imitation.imitation_losses(y, target, exists, best)[0].sum())(x)).all()


def test_the_first_of_equally_good_actions_is_imitated(examples: list[PaperExample]) -> None:
    example = next(e for e in examples if (e.exact() >= e.exact().max()).sum() > 1)
    row, column, choice = example.best
    flat = np.flatnonzero(example.exact() >= example.exact().max())[0]
    assert np.ravel_multi_index((row, column, choice), example.exact().shape) == flat
    # An expert's values are equal if they are within its tie: 5 % of 4 merges and the bonus.
    n = len(example.part)
    values = np.zeros((n, n, 6), np.float16)
    u, v = np.argwhere(example.group[:, None] != example.group[None])[[2, 5]]
    values[(*u, 3)], values[(*v, 1)] = 6.8, 7.0
    told = replace(example, q_values=values, tie=0.35)
    assert told.best == (*u, 3)
    assert replace(told, tie=0.1).best == (*v, 1)
    assert imitation.batch_of([told], None)["best"].tolist() == [[*u, 3]]
    # Values above the bound of the targets are still told apart.
    values[(*u, 3)], values[(*v, 1)] = 20.0, 22.0
    assert max(20.0, told.max_return) == 20.0
    assert replace(example, q_values=values, tie=0.35).best == (*v, 1)
    # Nothing is to be imitated where nothing leads to the whole.
    assert replace(example, returns=np.minimum(example.returns, 1.0)).best == (-1, -1, -1)


def test_the_loss_is_l1_and_fifty_times_l2(examples: list[PaperExample]) -> None:
    network = paper.init(np.random.default_rng(0), SMALL)
    inputs = paper.normalization(imitation.batch_of(examples, None)["state"])
    batch = imitation.batch_of(examples, None)
    loss, terms = imitation.losses(network, inputs, batch)
    assert loss == pytest.approx(float(terms["l1"] + 50.0 * terms["l2"]), rel=1e-5)
    # Nor does what is taught about actions between points that are not there, or joined already.
    nowhere = ~batch["exists"]
    assert nowhere.any()
    batch["branch_targets"][nowhere] = 99.0
    assert imitation.losses(network, inputs, batch)[0] == pytest.approx(float(loss))


def test_exact_values_are_returns_to_go() -> None:
    connections = np.zeros((4, 4, 6), np.float32)
    connections[0, 1] = connections[1, 0] = 1.0  # three groups: two merges to go
    joints = np.array([[0, 0, 2, 1, 1, 1, 0, 1, 0, 0, 0], [2, 1, 3, 0, 0, 0, 0, 0, 1, 0, 0]], np.int16)
    free = np.zeros((4, 10), bool)
    free[[0, 2, 3, 3], [0, 1, 0, 2]] = True
    lesson = LabeledState(np.ones((4, 10, 9), np.float32), connections, free, np.ones((4, 6), np.float32), joints)
    # It can be finished after the first: two merges and the whole. The second works but leads nowhere.
    assert exact_returns(lesson).tolist() == [[6, 0, 6, 0, 0, 0], [0, 0, 0, 1, 0, 0]]
    course = SampleSet("four", np.ones((4, 16, 3), np.float32), (lesson,))
    example = examples_of([course], ENCODER, Augmentation(copies=0, reductions=0))[0]
    assert [*zip(example.part, example.point, strict=True)] == [(0, 0), (2, 1), (3, 0), (3, 2)]
    exact = example.exact()
    assert exact[0, 1].tolist() == [6, 0, 6, 0, 0, 0]
    assert exact[1, 2].tolist() == [0, 0, 0, 1, 0, 0]
    assert exact.sum() == 13.0
    # An expert is believed before the oracle.
    values = np.arange(96, dtype=np.float16).reshape(4, 4, 6) / 10.0
    by_expert = replace(course, samples=(replace(lesson, q_values=values),))
    taught = imitation.batch_of(examples_of([by_expert], ENCODER, Augmentation(copies=0, reductions=0)), None)
    # But more than two merges and the whole are not to be had.
    target = imitation.targets(taught)
    assert np.array_equal(target[0, :4, :4], np.minimum(values, 6.0))
    assert not target[0, 4:].any()


@pytest.mark.slow
def test_grasp_values_are_learnt_and_chosen_in_the_full_setting(tmp_path: Path) -> None:
    stand = shapes.stand()
    task = FullTask(stand)
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in stand.parts], np.float32)
    teacher = Labeler(stand, clouds, HandOracle(task))
    rng = np.random.default_rng(0)
    hands = Observer(stand, 4, 10, 1).observe(task.initial_state(rng).groups)["grasp_regions"].reshape(4, 8, 6)
    lessons = []
    for lesson in teacher.rollout(rng).states:
        n = int(lesson.free.sum())
        lessons.append(replace(lesson, q_values=rng.uniform(0.0, 4.0, (n, n, 16)).astype(np.float16)))
    course = replace(teacher.sample_set(lessons), grasps=hands)
    course.save(tmp_path / "stand.npz")
    again = SampleSet.load(tmp_path / "stand.npz")
    assert again.grasps is not None
    assert np.array_equal(again.grasps, hands)
    examples = examples_of([again], ENCODER, Augmentation(copies=0, reductions=0))
    batch = imitation.batch_of(examples[:1], None)
    first = lessons[0].q_values
    assert first is not None
    n = len(first)
    target = imitation.targets(batch)
    assert target.shape[3] == 64
    # Grasps 2 and 5 of the first pair: way 8 * 2 + 5. Four parts: at most three merges and the whole are to be had.
    both = float(first[0, 1, 2]) + float(first[0, 1, 8 + 5])
    assert target[0, 0, 1, 21] == pytest.approx(min(both, 7.0), abs=1e-3)
    assert target.max() == 7.0
    assert batch["state"].shape[1] == 5480 + 20 * 8 * 6
    assert batch["state"][0, 5480 + 48 + 3] == pytest.approx(hands[1, 0, 3])
    path = tmp_path / "paper.npz"
    list(imitation.train(examples, ENCODER, path, PaperTraining(steps=3, batch=2, warmup=1), SMALL, {}))
    policy = load_policy(str(path))
    assert isinstance(policy, PaperPolicy)
    assert policy.settings == ("full",)
    env = FullEnv(stand, cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=0)
    mask = info["action_mask"]
    values = policy.values(observation, mask)
    assert np.array_equal(np.isfinite(values), mask)
    u, v, k, l, g_a, g_b = policy.act(observation, mask)  # noqa: E741
    assert values[u, v, k, l, g_a, g_b] == values.max()
    plain = replace(course, grasps=None, samples=tuple(replace(x, q_values=None) for x in lessons))
    mixed = examples + examples_of([plain], ENCODER, Augmentation(copies=0, reductions=0))
    with pytest.raises(InputError, match="both settings"):
        next(imitation.train(mixed, ENCODER, tmp_path / "mixed.npz", PaperTraining(steps=3), SMALL, {}))


def test_batch_holds_slots_and_masks(examples: list[PaperExample]) -> None:
    batch = imitation.batch_of(examples, None)
    for row, e in enumerate(examples):
        n = len(e.part)
        assert batch["slot"][row, :n].tolist() == (10 * e.part + e.point).tolist()
        assert np.array_equal(batch["exists"][row, :n, :n], e.group[:, None] != e.group)
        assert not batch["exists"][row, n:].any()
        assert np.array_equal(imitation.targets(batch)[row, :n, :n], e.exact())
        groups = len(np.unique(e.group))
        assert e.exact().max() >= groups - 1 + 4


@pytest.mark.parametrize("setting", SETTINGS)
def test_augmentation_moves_groups_as_wholes(setting: SettingName, chair: Furniture) -> None:
    task = ObjectCentricTask(chair)
    state = task.initial_state(np.random.default_rng(0))
    joint = next(j for j in Oracle(task).mates(state) if j.viable)
    rest = (g for g in state.groups if joint.u not in g.parts and joint.v not in g.parts)
    observer = Observer(chair, len(chair.parts), 10, 1)
    seen = observer.observe(TaskState((*rest, joint.merge.merged)))
    moved = scattered(seen["poses"], group_labels(seen["connections"]), setting, np.random.default_rng(0))
    assert not np.allclose(moved, seen["poses"], atol=0.05)
    turns = [rotations_from_euler(p[:, 3:].astype(float)) for p in (seen["poses"], moved)]
    u, v = joint.u, joint.v
    relative = [
        np.concatenate([(r[u].T @ (p[v, :3] - p[u, :3]))[:, None], r[u].T @ r[v]], axis=1)
        for p, r in zip((seen["poses"], moved), turns, strict=True)
    ]
    assert np.allclose(relative[0], relative[1], atol=1e-5)
    assert not np.allclose(turns[0][:, 2], turns[1][:, 2], atol=0.3)  # groups may lie on any side


def test_places_in_training_are_those_of_episodes(chair: Furniture) -> None:
    """What a network learns from must lie where its parts lie when it acts."""
    # Experts explore on the ground in either setting.
    explored = ObjectCentricTask(chair)
    starts = [explored.initial_state(np.random.default_rng(seed)).part_poses for seed in range(10, 16)]
    recorded = np.array([[*pose.translation, 0.0, 0.0, 0.0] for poses in starts for pose in poses])
    draw = partial(scattered, np.resize(recorded, (200, 6)), np.arange(200), rng=np.random.default_rng(0))
    for name, setting in SETTINGS.items():
        drawn = draw(setting=name)[:, :3]
        low, high = drawn.min(axis=0) - 0.1, drawn.max(axis=0) + 0.1
        task = setting.make_task(chair)
        for seed in range(3):
            state = task.groups_of(task.initial_state(np.random.default_rng(seed)))
            met = np.array([pose.translation for pose in state.part_poses])
            assert (low < met).all()
            assert (met < high).all()


def test_noise_is_on_the_clouds_alone(examples: list[PaperExample], course: SampleSet) -> None:
    features = examples[0].features
    assert features.shape == (3, 4, 48)
    assert np.allclose(features[0], autoencoder.encode(ENCODER, course.clouds), atol=1e-5)
    radius = features[:, :, -1]
    assert np.abs(radius[1:] - radius[0]).max() < 0.02
    assert not np.array_equal(features[1], features[0])
    drawn = [imitation.batch_of(examples[:1], np.random.default_rng(s))["state"][0] for s in range(12)]
    assert len({d[:960].tobytes() for d in drawn}) == 3
    assert len({d[960:].tobytes() for d in drawn}) == 1
    # Chairs mirrored, turned and of other sizes come besides.
    more = examples_of([course], ENCODER, Augmentation(copies=0, changes=2, reductions=0))
    assert len(more) == 3 * len(examples)


def test_q_values_follow_from_factors_in_numpy_and_jax() -> None:
    rng = np.random.default_rng(0)
    p, state = paper.init(rng, SMALL), rng.normal(size=(2, STATE)).astype(np.float32)
    state[0, 2960 + 6 : 3080] = 0.0  # one part
    state[1, 2760:2960] = 0.0  # no free point
    p["heads"]["0"]["u"]["b"] += np.arange(6, dtype=np.float32)
    inputs = {"mean": np.full(STATE, 0.1, np.float32), "scale": np.full(STATE, 2.0, np.float32)}
    slot = np.array([[0, 57, 199], [3, 3, 8]], np.int32)
    q = paper.apply(p, inputs, state, slot)
    assert q.shape == (2, 3, 3, 6)
    # Padding stays 0 where it would become -0.2, and a number for each row says whether it is there.
    whole = (state - 0.1) * 2.0
    whole[0, 2960 + 6 : 3080] = whole[1, 2760:2960] = 0.0
    there = np.ones((2, 20 + 200 + 200 + 20 + 400), np.float32)
    there[0, 20 + 200 + 200 + 1 : 20 + 200 + 200 + 20] = there[1, 220:420] = 0.0
    whole = np.concatenate([whole, there], axis=1)
    for layer in p["state"].values():
        whole = layers.gelu(layers.norm(layer["norm"], layers.linear(layer["map"], whole)))
    a, b = np.split(layers.linear(p["slots"], whole).reshape(2, 200, 16), 2, axis=2)
    expected = (
        (a[0, 57] * b[0, 199]) @ p["heads"]["0"]["w"]
        + layers.linear(p["heads"]["0"]["u"], a[0, 57])
        + layers.linear(p["heads"]["0"]["v"], b[0, 199])
    )
    assert q[0, 1, 2] == pytest.approx(10.0 * expected, abs=1e-3)
    assert np.array_equal(q[1, 0], q[1, 1])
    on_jax = jax.jit(paper.apply)(p, inputs, state, slot)
    assert np.abs(q - on_jax).max() < 1e-3


def test_a_small_chair_is_learnt_and_assembled(examples: list[PaperExample], chair: Furniture, tmp_path: Path) -> None:
    path, training = tmp_path / "paper.npz", PaperTraining(steps=150, learning_rate=3e-3, warmup=10, batch=8)
    terms = [terms for _, terms in imitation.train(examples, ENCODER, path, training, SMALL, {"set": "one chair"})]
    assert terms[-1]["loss"] < 0.2 * terms[0]["loss"]
    kept = checkpoint.load(path, paper.KIND)
    assert kept.config["set"] == "one chair"
    assert np.array_equal(kept.params["encoder"]["encoder"]["0"]["w"], ENCODER["encoder"]["0"]["w"])
    assert imitation.viable_share(kept.params, examples) == 1.0
    policy = PaperPolicy.from_checkpoint(kept, "paper.npz")
    env = ObjectCentricEnv(chair, cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=5)
    done = False
    while not done:
        values = policy.values(observation, info["action_mask"])
        assert np.array_equal(np.isfinite(values), info["action_mask"])
        u, v, k, l, w = action = policy.act(observation, info["action_mask"])  # noqa: E741
        assert values[u, v, k, l, w] == values.max()
        observation, _, done, truncated, info = env.step(action)
        assert not truncated
    assert info["success"]


def test_the_policy_agrees_with_training(examples: list[PaperExample], course: SampleSet, chair: Furniture) -> None:
    params = {"encoder": ENCODER, "network": paper.init(np.random.default_rng(3), SMALL)}
    batch = imitation.batch_of(examples[:1], None)
    params["inputs"] = paper.normalization(batch["state"])
    env = ObjectCentricEnv(chair, cloud_points=CLOUD_POINTS)
    observation, info = env.reset(seed=0)
    mask = info["action_mask"]
    policy = PaperPolicy(params)
    values = policy.values(observation, mask)
    part, point = np.nonzero(mask.any(axis=(1, 3, 4)))
    state = np.zeros((1, STATE), np.float32)
    n = len(chair.parts)
    free = np.zeros((n, 10, 1))
    free[part, point] = 1.0
    PaperState(
        autoencoder.encode(ENCODER, course.clouds), observation["connection_points"][:n], free,
        observation["poses"][:n], observation["connections"][:n, :n],
    ).write(state[0])  # fmt: skip
    q = paper.apply(params["network"], params["inputs"], state, (10 * part + point)[None])[0]
    i, j = 0, len(part) - 1
    assert values[part[i], part[j], point[i], point[j]] == pytest.approx(q[i, j], abs=1e-3)
    # Actions that the mask takes away are not chosen, and change nothing about the others.
    best = tuple(policy.act(observation, mask))
    less = mask.copy()
    less[best] = False
    assert tuple(policy.act(observation, less)) != best
    assert np.array_equal(np.where(less, values, 0.0), np.where(less, policy.values(observation, less), 0.0))


def _until(steps: int, *args: Any) -> None:
    run = imitation.train(*args)
    list(islice(run, steps))
    run.close()


def test_resumed_run_equals_an_uninterrupted_one(examples: list[PaperExample], tmp_path: Path) -> None:
    training = PaperTraining(steps=9, batch=2, warmup=2, keep_every=0.0)
    straight, stopped = tmp_path / "straight.npz", tmp_path / "stopped.npz"
    list(imitation.train(examples, ENCODER, straight, training, SMALL, {}))
    _until(4, examples, ENCODER, stopped, training, SMALL, {})
    steps = [step for step, _ in imitation.train(examples, ENCODER, stopped, training, SMALL, {})]
    assert steps == [5, 6, 7, 8, 9]
    kept = [checkpoint.load(path, paper.KIND) for path in (straight, stopped)]
    assert jax.tree.all(jax.tree.map(np.array_equal, kept[0].params, kept[1].params))
    assert int(kept[1].extra["step"]) == 9
    with pytest.raises(InputError, match="other training"):
        _until(1, examples, ENCODER, stopped, replace(training, seed=1), SMALL, {})
    with pytest.raises(InputError, match="no samples"):
        _until(1, [], ENCODER, tmp_path / "none.npz", training, SMALL, {})


def test_checkpoints_of_other_networks_are_refused() -> None:
    with pytest.raises(InputError, match="'relational' network"):
        PaperPolicy.from_checkpoint(checkpoint.Checkpoint("relational", {}, {}, {}), "a.npz")
    with pytest.raises(InputError, match=r"'a.npz': config\['network'\] holds None"):
        PaperPolicy.from_checkpoint(checkpoint.Checkpoint(paper.KIND, {}, {}, {}), "a.npz")
    small, inputs = paper.init(np.random.default_rng(0), SMALL), np.zeros(STATE, np.float32)
    params = {"encoder": ENCODER, "inputs": {"mean": inputs, "scale": inputs}, "network": small}
    config = {"network": asdict(SMALL)}
    assert PaperPolicy.from_checkpoint(checkpoint.Checkpoint(paper.KIND, params, config, {}), "a.npz").name == "paper"
    params["inputs"]["mean"] = inputs[:7]
    with pytest.raises(InputError, match=r"'/inputs/mean' is float32 \(7,\); its configuration"):
        PaperPolicy.from_checkpoint(checkpoint.Checkpoint(paper.KIND, params, config, {}), "a.npz")


def test_acting_needs_no_jax() -> None:
    code = "import sys; import roboassembly.learning.paper.network; sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ)
