"""What two hands and two groups do to each other at a joint, before any arm comes in: cheap tests that must hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture, GraspRegion
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.world import CollisionWorld
from roboassembly.robots.gripper import MAX_OPENING, RETREAT, hand_bodies, hand_pose
from roboassembly.task.full.cell import WIDER
from roboassembly.task.rules.groups import Group, body

TOUCH = 2e-4
"""Metres between a pad and what it holds, in the exact geometry."""
_CLEAR = 0.02
"""Metres beyond which a retreat that has left the partner's boxes goes on."""
_LONGEST = 0.6
_ASTRAY = 1e-3
"""Metres of room on each side of an open hand."""
_SHORTEST, _SHORT_OF, _AMPLE = 0.03, 0.005, 0.2


@dataclass(frozen=True, eq=False)
class Grip:
    """A hand that holds one part of a group."""

    part: int
    grasp: int
    """0 to 7: region, then direction."""
    furniture_from_tips: SE3
    """In the group's frame."""
    approach: Float[np.ndarray, "3"]
    """Unit vector of the group's frame along which the hand comes."""
    closed: float
    """Metres between the pads."""
    open: float

    def moved(self, by: SE3) -> Grip:
        """The same, told in another frame: `other_from_group`."""
        return replace(self, furniture_from_tips=by * self.furniture_from_tips, approach=by.rotation @ self.approach)

    def hand(self, opening: float, moves: bool = False) -> Body:
        """The hand as a body of the group's frame."""
        return Body("hand", hand_shapes(opening), self.furniture_from_tips, moves)


def hand_shapes(opening: float) -> tuple[Shape, ...]:
    """Palm and fingers in the frame of the finger tips."""
    return tuple(Shape(mesh, pose, convex=True) for mesh, pose in hand_bodies(opening))


def grip_of(furniture: Furniture, group: Group, part: int, grasp: int) -> Grip | None:
    """How a hand holds a part with grasp 0 to 7; None if the part has no such grasp."""
    regions = furniture.parts[part].grasps
    region_index, direction = divmod(grasp, 4)
    if region_index >= len(regions):
        return None
    region: GraspRegion = regions[region_index]
    own = group.furniture_from_part[group.parts.index(part)]
    approach = region.approaches[direction]
    return Grip(
        part,
        grasp,
        own * hand_pose(region.position, region.closing, approach),
        own.rotation @ approach,
        region.width + 2.0 * TOUCH,
        min(MAX_OPENING, region.width + WIDER),
    )


def can_grip(furniture: Furniture, group: Group, held: Grip) -> bool:
    """Whether the open hand comes straight to the part, and closes, and meets nothing of the group."""
    alone = group.moved_to(SE3.Identity())
    return _comes(held, [body(furniture, alone, "group")]) and grip_fits_group(furniture, alone, held)


def grip_fits_group(furniture: Furniture, group: Group, held: Grip) -> bool:
    """Whether the closed hand meets nothing of a group, where both are."""
    scene = Scene((held.hand(held.closed, moves=True), body(furniture, group, "group")), ground=False)
    return CollisionWorld(scene).is_free(held.furniture_from_tips)


def _comes(held: Grip, still: Sequence[Body]) -> bool:
    hand = held.hand(held.open, moves=True)
    world = CollisionWorld(Scene((hand, *still), ground=False))
    goal = held.furniture_from_tips
    back = SE3(goal.rotation, goal.translation - RETREAT * held.approach)
    if not (world.is_free(goal) and world.edge_is_free(goal, back)):
        return False
    # It may stray a little sideways.
    aside = (sign * _ASTRAY * axis for axis in goal.rotation.T[:2] for sign in (-1.0, 1.0))
    return all(world.is_free(SE3(goal.rotation, goal.translation + shift)) for shift in aside)


@dataclass(frozen=True, eq=False)
class Retract:
    """A straight way out of a joint."""

    direction: Float[np.ndarray, "3"]
    """Unit vector of the merged group's frame, along which u's group and the hand that holds it leave."""
    length: float
    """Metres, until nothing of it is beside anything of v's."""

    @property
    def usable_length(self) -> float:
        """Metres, as far as more of them are better."""
        return min(self.length, _AMPLE)


def retracts(
    furniture: Furniture,
    u_group: Group,
    v_group: Group,
    grip_u: Grip | None,
    grip_v: Grip | None,
    directions: Sequence[Float[np.ndarray, "3"]],
) -> Iterator[Retract]:
    """Straight ways along which u's group leaves v's, both in the merged group's frame and held, if a hold is given;
    none if they, or the hands, are in each other's way where they are joined."""
    moving = Body(
        "moving",
        (*body(furniture, u_group, "u").shapes, *_closed(grip_u)),
        u_group.world_from_furniture,
        True,
    )
    still = Body("still", (*body(furniture, v_group, "v").shapes, *_closed(grip_v)), v_group.world_from_furniture)
    world = CollisionWorld(Scene((moving, still), ground=False))
    goal = moving.pose
    if not world.is_free(goal):
        return
    for d in directions:
        length = min(world.distance_to_clear(goal, d, "still") + _CLEAR, _LONGEST)
        reached = length * world.free_fraction(goal, SE3(goal.rotation, goal.translation + length * d))
        if reached >= length:
            yield Retract(d, length)
        elif reached > _SHORTEST:
            yield Retract(d, reached - _SHORT_OF)


def can_release(furniture: Furniture, merged: Group, held: Grip, *others: Body) -> bool:
    """Whether the hand, open again, backs out of the merged group and past others, such as the other hand."""
    return _comes(held, [body(furniture, merged, "merged"), *others])


def _closed(held: Grip | None) -> tuple[Shape, ...]:
    if held is None:
        return ()
    tips = held.furniture_from_tips
    return tuple(Shape(s.mesh, tips * s.body_from_mesh, s.convex) for s in hand_shapes(held.closed))
