"""Inverse reachability: placements of the platform, with arm configurations, that bring the hand to a pose.

The arm's workspace does not change when the platform drives or turns. One table of random configurations therefore
serves every target pose; its keys are invariant to driving and turning: height and tilt of the finger tips. Each row
found gives a placement of the platform, and Newton's method refines the arm's configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from roboassembly.geometry.poses import SE3
from roboassembly.robots.kinematics import JOINTS, Poses, arm
from roboassembly.robots.platform import PLATFORM_FROM_MOUNT

_ROWS = 30_000
"""Number of configurations in the table."""
_MARGIN = 0.1
"""Distance of the table's configurations from the joint limits [rad]."""
_LIMBER = 0.02
"""Smallest manipulability (Yoshikawa) of the table's configurations; the Panda's best is about 0.14."""
_METRES_A_RADIAN = 0.3
"""Weight of tilt against height in the look-up [m/rad]."""
_GUIDE_ROW = 64
"""Rank of the neighbour whose distance measures the density of rows."""


@dataclass(frozen=True, eq=False)
class _Table:
    tree: KDTree
    q: Float[np.ndarray, "n 7"]
    tips: Poses
    """Poses `platform_from_tips`."""


@cache
def _table() -> _Table:
    rng = np.random.default_rng(0)
    low, high = arm().low + _MARGIN, arm().high - _MARGIN
    q = rng.uniform(low, high, (_ROWS * 2, JOINTS))
    q = q[arm().manipulability(q) > _LIMBER][:_ROWS]
    tips = arm().poses(q)
    mount = PLATFORM_FROM_MOUNT
    tips = Poses(mount.rotation @ tips.rotation, tips.translation @ mount.rotation.T + mount.translation)
    return _Table(KDTree(_keys(tips)), q, tips)


def _keys(tips: Poses) -> Float[np.ndarray, "n 4"]:
    """Return the keys, invariant to driving and turning: height, and the vertical in the frame of the tips."""
    return np.concatenate([tips.translation[:, 2:], _METRES_A_RADIAN * tips.rotation[:, 2]], axis=1)


def reach(world_from_tips: SE3, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 10"]:
    """Return configurations with the finger tips at a pose: placements `(x, y, angle)` of the platform, then the arm's
    seven joint angles [m, rad]. Collisions are not checked.

    Args:
        world_from_tips: target pose.
        count: number of guesses; somewhat fewer solutions are found, and none for a pose out of reach.
        rng: source of the choice among near rows.
    """
    table = _table()
    target = Poses(world_from_tips.rotation[None], world_from_tips.translation[None])
    _, rows = table.tree.query(_keys(target)[0], k=4 * count)
    rows = rng.choice(rows, count, replace=False)
    tips = table.tips.rotation[rows]
    # Rotation about the vertical that brings the row's tips nearest to the target.
    between = world_from_tips.rotation[None] @ tips.transpose(0, 2, 1)
    angle = np.arctan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1])
    cosine, sine = np.cos(angle), np.sin(angle)
    along = table.tips.translation[rows]
    x = world_from_tips.translation[0] - (cosine * along[:, 0] - sine * along[:, 1])
    y = world_from_tips.translation[1] - (sine * along[:, 0] + cosine * along[:, 1])
    place = np.stack([x, y, angle], axis=1)
    q, found = arm().solve(in_mount(place, target), table.q[rows])
    return np.concatenate([place, q], axis=1)[found]


def nearness(world_from_tips: Poses) -> Float[np.ndarray, "n"]:
    """Return the distance of the table's rows from each pose [m, with weighted tilt]: less means more solutions."""
    far, _ = _table().tree.query(_keys(world_from_tips), k=[_GUIDE_ROW])
    return np.asarray(far)[:, 0]


def in_mount(place: Float[np.ndarray, "n 3"], world_from_tips: Poses) -> Poses:
    """Return `mount_from_tips` for platforms at several placements.

    Args:
        place: placements `(x, y, angle)` [m, rad].
        world_from_tips: one pose for all placements, or one for each.
    """
    cosine, sine, zeros, ones = np.cos(place[:, 2]), np.sin(place[:, 2]), np.zeros(len(place)), np.ones(len(place))
    back = np.stack([cosine, sine, zeros, -sine, cosine, zeros, zeros, zeros, ones], axis=1).reshape(-1, 3, 3)
    off = world_from_tips.translation - np.concatenate([place[:, :2], zeros[:, None]], axis=1)
    turn = PLATFORM_FROM_MOUNT.rotation.T @ back
    rotation = turn @ world_from_tips.rotation
    translation = (turn @ off[..., None])[..., 0] - PLATFORM_FROM_MOUNT.rotation.T @ PLATFORM_FROM_MOUNT.translation
    return Poses(rotation, translation)
