"""Depth of a scene as its lamp sees it, drawn anew only where something has moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32

from roboassembly.rendering import shaders
from roboassembly.rendering.offscreen import LIGHT_DIRECTION

LAMP = 0.07
"""Radius of the lamp over its distance: a shadow grows by twice this share of the distance to what casts it."""
SOFTEST, SHARPEST = 0.035, 0.004
"""Radii over which the edge of a shadow is softened at most and at least [m]."""
_DEPTH = 2.5
"""Half the depth of the map, in radii of the scene."""
_BIAS = 0.003
"""Distance in front of what hides a point at which it is still lit, so that no surface shades itself [m]."""
_CELLS = 128
"""Width and height of the coarse map of what may cast a shadow."""
_TILES = 40
"""Number of tiles, in each direction, of the ground on which shadows may fall."""
_TILED = 2.0
"""Half the width of that ground, in radii of the scene."""
_EDGE = 2
"""Pixels around a change that are drawn anew."""


class ShadowMap:
    """Shadow map of a scene.

    Args:
        gl: `moderngl.Context`.
        size: width and height [pixels].
        center: middle of the scene [m].
        radius: radius of the scene [m].
    """

    def __init__(self, gl: Any, size: int, center: Float[np.ndarray, "3"], radius: float) -> None:
        self._size, self._center, self._radius = size, center, radius
        self.lamp_from_world = _lamp_from_world(center, radius)
        self.program = gl.program(shaders.DEPTH_VERTEX, shaders.DEPTH_FRAGMENT)
        self._depths = gl.depth_texture((size, size))
        self._frame = gl.framebuffer(depth_attachment=self._depths)
        self._by_depth = gl.sampler(repeat_x=False, repeat_y=False, filter=(gl.NEAREST,) * 2, compare_func="")
        self._compared = gl.sampler(repeat_x=False, repeat_y=False, filter=(gl.LINEAR,) * 2, compare_func="<=")
        self._casters = gl.texture((_CELLS, _CELLS), 1)
        self._casters.filter = (gl.NEAREST, gl.NEAREST)
        self._cast = np.zeros((_CELLS, _CELLS), np.uint8)
        self._drawn: Float32[np.ndarray, "n 3 4"] | None = None
        self._boxes: Float[np.ndarray, "n 2 2"] = np.zeros((0, 2, 2))
        self._tiles = self._ground_tiles()

    def uniforms(self) -> dict[str, object]:
        """Return what shaders must know to look a shadow up; `bind` binds textures accordingly."""
        width, depth = 2.0 * self._radius, 2.0 * _DEPTH * self._radius
        return {
            "depths": 1, "shadows": 2, "casters": 4, "reach": SOFTEST / width, "sharpest": SHARPEST / width,
            "spread": LAMP * depth / width, "bias": _BIAS / depth, "to_light": tuple(-LIGHT_DIRECTION),
        }  # fmt: skip

    def bind(self) -> None:
        """Bind the textures of the map to units 1, 2 and 4."""
        self._depths.use(1)
        self._by_depth.use(1)
        self._depths.use(2)
        self._compared.use(2)
        self._casters.use(4)

    def draw(
        self,
        placed: Float32[np.ndarray, "n 3 4"],
        corners: Float[np.ndarray, "n 8 3"],
        shapes: Any,
        ranges: Float[np.ndarray, "n 2"],
    ) -> None:
        """Bring the map up to date.

        Args:
            placed: placement of each object.
            corners: corners of each object's box in the world [m].
            shapes: vertex array of all objects, for `program`.
            ranges: first index and number of indices of each object.
        """
        at = 0.5 * (corners @ self.lamp_from_world[:2, :3].T + self.lamp_from_world[:2, 3]) + 0.5
        boxes = np.stack([at.min(axis=1), at.max(axis=1)], axis=1)
        if self._drawn is None:
            low, high = np.zeros(2, int), np.full(2, self._size)
        else:
            moved = (placed != self._drawn).any(axis=(1, 2))
            if not moved.any():
                return
            both = np.concatenate([boxes[moved], self._boxes[moved]])
            both = both[(both[:, 1] > 0.0).all(axis=1) & (both[:, 0] < 1.0).all(axis=1)]
            if len(both) == 0:
                both = np.zeros((1, 2, 2))
            low = np.clip(np.floor(both[:, 0].min(axis=0) * self._size) - _EDGE, 0, self._size).astype(int)
            high = np.clip(np.ceil(both[:, 1].max(axis=0) * self._size) + _EDGE, 0, self._size).astype(int)
        self._drawn, self._boxes = placed.copy(), boxes
        area = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
        if area[2] > 0 and area[3] > 0:
            self._frame.scissor = area
            self._frame.use()
            self._frame.clear(depth=1.0, viewport=area)
            outside = (boxes[:, 1] * self._size < low - 1) | (boxes[:, 0] * self._size > high + 1)
            inside = np.array(~outside.any(axis=1), dtype=bool)
            for first, count in runs(inside, ranges):
                shapes.render(vertices=count, first=first)
            self._frame.scissor = None
        edge = 0.5 * SOFTEST / self._radius
        cells_low = np.clip(np.floor((boxes[:, 0] - edge) * _CELLS), 0, _CELLS).astype(int)
        cells_high = np.clip(np.ceil((boxes[:, 1] + edge) * _CELLS), 0, _CELLS).astype(int)
        self._cast[:] = 0
        for (left, bottom), (right, top) in zip(cells_low, cells_high, strict=True):
            self._cast[bottom:top, left:right] = 255
        self._casters.write(self._cast.tobytes())

    def shaded_ground(self) -> Float32[np.ndarray, "n 2"]:
        """Return triangles of the ground on which a shadow may fall [m]: three corners each."""
        corners, low, high = self._tiles
        total = np.zeros((_CELLS + 1, _CELLS + 1), int)
        total[1:, 1:] = (self._cast > 0).cumsum(axis=0).cumsum(axis=1)
        (left, bottom), (right, top) = low.T, high.T
        count = total[top, right] - total[bottom, right] - total[top, left] + total[bottom, left]
        return corners[count > 0].reshape(-1, 2)

    def _ground_tiles(self) -> tuple[Float32[np.ndarray, "t 6 2"], np.ndarray, np.ndarray]:
        """Return the corners of all tiles, and the lowest and highest cells of the coarse map that each lies in."""
        step = 2.0 * _TILED * self._radius / _TILES
        origin = self._center[:2] - _TILED * self._radius
        place = np.stack(np.meshgrid(np.arange(_TILES), np.arange(_TILES)), axis=-1).reshape(-1, 1, 2)
        corners = origin + step * (place + np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]))
        flat = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)
        at = 0.5 * (flat @ self.lamp_from_world[:2, :3].T + self.lamp_from_world[:2, 3]) + 0.5
        low = np.clip(np.floor(at.min(axis=1) * _CELLS), 0, _CELLS).astype(int)
        high = np.clip(np.ceil(at.max(axis=1) * _CELLS), 0, _CELLS).astype(int)
        return corners.astype(np.float32), low, high


def runs(chosen: Bool[np.ndarray, "n"], ranges: Float[np.ndarray, "n 2"]) -> Iterator[tuple[int, int]]:
    """Yield the first index and the number of indices of each run of chosen objects that follow one another."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    for first, last in ends.reshape(-1, 2):
        yield int(ranges[first, 0]), int(ranges[last - 1].sum() - ranges[first, 0])


def _lamp_from_world(center: Float[np.ndarray, "3"], radius: float) -> Float[np.ndarray, "4 4"]:
    """Return the matrix that projects a scene along the light to a cube of sides from −1 to 1."""
    right = np.cross(LIGHT_DIRECTION, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[0, :3], out[1, :3] = right / radius, np.cross(right, LIGHT_DIRECTION) / radius
    out[2, :3] = LIGHT_DIRECTION / (_DEPTH * radius)
    out[:3, 3] = -out[:3, :3] @ center
    return out
