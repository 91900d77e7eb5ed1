"""Budget and result of motion planning."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from roboassembly.geometry.poses import SE3


class PlanningStatus(StrEnum):
    """Outcome of motion planning."""

    SOLVED = "solved"
    START_IN_COLLISION = "start_in_collision"
    GOAL_IN_COLLISION = "goal_in_collision"
    UNREACHABLE = "unreachable"
    """Locked goal: none of many small motions away from it is free."""
    BUDGET_EXHAUSTED = "budget_exhausted"


@dataclass(frozen=True)
class Budget:
    """Limits of a search. A limit in seconds makes results depend on the machine, so the default is none."""

    states: int = 20_000
    """Number of configurations tested for collision."""
    seconds: float | None = None
    """Duration [s]; unlimited if None."""
    stances: int | None = None
    """Number of ways in which two robots may try to mate their groups; as many as the task has if None."""


@dataclass(frozen=True, eq=False)
class PathResult:
    """Result of one planning problem."""

    status: PlanningStatus
    path: tuple[SE3, ...]
    """Way-points `world_from_body` from start to goal, with edges as in `poses.interpolate`; empty unless solved."""
    states: int
    """Number of configurations tested for collision, including interpolated ones and failed attempts."""
    seconds: float
    """Duration of planning [s]."""
    planner: str
    """Name of the method: `retreat` or `rrt-connect`."""

    @property
    def solved(self) -> bool:
        """Whether a path was found."""
        return self.status is PlanningStatus.SOLVED
