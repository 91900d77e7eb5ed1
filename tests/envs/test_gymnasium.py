"""Tests of Gymnasium's conventions: both environments, made by their class and by `gymnasium.make`."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import gymnasium
import imageio.v3 as iio
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.utils.env_checker import check_env

from roboassembly.datasets import catalogue
from roboassembly.envs import FULL, OBJECT_CENTRIC
from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.wrappers import DiscreteActions
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.learning.registry import load_policy
from roboassembly.rendering import gl
from roboassembly.rendering.camera import box_corners, fit_camera, project
from roboassembly.robots.body import placed

CLASSES = {OBJECT_CENTRIC: ObjectCentricEnv, FULL: FullEnv}
NAMES = {OBJECT_CENTRIC: ("u", "v", "k", "l", "w"), FULL: ("u", "v", "k", "l", "g_a", "g_b")}
ONE_IN_SHORT = [OBJECT_CENTRIC, pytest.param(FULL, marks=pytest.mark.slow)]
"""Both environments; the normal run leaves out the slow one."""
Make = Callable[..., gymnasium.Env[Any, Any]]


@cache
def stool() -> Furniture:
    """Return a piece of five parts, because two robots take a second for a merge."""
    return catalogue.make("three_legged", 3)


@cache
def assembly(name: str) -> tuple[tuple[int, ...], ...]:
    """Return the actions with which the shipped policy assembles the stool from the start of seed 0."""
    policy = load_policy("relational")
    env = CLASSES[name](stool(), cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=0)
    actions, over = [], False
    while not over:
        actions.append(tuple(int(i) for i in policy.act(observation, info["action_mask"])))
        observation, _, over, _, info = env.step(np.array(actions[-1]))
    assert info["success"], "choose another policy or another seed"
    return tuple(actions)


@pytest.fixture(params=CLASSES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(params=["class", "gymnasium.make"])
def make(request: pytest.FixtureRequest, name: str) -> Make:
    def by_class(**arguments: Any) -> gymnasium.Env[Any, Any]:
        return CLASSES[name](**{"furniture": stool(), **arguments})

    def by_name(**arguments: Any) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(name, **{"furniture": stool(), **arguments})

    return by_class if request.param == "class" else by_name


def one_line(error: pytest.ExceptionInfo[BaseException]) -> str:
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.usefixtures("drawing")
def test_gymnasium_checker_gives_no_warnings(name: str) -> None:
    """Gymnasium's checker finds no error in spaces, determinism and render modes, and warns of nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, furniture=stool()).unwrapped)


def bad_actions(names: tuple[str, ...]) -> list[tuple[Any, str]]:
    """Return invalid actions, each with the text that its error contains."""
    n, last = len(names), len(names) - 1
    largest = {"u": 19, "k": 9, "w": 5, "g_b": 7}
    return [
        (np.zeros(n - 1, int), rf"shape \({n - 1},\); expected {n} integers \(u, v, k, l, "),
        (np.zeros((1, n), int), rf"shape \(1, {n}\)"),
        (np.zeros(20_000, int), r"shape \(20000,\)"),
        (3, r"action 3 has shape \(\)"),
        (None, r"action None has shape \(\)"),
        (np.array([0.5] + [0] * last), "dtype float64"),
        (np.ones(n), "dtype float64"),
        (np.ones(n, bool), "dtype bool"),
        (["0"] * n, "dtype <U1"),
        ([[0], [0, 1], *[[0]] * (n - 2)], "no array"),
        ([20, *[0] * last], f"u is 20; expected 0 to {largest['u']}"),
        ([0, 1, -1, *[0] * (n - 3)], f"k is -1; expected 0 to {largest['k']}"),
        ([0, 1, *[0] * (n - 3), 99], f"{names[-1]} is 99; expected 0 to {largest[names[-1]]}"),
        ([2**40] * n, f"u is {2**40}"),
        ([2**70] * n, "dtype object"),
    ]


def test_actions_outside_of_the_space(make: Make, name: str) -> None:
    """Invalid actions raise with their value and leave the episode unchanged."""
    env, undisturbed = make(), make()
    for each in (env, undisturbed):
        each.reset(seed=0)
    for action, message in bad_actions(NAMES[name]):
        with pytest.raises(InvalidAction, match=message) as error:
            env.step(action)
        one_line(error)
    first = assembly(name)[0]
    observation, reward, terminated, _, _ = env.step(first)
    expected, *_ = undisturbed.step(np.array(first, np.int16))
    assert (reward, terminated) == (1.0, False)
    for key in expected:
        np.testing.assert_array_equal(observation[key], expected[key])


