"""An assembly by two robots as a record: where all was, and every leg. `plan.json` is this, and the viewer reads it."""

from __future__ import annotations

from dataclasses import dataclass

from roboassembly.furniture.model import Furniture
from roboassembly.task.full.cell import Cell, Stand
from roboassembly.task.full.cell_state import Leg, Moment
from roboassembly.task.plans.plan import UprightResult
from roboassembly.task.rules.groups import TaskState


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
class FullUprightMotion:
    """A robot takes the finished piece from its post, sets it on the floor and leaves."""

    legs: tuple[Leg, ...]
    """At least one."""


@dataclass(frozen=True, eq=False)
class FullPlan:
    """A whole assembly by two robots."""

    furniture: Furniture
    initial: FullState
    steps: tuple[FullStep, ...]
    success: bool
    seed: int
    upright: UprightResult[FullUprightMotion] | None = None
    """How the piece ends; None if it is not assembled, or as long as `upright.set_upright` was not asked."""

    @property
    def final_legs(self) -> tuple[Leg, ...]:
        """Those of the motion that sets the piece on its feet; empty if there is none."""
        return self.upright.motion.legs if self.upright is not None and self.upright.motion is not None else ()

    @property
    def final_moment(self) -> Moment:
        """Where all is at the end."""
        legs = self.final_legs or (self.steps[-1].legs if self.steps else ())
        return legs[-1].after if legs else self.initial.moment

    @property
    def stands(self) -> tuple[Stand, ...]:
        """All posts that are ever up, each once."""
        legs = [*(leg for step in self.steps for leg in step.legs), *self.final_legs]
        moments = [self.initial.moment, *(m for leg in legs for m in (leg.moment, leg.after))]
        return tuple({id(stand): stand for moment in moments for stand in moment.stands}.values())
