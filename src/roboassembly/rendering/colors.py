"""Colours of pictures: moving parts are orange, waiting parts green, idle parts wood; robots are blue and white."""

from __future__ import annotations

import colorsys
import enum
from collections.abc import Sequence

Color = tuple[float, float, float]
"""Red, green and blue (sRGB), each in `[0, 1]`."""


class Role(enum.StrEnum):
    """Role of an object in a picture, which decides its colour."""

    IDLE = "idle"
    WAITING = "waiting"
    MOVING = "moving"
    ROBOT_A = "robot_a"
    ROBOT_B = "robot_b"
    ROBOT_DARK = "robot_dark"
    POST = "post"


class Finish(enum.StrEnum):
    """Finish of an object's surface."""

    WOOD = "wood"
    PAINT = "paint"


MOVING: Color = (0.95, 0.45, 0.08)
WAITING: Color = (0.28, 0.66, 0.32)
WOOD: Color = (0.80, 0.66, 0.49)
ROBOT_A: Color = (0.62, 0.70, 0.82)
ROBOT_B: Color = (0.90, 0.90, 0.92)
ROBOT_DARK: Color = (0.20, 0.21, 0.23)
POST: Color = (0.45, 0.47, 0.50)
_GOLDEN = 0.6180339887
BACKGROUND: Color = (0.945, 0.953, 0.961)
FLOOR: Color = (0.90, 0.905, 0.91)
FLOOR_LINES: Color = (0.77, 0.78, 0.795)


def part_colors(roles: Sequence[Role]) -> list[Color]:
    """Return one colour per object. Parts differ slightly in brightness, so that touching parts can be told apart."""
    return [_plain[role] if role in _plain else _shade(_base[role], index) for index, role in enumerate(roles)]


_base = {Role.MOVING: MOVING, Role.WAITING: WAITING, Role.IDLE: WOOD}
_plain = {Role.ROBOT_A: ROBOT_A, Role.ROBOT_B: ROBOT_B, Role.ROBOT_DARK: ROBOT_DARK, Role.POST: POST}


def finishes(roles: Sequence[Role]) -> list[Finish]:
    """Return the finish of each object: parts are wood, robots and posts are painted."""
    return [Finish.WOOD if role in _base else Finish.PAINT for role in roles]


def wood_colors(count: int) -> list[Color]:
    """Return the colours of idle parts."""
    return part_colors([Role.IDLE] * count)


def distinct_colors(labels: Sequence[int]) -> list[Color]:
    """Return one colour per label: equal labels share a colour, different labels get clearly different ones."""
    return [colorsys.hls_to_rgb((0.08 + k * _GOLDEN) % 1.0, 0.62 - 0.14 * (k % 2), 0.55) for k in labels]


def _shade(color: Color, index: int) -> Color:
    # Multiples of the golden ratio modulo one: neighbours in the list always differ.
    offset = (index * _GOLDEN) % 1.0 - 0.5
    hue, lightness, saturation = colorsys.rgb_to_hls(*color)
    return colorsys.hls_to_rgb(hue, lightness * (1.0 + 0.14 * offset), saturation)


def to_bytes(color: Color) -> tuple[int, int, int]:
    """Return the colour with 0 to 255 per channel."""
    r, g, b = (round(255 * c) for c in color)
    return r, g, b
