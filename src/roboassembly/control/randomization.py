"""Randomization of episodes: light, colours, cameras, physics, sensors and starts, each off by default."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from roboassembly.errors import ArgumentError
from roboassembly.simulation.control_model import PhysicsScales

_LARGEST = {
    "lighting": 1.0, "colors": 1.0, "camera_position": 0.2, "camera_angle": 0.3, "friction": 0.8, "density": 0.8,
    "stiffness": 0.8, "joint_noise": 0.1, "pose_noise": 0.1, "angle_noise": 0.5, "pixel_noise": 100.0,
    "part_position": 0.02, "part_angle": 0.2,
}  # fmt: skip
"""Largest value of each field that is a number."""
_MOST_DELAY = 20
"""Largest delay [control steps]."""


@dataclass(frozen=True)
class Randomization:
    """Ranges of all that differs from episode to episode, by the seed of `reset`. All is off by default.

    Raises:
        ArgumentError: a value out of range.
    """

    lighting: float = 0.0
    """Strength from 0 to 1 with which direction, brightness and colour of the light change."""
    colors: float = 0.0
    """Strength from 0 to 1 with which the colours of parts, robots, posts, floor and background change."""
    textures: bool = False
    """Whether parts and floor have drawn patterns: grain, noise, checks or stripes."""
    camera_position: float = 0.0
    """Largest shift of each camera along each axis [m]."""
    camera_angle: float = 0.0
    """Largest turn of each camera about each axis [rad]."""
    friction: float = 0.0
    """Largest relative change of all friction, such as 0.3 for factors from 0.7 to 1.3."""
    density: float = 0.0
    """Largest relative change of the density of the parts."""
    stiffness: float = 0.0
    """Largest relative change of the stiffness with which drives and joints follow commands."""
    joint_noise: float = 0.0
    """Standard deviation of the measured joint angles and of place and yaw of the platforms [rad, m]."""
    pose_noise: float = 0.0
    """Standard deviation of each coordinate of the observed poses of parts [m]."""
    angle_noise: float = 0.0
    """Standard deviation of the observed rotation of parts about each axis [rad]."""
    pixel_noise: float = 0.0
    """Standard deviation of each channel of a pixel, of 255."""
    delay: int = 0
    """Largest age of an observation [control steps]; each episode has an age of its own from 0 to this."""
    part_position: float = 0.0
    """Largest level shift of a part and its post at the beginning, along each axis [m]."""
    part_angle: float = 0.0
    """Largest turn of a part about the vertical above its post at the beginning [rad]."""

    def __post_init__(self) -> None:
        for name, largest in _LARGEST.items():
            value: object = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= largest:
                raise ArgumentError(f"randomization: {name} is {value!r}; expected a number from 0 to {largest:g}")
        if not _is_flag(self.textures):
            raise ArgumentError(f"randomization: textures is {self.textures!r}; expected True or False")
        if not _is_integer(self.delay) or not 0 <= self.delay <= _MOST_DELAY:
            raise ArgumentError(f"randomization: delay is {self.delay!r}; expected an integer from 0 to {_MOST_DELAY}")

    @classmethod
    def full(cls, strength: float = 1.0) -> Randomization:
        """Return a moderate randomization of everything.

        Args:
            strength: factor from 0 to 1 on all ranges.

        Raises:
            ArgumentError: a strength out of range.
        """
        if not 0.0 <= strength <= 1.0:
            raise ArgumentError(f"strength is {strength!r}; expected a number from 0 to 1")
        return cls(
            lighting=strength, colors=strength, textures=strength > 0.0, camera_position=0.02 * strength,
            camera_angle=0.05 * strength, friction=0.3 * strength, density=0.2 * strength, stiffness=0.1 * strength,
            joint_noise=0.002 * strength, pose_noise=0.002 * strength, angle_noise=0.01 * strength,
            pixel_noise=4.0 * strength, delay=round(2 * strength), part_position=0.005 * strength,
            part_angle=0.05 * strength,
        )  # fmt: skip

    @property
    def changes_pictures(self) -> bool:
        """Whether pictures of one state differ from episode to episode."""
        seen = (self.lighting, self.colors, self.textures, self.camera_position, self.camera_angle)
        return any(bool(value) for value in seen)

    def draw(self, rng: np.random.Generator) -> Variation:
        """Return the variation of one episode; the same number of draws whatever is on."""
        friction, density, stiffness = 1.0 + rng.uniform(-1.0, 1.0, 3) * [self.friction, self.density, self.stiffness]
        delay = int(rng.integers(self.delay + 1))
        looks, sensors = (int(seed) for seed in rng.integers(2**31 - 1, size=2))
        return Variation(self, PhysicsScales(friction, stiffness), density, delay, looks, sensors)


@dataclass(frozen=True)
class Variation:
    """Draws of one episode."""

    ranges: Randomization
    physics: PhysicsScales
    density: float
    """Factor on the density of the parts."""
    delay: int
    """Age of observations [control steps]."""
    looks: int
    """Seed of what pictures show: light, colours, patterns and cameras."""
    sensors: int
    """Seed of the noise of all sensors."""


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


NONE = Randomization()
"""No randomization."""
assert {f.name for f in fields(Randomization)} == {*_LARGEST, "textures", "delay"}
