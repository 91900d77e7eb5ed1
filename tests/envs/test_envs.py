"""Contract of every environment, on furniture of every source."""

from __future__ import annotations

import warnings
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from roboassembly.bench.scaling import lattice, shelf
from roboassembly.datasets import catalogue
from roboassembly.envs import FULL, OBJECT_CENTRIC
from roboassembly.envs.assembly import AssemblyEnv
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.wrappers import DiscreteActions
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.evaluation.rollout import rollout_policy
from roboassembly.furniture import storage
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance, RawFurniture, RawPart
from roboassembly.generate.design import as_parts
from roboassembly.geometry.meshes import Mesh, distances_to
from roboassembly.geometry.poses import SE3, pose_to_euler, rotations_from_euler
from roboassembly.learning.registry import load_policy
from roboassembly.solvers.disassembly import Disassembly, partition_of
from roboassembly.solvers.options import grasping, upright
from roboassembly.solvers.search import solve
from roboassembly.task.full.grips import grip_of
from roboassembly.task.rules.groups import Group

trimesh = pytest.importorskip("trimesh")


def _imported() -> Furniture:
    """Return a repaired table of touching boxes, as an importer makes it."""
    from roboassembly.importers.pipeline import finish

    top = trimesh.creation.box((0.6, 0.4, 0.03))
    top.apply_translation((0, 0, 0.415))
    parts = [RawPart("top", Mesh.from_trimesh(top))]
    for i, (x, y) in enumerate([(-0.25, -0.15), (0.25, -0.15), (-0.25, 0.15), (0.25, 0.15)]):
        segment = trimesh.creation.box((0.04, 0.04, 0.4))
        segment.apply_translation((x, y, 0.2))
        parts.append(RawPart(f"leg{i}", Mesh.from_trimesh(segment)))
    return finish("table", RawFurniture(tuple(parts), Provenance("test"))).furniture


SAMPLE = ("ladder", "windsor", "pedestal", "stool")
"""Families that include swapped, mirrored, turned and captive parts."""
FEW = "cantilever"
"""Family of few parts, because two robots are slow."""
SOURCES = {**{name: (lambda name=name: catalogue.make(name, 1)) for name in (*SAMPLE, FEW)}, "imported": _imported}
CASES = [(ObjectCentricEnv, name) for name in (*SAMPLE, "imported")] + [(FullEnv, name) for name in (FEW, "imported")]
"""Environments with their furniture."""
AnEnv = AssemblyEnv[Any, Any, Any]


_RIGHT: dict[tuple[object, ...], tuple[int, ...]] = {}
"""Right actions found so far, by environment, furniture, seed of the step and poses of the parts."""


@cache
def piece(name: str) -> Furniture:
    return SOURCES[name]()


@pytest.fixture(scope="module", params=CASES, ids=[f"{env.__name__}-{name}" for env, name in CASES])
def case(request: pytest.FixtureRequest) -> tuple[type[AnEnv], str]:
    return request.param


@pytest.fixture(scope="module")
def furniture(case: tuple[type[AnEnv], str]) -> Furniture:
    return piece(case[1])


@pytest.fixture
def env(case: tuple[type[AnEnv], str], furniture: Furniture) -> AnEnv:
    return case[0](furniture)


@cache
def reasoning(furniture: Furniture) -> Disassembly:
    return Disassembly(furniture, lambda: False)


def right_action(env: AnEnv) -> tuple[int, ...]:
    """Return an action that merges and keeps the furniture completable, found once for each state."""
    seed = int(deepcopy(env.np_random).integers(2**31 - 1))
    poses = env.task.groups_of(env.state).part_poses
    state = (type(env), env.task.furniture.name, seed, *(pose.homogeneous.tobytes() for pose in poses))
    if state not in _RIGHT:
        _RIGHT[state] = _right_action(env, seed)
    return _RIGHT[state]


def _right_action(env: AnEnv, seed: int) -> tuple[int, ...]:
    assigned = next(env.task.rules.pairs.slot_assignments(env.task.groups_of(env.state)))
    disassembly = reasoning(env.task.furniture)
    rejected: set[frozenset[frozenset[int]]] = set()
    while True:
        order = disassembly.order(partition_of(assigned), rejected, straight=True, exhaustive=False)
        assert order, "nothing merges"
        if isinstance(env, FullEnv):
            options = grasping(env.task, env.state, assigned, *order[0])
        else:
            options = upright(disassembly, env.state, assigned, *order[0], straight=True)
        for action in options:
            if env.task.step(env.state, action, seed).step is not None:
                return action
        rejected.add(frozenset(order[0]))


