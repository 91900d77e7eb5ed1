"""Record of an assembly by two robots: states and motion segments. `plan.json` stores it, the viewer shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from roboassembly.furniture.model import Furniture
from roboassembly.task.full.cell import Cell, Post
from roboassembly.task.full.cell_state import CellState, Segment
from roboassembly.task.plans.plan import UprightResult
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName


@dataclass(frozen=True, eq=False)
class FullState:
    """Where all is between two steps."""

    groups: TaskState
    cell_state: CellState
    """Its `standing` are the groups, in their order."""
    cell: Cell


@dataclass(frozen=True, eq=False)
class FullStep:
    """The record of one merge."""

    action: tuple[int, ...]
    """`(u, v, k, l, g_a, g_b)`."""
    segments: tuple[Segment, ...]
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float


@dataclass(frozen=True, eq=False)
class FullUprightMotion:
    """A robot takes the finished piece from its post, sets it on the floor and leaves."""

    segments: tuple[Segment, ...]
    """At least one."""


@dataclass(frozen=True, eq=False)
class FullPlan:
    """A whole assembly by two robots."""

    setting: ClassVar[SettingName] = "full"

    furniture: Furniture
    initial: FullState
    steps: tuple[FullStep, ...]
    success: bool
    seed: int
    upright: UprightResult[FullUprightMotion] | None = None
    """How the piece ends; None if it is not assembled, or as long as `upright.set_upright` was not asked."""

    @property
    def final_segments(self) -> tuple[Segment, ...]:
        """Those of the motion that sets the piece on its feet; empty if there is none."""
        return self.upright.motion.segments if self.upright is not None and self.upright.motion is not None else ()

    @property
    def final_cell_state(self) -> CellState:
        """Where all is at the end."""
        segments = self.final_segments or (self.steps[-1].segments if self.steps else ())
        return segments[-1].after if segments else self.initial.cell_state

    @property
    def posts(self) -> tuple[Post, ...]:
        """All posts that are ever up, each once."""
        segments = [*(segment for step in self.steps for segment in step.segments), *self.final_segments]
        states = [self.initial.cell_state, *(m for segment in segments for m in (segment.before, segment.after))]
        return tuple({id(stand): stand for state in states for stand in state.posts}.values())
