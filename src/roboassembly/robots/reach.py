"""Where a platform may stand so that its hand comes to a pose, with the arm's configuration for each such place.

What the arm can reach does not change when the platform drives or turns. So one table of random configurations serves
every wanted pose: it is looked up by what driving and turning leave as it is, the height of the finger tips and how
they are tilted. Each row found tells where the platform has to stand; Newton's method takes the rest of the way.
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

_ROWS = 60_000
_MARGIN = 0.1
"""Radians that the table's configurations stay away from the joints' limits."""
_LIMBER = 0.02
"""Yoshikawa's measure that they have at least; the Panda's best is about 0.14."""
_METRES_A_RADIAN = 0.3
"""How much farther away, for the look-up, is a row of another tilt."""
_GUIDE_ROW = 64
"""The so many-th nearest row tells how many are near."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Ways for one robot to have its finger tips at one pose."""

    configurations: Float[np.ndarray, "n 10"]
    """`(x, y, angle)` of the platform, then the arm's seven; metres and radians."""
    manipulability: Float[np.ndarray, "n"]


@dataclass(frozen=True, eq=False)
class _Table:
    tree: KDTree
    q: Float[np.ndarray, "n 7"]
    tips: Poses
    """`platform_from_tips`."""


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
    """What driving and turning leave as it is: height, and the vertical as the tips see it."""
    return np.concatenate([tips.translation[:, 2:], _METRES_A_RADIAN * tips.rotation[:, 2]], axis=1)


def reach(world_from_tips: SE3, count: int, rng: np.random.Generator) -> Reach:
    """Ways to have the finger tips there; nothing around is looked at.

    Args:
        world_from_tips: wanted.
        count: of guesses; a little fewer ways are found, and none if the arm cannot be so.
        rng: draws which of the rows near enough are tried.
    """
    table = _table()
    wanted = Poses(world_from_tips.rotation[None], world_from_tips.translation[None])
    _, rows = table.tree.query(_keys(wanted)[0], k=4 * count)
    rows = rng.choice(rows, count, replace=False)
    tips = table.tips.rotation[rows]
    # The turn about the vertical that brings the row's tips nearest to the wanted ones.
    between = world_from_tips.rotation[None] @ tips.transpose(0, 2, 1)
    angle = np.arctan2(between[:, 1, 0] - between[:, 0, 1], between[:, 0, 0] + between[:, 1, 1])
    cosine, sine = np.cos(angle), np.sin(angle)
    along = table.tips.translation[rows]
    x = world_from_tips.translation[0] - (cosine * along[:, 0] - sine * along[:, 1])
    y = world_from_tips.translation[1] - (sine * along[:, 0] + cosine * along[:, 1])
    place = np.stack([x, y, angle], axis=1)
    q, found = arm().solve(in_mount(place, world_from_tips), table.q[rows])
    configurations = np.concatenate([place, q], axis=1)[found]
    return Reach(configurations, arm().manipulability(q[found]))


def nearness(world_from_tips: Poses) -> Float[np.ndarray, "n"]:
    """How far the table's rows are from each pose, metres and tilt together: the less, the more ways there are."""
    far, _ = _table().tree.query(_keys(world_from_tips), k=[_GUIDE_ROW])
    return far[:, 0]


def in_mount(place: Float[np.ndarray, "n 3"], world_from_tips: SE3) -> Poses:
    """`mount_from_tips` for platforms at several places."""
    cosine, sine, zero, one = np.cos(place[:, 2]), np.sin(place[:, 2]), np.zeros(len(place)), np.ones(len(place))
    back = np.stack([cosine, sine, zero, -sine, cosine, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    off = world_from_tips.translation - np.concatenate([place[:, :2], zero[:, None]], axis=1)
    turn = PLATFORM_FROM_MOUNT.rotation.T @ back
    rotation = turn @ world_from_tips.rotation
    translation = (turn @ off[..., None])[..., 0] - PLATFORM_FROM_MOUNT.rotation.T @ PLATFORM_FROM_MOUNT.translation
    return Poses(rotation, translation)