def test_gymnasium_checker(env: AnEnv) -> None:
    """Pictures: `test_gymnasium.py`."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


def test_discrete_view_passes_the_checker(env: AnEnv) -> None:
    check_env(DiscreteActions(env), skip_render_check=True)


def test_episode_of_right_actions(env: AnEnv, furniture: Furniture) -> None:
    """Each merge gives a reward of 1 and the last one 4 more."""
    observation, info = env.reset(seed=0)
    assert info["groups"] == len(furniture.parts)
    assert not info["success"]
    rewards, terminated = [], False
    while not terminated:
        action = right_action(env)
        assert info["action_mask"][action], "a right action must exist"
        observation, reward, terminated, truncated, info = env.step(np.array(action))
        assert env.observation_space.contains(observation)
        assert (info["verdict"], truncated) == ("merged", False)
        assert info["planning_steps"] > 0
        rewards.append(reward)
    assert rewards == [1.0] * (len(furniture.parts) - 2) + [5.0]
    assert terminated
    assert info["success"]
    assert not info["action_mask"].any()


def test_observation_is_the_papers_state(env: AnEnv, furniture: Furniture) -> None:
    observation, _ = env.reset(seed=0)
    n = len(furniture.parts)
    assert {k: v.shape for k, v in observation.items()} == {
        "shapes": (20, 128, 3),
        "connection_points": (20, 10, 9),
        "grasp_regions": (20, 2, 4, 6),
        "poses": (20, 6),
        "connections": (20, 20, 6),
    }
    assert not any(observation[k][n:].any() for k in observation)
    assert not observation["connections"].any(), "nothing is joined at first"
    for p, part in enumerate(furniture.parts):
        np.testing.assert_allclose(
            observation["poses"][p], pose_to_euler(env.task.groups_of(env.state).part_poses[p]), atol=1e-6
        )
        low, high = part.mesh.bounds
        assert (observation["shapes"][p] >= low - 1e-6).all()
        assert (observation["shapes"][p] <= high + 1e-6).all()
        for k, point in enumerate(part.points):
            np.testing.assert_allclose(observation["connection_points"][p, k, :3], point.position, atol=1e-6)
        assert not observation["connection_points"][p, len(part.points) :].any()
        alone = Group((p,), (p,), (SE3.Identity(),), SE3.Identity())
        for g in range(4 * len(part.grasps)):
            held = grip_of(furniture, alone, p, g)
            assert held is not None
            grasp, tips = observation["grasp_regions"][p].reshape(8, 6)[g].astype(float), held.furniture_from_tips
            np.testing.assert_allclose(grasp[:3], tips.translation, atol=1e-6)
            np.testing.assert_allclose(rotations_from_euler(grasp[3:]), tips.rotation, atol=1e-5)
        assert not observation["grasp_regions"][p, len(part.grasps) :].any()

    action = right_action(env)
    observation, *_ = env.step(np.array(action))
    u, v = action[:2]
    poses = env.task.groups_of(env.state).part_poses
    relative = poses[u].actInv(poses[v])
    np.testing.assert_allclose(observation["connections"][u, v], pose_to_euler(relative), atol=1e-5)
    assert np.count_nonzero(observation["connections"].any(axis=2)) == 2


def test_observations_are_fresh_arrays(env: AnEnv) -> None:
    first, _ = env.reset(seed=0)
    for array in first.values():
        array.fill(7.0)
    second, _ = env.reset(seed=0)
    assert not any((array == 7.0).all() for array in second.values())


def test_mask_follows_its_definition(env: AnEnv, furniture: Furniture) -> None:
    _, info = env.reset(seed=0)
    mask = info["action_mask"]
    assert mask.shape == tuple(env.action_space.nvec)
    points = [len(p.points) for p in furniture.parts]
    grasps = [4 * len(p.grasps) for p in furniture.parts]
    ways = [[g * h for h in grasps] if isinstance(env, FullEnv) else [6] * len(points) for g in grasps]
    expected = sum(a * b * ways[i][j] for i, a in enumerate(points) for j, b in enumerate(points) if i != j)
    assert mask.sum() == expected
    np.testing.assert_array_equal(mask, env.action_mask)


def test_mask_does_not_leak_the_answer(env: AnEnv, furniture: Furniture) -> None:
    """The mask allows every pair of points of different groups, right or wrong."""
    _, info = env.reset(seed=0)
    for _ in range(2 if isinstance(env, FullEnv) else len(furniture.parts) // 2):
        *_, info = env.step(np.array(right_action(env)))
    joined = env.task.groups_of(env.state)
    mask, free = info["action_mask"], env.task.rules.free_points(joined, 20, 10)
    for u in range(20):
        for v in range(20):
            there = u < len(furniture.parts) and v < len(furniture.parts)
            apart = there and joined.group_of[u] != joined.group_of[v]
            expected = free[u][:, None] & free[v][None] if apart else np.zeros((10, 10), bool)
            # Of grasps it tells which a part has: all eight, or the four of its one region.
            np.testing.assert_array_equal(mask[u, v].reshape(10, 10, -1).any(axis=-1), expected)
            assert len({way.tobytes() for way in mask[u, v][expected]}) <= 1


def test_masked_actions_end_the_episode(env: AnEnv) -> None:
    more = [0] * (len(env.action_space.nvec) - 5)
    for action in ([0, 0, 0, 0, 0, *more], [19, 0, 9, 0, 0, *more], [0, 1, 9, 9, 5, *more]):
        _, info = env.reset(seed=0)
        if info["action_mask"][tuple(action)]:
            continue
        _, reward, terminated, _, info = env.step(np.array(action))
        assert (reward, terminated, info["verdict"]) == (0.0, True, "not_an_action")


def _is_right(env: AnEnv, action: np.ndarray) -> bool:
    joined, (u, v, k, l) = env.task.groups_of(env.state), (int(i) for i in action[:4])  # noqa: E741
    groups = (joined.groups[joined.group_of[u]], joined.groups[joined.group_of[v]])
    return env.task.rules.pairs.judge(*groups, u, k, v, l) is not None


def test_wrong_pairs_end_the_episode_and_change_nothing(env: AnEnv) -> None:
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    choices = np.argwhere(env.action_mask)
    wrong = 0
    for action in choices[rng.permutation(len(choices))[:40]]:
        if isinstance(env, FullEnv):
            if wrong > 5:
                break
            if _is_right(env, action):
                continue  # two robots would take their time to join it
        before, _ = env.reset(seed=0)
        after, reward, terminated, _, info = env.step(action)
        if info["verdict"] != "wrong_pair":
            continue
        wrong += 1
        assert (reward, terminated, info["planning_steps"]) == (0.0, True, 0)
        for key in before:
            np.testing.assert_array_equal(before[key], after[key])
    assert wrong > 5


def test_seeds_reproduce_episodes(env: AnEnv) -> None:
    def play(seed: int) -> list[np.ndarray]:
        observation, _ = env.reset(seed=seed)
        seen = [observation["poses"]]
        rng = np.random.default_rng(seed)
        for _ in range(1 if isinstance(env, FullEnv) else 2):
            observation, *_ = env.step(np.array(right_action(env)))
            seen.append(observation["poses"])
        choices = np.argwhere(env.action_mask)
        drawn = (choices[k] for k in rng.permutation(len(choices)))
        # Two robots would take their time to join a right pair.
        observation, *_ = env.step(next(c for c in drawn if not (isinstance(env, FullEnv) and _is_right(env, c))))
        return [*seen, observation["poses"]]

    first = play(0)
    for one, two in zip(first, play(0), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(first[0], env.reset(seed=5)[0]["poses"])


def test_several_pieces() -> None:
    env = ObjectCentricEnv(["stool", "stool:1", catalogue.make("windsor")])
    names = {env.reset(seed=s)[1]["furniture"] for s in range(12)}
    assert names == {"stool-0", "stool-1", "windsor-0"}
    assert env.reset(options={"furniture": 2})[1]["furniture"] == "windsor-0"
    with pytest.raises(InputError, match="index from 0 to 2"):
        env.reset(options={"furniture": 3})


def test_made_through_gymnasium_and_vectorised() -> None:
    envs = gymnasium.make_vec(OBJECT_CENTRIC, num_envs=2, vectorization_mode="sync", furniture="stool")
    observation, info = envs.reset(seed=0)
    assert observation["poses"].shape == (2, 20, 6)
    assert info["action_mask"].shape == (2, 20, 20, 10, 10, 6)
    _, rewards, terminated, _, info = envs.step(np.array([[0, 0, 0, 0, 0]] * 2))
    assert rewards.tolist() == [0.0, 0.0]
    assert terminated.tolist() == [True, True]
    assert list(info["verdict"]) == ["not_an_action"] * 2
    envs.close()


def test_the_full_setting_through_gymnasium() -> None:
    env = gymnasium.make(FULL, furniture="stool")
    _, info = env.reset(seed=0)
    assert info["action_mask"].shape == (20, 20, 10, 10, 8, 8)
    assert (info["stage"], info["robot"]) == ("", -1)
    assert 0.0 < info["density"] <= 700.0
    *_, info = env.step(np.zeros(6, int))
    assert info["verdict"] == "not_an_action"


def test_furniture_that_two_robots_cannot_hold_is_refused_at_reset() -> None:
    stool = catalogue.make("stool")
    bare = replace(stool, parts=(*stool.parts[:-1], replace(stool.parts[-1], grasps=())))
    env = FullEnv(bare)
    with pytest.raises(InputError, match=f"no hand can hold part '{bare.parts[-1].name}'"):
        env.reset(seed=0)


def test_smaller_spaces_for_small_furniture() -> None:
    stool = catalogue.make("stool")
    points = max(len(p.points) for p in stool.parts)
    env = ObjectCentricEnv(stool, max_parts=9, max_points=points, cloud_points=16)
    check_env(env, skip_render_check=True)
    assert env.action_space.nvec.tolist() == [9, 9, points, points, 6]
    with pytest.raises(InputError, match="too small"):
        ObjectCentricEnv(stool, max_parts=8)
    with pytest.raises(InputError, match="1 to 1000"):
        ObjectCentricEnv(stool, max_parts=1001)


def test_invalid_furniture_raises_at_construction(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean stool"):
        gymnasium.make(OBJECT_CENTRIC, furniture="stol")
    with pytest.raises(InputError, match="no furniture given"):
        ObjectCentricEnv([])
    folder = storage.save(catalogue.make("stool"), tmp_path / "s")
    assert ObjectCentricEnv(str(folder)).reset(seed=0)[1]["furniture"] == "stool-0"


def test_step_before_reset() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        ObjectCentricEnv("stool").step(np.zeros(5, int))


def test_discrete_numbers() -> None:
    env = DiscreteActions(ObjectCentricEnv("stool"))
    assert env.action_space.n == 20 * 20 * 10 * 10 * 6
    assert env.flatten((0, 0, 0, 0, 5)) == 5
    assert env.flatten((0, 0, 0, 1, 0)) == 6
    assert env.flatten((1, 0, 0, 0, 0)) == 20 * 10 * 10 * 6
    assert env.unflatten(env.flatten((3, 7, 2, 9, 4))) == (3, 7, 2, 9, 4)
    _, info = env.reset(seed=0)
    assert info["action_mask"].shape == (240_000,)
    np.testing.assert_array_equal(env.action_masks(), info["action_mask"])


@pytest.mark.slow
def test_a_third_party_learner_runs_unmodified() -> None:
    """sb3-contrib's MaskablePPO, 2,000 steps on the flat view."""
    learner = pytest.importorskip("sb3_contrib")
    stool = catalogue.make("stool")
    points = max(len(p.points) for p in stool.parts)
    env = DiscreteActions(ObjectCentricEnv(stool, max_parts=9, max_points=points, cloud_points=16))
    model = learner.MaskablePPO("MultiInputPolicy", env, n_steps=250, batch_size=125, n_epochs=2, seed=0)
    model.learn(2_000)
    assert model.num_timesteps == 2_000
    observation, _ = env.reset(seed=0)
    action, _ = model.predict(observation, action_masks=env.action_masks(), deterministic=True)
    assert env.action_masks()[int(action)]


