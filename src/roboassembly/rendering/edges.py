"""Smooth edges of finished pictures, which cost a processor a tenth of four samples per pixel."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, UInt8

CONTRAST = 30
"""Difference to a neighbour above which a pixel lies on an edge."""
REACH = 5
"""Pixels around a pixel on which its smoothed colour depends."""
_LONGEST = 8.0
"""Longest distance along an edge over which colours are averaged [pixels]."""


def smooth_edges(picture: UInt8[np.ndarray, "height width 3"], contrast: int = CONTRAST) -> None:
    """Average pixels on edges along the edge, in place.

    This is FXAA (T. Lottes, "FXAA", NVIDIA, 2009) in its short form: four samples along the direction in which the
    brightness changes least, or the inner two of them if the outer two belong to something else.

    Args:
        picture: picture without smooth edges.
        contrast: difference to a neighbour above which a pixel lies on an edge.
    """
    height, width, _ = picture.shape
    if min(height, width) < 3:
        return
    green = np.ascontiguousarray(picture[:, :, 1])
    edge = np.zeros((height, width), dtype=bool)
    jumps = _differ(green[:, 1:], green[:, :-1], contrast)
    edge[:, 1:] |= jumps
    edge[:, :-1] |= jumps
    jumps = _differ(green[1:], green[:-1], contrast)
    edge[1:] |= jumps
    edge[:-1] |= jumps
    edge[[0, -1]] = edge[:, [0, -1]] = False
    at = np.flatnonzero(edge)
    if len(at) == 0:
        return
    light = green.reshape(-1)
    # Corners: upper left, upper right, lower left, lower right.
    a, b, c, d = (light[at + offset].astype(np.float32) for offset in (-width - 1, -width + 1, width - 1, width + 1))
    middle = light[at].astype(np.float32)
    along = np.stack([(c + d) - (a + b), (a + c) - (b + d)], axis=1)
    least = np.maximum((a + b + c + d) / 32.0, 2.0)
    along /= (np.abs(along).min(axis=1) + least)[:, None]
    np.clip(along, -_LONGEST, _LONGEST, out=along)
    rows, columns = np.divmod(at, width)
    here = np.stack([columns, rows], axis=1).astype(np.float32)
    inner = 0.5 * (_sample(picture, here - along / 6.0) + _sample(picture, here + along / 6.0))
    outer = 0.5 * inner + 0.25 * (_sample(picture, here - 0.5 * along) + _sample(picture, here + 0.5 * along))
    low = np.minimum.reduce([a, b, c, d, middle])
    high = np.maximum.reduce([a, b, c, d, middle])
    beyond = (outer[:, 1] < low) | (outer[:, 1] > high)
    outer[beyond] = inner[beyond]
    picture.reshape(-1, 3)[at] = np.round(outer)


def _sample(picture: UInt8[np.ndarray, "height width 3"], at: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, "n 3"]:
    """Return the colours between pixels, at columns and rows."""
    height, width, _ = picture.shape
    x, y = np.clip(at[:, 0], 0.0, width - 1.001), np.clip(at[:, 1], 0.0, height - 1.001)
    left, top = x.astype(np.int32), y.astype(np.int32)
    right, low = (x - left)[:, None], (y - top)[:, None]
    flat, first = picture.reshape(-1, 3), top * width + left
    upper = flat[first] * (1.0 - right) + flat[first + 1] * right
    lower = flat[first + width] * (1.0 - right) + flat[first + width + 1] * right
    return upper * (1.0 - low) + lower * low


def _differ(
    a: UInt8[np.ndarray, "rows columns"], b: UInt8[np.ndarray, "rows columns"], contrast: int
) -> Bool[np.ndarray, "rows columns"]:
    # Bytes take half the time of signed numbers, which a plain difference would need.
    return np.maximum(a, b) - np.minimum(a, b) > contrast
