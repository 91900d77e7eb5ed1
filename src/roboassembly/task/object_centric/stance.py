"""How a finished piece stands on its feet, and whether it stays.

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
"""Radians between a piece's z axis and where it points when the piece stands, up to which it counts as standing."""
LARGEST_LEAN = float(np.deg2rad(10.0))
"""Radians from the vertical at which a standing piece may come to rest: a rocking chair leans by a few degrees."""
NUDGE = float(np.deg2rad(1.0))
"""Radians by which a standing piece is tilted to each side, to find out whether it only balances."""
NOT_ASSEMBLED = "the parts are not where the furniture has them"
"""Why parts that are not the assembled furniture are not set upright."""
_UP = np.array([0.0, 0.0, 1.0])
_SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))


@dataclass(frozen=True, eq=False)
class Stance:
    """How a finished piece stands on its feet, if it does."""

    group: Group
    """The whole piece where it is now, in the furniture's frame."""
    rotation: Float[np.ndarray, "3 3"]
    """Of the furniture's frame in the world once it stands: the smallest turn from where it is, and its lean."""
    lean: float
    """Radians from the vertical at which it comes to rest, let go upright or nudged: the largest."""

    @property
    def reason(self) -> str:
        """Why it does not stay upright; empty if it does."""
        if self.lean <= LARGEST_LEAN:
            return ""
        return f"it does not stay upright: it tips over and comes to rest {np.rad2deg(self.lean):.0f}° from it"

    @property
    def reached(self) -> bool:
        """Whether the piece is turned like this already, but for a turn about the vertical."""
        return tilt(self.group.world_from_furniture.rotation) <= self.lean + TILT_TOLERANCE


def tilt(rotation: Float[np.ndarray, "3 3"]) -> float:
    """Radians between the z axis of a frame and the vertical."""
    return float(np.arctan2(np.hypot(rotation[0, 2], rotation[1, 2]), rotation[2, 2]))


def stance_of(furniture: Furniture, poses: Sequence[SE3]) -> Stance | None:
    """How an assembled piece stands; None if the parts at `poses` are not the assembled furniture.

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
    nudges = [align_axis(_UP, np.array([np.sin(NUDGE) * x, np.sin(NUDGE) * y, np.cos(NUDGE)])) for x, y in _SIDES]
    lean = max(tilt(rotation), *(tilt(_rest(furniture, group, nudge @ turn)) for nudge in nudges))
    return Stance(group, rotation, lean)


def _rest(furniture: Furniture, group: Group, turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation in which a group comes to rest when it is let go turned some way."""
    _, rested = settle_group(furniture, standing_at(furniture, group, turn))
    return rested.world_from_furniture.rotation


def standing_at(
    furniture: Furniture,
    group: Group,
    rotation: Float[np.ndarray, "3 3"],
    place: Float[np.ndarray, "2"] | None = None,
) -> Group:
    """A group turned some way, its lowest point `GROUND_CLEARANCE` above the ground.

    Args:
        furniture: what the group is of.
        group: to be moved.
        rotation: of the furniture's frame in the world.
        place: of its centre of mass on the ground, metres; where it is now if None.
    """
    center = center_of_mass(furniture, group)
    if place is None:
        place = group.world_from_furniture.act(center)[:2]
    lift = GROUND_CLEARANCE - float((hull_points(furniture, group) @ rotation[2]).min())
    return group.moved_to(SE3(rotation, np.array([*(place - (rotation @ center)[:2]), lift])))