def test_numbers_outside_of_the_space(make: Make) -> None:
    env = DiscreteActions(make())
    env.reset(seed=0)
    size = env.action_space.n
    for number, message in (
        (size, f"action {size} is out of range; expected an integer from 0 to {size - 1}"),
        (-1, "action -1 is out of range"),
        (3.7, "dtype float64"),
        (np.array([3]), r"shape \(1,\)"),
        (None, "dtype object"),
        ("3", "dtype <U1"),
    ):
        with pytest.raises(InvalidAction, match=message) as error:
            env.step(number)
        one_line(error)
    with pytest.raises(InvalidAction, match="u is 20; expected 0 to 19"):
        env.flatten((20, *[0] * (len(env.env.action_space.nvec) - 1)))
    *_, info = env.step(np.int64(0))
    assert info["verdict"] == "not_an_action"


def test_actions_that_do_not_exist_are_wrong_choices(make: Make, name: str) -> None:
    for action in ([0] * len(NAMES[name]), [19, 0, 9, *[0] * (len(NAMES[name]) - 3)]):
        env = make()
        _, info = env.reset(seed=0)
        assert not info["action_mask"][tuple(action)]
        _, reward, terminated, truncated, info = env.step(action)
        assert (reward, terminated, truncated, info["verdict"]) == (0.0, True, False, "not_an_action")


def test_steps_before_and_after_an_episode(make: Make, name: str) -> None:
    env = make()
    nothing = np.zeros(len(NAMES[name]), int)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(nothing)
    with pytest.raises(ResetNeeded, match="reset"):
        env.unwrapped.step(nothing)
    env.reset(seed=0)
    env.step(nothing)
    before = env.unwrapped.np_random.bit_generator.state
    for _ in range(2):
        with pytest.raises(ResetNeeded, match=r"over \(its last verdict is 'not_an_action'\); call reset\(\)"):
            env.step(assembly(name)[0])
    assert env.unwrapped.np_random.bit_generator.state == before
    env.reset(seed=0)
    assert env.step(assembly(name)[0])[1] == 1.0


def test_complete_assembly_ends_the_episode() -> None:
    env = ObjectCentricEnv(stool())
    env.reset(seed=0)
    for action in assembly(OBJECT_CENTRIC):
        *_, info = env.step(action)
    assert info["success"]
    with pytest.raises(ResetNeeded, match="'merged'"):
        env.step(action)


BAD_OPTIONS: tuple[tuple[Any, type[Exception], str], ...] = (
    ({"furnitur": 3}, ValueError, "unknown reset option 'furnitur' .*3.*known: 'furniture'"),
    ({"furniture": 0, "w": "x"}, ValueError, "unknown reset option 'w' .*'x'"),
    ({"furniture": 1}, ValueError, r"options\['furniture'\] is 1; expected an index from 0 to 0"),
    ({"furniture": -1}, ValueError, "is -1"),
    ({"furniture": True}, ValueError, "is True"),
    ({"furniture": "stool"}, ValueError, "is 'stool'"),
    ({"furniture": 0.0}, ValueError, "is 0.0"),
    ("furniture", TypeError, "options is 'furniture'; expected a dictionary"),
    ([("furniture", 0)], TypeError, "a dictionary"),
)


