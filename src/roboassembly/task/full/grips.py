"""Grips of hands on groups, and what two hands and two groups do to each other at a joint.

All tests here come before any arm does: they are cheap, and an action must pass them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture, GraspRegion
from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import SE3, shifted
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.world import CollisionWorld
from roboassembly.robots.gripper import MAX_OPENING, SHORT_RETREAT, WIDER, hand_bodies, hand_pose
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group, body
from roboassembly.task.rules.pairs import Merge

_STILL = "still"
"""Name of the body that u's group leaves."""
TOUCH = 2e-4
"""Distance between a pad and the part that it holds, in the exact geometry [m]."""
_BEYOND_PARTNER = 0.02
"""Distance that a retract goes on after it has left the partner's boxes [m]."""
_LONGEST, _LONGEST_ONWARD = 0.6, 1.0
"""Length of a straight retract, and of a second motion, at most [m]."""
ASTRAY = 1e-3
"""Clearance of an open hand as it comes and goes: physical robots stray a little from their paths [m]."""
_STOPS = (1.0, 0.5)
"""Shares of the way to what stops a first motion after which second ones begin."""
_OTHER = 0.9
"""Absolute cosine above which a direction is no other one."""
_SHORTEST, _SHORT_OF, _AMPLE = 0.03, 0.005, 0.2
"""Length of a first motion that is stopped at least; distance that it ends before what stops it; length beyond which
more is no better [m]."""


@dataclass(frozen=True, eq=False)
class Grip:
    """Grip of a hand on one part of a group."""

    part: int
    grasp: int
    """Index 0 to 7 of the grasp: region, then direction."""
    furniture_from_tips: SE3
    """Pose of the finger tips in the group's frame."""
    approach: Float[np.ndarray, "3"]
    """Unit vector in the group's frame along which the hand comes."""
    closed: float
    """Distance between the pads when they hold the part [m]."""
    open: float
    """Distance between the pads as the hand comes and goes [m]."""

    def moved(self, by: SE3) -> Grip:
        """Return the same grip in another frame.

        Args:
            by: `other_from_group`.
        """
        return replace(self, furniture_from_tips=by * self.furniture_from_tips, approach=by.rotation @ self.approach)

    def hand(self, opening: float, moves: bool = False) -> Body:
        """Return the hand as a body of the group's frame."""
        return Body("hand", hand_shapes(opening), self.furniture_from_tips, moves)


@dataclass(frozen=True, eq=False)
class Motion:
    """A straight motion."""

    direction: Float[np.ndarray, "3"]
    """Unit vector of the merged group's frame."""
    length: float
    """Distance [m]."""


@dataclass(frozen=True, eq=False)
class Retract:
    """A motion of u's group out of a joint, with the hand that holds it."""

    motions: tuple[Motion, ...]
    """One straight motion or two, until nothing of u's group is beside anything of v's."""

    @property
    def usable_length(self) -> float:
        """Length of the first motion, as far as more of it is better [m]."""
        return min(self.motions[0].length, _AMPLE)


@dataclass(frozen=True, eq=False)
class MateGrasp:
    """A right pair and two grips that pass all tests before any arm comes in."""

    merge: Merge
    u: Group
    """Group of u in its own frame."""
    v: Group
    grip_a: Grip
    """R_a's grip on u's group, in the frame of that group."""
    grip_b: Grip
    """R_b's grip on v's group, in the frame of that group."""
    retracts: tuple[Retract, ...]
    """Motions out of the joint, the most useful first."""

    @property
    def merged_grips(self) -> tuple[Grip, Grip]:
        """Both grips in the merged group's frame."""
        return self.grip_a.moved(self.merge.furniture_from_u), self.grip_b.moved(self.merge.furniture_from_v)

    @property
    def merged_groups(self) -> tuple[Group, Group]:
        """Both groups in the merged group's frame."""
        return _reframed(self.u, self.merge.furniture_from_u), _reframed(self.v, self.merge.furniture_from_v)


def hand_shapes(opening: float) -> tuple[Shape, ...]:
    """Return palm and fingers in the frame of the finger tips.

    Args:
        opening: distance between the pads [m].
    """
    return tuple(Shape(mesh, pose, convex=True) for mesh, pose in hand_bodies(opening))


def grip_of(furniture: Furniture, group: Group, part: int, grasp: int) -> Grip | None:
    """Return the grip on a part with grasp 0 to 7; None if the part has no such grasp."""
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


def can_grip(furniture: Furniture, group: Group, grip: Grip) -> bool:
    """Whether the open hand comes straight to the part and closes without touching the rest of the group."""
    alone = group.moved_to(SE3.Identity())
    return _can_approach(grip, [body(furniture, alone, "group")]) and grip_fits_group(furniture, alone, grip)