def test_own_frames_describe_the_same_parts() -> None:
    """Everything in the world stays where it is, and the poses of joined parts in each other agree with the world."""
    chair = piece("ladder")
    aligned, own = (ObjectCentricEnv(chair, frames=frames) for frames in ("aligned", "own"))
    a, b = (env.reset(seed=4)[0] for env in (aligned, own))
    turned = 0
    for index in range(len(chair.parts)):
        turns = [rotations_from_euler(seen["poses"][index, 3:].astype(float)) for seen in (a, b)]
        own_from_aligned = turns[1].T @ turns[0]
        turned += not np.allclose(own_from_aligned, np.eye(3), atol=1e-3)
        assert np.allclose(a["poses"][index, :3], b["poses"][index, :3], atol=1e-5)
        points = [seen["connection_points"][index].reshape(-1, 3, 3) for seen in (a, b)]
        assert np.allclose(points[0] @ own_from_aligned.T, points[1], atol=1e-5)
        assert np.allclose(a["shapes"][index] @ own_from_aligned.T, b["shapes"][index], atol=1e-5)
    assert turned
    joint = chair.connections[0]
    u, v = joint.part_a, joint.part_b
    for w in range(6):
        observation, reward, *_ = own.step(np.array([u, v, joint.point_a, joint.point_b, w]))
        if reward:
            break
        own.reset(seed=4)
    assert reward
    turns = [rotations_from_euler(observation["poses"][i, 3:].astype(float)) for i in (u, v)]
    joined = rotations_from_euler(observation["connections"][u, v, 3:].astype(float))
    assert np.allclose(turns[0].T @ turns[1], joined, atol=1e-4)
    # The parts still fit: the two connection points lie on each other.
    ends = [
        turn @ observation["connection_points"][i, k, :3] + observation["poses"][i, :3]
        for turn, i, k in zip(turns, (u, v), (joint.point_a, joint.point_b), strict=True)
    ]
    assert np.linalg.norm(ends[0] - ends[1]) < 3e-3


