"""Bounds of how far points of a mobile Franka move along an edge, whatever the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from roboassembly.robots.kinematics import JOINTS, arm
from roboassembly.robots.platform import PLATFORM_FROM_MOUNT

_SAMPLES, _SLACK = 10_000, 1.03
"""Number of random configurations, and safety factor, of the largest distances from axes to links."""


class MotionBounds:
    """Bounds of motion of each moving shape, and of each pair of them.

    Args:
        carriers: joint that moves each shape; 0 is the platform.
        points: points of each shape in the frame of its carrier [m].
        pairs: pairs of shapes; the second is carried by a later joint.
    """

    def __init__(
        self, carriers: Sequence[int], points: Sequence[Float[np.ndarray, "n 3"]], pairs: Int[np.ndarray, "p 2"]
    ) -> None:
        reach = np.array([_reach(c, p) for c, p in zip(carriers, points, strict=True)])
        self._shapes = np.concatenate([np.ones((len(reach), 1)), reach], axis=1)
        carrier, joint = np.array(carriers), np.arange(1 + JOINTS)
        # Only the joints between two shapes move one relative to the other.
        between = joint > carrier[pairs[:, :1]]
        self._pairs = np.concatenate([np.zeros((len(pairs), 1)), between * reach[pairs[:, 1]]], axis=1)

    def along(self, steps: Float[np.ndarray, "e 10"]) -> tuple[Float[np.ndarray, "e s"], Float[np.ndarray, "e p"]]:
        """Return how far each shape moves at most in the world, and the second of each pair in the first's frame [m].

        Args:
            steps: difference of configurations along each edge [m, rad].
        """
        travel = np.concatenate([np.linalg.norm(steps[:, :2], axis=1)[:, None], np.abs(steps[:, 2:])], axis=1)
        return travel @ self._shapes.T, travel @ self._pairs.T


def _reach(carrier: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "8"]:
    """Return the largest distance from the axis of the platform, and of each joint, to points that it moves [m]."""
    out = np.zeros(1 + JOINTS)
    out[:carrier] = _spans()[:carrier, carrier] + np.linalg.norm(points, axis=1).max()
    out[carrier] = np.linalg.norm(points[:, :2], axis=1).max()
    return out


@cache
def _spans() -> Float[np.ndarray, "8 8"]:
    """Return the largest distance from each axis to the origins of later carriers, by random configurations [m]."""
    rng = np.random.default_rng(0)
    q = rng.uniform(arm().low, arm().high, (_SAMPLES, JOINTS))
    # A joint's own angle does not change its spans, so the samples cover the extreme of each span well.
    frames, origins = arm().frames(q)
    axes = frames[..., 2]
    mount = PLATFORM_FROM_MOUNT.translation
    axes = np.concatenate([np.broadcast_to([0.0, 0.0, 1.0], (len(q), 1, 3)), axes], axis=1)
    origins = np.concatenate([np.zeros((len(q), 1, 3)), origins + mount], axis=1)
    out = np.zeros((1 + JOINTS, 1 + JOINTS))
    for i in range(1 + JOINTS):
        off = origins[:, i + 1 :] - origins[:, i, None]
        out[i, i + 1 :] = np.linalg.norm(np.cross(off, axes[:, i, None]), axis=2).max(axis=0, initial=0.0)
    return _SLACK * out
