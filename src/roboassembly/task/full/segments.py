"""What a full step's planning has come to: the moment, the segments so far, and what all segments need.

Each is planned on exact geometry: the robot with what it holds, all else as obstacles. Way-points of the hand that
have to be straight (approach, lift, mate, back off) are lines in space; in between RRT-Connect finds the way.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from itertools import product

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import Floor, Path, connect, line, path_is_free, turned_on
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.reach import reach
from roboassembly.task.full.cell import Cell
from roboassembly.task.full.cell_state import CellState, Configuration, Segment

TUCKED = np.array([0.0, -1.2, 0.0, -2.6, 0.0, 2.0, 0.785])
"""The arm folded over the platform, to drive."""
PLACE, ARM = slice(2), slice(3, None)
"""Joints of a configuration."""
GUESSES = 64
"""Arm configurations looked for at a pose of the hand."""
LIFT = 0.06
"""Metres that a group rises straight from its post before anything else, and sinks onto it."""
_BACK = (0.10, 0.05)
"""Metres that an open hand comes and goes straight; less, but so that the fingers are out, where the wrist would meet
the other robot's hand."""
TRIES = 12
"""Ways to stand at a pose to which the planner looks for a path."""
_PARKINGS = 12
"""Places to drive to afterwards that are tried."""


class Obstacle(StrEnum):
    """Why a segment cannot be."""

    NO_ARM_SOLUTION = "no_arm_solution"
    """No way to stand that has the hand where it must be without a collision."""
    NO_PATH = "no_path"
    NO_PLACEMENT = "no_placement"
    """No post can hold the merged group, or there is no room for it."""


class LegError(Exception):
    """A segment cannot be planned.

    Args:
        why: it cannot.
        segment: its name.
        final: whether other segments before it would not help.
    """

    def __init__(self, why: Obstacle, segment: str, *, final: bool = False) -> None:
        super().__init__(f"{segment}: {why}")
        self.why, self.segment, self.final = why, segment, final


class SegmentPlanner:
    """Segments of one step, planned one after the other and kept.

    Args:
        furniture: what is assembled.
        cell: where.
        state: at the beginning.
        budget: of each path.
        rng: draws.
    """

    def __init__(
        self, furniture: Furniture, cell: Cell, state: CellState, budget: Budget, rng: np.random.Generator
    ) -> None:
        self.furniture, self.cell, self.state, self.budget, self.rng = furniture, cell, state, budget, rng
        self.segments: list[Segment] = []
        self._tallies: list[Tally] = []

    @property
    def states(self) -> int:
        """Configurations tested for collision so far."""
        return sum(tally.states for tally in self._tallies)

    @property
    def reached(self) -> tuple[CellState, tuple[Segment, ...]]:
        """How far it is, to come `back_to`."""
        return self.state, tuple(self.segments)

    def back_to(self, reached: tuple[CellState, tuple[Segment, ...]]) -> None:
        """Take back the segments planned since then."""
        self.state, self.segments = reached[0], list(reached[1])

    def world(self, state: CellState, robot: int) -> RobotWorld:
        """One robot among all else."""
        made = state.world(self.furniture, robot)
        self._tallies.append(made.tally)
        return made

    def go(self, world: RobotWorld, start: Configuration, goal: Configuration) -> Path | None:
        """A way through a world; None if none was found within the budget."""
        seed = int(self.rng.integers(2**31 - 1))
        return connect(world, start, goal, Floor(self.cell.floor), self.budget, seed)

    def add(self, name: str, robot: int, path: Path) -> None:
        """Keep a segment that begins at the moment, and go on to its end."""
        path = turned_on(path, self.state.robots[robot].at)
        segment = Segment(name, robot, path, self.state)
        self.segments.append(segment)
        self.state = segment.after

    def ways_to_stand(
        self, world: RobotWorld, tips: SE3, near: Configuration, joints: slice, segment: str, draws: int = 1
    ) -> Iterator[Configuration]:
        """Free configurations with the finger tips there, of each draw of `GUESSES` those nearest to one first.

        Args:
            world: to be free in.
            tips: where they are to be.
            near: configuration.
            joints: that count for what is near.
            segment: for the error.
            draws: of configurations.

        Raises:
            LegError: there is none.
        """
        none = True
        for _ in range(draws):
            found = reach(tips, GUESSES, self.rng).configurations
            free = found[world.free(found)] if len(found) else found
            none = none and not len(free)
            yield from free[np.argsort(np.linalg.norm((free - near)[:, joints], axis=1))]
        if none:
            raise LegError(Obstacle.NO_ARM_SOLUTION, segment)

    def back(self, world: RobotWorld, at: Configuration) -> Path | None:
        """Straight back out of a grasp, driving or from where the platform stands."""
        approach = world_from_tips(at).rotation[:, 2]
        for length, drive in product(_BACK, (True, False)):
            back = line(at, -length * approach, drive=drive)
            if back is not None and path_is_free(world, back):
                return back
        return None

    def park(self, robot: int, world: RobotWorld, name: str) -> None:
        """Fold the arm and drive to a free place near the middle.

        Raises:
            LegError: there is no way.
        """
        for _ in range(_PARKINGS):
            spot = 0.7 * self.cell.radius * self.rng.uniform(-1.0, 1.0, 2)
            goal = np.array([*spot, self.rng.uniform(-np.pi, np.pi), *TUCKED])
            if not world.free(goal[None])[0]:
                continue
            path = self.go(world, self.state.robots[robot].at, goal)
            if path is not None:
                self.add(name, robot, path)
                return
        raise LegError(Obstacle.NO_PATH, name)
