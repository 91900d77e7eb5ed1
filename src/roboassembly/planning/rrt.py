"""RRT-Connect in SE(3) through OMPL; every edge goes to the collision world as one batch.

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
"""Longest extension of a tree, in OMPL's SE(3) metric (metres plus radians)."""


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
    """OMPL's RRT-Connect on states of any space; None if it was `exhausted` first.

    Args:
        longest: extension of a tree in the space's metric; OMPL's own choice if None.
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
    copies = []
    for index in range(path.getStateCount()):
        copy = space.allocState()
        space.copyState(copy, path.getState(index))
        copies.append(copy)
    return copies


def box_around(bounds: Float[np.ndarray, "2 n"], points: Sequence[Float[np.ndarray, "n"]]) -> base.RealVectorBounds:
    """OMPL's bounds: lowest and highest values, widened so that some points lie within."""
    box = base.RealVectorBounds(bounds.shape[1])
    for axis, values in enumerate(np.vstack([bounds, *points]).T.tolist()):
        box.setLow(axis, min(values))
        box.setHigh(axis, max(values))
    return box


def exhaustion(states: Callable[[], int], budget: Budget, begun: float) -> Exhausted:
    """Tells when the budget is spent: states from the counter's value now, seconds from `begun`."""
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
    """Way-points from `start` to one of `goals`, all of which are known to be free; None if the budget ran out.

    Args:
        world: counts the states; the budget in states is spent from its counter onward.
        start: where the body is.
        goals: where it may end.
        bounds: lowest and highest position of the body's origin, metres.
        budget: what this search may spend.
        seed: the same seed gives the same path.
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
    """Return a path without the way-points that a free straight edge makes needless.

    Args:
        path: way-points.
        edge_is_free: whether the straight edge between two way-points is free.
        seed: of the pairs that are tried.
        attempts: number of pairs that are tried.
    """
    rng = np.random.default_rng(seed)
    kept = list(path)
    for _ in range(attempts):
        if len(kept) < 3:
            break
        i, j = sorted(rng.choice(len(kept), size=2, replace=False).tolist())
        if j - i > 1 and edge_is_free(kept[i], kept[j]):
            del kept[i + 1 : j]
    return tuple(kept)


def set_pose(state: Any, pose: SE3) -> None:
    """Write a pose into an OMPL SE(3) state. (OMPL's stubs know only the base class of states; hence Any.)"""
    state.setXYZ(*map(float, pose.translation))
    quaternion = pin.Quaternion(pose.rotation)
    # OMPL waits for ever for a goal whose quaternion is off unit length by more than 1e-9.
    quaternion.normalize()
    rotation = state.rotation()
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion.x, quaternion.y, quaternion.z, quaternion.w


def pose_of(state: Any) -> SE3:
    """The pose of an OMPL SE(3) state."""
    q = state.rotation()
    position = np.array([state.getX(), state.getY(), state.getZ()])
    return SE3(pin.Quaternion(q.w, q.x, q.y, q.z).toRotationMatrix(), position)
