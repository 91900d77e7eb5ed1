"""What is asked of a planner, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from roboassembly.geometry.poses import SE3


class PlanningStatus(StrEnum):
    """Why a plan ended as it did."""

    SOLVED = "solved"
    START_IN_COLLISION = "start_in_collision"
    GOAL_IN_COLLISION = "goal_in_collision"
    UNREACHABLE = "unreachable"
    """The goal is locked in: none of many small motions away from it is free."""
    BUDGET_EXHAUSTED = "budget_exhausted"


@dataclass(frozen=True)
class Budget:
    """When to give up. A limit in seconds makes results depend on the machine, so there is none by default."""

    states: int = 20_000
    """Configurations tested for collision."""
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class PathResult:
    """The outcome of one planning problem."""

    status: PlanningStatus
    path: tuple[SE3, ...]
    """`world_from_body` way-points from start to goal; empty unless solved. Edges as in `poses.interpolate`."""
    states: int
    """Configurations tested for collision, interpolated ones and failed attempts included."""
    seconds: float
    planner: str
    """`retreat` or `rrt-connect`."""

    @property
    def solved(self) -> bool:
        """Whether there is a path."""
        return self.status is PlanningStatus.SOLVED