def test_resampled_clouds_differ_between_equal_parts_and_episodes() -> None:
    chair = piece("stool")
    members = next(c.members for c in chair.classes if len(c.members) > 1)
    clouds = {}
    for name in ("shared", "resampled"):
        env = ObjectCentricEnv(chair, clouds=name)
        clouds[name] = [env.reset(seed=seed)[0]["shapes"] for seed in (1, 2, 1)]
    first, second, again = clouds["shared"]
    assert (first[members[0]] == first[members[1]]).all()
    assert (first == second).all()
    first, second, again = clouds["resampled"]
    assert (first == again).all()
    assert not np.isclose(first[members[0]], first[members[1]]).all(axis=1).any()
    assert not np.isclose(first[members[0]], second[members[0]]).all(axis=1).any()
    # Still on the surface of the part.
    mesh = chair.parts[members[0]].mesh
    assert distances_to(mesh.bvh, first[members[0]].astype(float)).max() < 1e-6


def test_noise_has_the_standard_deviation_that_was_asked_for() -> None:
    env = ObjectCentricEnv(piece("stool"), cloud_points=2000, noise=0.001)
    noisy = env.reset(seed=0)[0]["shapes"]
    plain = ObjectCentricEnv(piece("stool"), cloud_points=2000).reset(seed=0)[0]["shapes"]
    n = len(piece("stool").parts)
    assert (noisy - plain)[:n].std() == pytest.approx(0.001, rel=0.02)


