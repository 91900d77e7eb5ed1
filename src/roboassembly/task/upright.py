"""After the last merge: the finished piece is set upright on its feet, along a path that is planned and checked.

Up is the +z axis of the assembled furniture's frame. The piece is set upright only if it then stays: let go upright, it
has to come to rest less than `LARGEST_LEAN` from it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.planning.world import CollisionWorld
from roboassembly.poses import (
    SE3,
    align_axis,
    from_quaternion,
    interpolate,
    poses_to_configurations,
    rotation_angle,
    transform_points,
)
from roboassembly.scene import Scene
from roboassembly.task.groups import Group, body, center_of_mass, hull_points
from roboassembly.task.layout import GROUND_CLEARANCE
from roboassembly.task.pairs import PairRule
from roboassembly.task.plan import Plan, UprightMotion, UprightResult
from roboassembly.task.settling import let_go

TILT_TOLERANCE = float(np.deg2rad(2.0))
"""Radians between a piece's z axis and where it points when the piece stands, up to which it counts as standing."""
LARGEST_LEAN = float(np.deg2rad(10.0))
"""Radians from the vertical at which a standing piece may come to rest: a rocking chair leans by a few degrees."""
PLANNER = "lift-turn-lower"
_CLEARANCE = 0.02
"""Metres between the ground and the lowest point of the piece while it turns."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Stance:
    """How a finished piece stands on its feet, if it does."""

    group: Group
    """The whole piece where it is now, in the furniture's frame."""
    rotation: Float[np.ndarray, "3 3"]
    """Of the furniture's frame in the world once it stands: the smallest turn from where it is, and its lean."""
    lean: float
    """Radians from the vertical at which it comes to rest when it is let go upright."""

    @property
    def reason(self) -> str:
        """Why it does not stay upright; empty if it does."""
        if self.lean <= LARGEST_LEAN:
            return ""
        return f"let go upright, the piece tips over and comes to rest {np.rad2deg(self.lean):.0f}° from upright"

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
    group = Group(parts, parts, tuple(frame.actInv(pose) for pose in poses), frame)
    turn = align_axis(frame.rotation[:, 2], _UP) @ frame.rotation
    _, rested = let_go(furniture, standing_at(furniture, group, turn))
    rotation = rested.world_from_furniture.rotation
    return Stance(group, rotation, tilt(rotation))


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


def set_upright(plan: Plan) -> Plan:
    """The plan with its last motion: the assembled piece lifted, turned and set on its feet.

    A plan that did not succeed, or that has its last motion already, comes back as it is. Nothing is random.

    Args:
        plan: of a whole assembly.
    """
    if not plan.success or plan.upright is not None:
        return plan
    begun = time.perf_counter()
    motion, reason, states = _motion(plan.furniture, plan.final_poses)
    seconds = time.perf_counter() - begun
    return replace(plan, upright=UprightResult(not reason, reason, motion, states, seconds))


def _motion(furniture: Furniture, poses: Sequence[SE3]) -> tuple[UprightMotion | None, str, int]:
    """The motion, if one is needed and there is one; why there is none; and configurations tested."""
    stance = stance_of(furniture, poses)
    if stance is None:
        return None, NOT_ASSEMBLED, 0
    if stance.reason or stance.reached:
        return None, stance.reason, 0
    group = stance.group
    goal = standing_at(furniture, group, stance.rotation)
    origin = SE3(np.eye(3), center_of_mass(furniture, group))
    piece = body(furniture, group, "piece", origin=origin.translation, moves=True)
    world = CollisionWorld(Scene((piece,)))
    path = _lift_turn_lower(world, piece.pose, goal.world_from_furniture * origin)
    free = world.is_free(path[0]) and world.is_free(path[-1])
    if not (free and all(world.edge_is_free(a, b) for a, b in zip(path[:-1], path[1:], strict=True))):
        return None, "the piece meets the ground on its way", world.states
    settling, rested = let_go(furniture, goal)
    moving = {p: piece.pose.actInv(pose) for p, pose in enumerate(poses)}
    if tilt(rested.world_from_furniture.rotation) > LARGEST_LEAN:
        return None, "the piece tips over once it is let go", world.states
    after = tuple(settling[-1] * path[-1] * moving[p] for p in range(len(poses)))
    return UprightMotion(moving, path, settling, after, PLANNER), "", world.states


NOT_ASSEMBLED = "the parts are not where the furniture has them"


def _lift_turn_lower(world: CollisionWorld, start: SE3, goal: SE3) -> tuple[SE3, ...]:
    """Straight up, a turn about the centre of mass, straight down. Nothing but the ground is there, so that it is free
    if both ends are: the turn happens as high as its lowest point asks for."""
    travel = max(2, int(np.ceil(np.rad2deg(rotation_angle(start.rotation.T @ goal.rotation)))))
    turning = interpolate(start, goal, np.linspace(0.0, 1.0, travel + 1)).T
    lowest = min(
        world.lowest_point(from_quaternion((0.0, 0.0, 0.0), (qw, qx, qy, qz))) for *_, qx, qy, qz, qw in turning
    )
    height = max(start.translation[2], goal.translation[2], _CLEARANCE - lowest)
    above = [SE3(p.rotation, np.array([*p.translation[:2], height])) for p in (start, goal)]
    return (start, *above, goal)
