"""`RoboAssembly/Control-v0` follows Gymnasium's conventions and those of the other environments."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.utils.env_checker import check_env

from roboassembly.control.env import ControlEnv
from roboassembly.control.observation import ROBOT_FIELDS
from roboassembly.control.randomization import Randomization
from roboassembly.datasets import catalogue
from roboassembly.envs import CONTROL
from roboassembly.envs.full import FullEnv
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import pose_to_seven
from roboassembly.robots.body import world_from_tips
from roboassembly.task.full.segments import TUCKED

Make = Callable[..., gymnasium.Env[Any, Any]]


@cache
def stool() -> Furniture:
    """Return a piece of five parts, whose layout takes little time."""
    return catalogue.make("three_legged", 3)


@pytest.fixture(params=["class", "gymnasium.make"])
def make(request: pytest.FixtureRequest) -> Make:
    def by_class(**arguments: Any) -> gymnasium.Env[Any, Any]:
        return ControlEnv(**{"furniture": stool(), **arguments})

    def by_name(**arguments: Any) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(CONTROL, **{"furniture": stool(), **arguments})

    return by_class if request.param == "class" else by_name


def one_line(error: pytest.ExceptionInfo[BaseException]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"task": "merge", "obs": "rgbd", "camera_width": 24, "camera_height": 16},
    ],
)
def test_gymnasium_checker_gives_no_warnings(arguments: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(CONTROL, furniture=stool(), **arguments).unwrapped)


BAD_ACTIONS = (
    (np.zeros(21), r"has shape \(21,\); expected 22 numbers in \[-1, 1\]"),
    (np.zeros((1, 22)), r"has shape \(1, 22\)"),
    (np.zeros((2, 11)), r"has shape \(2, 11\)"),
    (0.5, r"action 0.5 has shape \(\)"),
    (None, r"action None has shape \(\)"),
    (["0"] * 22, "has dtype <U1; expected 22 numbers"),
    (np.zeros(22, bool), "has dtype bool"),
    ([[0], [0, 1], *[[0]] * 20], "is no array"),
    (np.full(22, np.nan), r"action\[0\] \(a/x\) is nan; expected 22 numbers"),
    (np.where(np.arange(22) == 21, np.inf, 0.0), r"action\[21\] \(b/hand\) is inf"),
    (np.where(np.arange(22) == 4, -np.inf, 0.0), r"action\[4\] \(a/q2\) is -inf"),
)


def test_actions_outside_of_the_space(make: Make) -> None:
    """Actions that are none raise with their value and leave the episode unchanged; large numbers are cut."""
    env, undisturbed = make(), make()
    for each in (env, undisturbed):
        each.reset(seed=0)
    for action, message in BAD_ACTIONS:
        with pytest.raises(InvalidAction, match=message) as error:
            env.step(action)
        one_line(error)
    large = np.where(np.arange(22) == 0, 7.0, 0.0)
    observation, *_ = env.step(large)
    expected, *_ = undisturbed.step(np.clip(large, -1.0, 1.0).astype(np.float32))
    for key in expected:
        np.testing.assert_array_equal(observation[key], expected[key])


def test_steps_before_and_after_an_episode(make: Make) -> None:
    env = make(time_limit=0.1)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(np.zeros(22))
    with pytest.raises(ResetNeeded, match="reset"):
        env.unwrapped.step(np.zeros(22))
    env.reset(seed=0)
    assert env.step(np.zeros(22))[2:4] == (False, False)
    _, reward, terminated, truncated, info = env.step(np.zeros(22))
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert (info["failure"], info["is_success"], info["seconds"]) == ("time_limit", False, 0.1)
    with pytest.raises(ResetNeeded, match=r"over \(it ended with 'time_limit'\); call reset\(\)"):
        env.step(np.zeros(22))
    env.reset(seed=0)
    assert env.step(np.zeros(22))[4]["failure"] == ""


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"furnitur": 3}, ValueError, "unknown reset option 'furnitur' .*3.*known: 'furniture', 'merge'"),
        ({"furniture": 1}, ValueError, r"options\['furniture'\] is 1; expected an index from 0 to 0"),
        ({"furniture": True}, ValueError, "is True"),
        ({"merge": 4}, ValueError, r"options\['merge'\] is 4; expected an index from 0 to 3"),
        ({"merge": -1}, ValueError, "is -1"),
        ({"merge": "leg"}, ValueError, "is 'leg'"),
        ("merge", TypeError, "options is 'merge'; expected a dictionary"),
    ],
)
def test_reset_options(options: Any, kind: type[Exception], message: str) -> None:
    env = ControlEnv(stool(), task="merge")
    with pytest.raises(kind, match=message) as error:
        env.reset(seed=1, options=options)
    one_line(error)


def test_a_merge_is_no_option_of_the_whole_piece() -> None:
    with pytest.raises(ValueError, match="is 0; only task='merge' takes it"):
        ControlEnv(stool()).reset(seed=0, options={"merge": 0})
    with pytest.raises(ValueError, match=r"options\['merge'\] needs options\['furniture'\]"):
        ControlEnv([stool(), stool()], task="merge").reset(seed=0, options={"merge": 0})


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"task": "chair"}, ValueError, "task is 'chair'; expected 'merge', 'piece'"),
        ({"control": "torque"}, ValueError, "control is 'torque'; expected 'joint_position', 'joint_delta', 'end_eff"),
        ({"obs": "depth"}, ValueError, "obs is 'depth'; expected 'state', 'rgb', 'rgbd'"),
        ({"reward": None}, ValueError, "reward is None; expected 'sparse', 'dense'"),
        ({"cameras": ["front"]}, ValueError, "unknown camera 'front'; known: 'wrist_a', 'wrist_b', 'overview', 'over"),
        ({"cameras": []}, ValueError, "no cameras given"),
        ({"cameras": ["overview", "overview"]}, ValueError, "camera 'overview' is named twice"),
        ({"cameras": "overview"}, TypeError, "cameras is 'overview'; expected a list of names"),
        ({"camera_width": 0}, ValueError, "0 x 128"),
        ({"camera_height": 9000}, ValueError, "128 x 9000"),
        ({"camera_width": 12.5}, TypeError, "camera_width is 12.5; expected an integer"),
        ({"width": 0}, ValueError, "0 x 480"),
        ({"time_limit": 0}, ValueError, "time_limit is 0; expected more than 0"),
        ({"time_limit": float("nan")}, ValueError, "time_limit is nan"),
        ({"time_limit": "1 h"}, TypeError, "time_limit is '1 h'; expected a number of seconds"),
        ({"layout": -1}, ValueError, "layout is -1; expected an integer from 0 to 2147483647"),
        ({"layout": "ring"}, TypeError, "layout is 'ring'; expected an integer"),
        ({"max_parts": 4}, ValueError, "'three_legged-3' has 5 parts; max_parts=4 .* give max_parts=5"),
        ({"max_parts": 0}, ValueError, "max_parts is 0; expected an integer from 1 to 1000"),
        ({"randomization": True}, TypeError, "randomization is True; expected a Randomization or None"),
        ({"furniture": None}, TypeError, "furniture is None; expected a name"),
        ({"furniture": []}, ValueError, "no furniture given"),
        ({"furniture": "stol"}, InputError, "'stol'; did you mean stool"),
        ({"render_mode": "ansi"}, UnsupportedMode, "render_mode is 'ansi'; expected 'rgb_array' or None"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*not in the possible render_modes")
def test_arguments(make: Make, arguments: dict[str, Any], kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        make(**arguments)


def test_it_starts_where_full_starts() -> None:
    """The same seed has the same layout as in `Full-v0`, as observed: poses of parts, robots and finger tips."""
    env, full = ControlEnv(stool(), max_parts=6), FullEnv(stool())
    observation, info = env.reset(seed=3)
    full.reset(seed=3)
    expected = [pose_to_seven(pose) for pose in full.state.groups.part_poses]
    np.testing.assert_allclose(observation["parts"][:5], expected, atol=1e-6)
    assert not observation["parts"][5].any()
    for row, robot in zip(observation["robots"], full.state.cell_state.robots, strict=True):
        named = dict(zip(ROBOT_FIELDS, row.tolist(), strict=True))
        assert (named["x"], named["y"]) == pytest.approx(robot.at[:2].tolist(), abs=1e-6)
        assert np.arctan2(named["sin_yaw"], named["cos_yaw"]) == pytest.approx(robot.at[2], abs=1e-6)
        assert [named[f"q{j + 1}"] for j in range(7)] == pytest.approx(TUCKED.tolist())
        assert [named[f"tips_{c}"] for c in "xyz"] == pytest.approx(world_from_tips(robot.at).translation, abs=1e-6)
        assert (named["opening"], named["holds"], named["left_force"]) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(observation["groups"][:5], range(5))
    assert not observation["goal"].any()
    assert info["task_description"] == "Assemble three_legged-3: join its 5 parts."


@pytest.mark.parametrize(
    ("task", "options"),
    [
        pytest.param("piece", {}, marks=pytest.mark.slow),
        ("merge", {"merge": 0}),
        pytest.param("merge", {"merge": 2}, marks=pytest.mark.slow),
    ],
)
def test_one_layout_for_all_episodes(task: str, options: dict[str, Any]) -> None:
    """Episodes begin alike but for the ranges of parts; without a layout they do not."""
    ranges = Randomization(part_position=0.02, part_angle=0.2)
    fixed = ControlEnv(stool(), task=task, layout=1)  # pyright: ignore[reportArgumentType]
    first, second = (fixed.reset(seed=seed, options=options)[0] for seed in (3, 4))
    for name, rows in first.items():
        np.testing.assert_array_equal(rows, second[name])
    near = ControlEnv(stool(), task=task, layout=1, randomization=ranges)  # pyright: ignore[reportArgumentType]
    third, fourth = (near.reset(seed=seed, options=options)[0] for seed in (3, 4))
    np.testing.assert_array_equal(third["robots"], first["robots"])
    assert 0.001 < np.abs(third["parts"][:5, :3] - fourth["parts"][:5, :3]).max() < 0.3
    dots = np.abs((third["parts"][:5, 3:] * first["parts"][:5, 3:]).sum(axis=1))
    assert 0.0 < 2.0 * np.arccos(dots.clip(0.0, 1.0)).max() <= 0.2 + 1e-3
    again = near.reset(seed=3, options=options)[0]
    np.testing.assert_array_equal(again["parts"], third["parts"])
    other = ControlEnv(stool(), task=task, layout=2).reset(seed=3, options=options)[0]  # pyright: ignore[reportArgumentType]
    assert np.abs(other["parts"][:5, :3] - first["parts"][:5, :3]).max() > 0.3


def test_the_goal_of_a_merge_is_told() -> None:
    env = ControlEnv(stool(), task="merge")
    observation, info = env.reset(seed=0, options={"merge": 3})
    merge = env.merge
    assert merge is not None
    assert info["groups"] == 2
    assert info["merges"] == 0
    assert sorted(merge.first + merge.second) == list(range(5))
    np.testing.assert_array_equal(observation["goal"][list(merge.first)], 1.0)
    np.testing.assert_array_equal(observation["goal"][list(merge.second)], -1.0)
    a, b = (stool().assembled[parts[0]] for parts in merge.groups)
    np.testing.assert_allclose(observation["goal_pose"], pose_to_seven(b.inverse() * a), atol=1e-6)
    # Parts that are joined already lie to each other as in the finished piece.
    joined = merge.second if len(merge.second) > 1 else merge.first
    poses = env.cell.part_poses()
    for part in joined[1:]:
        reached = poses[joined[0]].actInv(poses[part])
        assert reached.isApprox(stool().assembled[joined[0]].actInv(stool().assembled[part]), 1e-9)
    names = [stool().parts[p].name.replace("_", " ") for p in merge.first]
    assert info["task_description"].startswith(f"Join {names[0]}")


def test_a_robot_that_touches_something_ends_a_strict_episode() -> None:
    """R_a drives into R_b, which stands 1.2 m from it."""
    env = ControlEnv(stool(), strict=True)
    env.reset(seed=0)
    ahead = np.zeros(22)
    ahead[0], ahead[10], ahead[21] = 0.5, -1.0, -1.0
    for _ in range(60):
        _, _, terminated, _, info = env.step(ahead)
        if terminated:
            break
    assert info["failure"] == "collision"
    robots = [env.cell.physics.configuration(robot)[:2] for robot in (0, 1)]
    assert 0.4 < np.linalg.norm(robots[0] - robots[1]) < 1.1


def test_vectorised_environments_differ_by_seed() -> None:
    envs = gymnasium.make_vec(CONTROL, num_envs=2, vectorization_mode="async", furniture="three_legged", time_limit=0.1)
    observation, info = envs.reset(seed=7)
    assert observation["parts"].shape == (2, 20, 7)
    assert not np.array_equal(*observation["parts"])
    for _ in range(2):
        observation, _, terminated, truncated, info = envs.step(np.zeros((2, 22), np.float32))
    assert truncated.all()
    assert not terminated.any()
    assert list(info["failure"]) == ["time_limit"] * 2
    assert envs.call("task_description")[0].startswith("Assemble")
    envs.close()


def test_physics_that_leaves_all_bounds_ends_the_episode() -> None:
    env = ControlEnv(stool())
    env.reset(seed=0)
    before, *_ = env.step(np.zeros(22))
    env.cell.physics.data.qvel[3] = 1e30
    observation, reward, terminated, _, info = env.step(np.zeros(22))
    assert (reward, terminated, info["failure"]) == (0.0, True, "unstable")
    assert np.isfinite(observation["robots"]).all()
    np.testing.assert_array_equal(observation["parts"], before["parts"])
    env.reset(seed=0)
    assert env.step(np.zeros(22))[4]["failure"] == ""


def test_the_task_is_told_before_the_first_episode() -> None:
    env = ControlEnv(stool(), task="merge")
    assert env.task_description == "Assemble three_legged-3: join its 5 parts."
    assert env.observation_delay == 0


def test_human_render_mode_of_gymnasium() -> None:
    with pytest.raises(UnsupportedMode, match="'human'; expected 'rgb_array' or None"):
        ControlEnv(stool(), render_mode="human")
    with pytest.warns(UserWarning, match="HumanRendering wrapper"):
        env = gymnasium.make(CONTROL, furniture=stool(), render_mode="human")
    assert isinstance(env, gymnasium.wrappers.HumanRendering)
    assert env.unwrapped.render_mode == "rgb_array"


def test_drawing_without_a_state_or_a_mode(make: Make) -> None:
    env = make(render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="reset"):
        env.render()
    env = make()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match=r'render_mode="rgb_array"'):
        assert env.render() is None


def test_randomization_of_everything_is_an_argument() -> None:
    env = gymnasium.make(CONTROL, furniture=stool(), randomization=Randomization.full(0.5))
    assert env.observation_space.contains(env.reset(seed=0)[0])
