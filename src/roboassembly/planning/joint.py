"""Joint planning of all bodies: RRT-Connect in the 6·M-dimensional space of M free bodies, the paper's baseline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from ompl import base

from roboassembly.geometry.poses import SE3, interpolate, poses_to_configurations, rotation_angle
from roboassembly.geometry.scene import Scene, Shape
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.planning.rrt import box_around, exhaustion, pose_of, run_rrt_connect, set_pose
from roboassembly.planning.world import ANGULAR_RESOLUTION, RESOLUTION, ExactChecks


class JointWorld(ExactChecks):
    """Exact collision checks of a scene in which bodies move independently."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._radii = [max(map(_radius, body.shapes)) for body in scene.bodies if body.moves]

    def is_free(self, poses: Sequence[SE3]) -> bool:
        """Return whether one configuration is free, by an exact test."""
        return self.first_collision(poses_to_configurations(poses).reshape(-1, 1, order="F")) is None

    def edge_is_free(self, start: Sequence[SE3], end: Sequence[SE3]) -> bool:
        """Return whether all states of an edge are free; between successive ones no point moves more than 2 mm."""
        steps = 1
        for a, b, radius in zip(start, end, self._radii, strict=True):
            angle = rotation_angle(a.rotation.T @ b.rotation)
            travel = float(np.linalg.norm(b.translation - a.translation)) + angle * radius
            steps = max(steps, int(np.ceil(max(travel / RESOLUTION, angle / ANGULAR_RESOLUTION))))
        # Slices limit the cost of an edge that collides early.
        for first in range(1, steps + 1, 64):
            fractions = np.arange(first, min(first + 64, steps + 1)) / steps
            columns = np.concatenate([interpolate(a, b, fractions) for a, b in zip(start, end, strict=True)])
            if self.first_collision(columns) is not None:
                return False
        return True


def _radius(shape: Shape) -> float:
    """Return the distance of a shape's farthest vertex from the origin of its body's frame [m]."""
    vertices: list[np.ndarray] = list(shape.mesh.hull_vertices)
    return max(float(np.linalg.norm(shape.body_from_mesh.act(v))) for v in vertices)


def joint_rrt_connect(
    world: JointWorld,
    start: Sequence[SE3],
    goal: Sequence[SE3],
    bounds: Float[np.ndarray, "2 3"],
    budget: Budget,
    seed: int,
) -> tuple[PlanningStatus, tuple[tuple[SE3, ...], ...], float]:
    """Plan motions of all bodies from `start` to `goal` at once.

    Args:
        world: collision checks, which also count states.
        start: initial poses.
        goal: final poses.
        bounds: lowest and highest position of every body's origin [m].
        budget: limits of the search.
        seed: seed of the search.

    Returns:
        Status, way-points (poses of all bodies each), and duration [s].
    """
    begun = time.perf_counter()
    if not world.is_free(goal):
        return PlanningStatus.GOAL_IN_COLLISION, (), time.perf_counter() - begun
    if not world.is_free(start):
        return PlanningStatus.START_IN_COLLISION, (), time.perf_counter() - begun
    space = base.CompoundStateSpace()
    parts: list[base.SE3StateSpace] = []
    for a, b in zip(start, goal, strict=True):
        part = base.SE3StateSpace()
        part.setBounds(box_around(bounds, [a.translation, b.translation]))
        space.addSubspace(part, 1.0)
        parts.append(part)

    def read(state: Any) -> list[SE3]:
        return [pose_of(state[i]) for i in range(len(parts))]

    def make(poses: Sequence[SE3]) -> Any:
        state: Any = space.allocState()
        for i, pose in enumerate(poses):
            set_pose(state[i], pose)
        return state

    exhausted = exhaustion(lambda: world.states, budget, begun)
    path = run_rrt_connect(
        space, make(start), [make(goal)], lambda a, b: world.edge_is_free(read(a), read(b)),
        lambda s: world.is_free(read(s)), exhausted, seed, None,
    )  # fmt: skip
    seconds = time.perf_counter() - begun
    if path is None:
        return PlanningStatus.BUDGET_EXHAUSTED, (), seconds
    return PlanningStatus.SOLVED, tuple(tuple(read(s)) for s in path), seconds
