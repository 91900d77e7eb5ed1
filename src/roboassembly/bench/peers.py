"""Common part of the peers: OMPL's RRT-Connect, which tests one state at a time through a Python callback.

This is the usual way to use OMPL with a collision checker whose Python bindings have no batches. OMPL's
`DiscreteMotionValidator` divides edges into states at most `RESOLUTION` (of the body's origin) and
`ANGULAR_RESOLUTION` apart. This is coarser than ours, where 2 mm is the limit for the body's fastest point, so the
difference favours the peers. Their paths are not shortened.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from ompl import base, geometric, util

from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Scene
from roboassembly.planning.rrt import RANGE
from roboassembly.planning.world import ANGULAR_RESOLUTION, RESOLUTION

util.setLogLevel(util.LogLevel.LOG_NONE)

SE3State = Any
"""OMPL state of SE(3); its Python type has no typed coordinates."""
IsFree = Callable[[SE3State], bool]
"""Function that returns whether the moving body is free of collision at an OMPL state of SE(3)."""


class Peer(Protocol):
    """Collision library behind the callback. It caches meshes."""

    name: str
    description: str
    """Sentence on the representation of the bodies and its approximations."""

    def set_up(self, scene: Scene) -> IsFree:
        """Replace the scene."""
        ...

    def close(self) -> None:
        """Free what the library holds."""
        ...


@dataclass(frozen=True)
class Run:
    """One planner on one merge."""

    solved: bool
    states: int
    """Number of configurations tested for collision."""
    seconds: float
    """Wall time, including building the scene and, on a failure, the time spent [s]."""
    capped: bool = False
    """Whether the limit of wall time stopped it."""


def plan_with_peer(
    peer: Peer,
    scene: Scene,
    ends: tuple[SE3, SE3],
    bounds: Float[np.ndarray, "2 3"],
    states: int,
    cap_seconds: float,
    seed: int,
) -> Run:
    """Build the scene with `peer` and plan from the first of `ends` to the second, `world_from_body` each.

    Args:
        peer: collision library that tests single states.
        scene: moving and still bodies.
        ends: start and goal.
        bounds: lowest and highest position of the body's origin [m].
        states: largest number of tested configurations.
        cap_seconds: limit of wall time [s].
        seed: seed of OMPL.
    """
    begun = time.perf_counter()
    deadline = begun + cap_seconds
    is_free = peer.set_up(scene)
    tested = 0

    def counted(state: SE3State) -> bool:
        nonlocal tested
        if tested >= states:
            return False
        tested += 1
        return is_free(state)

    util.RNG.setSeed(int(seed) % (2**31 - 1) + 1)
    space = state_space(bounds, ends)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(counted)
    information.setup()
    definition = base.ProblemDefinition(information)
    start, goal = (ompl_state(space, pose) for pose in ends)
    definition.setStartAndGoalStates(start, goal)
    planner = geometric.RRTConnect(information)
    planner.setRange(RANGE)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: tested >= states or time.perf_counter() >= deadline))
    solved = bool(definition.hasExactSolution())
    ended = time.perf_counter()
    return Run(solved, tested, ended - begun, capped=not solved and tested < states and ended >= deadline)


def state_space(bounds: Float[np.ndarray, "2 3"], ends: tuple[SE3, SE3]) -> base.SE3StateSpace:
    """Return SE(3) within the bounds, with edges tested at our resolution."""
    space = base.SE3StateSpace()
    box = base.RealVectorBounds(3)
    points = [pose.translation for pose in ends]
    low, high = np.minimum(bounds[0], np.min(points, axis=0)), np.maximum(bounds[1], np.max(points, axis=0))
    for axis in range(3):
        box.setLow(axis, float(low[axis]))
        box.setHigh(axis, float(high[axis]))
    space.setBounds(box)
    # Set for either component by itself: one fraction for both would turn by a tenth of a degree a state.
    subspaces: tuple[Any, Any] = (space.getSubspace(0), space.getSubspace(1))
    place, turn = subspaces
    place.setLongestValidSegmentFraction(RESOLUTION / place.getMaximumExtent())
    # OMPL's distance between rotations is half their angle.
    turn.setLongestValidSegmentFraction(0.5 * float(ANGULAR_RESOLUTION) / turn.getMaximumExtent())
    return space


def ompl_state(space: base.SE3StateSpace, pose: SE3) -> SE3State:
    """Return a pose as a state of the space."""
    return configuration_state(space, pin.SE3ToXYZQUAT(pose))


def configuration_state(space: base.SE3StateSpace, configuration: Float[np.ndarray, "7"]) -> SE3State:
    """Return `(x, y, z, qx, qy, qz, qw)` as a state of the space."""
    state: SE3State = space.allocState()
    state.setXYZ(*map(float, configuration[:3]))
    quaternion = configuration[3:] / np.linalg.norm(configuration[3:])
    rotation = state.rotation()
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, quaternion)
    return state
