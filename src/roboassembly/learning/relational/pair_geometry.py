"""Geometry of two groups: what happens when any point of one mates with any point of the other.

The first group moves, the second waits; all results are in the frame of the waiting group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.relational.depth_images import exit_counts
from roboassembly.learning.relational.group_geometry import GroupGeometry
from roboassembly.learning.relational.policy_view import CONTACT_COSINE, CONTACT_DISTANCE

_NEAR = 0.012
"""Distance up to which two points that do not mate should probably coincide [m]."""
_AROUND = 0.040
"""Distance up to which two points that do not mate are in each other's way [m]."""


@dataclass(frozen=True, eq=False)
class PairGeometry:
    """Each of k points of a moving group mated with each of l points of a waiting group."""

    matches: UInt8[np.ndarray, "k l 4"]
    """Counts of other pairs of points, see `Tokens.matches`."""
    bounds: Float[np.ndarray, "k l 6"]
    """Bounds of the moving group relative to the waiting group's, see `Tokens.bounds` [m]."""
    exits: UInt8[np.ndarray, "k l 22"]
    """Counts of the depth images along the exits, see `Tokens.exits`."""

    @staticmethod
    def both_ways(a: GroupGeometry, b: GroupGeometry) -> tuple[PairGeometry, PairGeometry]:
        """Return the geometry of two groups where a moves, and where b does."""
        rotation, translation = _poses(a, b)
        of_a, of_b = _count_matches(rotation, translation, a, b)
        back = rotation.transpose(1, 0, 3, 2)
        translation_back = -(back @ translation.transpose(1, 0, 2)[..., None])[..., 0]
        return (
            PairGeometry(of_a, _relative_bounds(rotation, translation, a, b), exit_counts(a.images, b.images)),
            PairGeometry(of_b, _relative_bounds(back, translation_back, b, a), exit_counts(b.images, a.images)),
        )


def _poses(
    moving: GroupGeometry, waiting: GroupGeometry
) -> tuple[Float[np.ndarray, "k l 3 3"], Float[np.ndarray, "k l 3"]]:
    """`waiting_from_moving` at each mate."""
    return mating_poses(moving.frame, moving.position, waiting.frame, waiting.position)


def _count_matches(
    rotation: Float[np.ndarray, "k l 3 3"], translation: Float[np.ndarray, "k l 3"], moving: GroupGeometry,
    waiting: GroupGeometry,
) -> tuple[UInt8[np.ndarray, "k l 4"], UInt8[np.ndarray, "l k 4"]]:  # fmt: skip
    """Numbers of other points that mate, mate with equal tangents, nearly meet one of the other group, and come close.

    Returns:
        Those of the moving group at each mate, and those of the waiting group, with the mate's points swapped.
    """
    # (k, l, k, 3): all points of the moving group at each mate, and (k, l, k, l): their distances to the waiting ones.
    back = rotation.transpose(0, 1, 3, 2)
    mated = moving.position @ back + translation[:, :, None]
    squared = _squared(mated)[..., None] + _squared(waiting.position) - 2.0 * (mated @ waiting.position.T)
    distance = np.sqrt(np.maximum(squared, 0.0))
    opposed = (moving.frame[:, :, 2] @ back) @ waiting.frame[:, :, 2].T < CONTACT_COSINE
    aligned = (moving.frame[:, :, 0] @ back) @ waiting.frame[:, :, 0].T > -CONTACT_COSINE
    mates = (distance < CONTACT_DISTANCE) & opposed
    near = (distance < _NEAR) & ~mates
    around = (distance < _AROUND) & ~mates
    meetings = np.stack([mates, mates & aligned, near, around])
    # The pair itself mates, too.
    counts = [meetings.any(axis=other).sum(axis=3).transpose(1, 2, 0) - np.array([1, 1, 0, 0]) for other in (4, 3)]
    of_moving, of_waiting = (np.maximum(count, 0).astype(np.uint8) for count in counts)
    return of_moving, of_waiting.transpose(1, 0, 2)


def _squared(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Squared lengths."""
    return (vectors * vectors).sum(axis=-1)


def _relative_bounds(
    rotation: Float[np.ndarray, "k l 3 3"], translation: Float[np.ndarray, "k l 3"], moving: GroupGeometry,
    waiting: GroupGeometry,
) -> Float[np.ndarray, "k l 6"]:  # fmt: skip
    """Lower and upper bounds of the moving group less those of the waiting group, along the axes that `w` names [m]."""
    turn = waiting.axes.transpose(0, 2, 1)
    offset = (turn @ translation[..., None])[..., 0]
    mated = ((turn @ rotation).reshape(-1, 3) @ moving.outline.T).reshape(*translation.shape, -1)
    low, high = mated.min(axis=3) + offset, mated.max(axis=3) + offset
    still = waiting.outline @ waiting.axes
    return np.concatenate([low - still.min(axis=1), high - still.max(axis=1)], axis=-1)
