"""Shared planning functions of a full step.

A stage of a step is a function from a `CellState` and a seed to a `Planned` or a `Failure`. It changes nothing, so
that stages can be tested, timed and tried in parallel. Collisions are tested on exact geometry: the robot with its
payload moves, all else is an obstacle. Straight motions of the hand (approach, lift, mate, release) are lines in
space; RRT-Connect connects them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import Configuration, Floor, Path, connect, line, turned_on
from roboassembly.planning.robot_shapes import Configurations, WorldCache
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.body import DOF, world_from_tips
from roboassembly.robots.gripper import RETREAT, SHORT_RETREAT
from roboassembly.robots.reach import reach
from roboassembly.task.full.cell import Cell
from roboassembly.task.full.cell_state import CellState, Segment
from roboassembly.task.full.failure import Failure, Stage
from roboassembly.task.full.grips import ASTRAY

TUCKED = np.array([0.0, -1.2, 0.0, -2.6, 0.0, 2.0, 0.785])
"""Joint angles of the arm folded over the platform [rad]."""
PLATFORM, ARM = slice(2), slice(3, None)
"""Entries of a configuration: position of the platform; joints of the arm."""
GUESSES = 64
"""Configurations drawn for a pose of the hand."""
LIFT_HEIGHT = 0.06
"""Distance [m] that a group moves straight up from its post, and straight down onto it."""
_PARKING_SPOTS = 16
"""Number of places to drive to that are considered."""


@dataclass(frozen=True, eq=False)
class StepContext:
    """Constants of a step."""

    furniture: Furniture
    cell: Cell
    budget: Budget
    """Limit of each path."""
    worlds: WorldCache
    """Shapes of earlier worlds."""

    def world(self, state: CellState, robot: int, tally: Tally) -> RobotWorld:
        """Return the collision model of one robot among all else.

        Args:
            state: where all is.
            robot: 0 or 1.
            tally: counts the tested configurations.
        """
        return state.world(self.furniture, robot, tally=tally, cache=self.worlds)

    def connect(
        self, world: RobotWorld, start: Configuration, goals: Configurations, seed: np.random.SeedSequence
    ) -> Path | None:
        """Return a free path to one of some goals; None if none was found within the budget."""
        return connect(world, start, goals, Floor(self.cell.floor), self.budget, int(seed.generate_state(1)[0] >> 1))


@dataclass(frozen=True, eq=False)
class Planned:
    """Segments from one state of the cell to another. Immutable."""

    state: CellState
    """State after the last segment."""
    segments: tuple[Segment, ...] = ()
    states: int = 0
    """Configurations tested for collision."""

    def move(self, stage: Stage, robot: int, path: Path) -> Planned:
        """Return this and one more segment."""
        segment = Segment(stage, robot, turned_on(path, self.state.robots[robot].at), self.state)
        return replace(self, state=segment.after, segments=(*self.segments, segment))

    def change(self, state: CellState) -> Planned:
        """Return this with another state at the end: a hand has opened or closed, a post has risen or sunk."""
        return replace(self, state=state)

    def then(self, later: Planned | Failure) -> Planned | Failure:
        """Return this and what was planned from its end on; or the failure, with the states tested until then."""
        states = self.states + later.states
        if isinstance(later, Failure):
            return replace(later, states=states)
        return Planned(later.state, (*self.segments, *later.segments), states)


def child_seed(seed: np.random.SeedSequence, *key: int) -> np.random.SeedSequence:
    """Return the seed of a part of a computation. It depends on nothing but `seed` and `key`."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *key))


def arm_configurations(
    world: RobotWorld,
    tips: SE3,
    near: Configuration,
    entries: slice,
    seed: np.random.SeedSequence,
    draws: int = 1,
) -> Iterator[Configuration]:
    """Yield free configurations with the finger tips at a pose; of each draw of `GUESSES` the nearest first.

    Args:
        world: collision model.
        tips: `world_from_tips`.
        near: configuration that others should be near.
        entries: entries of configurations that the distance counts.
        seed: of the draws.
        draws: number of draws.
    """
    for draw in range(draws):
        found = reach(tips, GUESSES, np.random.default_rng(child_seed(seed, draw)))
        yield from world.each_free(found[np.argsort(np.linalg.norm((found - near)[:, entries], axis=1))])


def retreat_path(world: RobotWorld, at: Configuration) -> Path | None:
    """Return the straight path of an open hand out of a grasp; None if there is none.

    The platform drives along if it can, else it stands still.
    """
    approach = world_from_tips(at).rotation[:, 2]
    for distance in (RETREAT, SHORT_RETREAT):
        for drive in (True, False):
            path = line(at, -distance * approach, drive=drive)
            # Most paths that are blocked are so at a way-point.
            if (
                path is not None
                and world.free(np.array(path[1:]), clearance=ASTRAY).all()
                and world.path_is_free(path, clearance=ASTRAY)
            ):
                return path
    return None


def parking_path(
    context: StepContext, world: RobotWorld, start: Configuration, seed: np.random.SeedSequence
) -> Path | None:
    """Return a path that folds the arm and drives to a free place near the middle; None if none was found."""
    rng = np.random.default_rng(child_seed(seed, 0))
    spots = np.empty((_PARKING_SPOTS, DOF))
    spots[:, :2] = 0.7 * context.cell.radius * rng.uniform(-1.0, 1.0, (_PARKING_SPOTS, 2))
    spots[:, 2] = rng.uniform(-np.pi, np.pi, _PARKING_SPOTS)
    spots[:, 3:] = TUCKED
    return context.connect(world, start, spots, child_seed(seed, 1))