def test_hints_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ValueError, match="frames is 'mine'; expected 'aligned' or 'own'"):
        ObjectCentricEnv("stool", frames="mine")
    with pytest.raises(ValueError, match="clouds is 'none'; expected 'shared' or 'resampled'"):
        ObjectCentricEnv("stool", clouds="none")
    with pytest.raises(ValueError, match="noise is -1"):
        ObjectCentricEnv("stool", noise=-1.0)


@pytest.fixture(scope="module")
def long_frame() -> Furniture:
    """Return a frame of 24 parts, more than the paper's."""
    return annotate("frame", as_parts(lattice(24).parts()), Provenance("test"), with_grasps=False)


def test_furniture_of_more_parts_needs_larger_spaces(long_frame: Furniture) -> None:
    parts, points = long_frame.padding
    assert parts == 24
    with pytest.raises(ValueError, match=rf"has 24 parts .* give max_parts=24, max_points={points}"):
        ObjectCentricEnv(long_frame)
    env = ObjectCentricEnv(long_frame, max_parts=parts, max_points=points)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
    plan = solve(long_frame, 0).plan
    assert plan.success
    observation, info = env.reset(seed=0)
    assert observation["shapes"][:24].any(axis=(1, 2)).all()
    assert info["action_mask"].any(axis=(1, 2, 3, 4)).sum() == 24


@pytest.mark.slow
def test_policies_see_furniture_of_more_parts_whole(long_frame: Furniture) -> None:
    """The random policy draws from parts beyond the twentieth, too; `paper` says that it cannot."""
    first = {rollout_policy(load_policy("random", seed), long_frame, seed).actions[0][0] for seed in range(40)}
    assert max(first) >= 20
    shelves = annotate("shelf", as_parts(shelf(26).parts()), Provenance("test"), with_grasps=False)
    done = rollout_policy(load_policy("relational"), shelves, 0)
    assert len(done.plan.steps) >= 3
    assert max(part for step in done.plan.steps for part in step.action[:2]) >= 20
