"""RRT-Connect baseline of the paper ("6M RRT-Connect"): plans the motion of all M parts at once, in 6·M dimensions.

It knows the parts' final poses and has no order of merges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Body, Scene, Shape
from roboassembly.planning.joint import JointWorld, joint_rrt_connect
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.task.layout import GROUND_CLEARANCE, scatter_parts

BUDGET = Budget(states=100_000)
"""Budget of the paper."""


@dataclass(frozen=True, eq=False)
class JointResult:
    """Result of the RRT-Connect baseline."""

    status: PlanningStatus
    planning_steps: int
    """Configurations of all parts tested for collision."""
    planning_seconds: float
    path: tuple[tuple[SE3, ...], ...]
    """World poses of all parts at each way-point; empty unless solved."""


def solve_jointly(furniture: Furniture, seed: int, budget: Budget = BUDGET) -> JointResult:
    """RRT-Connect in 6·M dimensions, from the same random start as `search.solve` to the standing furniture."""
    initial = scatter_parts(furniture, np.random.default_rng(seed)).part_poses
    middle = np.mean([p.translation[:2] for p in initial], axis=0)
    stand = SE3(np.eye(3), np.array([*middle, GROUND_CLEARANCE - furniture.lowest]))
    goal = [stand * slot for slot in furniture.assembled]
    bodies = tuple(
        Body(part.name, (Shape(part.mesh, SE3.Identity()),), pose, moves=True)
        for part, pose in zip(furniture.parts, initial, strict=True)
    )
    world = JointWorld(Scene(bodies))
    places = np.array([p.translation for p in (*initial, *goal)])
    size = max(part.mesh.radius for part in furniture.parts)
    bounds = np.array([places.min(axis=0) - size, places.max(axis=0) + size])
    bounds[0, 2] = 0.0
    status, path, seconds = joint_rrt_connect(world, initial, goal, bounds, budget, seed)
    return JointResult(status, world.states, seconds, path)
