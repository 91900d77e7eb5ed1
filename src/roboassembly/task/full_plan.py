"""An assembly by two robots as a record: where all was, and every leg. `plan.json` is this, and the viewer reads it."""

from __future__ import annotations

from dataclasses import dataclass

from roboassembly.furniture.model import Furniture
from roboassembly.task.cell import Cell, Stand
from roboassembly.task.groups import TaskState
from roboassembly.task.moments import Leg, Moment


@dataclass(frozen=True, eq=False)
class FullState:
    """Where all is between two steps."""

    groups: TaskState
    moment: Moment
    """Its `standing` are the groups, in their order."""
    cell: Cell


@dataclass(frozen=True, eq=False)
class FullStep:
    """The record of one merge."""

    action: tuple[int, ...]
    """`(u, v, k, l, g_a, g_b)`."""
    legs: tuple[Leg, ...]
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float


@dataclass(frozen=True, eq=False)
class FullPlan:
    """A whole assembly by two robots."""

    furniture: Furniture
    initial: FullState
    steps: tuple[FullStep, ...]
    success: bool
    seed: int

    @property
    def stands(self) -> tuple[Stand, ...]:
        """All posts that are ever up, each once."""
        moments = [
            self.initial.moment,
            *(m for step in self.steps for leg in step.legs for m in (leg.moment, leg.after)),
        ]
        return tuple({id(stand): stand for moment in moments for stand in moment.stands}.values())
