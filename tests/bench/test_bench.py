"""Tests of the planning benchmark: its report, and that all collision checkers agree."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from roboassembly.bench.bullet import quiet
from roboassembly.bench.fcl_backend import FclPeer
from roboassembly.bench.merges import BenchMerge, find_chairs, merges_of
from roboassembly.bench.peers import IsFree, configuration_state, ompl_state, plan_with_peer, state_space
from roboassembly.bench.planning import PEERS, PlanningBenchConfig, PlanningBenchReport, run_planning_bench
from roboassembly.bench.pybullet_backend import PyBulletPeer
from roboassembly.bench.same_planner import PeerWorld
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.geometry.poses import SE3
from roboassembly.planning.mating import plan_mating
from roboassembly.planning.problem import Budget

pytest.importorskip("fcl")
pytest.importorskip("pybullet")


_chairs = cache(find_chairs)


@pytest.fixture(autouse=True)
def _chairs_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roboassembly.bench.planning.find_chairs", _chairs)


@cache
def quick_report() -> PlanningBenchReport:
    return run_planning_bench(PlanningBenchConfig.quick())


@cache
def merge() -> BenchMerge:
    """Return the merge of a slat with a post that already has other slats."""
    (chair,) = _chairs("ladder", 15, 1, 0)
    return list(merges_of(chair, 0))[3]


@pytest.mark.slow
def test_the_report_has_its_keys_and_is_json() -> None:
    out = json.loads(json.dumps(quick_report().to_json(), allow_nan=False))
    assert {
        "us_per_state",
        "plan_seconds",
        "solved",
        "states",
        "ratio_pybullet",
        "ratio_fcl",
        "ratio_pybullet_total",
        "ratio_fcl_total",
        "merges",
        "chair",
        "step",
        "skipped",
        "machine",
        "seed",
    } <= set(out)
    assert out["merges"] == len(out["per_merge"]) == 5
    assert out["skipped"] == {}
    assert set(out["chair"]) == {
        "parts", "states_median", "planning_seconds_median", "wall_seconds_median", "chairs"
    }  # fmt: skip
    assert out["chair"]["parts"] == 15
    for key in ("us_per_state", "plan_seconds", "solved", "states"):
        assert {"ours", "pybullet", "fcl"} <= set(out[key])


@pytest.mark.slow
def test_ours_solves_every_merge_and_ratios_are_numbers() -> None:
    out = quick_report().to_json()
    assert out["solved"]["ours"] == [5, 5]
    for name in ("ratio_pybullet", "ratio_fcl", "ratio_pybullet_total", "ratio_fcl_total"):
        assert np.isfinite(out[name])
        assert out[name] > 0
    assert all(0 < us < 1e5 for us in out["us_per_state"].values())
    assert all(value > 0 for value in out["step"].values())
    assert all(out["states"][name] <= 5 * 20_000 for name in PEERS)


@pytest.mark.slow
def test_the_same_planner_over_peers_solves_every_merge_with_the_same_states() -> None:
    same = quick_report().to_json()["same_planner"]
    assert same["solved"] == {"pybullet": [5, 5], "fcl": [5, 5]}
    assert same["states"]["pybullet"] == same["states"]["fcl"]


@pytest.mark.slow
def test_the_table_names_every_backend() -> None:
    text = quick_report().to_text()
    for name in ("ours", "pybullet", "fcl", "wrong pair"):
        assert name in text


def test_the_merge_is_the_one_that_the_task_plans() -> None:
    own = merge().chair.task.plan(merge().mating, merge().seed, Budget())
    ours = plan_mating(merge().world(), merge().problem, Budget(), merge().seed)
    assert own.states == ours.states
    for a, b in zip(own.path, ours.path, strict=True):
        np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=1e-12)


@pytest.mark.parametrize("name", ["fcl", pytest.param("pybullet", marks=pytest.mark.slow)])
def test_a_missing_backend_is_skipped_by_name(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    config = PlanningBenchConfig(chairs=1, merges=1, repeats=1, states=300, sampled_states=50)
    report = run_planning_bench(config)
    out = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert "python -m pip install '.[bench]'" in out["skipped"][name]
    assert out["plan_seconds"][name] is None
    assert out[f"ratio_{name}"] is None
    assert out["solved"]["ours"] == [1, 1]
    assert "skipped" in report.to_text()


@pytest.mark.parametrize(("make", "module"), [(FclPeer, "fcl"), (PyBulletPeer, "pybullet")])
def test_a_missing_backend_names_the_extra(
    make: type[FclPeer] | type[PyBulletPeer], module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=r"'\.\[bench\]'"):
        make()


def test_too_few_chairs_is_an_input_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roboassembly.bench.merges._SEEDS_TRIED", 2)
    with pytest.raises(InputError, match="ask for fewer"):
        find_chairs("ladder", 2, 1, 0)


def random_poses(count: int) -> list[SE3]:
    """Around the mating pose, from nearly there to a hand's breadth away, and anyhow within the bounds."""
    rng = np.random.default_rng(0)
    goal, (low, high) = merge().problem.goal, merge().bounds
    poses = []
    for index in range(count):
        if index % 4 == 3:
            poses.append(SE3(pin.exp3(rng.normal(size=3)), rng.uniform(low, high)))
            continue
        size = (1e-4, 0.003, 0.1)[index % 4]
        turn = pin.exp3(rng.normal(size=3) * size)
        poses.append(SE3(goal.rotation @ turn, goal.translation + size * rng.normal(size=3)))
    return poses


def answers(is_free: IsFree, poses: list[SE3]) -> np.ndarray:
    space = state_space(merge().bounds, (merge().problem.start, merge().problem.goal))
    return np.array([is_free(ompl_state(space, pose)) for pose in poses])


