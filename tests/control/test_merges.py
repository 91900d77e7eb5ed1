"""Merges in `RoboAssembly/Control-v0`: planned ones succeed in every mode of control, and repeat from their actions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from control.episodes import carry_out, planned_merge
from roboassembly.control.cell import POST_HEIGHT
from roboassembly.control.collisions import CollisionTest
from roboassembly.control.controls import CONTROLS, ControlName
from roboassembly.control.env import ControlEnv
from roboassembly.control.randomization import Randomization
from roboassembly.control.replay import commands_of
from roboassembly.datasets import catalogue
from roboassembly.simulation.control_physics import CONTROL_RATE
from roboassembly.solvers.options import grasping
from roboassembly.task.full.execution import JOINT_ANGLE, JOINT_POSITION
from roboassembly.task.full.posts import LOWEST
from roboassembly.task.plans.full_plan import FullStep

MERGE = {"merge": 0}
"""A stretcher into a leg."""


def make(**arguments) -> ControlEnv:
    env = ControlEnv(catalogue.make("stool", 0), **{"task": "merge", **arguments})
    env.reset(seed=0, options=MERGE)
    return env


@cache
def planned() -> FullStep:
    return planned_merge(make())


@pytest.mark.parametrize(
    "control", [pytest.param(c, marks=() if c == "joint_position" else pytest.mark.slow) for c in CONTROLS]
)
def test_a_planned_merge_succeeds_and_its_actions_repeat_it(control: ControlName) -> None:
    env = make(control=control, strict=control == "joint_position")
    actions, rewards, info = carry_out(env, planned())
    assert (sum(rewards), rewards[-1]) == (1.0, 1.0)
    assert (info["is_success"], info["success"], info["failure"], info["merges"]) == (True, True, "", 1)
    assert info["groups"] == 8
    # Both hands hold the one group that is left of the two.
    assert info["holds"][0] == info["holds"][1] >= 0
    assert 0.0 < info["joint_error_mm"] < 1e3 * JOINT_POSITION
    assert 0.0 < info["joint_error_deg"] < np.degrees(JOINT_ANGLE)
    assert info["seconds"] == len(actions) / CONTROL_RATE
    with pytest.raises(ResetNeeded, match="ended with 'success'"):
        env.step(actions[0])
    if control != "joint_delta":
        return
    first = env.cell.part_sevens()
    env.reset(seed=0, options=MERGE)
    for action in actions:
        *_, again = env.step(action)
    assert again["is_success"]
    assert again["joint_error_mm"] == info["joint_error_mm"]
    np.testing.assert_array_equal(env.cell.part_sevens(), first)


@pytest.mark.slow
def test_another_start_needs_another_plan() -> None:
    """The commands of one start grip nothing from another one: success is not given away."""
    env, segments = make(), planned().segments
    env.reset(seed=5, options=MERGE)
    for targets, openings in commands_of(segments[:3], env.cell):
        _, reward, terminated, _, info = env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
        assert (reward, terminated) == (0.0, False)
    assert info["holds"].tolist() == [-1, -1]
    assert info["groups"] == 9


def test_a_hand_grips_only_what_both_pads_press() -> None:
    """A hand that closes 40 mm beside the part holds nothing; at the part it does, and the post sinks."""
    env, segments = make(), planned().segments
    robot = segments[0].robot
    posts = len(env.cell.posts)
    for targets, openings in commands_of(segments[:1], env.cell):
        env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
    closed = np.zeros(2)
    for _ in range(20):
        *_, info = env.step(env.codec.encode(env.cell.physics.commands, closed, env.cell.physics.commands))
    assert info["holds"].tolist() == [-1, -1]
    assert len(env.cell.posts) == posts
    assert env.cell.physics.opening(robot) < 1e-3

    env.reset(seed=0, options=MERGE)
    for targets, openings in commands_of(segments[:3], env.cell):
        *_, info = env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
    assert info["holds"][robot] >= 0
    assert len(env.cell.posts) == posts - 1
    left, right = env.cell.physics.contact(robot).forces
    assert min(left, right) >= 1.0
    assert left == pytest.approx(right, rel=0.2)
    # The part came along when the hand rose by 60 mm.
    rise = env.cell.group(env.cell.physics.grasped(robot)).world_from_furniture.translation
    before = segments[0].before.placed[env.cell.physics.grasped(robot)].group.world_from_furniture.translation
    assert rise[2] - before[2] == pytest.approx(0.06, abs=2e-3)


def test_what_is_let_go_of_high_up_falls_and_near_the_posts_stands() -> None:
    env, segments = make(), planned().segments
    robot = segments[0].robot
    for targets, openings in commands_of(segments[:3], env.cell):
        env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
    key, posts = env.cell.physics.grasped(robot), len(env.cell.posts)
    start = env.cell.physics.commands.copy()
    opened = np.where(np.arange(2) == robot, 0.06, 0.0)

    def lowest() -> float:
        group = env.cell.group(key)
        mesh = env.task.furniture.parts[group.parts[0]].mesh
        return float(min(group.part_poses()[0].act(v)[2] for v in mesh.hull_vertices))

    # 60 mm above its post is just too high for the posts.
    assert lowest() - LOWEST == pytest.approx(0.06, abs=2e-3)
    assert lowest() - LOWEST > POST_HEIGHT
    fell_at = None
    for k in range(40):
        _, reward, terminated, _, info = env.step(env.codec.encode(start, opened, start))
        assert reward == 0.0
        if terminated:
            fell_at = k
            break
    assert (info["failure"], info["is_success"]) == ("dropped", False)
    # A part that lies on a finger or a platform counts as dropped after a second.
    assert fell_at is not None
    assert fell_at < CONTROL_RATE
    assert lowest() - LOWEST < 0.05

    env.reset(seed=0, options=MERGE)
    for targets, openings in commands_of(segments[:3], env.cell):
        env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
    lowered = list(np.linspace(segments[2].path[-1], segments[2].path[0], 40))
    commands = env.cell.physics.commands.copy()
    for q in [*lowered, *[lowered[-1]] * 4]:
        commands[robot] = q
        env.step(env.codec.encode(commands, np.zeros(2), env.cell.physics.commands))
    there = env.cell.group(key).world_from_furniture.translation
    for _ in range(10):
        *_, info = env.step(env.codec.encode(commands, opened, env.cell.physics.commands))
    assert info["failure"] == ""
    assert info["holds"][robot] == -1
    assert len(env.cell.posts) == posts + 1
    np.testing.assert_allclose(env.cell.group(key).world_from_furniture.translation, there, atol=1e-3)


def test_a_part_that_goes_through_another_one_touches_it_in_the_exact_test() -> None:
    """R_a takes the part in its hand through the part on the nearest post; parts do not collide in physics."""
    env, segments = make(control="joint_position"), planned().segments
    robot = segments[0].robot
    for targets, openings in commands_of(segments[:2], env.cell):
        env.step(env.codec.encode(targets, openings, env.cell.physics.commands))
    physics, test = env.cell.physics, CollisionTest(env.cell)
    key = physics.grasped(robot)
    assert not test.touches()
    other = min(physics.contents.on_posts, key=lambda k: np.linalg.norm((physics.center(k) - physics.center(key))[:2]))
    way = physics.center(other) - physics.center(key)
    commands, start = physics.commands.copy(), physics.commands[robot].copy()
    touched = []
    for share in np.linspace(0.0, 1.0, 40):
        commands[robot, :2] = start[:2] + share * way[:2]
        *_, info = env.step(env.codec.encode(commands, np.zeros(2), physics.commands))
        touched.append(test.touches())
        assert info["failure"] == ""
    assert not any(touched[:5])
    assert any(touched)


def test_dense_reward_adds_up_to_the_progress() -> None:
    """The changes of the progress add up to 1 less what it was at the beginning, and 1 comes for the merge."""
    from roboassembly.control.reward import NextMerge

    env = make(reward="dense")
    begun = NextMerge(env.cell, env.merge).progress()
    assert 0.0 < begun < 0.5
    _, rewards, info = carry_out(env, planned())
    assert info["is_success"]
    assert sum(rewards) == pytest.approx(1.0 + 1.0 - begun)
    assert rewards[-1] > 1.0


def test_another_merge_than_the_one_that_is_asked_for_is_a_failure() -> None:
    env = make(reward="dense")
    names = [part.name for part in env.task.furniture.parts]
    asked = set(env.merge.first + env.merge.second)
    leg, stretcher = names.index("leg_front_left"), names.index("stretcher_left")
    assert not asked & {leg, stretcher}
    state = env.state
    actions = grasping(env.task, state, state.groups, frozenset({stretcher}), frozenset({leg}))
    other = next(step for action in actions if (step := env.task.step(state, action, 0).step) is not None)
    _, rewards, info = carry_out(env, other)
    assert (info["failure"], info["is_success"], info["merges"]) == ("wrong_merge", False, 1)
    assert rewards[-1] == 0.0
    assert sum(rewards) < 0.5


def test_success_under_randomized_physics_and_starts() -> None:
    ranges = Randomization(friction=0.3, density=0.2, stiffness=0.1, part_position=0.005, part_angle=0.05)
    env = make(randomization=ranges)
    moved = env.cell.part_sevens()
    plain = make().cell.part_sevens()
    shift = np.linalg.norm(moved[:, :2] - plain[:, :2], axis=1)
    assert (shift > 0.0).all()
    assert shift.max() < 0.05
    _, rewards, info = carry_out(env, planned_merge(env))
    assert (sum(rewards), info["is_success"]) == (1.0, True)


@pytest.mark.slow
def test_a_whole_plan_replays_open_loop() -> None:
    from roboassembly.solvers.full_search import FULL_LIMITS, solve_full_from

    env = ControlEnv(catalogue.make("three_legged", 3), control="joint_position", time_limit=1e4)
    env.reset(seed=0)
    plan = solve_full_from(env.task, env.state, 0, FULL_LIMITS).plan
    assert plan.success
    rewards: list[float] = []
    for step in plan.steps:
        _, some, info = carry_out(env, step)
        rewards += some
    assert info["is_success"]
    assert sum(rewards) == len(env.task.furniture.parts) - 1 + 4
