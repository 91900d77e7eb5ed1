"""What the relational policy sees and says: invariances, agreement of NumPy and JAX, lessons, resuming."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.observation import surface_points
from roboassembly.errors import InputError
from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning import checkpoint, layers
from roboassembly.learning.augmentation import AUGMENTATIONS, augmented, up_axis_permutation
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational import imitation
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.cycles import closed_3_cycles, closed_4_cycles
from roboassembly.learning.relational.features import pair_features, up_axis_features
from roboassembly.learning.relational.group_geometry import PATCH_SIZE
from roboassembly.learning.relational.oracle_dataset import Labeler, targets_of
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.learning.relational.tokens import POINT_FEATURES, TokenCache, Tokens, pad, tokens_of, tokens_of_sample
from roboassembly.solvers.search import solve

CONFIG = relational.RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)


def course(name: str, points: int = 64) -> SampleSet:
    family, seed = name.split(":")
    furniture = catalogue.make(family, int(seed))
    clouds = np.array([surface_points(p.mesh, points) for p in furniture.parts], np.float32)
    teacher = Labeler(furniture, clouds)
    return SampleSet(furniture.name, clouds, teacher.rollout(np.random.default_rng(0)).states)


@pytest.fixture(scope="module")
def cantilever() -> SampleSet:
    return course("cantilever:1")


def observed(seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    env = ObjectCentricEnv("three_legged:1", cloud_points=64)
    observation, info = env.reset(seed=seed)
    return observation, info["action_mask"]


def values(params: dict, tokens: Tokens) -> np.ndarray:
    n = len(tokens.part)
    return relational.apply(params, pad([tokens], padded_length(n)))[1][0, :n, :n]


def test_tokens_do_not_depend_on_where_parts_lie() -> None:
    one, two = (tokens_of(PolicyView.from_observation(*observed(seed))) for seed in (0, 1))
    assert not np.allclose(observed(0)[0]["poses"], observed(1)[0]["poses"])
    for name in ("patch", "features", "matches", "bounds", "cycles_3", "cycles_4"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name


@pytest.mark.parametrize("name", ["cantilever:1", "panel:2"])
def test_what_is_imagined_of_a_merge_comes_true(name: str) -> None:
    env = ObjectCentricEnv(name, cloud_points=64)
    observation, info = env.reset(seed=0)
    plan = solve(catalogue.find(name), 0).plan
    for step in plan.steps:
        u, v, k, l, _ = step.action  # noqa: E741
        imagined = PolicyView.from_observation(observation, info["action_mask"]).after_merge(u, k, v, l)
        observation, _, _, _, info = env.step(np.array(step.action))
        seen = PolicyView.from_observation(observation, info["action_mask"])
        n = len(env.state.part_poses)
        assert np.array_equal(imagined.group[:n], seen.group[:n])
        assert np.abs(imagined.connections[..., :3] - seen.connections[..., :3]).max() < 0.003
        told, wanted = (rotations_from_euler(s.connections[:n, :n, 3:]) for s in (imagined, seen))
        assert np.abs(told - wanted).max() < 0.01
        assert np.array_equal(imagined.free, seen.free)
    assert info["success"]


def test_a_memory_changes_nothing(cantilever: SampleSet) -> None:
    memory = TokenCache(max_entries=40)
    for lesson in cantilever.samples:
        fresh, remembered = tokens_of_sample(cantilever, lesson), tokens_of_sample(cantilever, lesson, memory)
        for name in Tokens.__dataclass_fields__:
            assert np.array_equal(getattr(fresh, name), getattr(remembered, name)), name


def test_loops_close_where_a_third_group_fits_both() -> None:
    # A post stands on the left end of a beam; a brace reaches from the beam's right end to the post's top.
    at = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0], [-1, 0, 1]], float)
    normal = np.array([[0, 0, 1], [0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]], float)
    tangent = np.tile([0.0, 1.0, 0.0], (6, 1))
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=2)
    groups = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5])]
    possible = np.kron(~np.eye(3, dtype=bool), np.ones((2, 2), bool))
    wanted = np.zeros((6, 6), int)
    for one, two in ((0, 2), (1, 4), (3, 5)):
        wanted[one, two] = wanted[two, one] = 1
    assert np.array_equal(closed_3_cycles(groups, at, frame, possible), wanted)
    # Where the brace cannot go, nothing closes; neither with one that is 6 mm too long.
    without = possible.copy()
    without[3, 5] = without[5, 3] = False
    assert not closed_3_cycles(groups, at, frame, without).any()
    longer = at.copy()
    longer[5, 2] += 0.006
    assert not closed_3_cycles(groups, longer, frame, possible).any()
    # Two groups close no loop.
    assert not closed_3_cycles(groups[:2], at, frame, possible).any()


def test_bridges_close_where_two_groups_reach_as_far() -> None:
    # Two posts; a rod of 0.5 m at their feet, one at their tops, and a third that is 4 cm longer.
    holes = [[0, 0, 0], [0, 0, 1]]
    at = np.array([*holes, *holes, [0, 0, 0], [0.5, 0, 0], [0, 0, 0], [0.5, 0, 0], [0, 0, 0], [0.54, 0, 0]], float)
    normal = np.array([[1, 0, 0]] * 2 + [[-1, 0, 0]] * 2 + [[-1, 0, 0], [1, 0, 0]] * 3, float)
    tangent = np.tile([0.0, 0.0, 1.0], (len(at), 1))
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=2)
    groups = [np.array([2 * i, 2 * i + 1]) for i in range(5)]
    possible = normal @ normal.T < -0.5
    possible &= ~np.kron(np.eye(5, dtype=bool), np.ones((2, 2), bool))
    found = closed_4_cycles(groups, at, frame, possible)
    assert np.array_equal(found, found.T)
    # Each end of the two equal rods may take either hole of a post, the other rod and the other post being witnesses.
    assert found[0, 4] == found[1, 4] == found[2, 5] == found[3, 5] == found[1, 6] == 2
    assert not found[:, 8:].any()
    assert not found[~possible].any()


def test_features_of_a_pair_by_hand() -> None:
    # A point on top of a group 1 m wide and 0.2 m high, and one below another, 0.4 m wide and high.
    frame = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    own = np.zeros((2, POINT_FEATURES), np.float32)
    own[:, 0], own[:, -1] = (0.2, 0.4), 1.0
    tokens = Tokens(
        np.arange(2), np.zeros(2, int), np.arange(2), np.zeros((2, PATCH_SIZE), np.uint8), own,
        frame.astype(np.float32),
        np.array([[0.0, 0.0, 0.2], [0.1, 0.0, 0.0]], np.float32),
        np.array([[1.0, 1.0, 0.2], [0.4, 0.4, 0.4]], np.float32),
        np.zeros((2, 2, 4), np.uint8), np.array([[[0.0] * 6, [-0.4, -0.3, -0.2, 0.2, 0.3, -0.4]]] * 2, np.float32),
        np.array([[0, 2], [2, 0]], np.uint8), np.array([[0, 3], [3, 0]], np.uint8),
    )  # fmt: skip
    t = pad([tokens], 2)
    valid = ~np.eye(2, dtype=bool)[None]
    pair = pair_features({k: v.astype(np.float32) for k, v in t.items()}, valid)[0]
    assert not pair[0, 0].any()
    cosine, diagonal, shift, same_way, sizes = np.split(pair[0, 1, 10:20], [1, 4, 7, 8])
    assert (cosine, same_way) == (1.0, 1.0)
    assert np.allclose(diagonal, 1.0)
    assert np.allclose(shift, [0.1, 0.0, -0.2])  # of the moving group, the row's
    assert np.allclose(sizes, [0.2, 0.4])
    assert np.allclose(pair[0, 1, 21:24], [1.0, 1.0, 0.2])  # the moving group's extent
    assert np.allclose(pair[0, 1, 24:], [1, 1, 1, 2 / 3, np.log(3), 1, 1, 1, 1, 0.1, np.log(4), 1, 1, 1, 1])
    way = up_axis_features({k: v.astype(np.float32) for k, v in t.items()})[0, 0, 1]
    up = way[0]  # its lowest point is 0.2 m lower than the waiting group's with +z up, its highest 0.4 m
    assert np.allclose(up[[0, 2, 4, 5]], [-0.4, -0.8, -1.0, 2 * -0.5], atol=1e-6)
    assert np.allclose(way[1, [0, 2]], [0.8, 0.4], atol=1e-6)  # upside down


def test_values_follow_a_renumbering_of_parts() -> None:
    observation, mask = observed(0)
    order = np.random.default_rng(3).permutation(len(mask))
    shuffled = {k: v[order] for k, v in observation.items()}
    shuffled["connections"] = shuffled["connections"][:, order]
    params = relational.init(np.random.default_rng(0), CONFIG)
    plain = tokens_of(PolicyView.from_observation(observation, mask))
    turned = tokens_of(PolicyView.from_observation(shuffled, mask[order][:, order]))
    where = {(int(order[p]), int(k)): i for i, (p, k) in enumerate(zip(turned.part, turned.point, strict=True))}
    index = [where[int(p), int(k)] for p, k in zip(plain.part, plain.point, strict=True)]
    assert np.allclose(values(params, turned)[np.ix_(index, index)], values(params, plain), atol=1e-4)


def test_numpy_and_jax_say_the_same_and_padding_changes_nothing(cantilever: SampleSet) -> None:
    params = relational.init(np.random.default_rng(0), CONFIG)
    tokens = [tokens_of_sample(cantilever, lesson) for lesson in cantilever.samples]
    n = [len(t.part) for t in tokens]
    narrow, wide = (pad(tokens, size) for size in (padded_length(max(n)), 48))
    here = relational.apply(params, narrow)
    there = jax.jit(relational.apply)(params, wide)
    for row, count in enumerate(n):
        for a, b in zip(here, there, strict=True):
            assert np.allclose(a[row, :count, :count], np.asarray(b)[row, :count, :count], atol=1e-4)
        assert not np.asarray(there[2])[row, count:].any()


def test_views_are_averaged(cantilever: SampleSet) -> None:
    params = relational.init(np.random.default_rng(0), CONFIG)
    tokens = tokens_of_sample(cantilever, cantilever.samples[0])
    alone = relational.values(params, tokens)
    assert np.array_equal(alone, relational.values(params, tokens, AUGMENTATIONS[:1]))
    other = augmented(cantilever, AUGMENTATIONS[5])
    turned = relational.values(params, tokens_of_sample(other, other.samples[0]))[
        ..., up_axis_permutation(AUGMENTATIONS[5])
    ]
    both = relational.values(params, tokens, (AUGMENTATIONS[0], AUGMENTATIONS[5]))
    valid = np.isfinite(alone)
    assert np.allclose(both[valid], 0.5 * (alone + turned)[valid], atol=1e-2)
    assert np.isneginf(both[~valid]).all()


def test_layers_by_hand() -> None:
    x = np.array([[-1.0, 3.0]])
    # Mean 1, deviation 2.
    assert np.allclose(layers.norm(layers.init_norm(2), x), [[-1.0, 1.0]], atol=1e-5)
    assert np.allclose(layers.gelu(np.array([0.0, 1.0, -1.0])), [0.0, 0.8412, -0.1588], atol=1e-3)
    assert np.allclose(layers.softplus(np.array([0.0, 800.0, -800.0])), [np.log(2.0), 800.0, 0.0])
    assert np.allclose(layers.softmax(np.array([[0.0, np.log(3.0)]]), axis=1), [[0.25, 0.75]])


def test_lessons_say_what_the_oracle_says(cantilever: SampleSet) -> None:
    """Four parts: three lessons; in each something is good, and whatever is good is right."""
    assert len(cantilever.samples) == 3
    for lesson in cantilever.samples:
        tokens = tokens_of_sample(cantilever, lesson)
        right, good = targets_of(tokens, lesson)
        assert good.any()
        assert (good.any(axis=2) <= right.astype(bool)).all()
        different = tokens.group[:, None] != tokens.group[None]
        assert different[right.astype(bool)].all()
        assert right.sum() == len(lesson.mates)


def test_a_course_survives_a_file_and_a_broken_one_is_told(cantilever: SampleSet, tmp_path: Path) -> None:
    file = tmp_path / "course.npz"
    first, second, last = cantilever.samples
    n = int(second.free.sum())
    valued = replace(second, q_values=np.arange(n * n * 6, dtype=np.float16).reshape(n, n, 6))
    course = replace(cantilever, samples=(first, valued, last))
    course.save(file)
    loaded = SampleSet.load(file)
    assert loaded.name == cantilever.name
    for a, b in zip(loaded.samples, course.samples, strict=True):
        for name in ("mates", "points", "poses", "free", "q_values"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(InputError, match="not a file of training samples"):
        SampleSet.load(file)


def test_a_student_that_errs_is_set_right(cantilever: SampleSet) -> None:
    teacher = Labeler(catalogue.make("cantilever", 1), cantilever.clouds)

    def hopeless(tokens: Tokens) -> tuple[int, int, int]:
        return 0, 0, 0

    play = teacher.rollout(np.random.default_rng(0), hopeless)
    assert len(play.states) == play.mistakes == 3


def test_dead_ends_are_lessons_too() -> None:
    furniture = catalogue.make("windsor", 0)
    clouds = np.array([surface_points(p.mesh, 64) for p in furniture.parts], np.float32)
    teacher = Labeler(furniture, clouds)
    play = teacher.rollout(np.random.default_rng(1))
    assert len(play.states) == len(furniture.parts) - 1
    assert len(play.dead_ends) > 2
    for lesson in play.dead_ends:
        assert not lesson.mates[:, 4].any()
    taught = imitation.examples_of([SampleSet("windsor:0", clouds, (*play.states, *play.dead_ends))])
    assert [e.good.any() for e in taught] == [True] * len(play.states) + [False] * len(play.dead_ends)
    # What is learnt of them is that nothing is good; which choice is made there does not matter.
    params = relational.init(np.random.default_rng(0), CONFIG)
    dead = [e for e in taught if not e.good.any()][:2]
    _, terms = imitation.losses(params, imitation.batch_of(dead, padded_length(max(len(e.right) for e in dead))))
    assert not np.asarray(terms["choice"]).any()
    assert (np.asarray(terms["values"]) > 0.0).all()
    assert imitation.share_good(params, taught) == imitation.share_good(params, taught[: len(play.states)])


def test_a_gradient_is_the_same_in_pieces(cantilever: SampleSet) -> None:
    examples = imitation.examples_of([cantilever])[:4]
    params = relational.init(np.random.default_rng(0), CONFIG)
    batch = imitation.batch_of(examples, 48)  # 192 tokens: pieces of two states
    (loss, _), whole = jax.jit(jax.value_and_grad(imitation.losses, has_aux=True))(params, batch)
    told, terms = imitation.gradient_of(params, batch)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(told), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5)
    assert terms["loss"] == pytest.approx(float(loss), rel=1e-5)


def test_training_learns_a_chair_and_resumes_where_it_was_killed(cantilever: SampleSet, tmp_path: Path) -> None:
    examples = imitation.examples_of([cantilever])
    training = imitation.Training(steps=60, learning_rate=1e-2, warmup=5, batch=2, keep_every=0.0)
    whole = list(imitation.train(examples, tmp_path / "whole.npz", training, CONFIG, {}))
    assert whole[-1][1]["loss"] < 0.5 * whole[0][1]["loss"]
    assert np.mean([terms["chosen"] for _, terms in whole[-10:]]) > 0.9

    run = imitation.train(examples, tmp_path / "killed.npz", training, CONFIG, {})
    for step, _ in run:
        if step == 31:
            break
    del run
    rest = list(imitation.train(examples, tmp_path / "killed.npz", training, CONFIG, {}))
    assert rest[0][0] == 32
    assert rest[-1][0] == 60
    ends = [checkpoint.load(tmp_path / name, "relational").params for name in ("whole.npz", "killed.npz")]
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, ends), strict=True))
    with pytest.raises(InputError, match="other training"):
        next(imitation.train(examples, tmp_path / "killed.npz", imitation.Training(steps=7), CONFIG, {}))


def test_checkpoints_hold_arrays_and_refuse_what_they_are_not(tmp_path: Path) -> None:
    params = relational.init(np.random.default_rng(0), CONFIG)
    file = tmp_path / "policy.npz"
    checkpoint.save(file, checkpoint.Checkpoint("relational", params, {"a": 1}, {}), half=True)
    loaded = checkpoint.load(file, "relational")
    assert loaded.config == {"a": 1}
    assert np.allclose(loaded.params["q"]["w"], params["q"]["w"], atol=2e-3)
    with pytest.raises(InputError, match="'relational' network where a 'paper'"):
        checkpoint.load(file, "paper")
    with pytest.raises(InputError, match="no checkpoint"):
        checkpoint.load(tmp_path / "none.npz")
    file.write_bytes(b"not a zip")
    with pytest.raises(InputError, match="not a checkpoint"):
        checkpoint.load(file)
