"""Timing of motions in a film: eased motions, path lengths, and the speed along a path."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, from_quaternion, interpolate, rotation_angle

APPROACH_LENGTH = 0.10
"""Length [m] of the slow end of a path, before the parts mate."""


def ease(fraction: float) -> float:
    """Return the share of a motion that is done after a fraction of its time; the speed is zero at both ends."""
    return fraction * fraction * (3.0 - 2.0 * fraction)


def path_length(path: Iterable[SE3], radius: float) -> float:
    """Return the length [m] of a path: translations plus rotations times `radius`.

    Args:
        path: poses along the path.
        radius: distance [m] of the farthest point of the moving body from the origin of its frame.
    """
    total = 0.0
    for a, b in itertools.pairwise(path):
        total += float(np.linalg.norm(b.translation - a.translation))
        turn = rotation_angle(a.rotation.T @ b.rotation)
        total += radius * turn if turn > 1e-9 else 0.0
    return total


def speed_profile(
    length: float, flight: float, approach: float
) -> Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n"]]:
    """Return the distance along a path [m] as a function of time [s].

    A flight is followed by a slow approach over the last `APPROACH_LENGTH`. Both are cubic in time. They meet at the
    same speed; the speed is zero at the start and at the end.

    Args:
        length: length of the path [m].
        flight: duration of the flight [s].
        approach: duration of the approach [s].
    """
    last = min(APPROACH_LENGTH, 0.5 * length)
    first = length - last
    # At most 1.5 times the mean speed of the approach, so that the approach only slows down; at most twice the mean
    # speed of the flight, so that the flight does not overshoot (it would above three times).
    speed = min(1.5 * last / approach, 2.0 * first / flight)

    def distance(time: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        s = np.clip(time / flight, 0.0, 1.0)
        out = first * s * s * (3.0 - 2.0 * s) + speed * flight * s * s * (s - 1.0)
        r = np.clip((time - flight) / approach, 0.0, 1.0)
        slow = last * r * r * (3.0 - 2.0 * r) + speed * approach * r * (1.0 - r) ** 2
        return np.maximum.accumulate(out + slow)

    return distance


def interpolated(a: SE3, b: SE3, fractions: Float[np.ndarray, "n"]) -> Iterator[SE3]:
    """Yield the poses at these fractions of the straight motion from `a` to `b`."""
    for x, y, z, qx, qy, qz, qw in interpolate(a, b, fractions).T:
        yield from_quaternion((x, y, z), (qw, qx, qy, qz))


def pose_between(a: SE3, b: SE3, fraction: float) -> SE3:
    """Return the pose at a fraction of the straight motion from `a` to `b`."""
    return next(interpolated(a, b, np.array([fraction])))
