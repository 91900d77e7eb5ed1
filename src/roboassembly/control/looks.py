"""Looks of an episode's pictures: light, colours, patterns and cameras, as drawn by its seed."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from roboassembly.control.randomization import Randomization
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.colors import BACKGROUND, FLOOR, POST, ROBOT_A, ROBOT_B, Color, wood_colors
from roboassembly.rendering.offscreen import LIGHT_DIRECTION

TEXTURE = 64
"""Width and height of a pattern [pixels]."""
PATTERNS = ("grain", "noise", "checks", "stripes")
"""Kinds of patterns."""
_LIGHT = 0.4
"""Brightness of the directed light."""
_AMBIENT, _HEADLIGHT = 0.5, 0.2
"""Brightness of the light from everywhere and of that from the camera."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Light, colours, patterns and shifts of cameras of one episode."""

    parts: tuple[Color, ...]
    robots: tuple[Color, Color]
    post: Color
    floor: Color
    background: Color
    light: Float[np.ndarray, "3"]
    """Unit vector along which the light falls."""
    diffuse: Float[np.ndarray, "3"]
    """Colour of the directed light."""
    ambient: float
    """Brightness of the light from everywhere."""
    textures: tuple[UInt8[np.ndarray, "t t 3"], ...]
    """Pattern of each part, then that of the floor; empty without patterns."""
    cameras: tuple[SE3, ...]
    """Pose `planned_from_camera` of each camera: the identity where none is moved."""


def draw_looks(ranges: Randomization, parts: int, cameras: int, seed: int) -> Looks:
    """Return the looks of an episode.

    Args:
        ranges: what is drawn.
        parts: number of parts.
        cameras: number of cameras.
        seed: of all draws.
    """
    rng = np.random.default_rng(seed)
    plain = [*wood_colors(parts), ROBOT_A, ROBOT_B, POST, FLOOR, BACKGROUND]
    colors = [_varied(color, ranges.colors, rng) for color in plain]
    tilt, bright = rng.uniform(-1.0, 1.0, 2), rng.uniform(-1.0, 1.0, 5)
    light = LIGHT_DIRECTION + 0.8 * ranges.lighting * np.array([*tilt, 0.0])
    diffuse = _LIGHT * (1.0 + 0.6 * ranges.lighting * bright[0]) * (1.0 + 0.15 * ranges.lighting * bright[1:4])
    ambient = _AMBIENT * (1.0 + 0.5 * ranges.lighting * bright[4])
    textures = tuple(pattern(PATTERNS[int(rng.integers(len(PATTERNS)))], rng) for _ in range(parts + 1))
    moved = tuple(_moved(ranges, rng) for _ in range(cameras))
    a, b, post, floor, background = colors[parts:]
    return Looks(
        tuple(colors[:parts]), (a, b), post, floor, background, light / np.linalg.norm(light), diffuse, ambient,
        textures if ranges.textures else (), moved,
    )  # fmt: skip


def pattern(kind: str, rng: np.random.Generator) -> UInt8[np.ndarray, "t t 3"]:
    """Return a pattern in greys, with which colours are multiplied.

    Args:
        kind: one of `PATTERNS`.
        rng: draws scale and direction.
    """
    x, y = np.meshgrid(*[np.arange(TEXTURE) / TEXTURE] * 2)
    waves = int(rng.integers(2, 9))
    if kind == "grain":
        bent = x + 0.05 * np.sin(2.0 * np.pi * (y + rng.uniform()))
        value = np.sin(2.0 * np.pi * waves * bent) * 0.5 + 0.25 * _smooth_noise(rng, 16)
    elif kind == "noise":
        value = _smooth_noise(rng, 2 * waves)
    elif kind == "checks":
        value = np.sign(np.sin(2.0 * np.pi * waves * x) * np.sin(2.0 * np.pi * waves * y)) * 0.7
    else:
        value = np.sign(np.sin(2.0 * np.pi * waves * (x if rng.uniform() < 0.5 else y))) * 0.7
    grey = np.clip(0.78 + 0.22 * value, 0.0, 1.0)
    return np.repeat((255.0 * grey).astype(np.uint8)[..., None], 3, axis=2)


def _smooth_noise(rng: np.random.Generator, cells: int) -> Float[np.ndarray, "t t"]:
    """Return random numbers from −1 to 1 on a grid, linear between its points."""
    grid = rng.uniform(-1.0, 1.0, (cells + 1, cells + 1))
    grid[-1], grid[:, -1] = grid[0], grid[:, 0]
    at = np.arange(TEXTURE) * cells / TEXTURE
    low, share = at.astype(int), at % 1.0
    rows = grid[low] * (1.0 - share[:, None]) + grid[low + 1] * share[:, None]
    return rows[:, low] * (1.0 - share) + rows[:, low + 1] * share


def _varied(color: Color, strength: float, rng: np.random.Generator) -> Color:
    hue, light, strong = rng.uniform(-1.0, 1.0, 3)
    h, l, s = colorsys.rgb_to_hls(*color)  # noqa: E741
    varied = colorsys.hls_to_rgb(
        (h + 0.5 * strength * hue) % 1.0,
        float(np.clip(l * (1.0 + 0.35 * strength * light), 0.05, 0.97)),
        float(np.clip(s + 0.3 * strength * strong, 0.0, 1.0)),
    )
    return color if strength == 0.0 else varied


def _moved(ranges: Randomization, rng: np.random.Generator) -> SE3:
    """Return a small motion of a camera in its own frame."""
    shift, turn = ranges.camera_position * rng.uniform(-1.0, 1.0, 3), ranges.camera_angle * rng.uniform(-1.0, 1.0, 3)
    return SE3(_rotation(turn), shift)


def _rotation(angles: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x
