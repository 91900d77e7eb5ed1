"""Interfaces that the object-centric and the full task share."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal, Protocol, Self, TypeVar

import numpy as np
from jaxtyping import Bool

from roboassembly.furniture.model import Furniture
from roboassembly.task.rules.connections import Rules
from roboassembly.task.rules.groups import TaskState

if TYPE_CHECKING:
    # Records of plans name their setting, and audits read records: they load nothing of the planner.
    from roboassembly.planning.problem import Budget
    from roboassembly.task.full.failure import Failure
    from roboassembly.task.part_frames import PartFrames

SettingName = Literal["object-centric", "full"]
State = TypeVar("State")
State_co = TypeVar("State_co", covariant=True)
Step_co = TypeVar("Step_co", covariant=True)


class Outcome(Protocol[State_co, Step_co]):
    """Result of a step."""

    @property
    def state(self) -> State_co:
        """State after the step; the state before it unless merged."""
        ...

    @property
    def step(self) -> Step_co | None:
        """Record of the step; None unless merged."""
        ...

    @property
    def verdict(self) -> str:
        """Verdict on the step."""
        ...

    @property
    def failure(self) -> Failure | None:
        """Failure of a step with robots; None if it merged, or without robots."""
        ...

    @property
    def planning_steps(self) -> int:
        """Configurations tested for collision."""
        ...

    @property
    def planning_seconds(self) -> float:
        """Wall time [s]."""
        ...


class Task(Protocol[State, Step_co]):
    """Task of one setting for one piece of furniture."""

    setting: ClassVar[SettingName]

    @property
    def furniture(self) -> Furniture:
        """The furniture that is assembled."""
        ...

    @property
    def rules(self) -> Rules:
        """Rules about pairs."""
        ...

    @property
    def action_branches(self) -> tuple[int, ...]:
        """Number of values of each component of an action after its pair: of `w`, or of `g_a` and `g_b`."""
        ...

    def with_frames(self, frames: PartFrames) -> Self:
        """Return the same task with parts described in other frames; they say what `w` names."""
        ...

    def check_furniture(self) -> None:
        """Check that the furniture suits the setting; raises `InputError` if it does not."""
        ...

    def initial_state(self, rng: np.random.Generator) -> State:
        """Return a state in which an episode begins."""
        ...

    def groups_of(self, state: State) -> TaskState:
        """Return the groups of a state."""
        ...

    def existing_actions(
        self, groups: TaskState, max_parts: int = 0, max_points: int = 0
    ) -> Bool[np.ndarray, "P P K K ..."]:
        """Return the mask of actions that exist with some groups, padded to `max_parts` and `max_points` or to more."""
        ...

    def step(
        self, state: State, action: tuple[int, ...], seed: int, budget: Budget | None = None
    ) -> Outcome[State, Step_co]:
        """Carry out an action."""
        ...