def grip_fits_group(furniture: Furniture, group: Group, grip: Grip) -> bool:
    """Whether the closed hand touches nothing of a group, with both where they are."""
    scene = Scene((grip.hand(grip.closed, moves=True), body(furniture, group, "group")), ground=False)
    return CollisionWorld(scene).is_free(grip.furniture_from_tips)


def can_release(furniture: Furniture, merged: Group, grip: Grip, *others: Body) -> bool:
    """Whether the hand, open again, backs out of the merged group and past other bodies, such as the other hand."""
    return _can_approach(grip, [body(furniture, merged, "merged"), *others])


def retracts(
    furniture: Furniture,
    u_group: Group,
    v_group: Group,
    grip_u: Grip | None,
    grip_v: Grip | None,
    directions: Sequence[Float[np.ndarray, "3"]],
) -> Iterator[Retract]:
    """Yield motions along which u's group leaves v's; none if they, or the hands, collide at the joint.

    Straight ones come first. If there are none, two straight motions are tried: a board that lies on pegs between two
    others is lifted off them and drawn out. Groups that come apart in neither way do not come apart in practice: of 581
    merges of real furniture that the search planned, none did.

    Args:
        furniture: furniture of both groups.
        u_group: in the merged group's frame.
        v_group: in the merged group's frame.
        grip_u: hand that moves with u's group, in u's frame; None if there is no hand.
        grip_v: hand that stays with v's group, in v's frame; None if there is no hand.
        directions: unit vectors that are tried.
    """
    world, goal = _joint_world(furniture, u_group, v_group, grip_u, grip_v)
    if not world.is_free(goal):
        return
    stopped: list[Motion] = []
    straight = False
    for d in directions:
        length = min(world.distance_to_clear(goal, d, _STILL) + _BEYOND_PARTNER, _LONGEST)
        reached = length * world.free_fraction(goal, shifted(goal, length * d))
        if reached >= length:
            straight = True
            yield Retract((Motion(d, length),))
        elif reached > _SHORTEST:
            stopped.append(Motion(d, reached - _SHORT_OF))
    if not straight:
        yield from _onward(world, goal, stopped, distinct_directions([*directions, *UP_AXES]))


def _onward(
    world: CollisionWorld, goal: SE3, stopped: Sequence[Motion], directions: Sequence[Float[np.ndarray, "3"]]
) -> Iterator[Retract]:
    """Yield the motions that something stops, each with a second one along another direction that leads out."""
    for first in (replace(motion, length=share * motion.length) for motion in stopped for share in _STOPS):
        start = shifted(goal, first.length * first.direction)
        for d in directions:
            if abs(float(d @ first.direction)) > _OTHER:
                continue
            length = world.distance_to_clear(start, d, _STILL) + _BEYOND_PARTNER
            if length < _LONGEST_ONWARD and world.edge_is_free(start, shifted(start, length * d)):
                yield Retract((first, Motion(d, length)))


def _joint_world(
    furniture: Furniture, u_group: Group, v_group: Group, grip_u: Grip | None, grip_v: Grip | None
) -> tuple[CollisionWorld, SE3]:
    """Return two groups and the hands that hold them, where u's moves, and its pose at the joint."""
    moving = Body(
        "moving",
        (*body(furniture, u_group, "u").shapes, *_closed_hand(grip_u)),
        u_group.world_from_furniture,
        True,
    )
    still = Body(_STILL, (*body(furniture, v_group, "v").shapes, *_closed_hand(grip_v)), v_group.world_from_furniture)
    return CollisionWorld(Scene((moving, still), ground=False)), moving.pose


def _can_approach(grip: Grip, still: Sequence[Body]) -> bool:
    hand = grip.hand(grip.open, moves=True)
    world = CollisionWorld(Scene((hand, *still), ground=False))
    goal = grip.furniture_from_tips
    back = shifted(goal, -SHORT_RETREAT * grip.approach)
    # The hand may stray a little sideways.
    aside = (sign * ASTRAY * axis for axis in goal.rotation.T[:2] for sign in (-1.0, 1.0))
    poses = [goal, *(shifted(goal, shift) for shift in aside)]
    return world.are_free(poses) and world.edge_is_free(goal, back)


def _closed_hand(grip: Grip | None) -> tuple[Shape, ...]:
    if grip is None:
        return ()
    tips = grip.furniture_from_tips
    return tuple(Shape(s.mesh, tips * s.body_from_mesh, s.convex) for s in hand_shapes(grip.closed))


def _reframed(group: Group, by: SE3) -> Group:
    """Return the same group with its parts' poses in another frame."""
    return replace(group, furniture_from_part=tuple(by * p for p in group.furniture_from_part))
