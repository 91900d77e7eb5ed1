"""Stance of a finished piece: how it stands on its feet, and whether it stays upright.

Up is the +z axis of the assembled furniture's frame. A piece can be set upright only if it then stays: let go upright,
or nudged by `NUDGE` to any side, it has to come to rest less than `LARGEST_LEAN` from the vertical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis, rotation_angle
from roboassembly.task.layout import GROUND_CLEARANCE
from roboassembly.task.object_centric.settling import settle_group
from roboassembly.task.rules.groups import Group, center_of_mass, hull_points
from roboassembly.task.rules.pairs import PairRule

TILT_TOLERANCE = float(np.deg2rad(2.0))
"""Angle between a piece's z axis and its direction in the stance up to which the piece counts as standing [rad]."""
LARGEST_LEAN = float(np.deg2rad(10.0))
"""Largest angle from the vertical at which a standing piece may rest [rad]; a rocking chair leans by a few degrees."""
NUDGE = float(np.deg2rad(1.0))
"""Angle by which a standing piece is tilted to each side to test whether it only balances [rad]."""
NOT_ASSEMBLED = "the parts are not where the furniture has them"
"""Reason for parts that are not the assembled furniture."""
_UP = np.array([0.0, 0.0, 1.0])
_SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


@dataclass(frozen=True, eq=False)
class Stance:
    """Stance of a finished piece on its feet."""

    group: Group
    """Whole piece at its present pose."""
    rotation: Float[np.ndarray, "3 3"]
    """Rotation of the furniture's frame in the world when the piece stands, the nearest to its present rotation."""
    lean: float
    """Largest angle from the vertical at which the piece rests after it is released upright or nudged [rad]."""

    @property
    def reason(self) -> str:
        """Reason why the piece does not stay upright; empty if it does."""
        if self.lean <= LARGEST_LEAN:
            return ""
        return f"it does not stay upright: it tips over and comes to rest {np.rad2deg(self.lean):.0f}° from it"

    @property
    def reached(self) -> bool:
        """Whether the piece stands like this already, up to a turn about the vertical."""
        return tilt(self.group.world_from_furniture.rotation) <= self.lean + TILT_TOLERANCE


def tilt(rotation: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle between the z axis of a frame and the vertical [rad]."""
    return float(np.arctan2(np.hypot(rotation[0, 2], rotation[1, 2]), rotation[2, 2]))


def stance_of(furniture: Furniture, poses: Sequence[SE3]) -> Stance | None:
    """Return the stance of an assembled piece; None if the parts at `poses` are not the assembled furniture.

    Args:
        furniture: what is assembled.
        poses: `world_from_part` of every part.
    """
    frames = list(PairRule(furniture).furniture_frames(poses))
    if not frames:
        return None
    # A piece that is symmetric has several frames; the one nearest to upright needs the least turning.
    frame = min(frames, key=lambda f: (round(tilt(f.rotation), 9), round(rotation_angle(f.rotation), 9)))
    parts = tuple(range(len(poses)))
    # Which slots like parts have swapped does not matter for how the whole stands.
    group = Group(parts, parts, tuple(frame.actInv(pose) for pose in poses), frame)
    turn = align_axis(frame.rotation[:, 2], _UP) @ frame.rotation
    rotation = _rest(furniture, group, turn)
    lean = max(tilt(rotation), *(tilt(_rest(furniture, group, nudge @ turn)) for nudge in nudges()))
    return Stance(group, rotation, lean)


def nudges() -> list[Float[np.ndarray, "3 3"]]:
    """Return rotations of the world by `NUDGE` to four sides."""
    return [align_axis(_UP, np.array([np.sin(NUDGE) * x, np.sin(NUDGE) * y, np.cos(NUDGE)])) for x, y in _SIDES]


def _rest(furniture: Furniture, group: Group, turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation in which a group rests after it is released with some rotation."""
    _, rested = settle_group(furniture, standing_at(furniture, group, turn))
    return rested.world_from_furniture.rotation


def standing_at(
    furniture: Furniture,
    group: Group,
    rotation: Float[np.ndarray, "3 3"],
    place: Float[np.ndarray, "2"] | None = None,
) -> Group:
    """Return a group with some rotation, its lowest point `GROUND_CLEARANCE` above the ground.

    Args:
        furniture: furniture of the group.
        group: to be moved.
        rotation: of the furniture's frame in the world.
        place: of its centre of mass on the ground, metres; where it is now if None.
    """
    center = center_of_mass(furniture, group)
    if place is None:
        place = group.world_from_furniture.act(center)[:2]
    lift = GROUND_CLEARANCE - float((hull_points(furniture, group) @ rotation[2]).min())
    return group.moved_to(SE3(rotation, np.array([*(place - (rotation @ center)[:2]), lift])))
