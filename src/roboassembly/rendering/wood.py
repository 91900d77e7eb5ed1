"""Wood of pictures: its grain as a texture made from a seed, and the way it lies in a part."""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

LENGTH, DEPTH = 1.6, 0.30
"""Sizes that the texture stands for: along the grain, and away from the pith [m]. It repeats in both directions."""
_COLUMNS, _ROWS = 512, 512
_RING = (0.008, 0.024)
"""Least and greatest width of a year ring [m]."""
_GOLDEN = 0.6180339887


@cache
def wood_texture(seed: int = 0) -> UInt8[np.ndarray, "rows columns"]:
    """Return the brightness of wood: columns go along the grain, rows away from the pith.

    Year rings darken slowly and end sharply; fibres are fine streaks along the grain.

    Args:
        seed: seed of the widths of rings and of the fibres.
    """
    rng = np.random.default_rng(seed)
    widths = rng.uniform(*_RING, size=int(2.0 * DEPTH / sum(_RING)))
    ends = np.concatenate([[0.0], np.cumsum(widths)]) / widths.sum() * _ROWS
    waves = _noise(rng, (60.0, 90.0)) * 7.0 + _noise(rng, (8.0, 40.0)) * 1.2
    row = (np.arange(_ROWS)[:, None] + waves) % _ROWS
    ring = np.searchsorted(ends, row, side="right") - 1
    share = (row - ends[ring]) / (ends[ring + 1] - ends[ring])
    latewood = share**2.5 * np.clip((1.0 - share) / 0.12, 0.0, 1.0)
    strength = rng.uniform(0.55, 1.0, len(widths))[ring]
    fibres = _noise(rng, (0.8, 30.0)) * 0.10 + _noise(rng, (20.0, 120.0)) * 0.06
    value: Float[np.ndarray, "rows columns"] = np.clip(0.86 - 0.72 * strength * latewood + fibres, 0.0, 1.0)
    return np.rint(255.0 * value).astype(np.uint8)


def _noise(rng: np.random.Generator, blur: tuple[float, float]) -> Float[np.ndarray, "rows columns"]:
    """Return random numbers of unit variance that repeat at the borders, smooth over so many rows and columns."""
    drawn = rng.normal(size=(_ROWS, _COLUMNS))
    smooth: Float[np.ndarray, "rows columns"] = gaussian_filter(drawn, blur, mode="wrap")
    return smooth / smooth.std()


def grain_coordinates(vertices: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return coordinates [m] whose first axis is the longest side of the vertices' box, and the last the shortest."""
    return vertices[:, np.argsort(-np.ptp(vertices, axis=0), kind="stable")]


def grain_offsets(count: int) -> Float[np.ndarray, "count 4"]:
    """Return, for each part, where its wood was cut: the place along the grain, both of the pith, and its slope.

    Places are in metres; the pith runs aside of the part, so that its rings show as long lines and arcs.
    """
    turn = 2.0 * np.pi * (np.arange(count) * _GOLDEN % 1.0)
    away = 0.10 + 0.06 * np.cos(3.0 * turn)
    return np.stack([turn, away * np.cos(turn), away * np.sin(turn), 0.05 * np.sin(2.0 * turn)], axis=1)
