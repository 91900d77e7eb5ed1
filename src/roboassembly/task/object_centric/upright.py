"""Last motion of an object-centric plan: after the last merge the finished piece is set upright on its feet.

It is planned and checked like any other motion. It is made when a plan is to be shown: environments, rewards and the
planning steps of merges know nothing of it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, from_quaternion, interpolate, rotation_angle
from roboassembly.geometry.scene import Scene
from roboassembly.planning.world import CollisionWorld
from roboassembly.task.object_centric.settling import settle_group
from roboassembly.task.object_centric.stance import LARGEST_LEAN, NOT_ASSEMBLED, stance_of, standing_at, tilt
from roboassembly.task.plans.plan import Plan, UprightMotion, UprightResult
from roboassembly.task.rules.groups import body, center_of_mass

PLANNER = "lift-turn-lower"
_CLEARANCE = 0.02
"""Distance between the ground and the lowest point of the piece while it turns [m]."""


def plan_upright(plan: Plan) -> UprightResult[UprightMotion]:
    """Plan the last motion of a plan in which parts move by themselves."""
    begun = time.perf_counter()
    motion, reason, states = _motion(plan.furniture, plan.final_poses)
    return UprightResult(not reason, reason, motion, states, time.perf_counter() - begun)


def _motion(furniture: Furniture, poses: Sequence[SE3]) -> tuple[UprightMotion | None, str, int]:
    """Return the motion or None, the reason if the piece does not end on its feet, and the states tested."""
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
    if not (free and all(world.edge_is_free(a, b) for a, b in pairwise(path))):
        return None, "the piece meets the ground on its way", world.states
    settling, rested = settle_group(furniture, goal)
    moving = {p: piece.pose.actInv(pose) for p, pose in enumerate(poses)}
    if tilt(rested.world_from_furniture.rotation) > LARGEST_LEAN:
        return None, "the piece tips over once it is let go", world.states
    after = tuple(settling[-1] * path[-1] * moving[p] for p in range(len(poses)))
    return UprightMotion(moving, path, settling, after, PLANNER), "", world.states


def _lift_turn_lower(world: CollisionWorld, start: SE3, goal: SE3) -> tuple[SE3, ...]:
    """Return a path straight up, a turn about the centre of mass, and straight down.

    Only the ground is there, so the path is free if both ends are: the turn happens high enough.
    """
    travel = max(2, int(np.ceil(np.rad2deg(rotation_angle(start.rotation.T @ goal.rotation)))))
    turning = interpolate(start, goal, np.linspace(0.0, 1.0, travel + 1)).T
    lowest = min(
        world.lowest_point(from_quaternion((0.0, 0.0, 0.0), (qw, qx, qy, qz))) for *_, qx, qy, qz, qw in turning
    )
    height = max(start.translation[2], goal.translation[2], _CLEARANCE - lowest)
    above = [SE3(p.rotation, np.array([*p.translation[:2], height])) for p in (start, goal)]
    return (start, *above, goal)