def test_fcl_agrees_with_ours_on_random_configurations() -> None:
    poses, world, peer = random_poses(200), merge().world(), FclPeer()
    ours = np.array([world.is_free(pose) for pose in poses])
    assert 20 < ours.sum() < 180
    np.testing.assert_array_equal(answers(peer.set_up(merge().scene), poses), ours)


def test_pybullet_agrees_with_ours_on_random_configurations() -> None:
    """The results agree except where Bullet's single precision decides."""
    poses, world, peer = random_poses(200), merge().world(), PyBulletPeer()
    ours = np.array([world.is_free(pose) for pose in poses])
    theirs = answers(peer.set_up(merge().scene), poses)
    peer.close()
    assert (theirs == ours).mean() >= 0.99


def test_pybullet_agrees_on_clear_cases() -> None:
    """The mating pose is free and 4 mm across it is not; 1 m up is free and 5 cm into the ground is not."""
    peer, problem = PyBulletPeer(), merge().problem
    is_free = peer.set_up(merge().scene)
    retreat = problem.retreats[0]
    across = np.cross(retreat, [0.0, 0.0, 1.0]) if abs(retreat[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across *= 0.004 / np.linalg.norm(across)

    def moved(pose: SE3, offset: np.ndarray) -> SE3:
        return SE3(pose.rotation, pose.translation + offset)

    free = [problem.goal, problem.start, moved(problem.goal, np.array([0.0, 0.0, 1.0]))]
    taken = [moved(problem.goal, across), moved(problem.start, np.array([0.0, 0.0, -0.05]))]
    assert answers(is_free, free).all()
    assert not answers(is_free, taken).any()
    world = merge().world()
    assert all(world.is_free(pose) for pose in free)
    assert not any(world.is_free(pose) for pose in taken)
    peer.close()


def test_hulls_collide_at_the_mating_pose() -> None:
    """Moving parts are not hulls in Bullet, because hulls collide at the mating pose."""
    for pieces, least, most in (("hulls", 0.002, 0.1), ("triangles", 0.0, 0.0)):
        peer = PyBulletPeer("hulls" if pieces == "hulls" else "triangles")
        peer.set_up(merge().scene)
        assert least <= peer.depth(merge().problem.goal) <= most
        peer.close()


def test_peer_finds_a_path_in_free_space() -> None:
    """The path leads from the ground to above the chair, out of no connection."""
    goal = SE3(merge().problem.goal.rotation, merge().problem.goal.translation + np.array([0.0, 0.0, 1.0]))
    for peer in (FclPeer(), PyBulletPeer()):
        runs = [
            plan_with_peer(peer, merge().scene, (merge().problem.start, goal), merge().bounds, 20_000, 20.0, seed=5)
            for _ in range(2)
        ]
        assert runs[0].solved
        assert runs[0].states == runs[1].states > 10
        peer.close()


def test_the_wall_time_cap_is_reported() -> None:
    ends = (merge().problem.start, merge().problem.goal)
    run = plan_with_peer(FclPeer(), merge().scene, ends, merge().bounds, 10_000_000, 0.05, seed=0)
    assert run.capped
    assert not run.solved


def test_resolution_of_peers() -> None:
    ends = (merge().problem.start, merge().problem.goal)
    space = state_space(merge().bounds, ends)
    space.setup()
    here, there = np.zeros(7), np.array([0.25, 0, 0, 0, 0, 0, 1.0])
    here[6] = 1.0
    turned = np.array([0, 0, 0, 0, 0, np.sin(np.deg2rad(15)), np.cos(np.deg2rad(15))])
    states = [configuration_state(space, c) for c in (here, there, turned)]
    assert space.validSegmentCount(states[0], states[1]) in (125, 126)
    assert space.validSegmentCount(states[0], states[2]) in (30, 31)


def test_a_peer_world_counts_states() -> None:
    peer = FclPeer()
    world = PeerWorld(merge().scene, merge().box_axes, peer.set_up(merge().scene))
    far = SE3(np.eye(3), np.array([0.0, 0.0, 3.0]))
    assert world.edge_is_free(far, SE3(np.eye(3), np.array([0.1, 0.0, 3.0])))
    assert world.states >= 50


def test_standard_output_stays_clean() -> None:
    code = (
        "from roboassembly.bench.pybullet_backend import PyBulletPeer\n"
        "peer = PyBulletPeer(); peer.close(); print('{}')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "{}\n"
    assert done.stderr == ""


def test_quiet_silences_native_output_and_restores_the_streams(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet():
        os.write(1, b"noise")
    os.write(1, b"signal")
    assert capfd.readouterr().out == "signal"


@pytest.mark.slow
def test_robots_against_peers() -> None:
    pytest.importorskip("pybullet")
    pytest.importorskip("roboplan.core")
    from roboassembly.bench.robots import run_robot_bench

    out = run_robot_bench("stool", states=200, merges=1).to_json()
    assert out["skipped"] == {}
    # Bullet has hulls in the moving hand, so it may see collisions where there are none; nothing of RoboPlan is solid.
    assert out["states_agree"]["pybullet"] > 0.95
    assert out["states_agree"]["roboplan"] > 0.98
    assert out["path_solved"]["ours"] == out["paths"] == 7
    assert out["path_solved"]["RoboPlan, 20 mm"] >= 6
    assert out["path_ratio_median"]["OMPL over PyBullet"] > 5.0
    assert out["us_per_state"]["pybullet"] > 2.0 * out["us_per_state"]["ours"]
    assert out["hopeless"] > 20
    assert out["hopeless_seconds_median"] < 0.1
    json.dumps(out)
