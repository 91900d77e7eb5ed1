"""Randomization: off by default, decided by the seed, and what each field changes."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
import pytest

from roboassembly.control.env import ControlEnv
from roboassembly.control.looks import PATTERNS, TEXTURE, draw_looks, pattern
from roboassembly.control.randomization import NONE, Randomization
from roboassembly.datasets import catalogue
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.rendering.colors import ROBOT_A, wood_colors


@cache
def stool() -> Furniture:
    return catalogue.make("three_legged", 3)


def episode(ranges: Randomization | None, seed: int, steps: int = 6, **arguments: Any) -> list[dict[str, np.ndarray]]:
    env = ControlEnv(stool(), randomization=ranges, **arguments)
    seen = [env.reset(seed=seed)[0]]
    rng = np.random.default_rng(0)
    seen += [env.step(0.3 * rng.uniform(-1.0, 1.0, 22))[0] for _ in range(steps)]
    env.close()
    return seen


def same(one: list[dict[str, np.ndarray]], two: list[dict[str, np.ndarray]]) -> bool:
    return all(np.array_equal(a[key], b[key]) for a, b in zip(one, two, strict=True) for key in a)


def test_all_is_off_by_default() -> None:
    assert not any(getattr(NONE, field.name) for field in fields(Randomization))
    assert same(episode(None, 0), episode(Randomization(), 0))
    variation = NONE.draw(np.random.default_rng(0))
    assert (variation.physics.friction, variation.physics.stiffness, variation.density, variation.delay) == (1, 1, 1, 0)


def test_the_seed_decides_everything() -> None:
    full = Randomization.full()
    assert same(episode(full, 3), episode(full, 3))
    assert not same(episode(full, 3), episode(full, 4))
    assert not same(episode(full, 3), episode(None, 3))


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_the_seed_decides_pictures() -> None:
    """Two environments of one seed see the same bytes; another seed changes most pixels of the background."""
    arguments: dict[str, Any] = {"obs": "rgbd", "camera_width": 48, "camera_height": 36, "segmentation": True}
    full = Randomization.full()
    one, again, other = (episode(full, seed, 2, **arguments) for seed in (3, 3, 4))
    assert same(one, again)
    plain = episode(None, 3, 2, **arguments)
    for camera in ("wrist_a", "wrist_b", "overview", "overview_back"):
        assert (one[0][f"rgb_{camera}"] != other[0][f"rgb_{camera}"]).mean() > 0.5
        assert (one[0][f"rgb_{camera}"] != plain[0][f"rgb_{camera}"]).mean() > 0.5


@pytest.mark.parametrize(
    ("field", "value"),
    [("friction", 0.5), ("density", 0.5), ("stiffness", 0.5), ("part_position", 0.01), ("part_angle", 0.1)],
)
def test_each_range_changes_physics_within_it(field: str, value: float) -> None:
    ranges = Randomization(**{field: value})
    env, plain = ControlEnv(stool(), randomization=ranges), ControlEnv(stool())
    env.reset(seed=1)
    plain.reset(seed=1)
    one, two = env.cell.physics, plain.cell.physics
    friction = one.model.geom_friction / two.model.geom_friction
    stiffness = one.model.actuator_gainprm[:10, 0] / two.model.actuator_gainprm[:10, 0]
    mass = one.contents.bodies[0].mass / two.contents.bodies[0].mass
    shift = np.abs(env.cell.part_sevens()[:, :3] - plain.cell.part_sevens()[:, :3])
    changed = {
        "friction": friction.max() - 1.0, "stiffness": stiffness.max() - 1.0, "density": mass - 1.0,
        "part_position": shift.max(), "part_angle": shift.max(),
    }  # fmt: skip
    assert 0.0 < abs(changed[field]) <= (value if field != "part_angle" else 0.1)
    others = {"friction", "stiffness", "density"} - {field}
    assert all(abs(changed[name]) < 1e-12 for name in others)
    assert shift[:, 2].max() < 1e-12


def test_parts_weigh_what_the_density_says() -> None:
    env = ControlEnv(stool())
    env.reset(seed=0)
    density = env.state.cell.density
    assert density <= WOOD_DENSITY
    for key, body in env.cell.physics.contents.bodies.items():
        assert body.mass == pytest.approx(density * stool().parts[key].mesh.volume)


def test_noise_has_the_standard_deviation_that_was_asked_for() -> None:
    noisy = episode(Randomization(joint_noise=0.01, pose_noise=0.005, angle_noise=0.02), 0, 60)
    plain = episode(None, 0, 60)
    joints = np.array([a["robots"][:, 4:11] - b["robots"][:, 4:11] for a, b in zip(noisy, plain, strict=True)])
    places = np.array([a["parts"][:5, :3] - b["parts"][:5, :3] for a, b in zip(noisy, plain, strict=True)])
    dots = np.array([(a["parts"][:5, 3:] * b["parts"][:5, 3:]).sum(axis=1) for a, b in zip(noisy, plain, strict=True)])
    angles = 2.0 * np.arccos(np.clip(np.abs(dots), 0.0, 1.0))
    assert joints.std() == pytest.approx(0.01, rel=0.1)
    assert places.std() == pytest.approx(0.005, rel=0.1)
    # The root mean square of an angle of three independent turns is √3 times each.
    assert np.sqrt((angles**2).mean()) == pytest.approx(np.sqrt(3.0) * 0.02, rel=0.1)
    # What noise adds changes nothing of what happens.
    np.testing.assert_array_equal(noisy[-1]["held"], plain[-1]["held"])


def test_delayed_observations_are_earlier_ones() -> None:
    ranges = Randomization(delay=3)
    plain = episode(None, 0, 8)
    delays = set()
    for seed in range(6):
        env = ControlEnv(stool(), randomization=ranges)
        env.reset(seed=seed)
        delays.add(env.observation_delay)
    assert delays <= {0, 1, 2, 3}
    assert len(delays) > 1
    env = ControlEnv(stool(), randomization=ranges)
    env.reset(seed=0)
    age = env.observation_delay
    delayed = episode(ranges, 0, 8)
    for k in range(9):
        np.testing.assert_array_equal(delayed[k]["robots"], plain[max(0, k - age)]["robots"])


def test_values_out_of_range_are_refused() -> None:
    for arguments, message in (
        ({"friction": 1.0}, "friction is 1.0; expected a number from 0 to 0.8"),
        ({"lighting": -0.1}, "lighting is -0.1"),
        ({"density": float("nan")}, "density is nan"),
        ({"colors": "some"}, "colors is 'some'"),
        ({"colors": True}, "colors is True"),
        ({"textures": 1}, "textures is 1; expected True or False"),
        ({"delay": 1.5}, "delay is 1.5; expected an integer from 0 to 20"),
        ({"delay": 21}, "delay is 21"),
    ):
        with pytest.raises(ValueError, match=message):
            Randomization(**arguments)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="strength is 2"):
        Randomization.full(2)


def test_looks_without_ranges_are_the_usual_ones() -> None:
    looks = draw_looks(NONE, 3, 4, 5)
    assert looks.parts == tuple(wood_colors(3))
    assert looks.robots[0] == ROBOT_A
    assert looks.textures == ()
    assert all(pose.isIdentity(1e-12) for pose in looks.cameras)
    moved = draw_looks(Randomization(camera_position=0.02, camera_angle=0.1), 3, 4, 5).cameras
    assert 0.0 < max(np.abs(pose.translation).max() for pose in moved) <= 0.02


@pytest.mark.parametrize("kind", PATTERNS)
def test_patterns_are_drawn_here_and_are_neither_flat_nor_black(kind: str) -> None:
    grey = pattern(kind, np.random.default_rng(0))
    assert (grey.shape, grey.dtype) == ((TEXTURE, TEXTURE, 3), np.uint8)
    assert grey.std() > 8.0
    assert grey.min() > 100
