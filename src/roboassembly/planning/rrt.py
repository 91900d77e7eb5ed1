"""RRT-Connect through OMPL; every edge is tested as one batch.

Kuffner and LaValle 2000, "RRT-Connect: An Efficient Approach to Single-Query Path Planning".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from ompl import base, geometric, util

from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.planning.world import CollisionWorld

util.setLogLevel(util.LogLevel.LOG_NONE)

Exhausted = Callable[[], bool]
Waypoint = TypeVar("Waypoint")
RANGE = 0.25
"""Longest extension of a tree in OMPL's SE(3) metric [m + rad]."""


class _EdgeValidator(base.MotionValidator):
    def __init__(self, information: base.SpaceInformation, free: Callable[[Any, Any], bool], exhausted: Exhausted):
        super().__init__(information)
        self._free = free
        self._exhausted = exhausted

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802 (OMPL's name)
        return not self._exhausted() and self._free(first, second)


def run_rrt_connect(
    space: Any,
    start: Any,
    goals: Sequence[Any],
    edge_is_free: Callable[[Any, Any], bool],
    is_free: Callable[[Any], bool],
    exhausted: Exhausted,
    seed: int,
    longest: float | None,
) -> list[Any] | None:
    """Return a path found by OMPL's RRT-Connect in any space; None if the budget was exhausted first.

    Args:
        space: OMPL's state space.
        start: first state.
        goals: possible last states.
        edge_is_free: test of the edge between two states.
        is_free: test of one state.
        exhausted: test whether the budget is exhausted.
        seed: seed of OMPL's random numbers.
        longest: longest extension of a tree in the space's metric; OMPL's default if None.
    """
    util.RNG.setSeed(int(seed) % (2**31 - 1) + 1)
    information = base.SpaceInformation(space)
    # OMPL keeps no reference of its own to Python objects: these locals keep them alive while it runs.
    validator = _EdgeValidator(information, edge_is_free, exhausted)
    information.setMotionValidator(validator)
    information.setStateValidityChecker(is_free)
    information.setup()
    definition = base.ProblemDefinition(information)
    definition.addStartState(start)
    goal = base.GoalStates(information)
    for state in goals:
        goal.addState(state)
    definition.setGoal(goal)
    planner = geometric.RRTConnect(information)
    if longest is not None:
        planner.setRange(longest)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(exhausted))
    if not definition.hasExactSolution():
        return None
    path: Any = definition.getSolutionPath()
    copies: list[Any] = []
    for index in range(path.getStateCount()):
        copy = space.allocState()
        space.copyState(copy, path.getState(index))
        copies.append(copy)
    return copies


def box_around(bounds: Float[np.ndarray, "2 n"], points: Sequence[Float[np.ndarray, "n"]]) -> base.RealVectorBounds:
    """Return OMPL's bounds: lowest and highest values, widened to include some points."""
    box = base.RealVectorBounds(bounds.shape[1])
    for axis, values in enumerate(np.vstack([bounds, *points]).T.tolist()):
        box.setLow(axis, min(values))
        box.setHigh(axis, max(values))
    return box


def exhaustion(states: Callable[[], int], budget: Budget, begun: float) -> Exhausted:
    """Return a test whether the budget is exhausted, in states from now on and in seconds since `begun`."""
    limit = states() + budget.states
    deadline = None if budget.seconds is None else begun + budget.seconds
    return lambda: states() >= limit or (deadline is not None and time.perf_counter() > deadline)


def rrt_connect(
    world: CollisionWorld,
    start: SE3,
    goals: Sequence[SE3],
    bounds: Float[np.ndarray, "2 3"],
    budget: Budget,
    seed: int,
) -> tuple[SE3, ...] | None:
    """Return way-points from `start` to one of `goals`, which are known to be free; None if the budget is exhausted.

    Args:
        world: collision checks; its counter of states also measures the budget.
        start: initial pose.
        goals: possible final poses.
        bounds: lowest and highest position of the body's origin [m].
        budget: limits of this search.
        seed: seed of the search; equal seeds give equal paths.
    """
    space = base.SE3StateSpace()
    space.setBounds(box_around(bounds, [start.translation, *(g.translation for g in goals)]))

    def state(pose: SE3) -> Any:
        made = space.allocState()
        set_pose(made, pose)
        return made

    path = run_rrt_connect(
        space,
        state(start),
        [state(g) for g in goals],
        lambda a, b: world.edge_is_free(pose_of(a), pose_of(b)),
        lambda s: world.is_free(pose_of(s)),
        exhaustion(lambda: world.states, budget, time.perf_counter()),
        seed,
        RANGE,
    )
    return None if path is None else tuple(pose_of(s) for s in path)


def shortcut(
    path: Sequence[Waypoint], edge_is_free: Callable[[Waypoint, Waypoint], bool], seed: int, attempts: int
) -> tuple[Waypoint, ...]:
    """Return a path without way-points that a free straight edge makes redundant.

    Args:
        path: way-points.
        edge_is_free: whether the straight edge between two way-points is free.
        seed: seed of the choice of pairs.
        attempts: number of pairs of way-points to try.
    """
    rng = np.random.default_rng(seed)
    kept = list(range(len(path)))
    failed: set[tuple[int, int]] = set()
    for _ in range(attempts):
        if len(kept) < 3:
            break
        pair: list[int] = rng.choice(len(kept), size=2, replace=False).tolist()
        i, j = sorted(pair)
        edge = kept[i], kept[j]
        if j - i < 2 or edge in failed:
            continue
        if edge_is_free(path[edge[0]], path[edge[1]]):
            del kept[i + 1 : j]
        else:
            failed.add(edge)
    return tuple(path[k] for k in kept)


def set_pose(state: Any, pose: SE3) -> None:
    """Write a pose into an OMPL SE(3) state; `Any`, as OMPL's stubs know only the base class of states."""
    state.setXYZ(*map(float, pose.translation))
    quaternion = pin.Quaternion(pose.rotation)
    # OMPL waits without end for a goal whose quaternion is off unit length by more than 1e-9.
    quaternion.normalize()
    rotation = state.rotation()
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion.x, quaternion.y, quaternion.z, quaternion.w


def pose_of(state: Any) -> SE3:
    """Return the pose of an OMPL SE(3) state."""
    q = state.rotation()
    position = np.array([state.getX(), state.getY(), state.getZ()])
    return SE3(pin.Quaternion(q.w, q.x, q.y, q.z).toRotationMatrix(), position)
