"""Record of an assembly by two robots: states and motion segments. `plan.json` stores it, the viewer shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from roboassembly.furniture.model import Furniture
from roboassembly.task.full.cell import Cell
from roboassembly.task.full.cell_state import CellState, Segment
from roboassembly.task.full.posts import Post
from roboassembly.task.plans.plan import UprightResult
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName


@dataclass(frozen=True, eq=False)
class FullState:
    """State of the full setting between two steps."""

    groups: TaskState
    cell_state: CellState
    """State of the cell; its `placed` are the groups, in their order."""
    cell: Cell


@dataclass(frozen=True, eq=False)
class FullStep:
    """Record of one merge by two robots."""

    action: tuple[int, ...]
    """`(u, v, k, l, g_a, g_b)`."""
    segments: tuple[Segment, ...]
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float


@dataclass(frozen=True, eq=False)
class FullUprightMotion:
    """Motion of a robot that sets the finished piece from its post on the floor and leaves."""

    segments: tuple[Segment, ...]
    """Motion segments, at least one."""


@dataclass(frozen=True, eq=False)
class FullPlan:
    """Plan of a whole assembly by two robots."""

    setting: ClassVar[SettingName] = "full"

    furniture: Furniture
    initial: FullState
    steps: tuple[FullStep, ...]
    success: bool
    seed: int
    upright: UprightResult[FullUprightMotion] | None = None
    """Whether the piece ends on its feet; None if it is not assembled or `set_upright` was not called."""

    @property
    def final_segments(self) -> tuple[Segment, ...]:
        """Segments of the motion that sets the piece on its feet; empty if there is none."""
        return self.upright.motion.segments if self.upright is not None and self.upright.motion is not None else ()

    @property
    def final_cell_state(self) -> CellState:
        """State of the cell at the end."""
        segments = self.final_segments or (self.steps[-1].segments if self.steps else ())
        return segments[-1].after if segments else self.initial.cell_state

    @property
    def posts(self) -> tuple[Post, ...]:
        """All posts that are raised at any time, each once."""
        segments = [*(segment for step in self.steps for segment in step.segments), *self.final_segments]
        states = [self.initial.cell_state, *(m for segment in segments for m in (segment.before, segment.after))]
        return tuple({id(stand): stand for state in states for stand in state.posts}.values())