def test_reset_options(make: Make, name: str) -> None:
    """Invalid options raise and leave the running episode unchanged."""
    env = make()
    env.reset(seed=0, options={"furniture": 0})
    for options, kind, message in BAD_OPTIONS:
        with pytest.raises(kind, match=message) as error:
            env.reset(seed=1, options=options)
        one_line(error)
    assert env.step(assembly(name)[0])[1] == 1.0


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"cloud_points": -1}, ValueError, "cloud_points is -1; expected an integer from 1 to"),
        ({"cloud_points": 0}, ValueError, "cloud_points is 0; expected an integer from 1 to"),
        ({"cloud_points": 2**40}, ValueError, "cloud_points is 1099511627776; expected an integer from 1 to 65536"),
        ({"cloud_points": 12.5}, TypeError, "cloud_points is 12.5; expected an integer"),
        ({"cloud_points": "128"}, TypeError, "cloud_points is '128'; expected an integer"),
        ({"cloud_points": None}, TypeError, "cloud_points is None; expected an integer"),
        ({"max_parts": 1001}, ValueError, "max_parts is 1001; expected an integer from 1 to 1000"),
        ({"max_points": 0}, ValueError, "max_points is 0; expected an integer from 1 to 10"),
        ({"max_parts": True}, TypeError, "max_parts is True; expected an integer"),
        ({"max_parts": 4}, ValueError, "'three_legged-3' has 5 parts .* max_parts=4"),
        ({"furniture": None}, TypeError, "furniture is None; expected a name, a folder, a Furniture, or a list"),
        ({"furniture": 5}, TypeError, "furniture is 5; expected a name"),
        ({"furniture": ["stool", None]}, TypeError, "furniture contains None"),
        ({"furniture": []}, ValueError, "no furniture given"),
        ({"furniture": "stol"}, InputError, "'stol'; did you mean stool"),
        ({"width": 0}, ValueError, "0 x 480"),
        ({"render_mode": "ansi"}, UnsupportedMode, "render_mode is 'ansi'; expected 'rgb_array' or None"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*not in the possible render_modes")
def test_arguments(make: Make, arguments: dict[str, Any], kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        make(**arguments)


def test_action_masks_error_names_the_wrapper(make: Make) -> None:
    env = make()
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.Error, match=r"roboassembly\.envs\.wrappers\.DiscreteActions\(env\)") as error:
        env.get_wrapper_attr("action_masks")()
    one_line(error)
    assert not isinstance(error.value, AttributeError), "sb3-contrib would take that for an environment without masks"
    flat = DiscreteActions(env)
    np.testing.assert_array_equal(flat.action_masks(), env.get_wrapper_attr("action_mask").ravel())


@pytest.mark.slow
def test_maskable_ppo_error_names_the_wrapper() -> None:
    learner = pytest.importorskip("sb3_contrib")
    env = gymnasium.make(OBJECT_CENTRIC, furniture=stool(), cloud_points=8)
    model = learner.MaskablePPO("MultiInputPolicy", env, n_steps=8, batch_size=8, n_epochs=1, seed=0)
    with pytest.raises(gymnasium.error.Error, match="DiscreteActions"):
        model.learn(8)


def corners_of(env: Any, parts: tuple[int, ...]) -> np.ndarray:
    """Return the corners of the boxes of parts at their present poses."""
    poses = env.task.groups_of(env.state).part_poses
    return np.concatenate([box_corners(env.task.furniture.parts[p].mesh, poses[p]) for p in parts])


def robots_of(env: Any) -> np.ndarray:
    """Return the corners of the boxes of all links; none without robots."""
    robots = env.state.cell_state.robots if isinstance(env, FullEnv) else ()
    boxes = [box_corners(link.mesh, pose) for robot in robots for link, pose in placed(robot.at, robot.opening)]
    return np.concatenate([np.zeros((0, 3)), *boxes])


def colored(picture: np.ndarray, color: str) -> np.ndarray:
    """Return the mask of the pixels with the colour of a role."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return {
        "orange": (red > green + 60) & (red > blue + 60) & (green < 0.62 * red),
        "green": (green > red + 30) & (green > blue + 30),
        "blue": (blue > red + 25) & (blue > green + 8),
    }[color]


@pytest.mark.usefixtures("drawing")
def test_pictures_show_the_state(make: Make, name: str) -> None:
    """The moved group is orange, the group it moved to is green, and the robots of the full setting are blue."""
    env = make(render_mode="rgb_array")
    own: Any = env.unwrapped
    env.reset(seed=0)
    everything = tuple(range(len(stool().parts)))
    seen = [corners_of(own, everything), robots_of(own)]
    first = env.render()
    assert first is not None
    assert (first.shape, first.dtype) == ((480, 640, 3), np.uint8)
    assert not colored(first, "orange").any()
    assert not colored(first, "green").any()
    pixels = project(corners_of(own, everything), fit_camera(np.concatenate(seen), 640 / 480), 640, 480)
    assert ((pixels > 0) & (pixels < [640, 480])).all()

    visible = {"orange": 0, "green": 0}
    # A thin part may be hidden from the camera after one step, but not after each of several.
    for action in assembly(name)[:3]:
        before = own.task.groups_of(own.state)
        moved = [before.groups[before.group_of[part]].parts for part in action[:2]]
        env.step(np.array(action))
        seen += [corners_of(own, everything), robots_of(own)]
        picture = env.render()
        assert picture is not None
        view = fit_camera(np.concatenate(seen), 640 / 480)
        for parts, color in zip(moved, visible, strict=True):
            low, high = (f(project(corners_of(own, parts), view, 640, 480), axis=0) for f in (np.min, np.max))
            drawn = np.argwhere(colored(picture, color))[:, ::-1]
            assert (drawn >= low - 2).all(), color
            assert (drawn <= high + 2).all(), color
            visible[color] += len(drawn)
        assert colored(picture, "blue").any() == (name == FULL)
    assert min(visible.values()) > 30, visible
    env.close()
    env.close()


@pytest.mark.usefixtures("drawing")
def test_drawing_changes_nothing() -> None:
    """Rendering changes neither the episode nor later pictures."""
    always, once = (gymnasium.make(OBJECT_CENTRIC, furniture=stool(), render_mode="rgb_array") for _ in range(2))
    plain = gymnasium.make(OBJECT_CENTRIC, furniture=stool())
    for env in (always, once, plain):
        env.reset(seed=0)
    pictures = [always.render()]
    for action in assembly(OBJECT_CENTRIC):
        observations = [env.step(action)[0] for env in (always, once, plain)]
        pictures.append(always.render())
        for key in observations[0]:
            np.testing.assert_array_equal(observations[0][key], observations[1][key])
            np.testing.assert_array_equal(observations[0][key], observations[2][key])
    np.testing.assert_array_equal(pictures[-1], once.render())
    assert len({p.tobytes() for p in pictures}) == len(pictures)
    # In turn: each has an OpenGL context of its own.
    once.reset(seed=0)
    np.testing.assert_array_equal(pictures[-1], always.render())
    np.testing.assert_array_equal(pictures[0], once.render())
    for env in (always, once, plain):
        env.close()


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("name", ONE_IN_SHORT)
def test_record_video(name: str, tmp_path: Any) -> None:
    """The film has one frame per state, the picture of that state."""
    env = gymnasium.make(name, furniture=stool(), render_mode="rgb_array", width=320, height=240)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "films"))
    env.reset(seed=0)
    states = [env.env.render()]
    for action in assembly(name):
        env.step(action)
        states.append(env.env.render())
    env.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    frames = iio.imread(film)
    assert frames.shape == (len(states), 240, 320, 3)
    for frame, state in zip(frames, states, strict=True):
        assert np.abs(frame.astype(int) - state.astype(int)).mean() < 6.0
    assert iio.immeta(film)["fps"] == env.metadata["render_fps"]


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("name", ONE_IN_SHORT)
def test_pictures_of_vectorised_environments(name: str) -> None:
    envs = gymnasium.make_vec(
        name, num_envs=2, vectorization_mode="sync", furniture=stool(), render_mode="rgb_array", width=64, height=48
    )
    envs.reset(seed=0)
    pictures = envs.render()
    assert pictures is not None
    assert [p.shape for p in pictures] == [(48, 64, 3)] * 2
    assert not np.array_equal(*pictures), "they start from seeds 0 and 1"
    envs.close()


def test_drawing_without_a_state_or_a_mode(make: Make) -> None:
    env = make(render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="reset"):
        env.render()
    env = make()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match=r'render_mode="rgb_array"'):
        assert env.render() is None


def test_drawing_without_opengl_names_the_missing_package(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "can_render", lambda _: False)
    gl.context_module.cache_clear()
    try:
        with pytest.raises(gl.RenderingUnavailableError, match="apt install libegl1") as error:
            env.render()
        one_line(error)
    finally:
        gl.context_module.cache_clear()


def test_human_render_mode_of_gymnasium(name: str) -> None:
    with pytest.raises(UnsupportedMode, match="'human'; expected 'rgb_array' or None"):
        CLASSES[name](stool(), render_mode="human")
    with pytest.warns(UserWarning, match="HumanRendering wrapper"):
        env = gymnasium.make(name, furniture=stool(), render_mode="human")
    assert isinstance(env, gymnasium.wrappers.HumanRendering)
    assert env.unwrapped.render_mode == "rgb_array"
