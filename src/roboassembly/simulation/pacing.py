"""Time parametrization of paths: smooth motions within a robot's speeds and accelerations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

TIME_STEP = 0.002
"""Time step of the physics of robots [s]."""
_SPEEDS = np.array([0.8, 0.8, 1.0, 1.5, 1.5, 1.5, 1.5, 2.0, 2.0, 2.0])
_ACCELERATIONS = np.array([0.8, 0.8, 1.2, 4.0, 4.0, 4.0, 4.0, 6.0, 6.0, 6.0])
"""Largest speeds [m/s, rad/s] and accelerations [m/s², rad/s²], well within a Panda's (2.1 rad/s, 7.5 rad/s²)."""
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 5.7735
"""Largest speed and acceleration of a quintic from rest to rest over unit distance and time."""
_BEND = 0.98
"""Cosine between two edges above which a robot does not stop at the way-point between them."""


def time_parametrize(
    path: Sequence[Float[np.ndarray, "10"]], speed: float = 1.0
) -> Iterator[tuple[Float[np.ndarray, "10"], Float[np.ndarray, "10"]]]:
    """Yield configurations and velocities at every time step, at rest at the ends and wherever the path bends.

    Args:
        path: way-points.
        speed: share of the full speed.
    """
    run = [path[0]]
    for k in range(1, len(path)):
        run.append(path[k])
        if k + 1 < len(path):
            a, b = (path[k] - path[k - 1]) / _SPEEDS, (path[k + 1] - path[k]) / _SPEEDS
            if a @ b > _BEND * np.linalg.norm(a) * np.linalg.norm(b):
                continue
        yield from _stretch(np.array(run), speed)
        run = [path[k]]


def _stretch(
    points: Float[np.ndarray, "k 10"], speed: float
) -> Iterator[tuple[Float[np.ndarray, "10"], Float[np.ndarray, "10"]]]:
    """One smooth motion through points that lie almost in line: quintic in time."""
    steps = np.abs(np.diff(points, axis=0))
    reached = np.concatenate([[0.0], np.cumsum((steps / _SPEEDS).max(axis=1))])
    if reached[-1] < 1e-9:
        return
    way = steps.sum(axis=0)
    seconds = max(
        (_PEAK_SPEED * way / (speed * _SPEEDS)).max(),
        np.sqrt(_PEAK_ACCELERATION * way / (speed * _ACCELERATIONS)).max(),
    )
    count = int(np.ceil(seconds / TIME_STEP))
    # A smooth curve through the points, so that velocities do not jump from edge to edge.
    curve = CubicSpline(reached, points) if len(points) > 2 else None
    for i in range(1, count + 1):
        s = i / count
        at = reached[-1] * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        rate = reached[-1] * 30.0 * s * s * (1.0 - s) ** 2 / seconds
        if curve is None:
            slope = (points[1] - points[0]) / reached[-1]
            yield points[0] + slope * at, slope * rate
        else:
            yield curve(at), curve(at, 1) * rate
