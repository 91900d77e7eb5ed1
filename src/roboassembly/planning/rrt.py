"""RRT-Connect in SE(3) through OMPL; every edge goes to the collision world as one batch.

Kuffner and LaValle 2000, "RRT-Connect: An Efficient Approach to Single-Query Path Planning".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from ompl import base, geometric, util

from roboassembly.planning.problem import Budget
from roboassembly.planning.world import CollisionWorld
from roboassembly.poses import SE3

util.setLogLevel(util.LogLevel.LOG_NONE)

RANGE = 0.25
"""Longest extension of a tree, in OMPL's SE(3) metric (metres plus radians)."""


class _EdgeValidator(base.MotionValidator):
    def __init__(self, information: base.SpaceInformation, world: CollisionWorld) -> None:
        super().__init__(information)
        self._world = world
        self.exhausted: Callable[[], bool] = lambda: False

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802 (OMPL's name)
        if self.exhausted():
            return False
        return self._world.edge_is_free(_pose(first), _pose(second))


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
        bounds: lowest and highest position of the body's origin, metres.
        budget: what this search may spend.
        seed: the same seed gives the same path.
    """
    util.RNG.setSeed(int(seed) % (2**31 - 1) + 1)
    space = base.SE3StateSpace()
    box = base.RealVectorBounds(3)
    everywhere = [start.translation, *(g.translation for g in goals)]
    low = np.minimum(bounds[0], np.min(everywhere, axis=0))
    high = np.maximum(bounds[1], np.max(everywhere, axis=0))
    for axis in range(3):
        box.setLow(axis, float(low[axis]))
        box.setHigh(axis, float(high[axis]))
    space.setBounds(box)
    information = base.SpaceInformation(space)
    validator = _EdgeValidator(information, world)
    information.setMotionValidator(validator)
    information.setStateValidityChecker(lambda state: world.is_free(_pose(state)))
    information.setup()

    definition = base.ProblemDefinition(information)
    first = _state(space, start)
    targets = [_state(space, g) for g in goals]
    definition.addStartState(first)
    goal = base.GoalStates(information)
    for target in targets:
        goal.addState(target)
    definition.setGoal(goal)
    planner = geometric.RRTConnect(information)
    planner.setRange(RANGE)
    planner.setProblemDefinition(definition)
    planner.setup()

    limit = world.states + budget.states
    deadline = None if budget.seconds is None else time.perf_counter() + budget.seconds
    validator.exhausted = lambda: world.states >= limit or (deadline is not None and time.perf_counter() > deadline)
    planner.solve(base.PlannerTerminationCondition(validator.exhausted))
    if not definition.hasExactSolution():
        return None
    path: Any = definition.getSolutionPath()
    return tuple(_pose(path.getState(i)) for i in range(path.getStateCount()))


def shortcut(world: CollisionWorld, path: Sequence[SE3], seed: int, attempts: int = 40) -> tuple[SE3, ...]:
    """Leave out way-points between which the straight edge is free (random pairs, then neighbours)."""
    rng = np.random.default_rng(seed)
    poses = list(path)
    for _ in range(attempts):
        if len(poses) < 3:
            break
        i, j = sorted(rng.choice(len(poses), size=2, replace=False).tolist())
        if j - i > 1 and world.edge_is_free(poses[i], poses[j]):
            del poses[i + 1 : j]
    return tuple(poses)


def _state(space: base.SE3StateSpace, pose: SE3) -> Any:
    # OMPL's stubs know only the base class of states and paths; hence Any here and below.
    state: Any = space.allocState()
    state.setXYZ(*map(float, pose.translation))
    quaternion = pin.Quaternion(pose.rotation)
    # OMPL waits for ever for a goal whose quaternion is off unit length by more than 1e-9.
    quaternion.normalize()
    rotation = state.rotation()
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return state


def _pose(state: Any) -> SE3:
    q = state.rotation()
    return SE3(
        pin.Quaternion(q.w, q.x, q.y, q.z).toRotationMatrix(), np.array([state.getX(), state.getY(), state.getZ()])
    )
