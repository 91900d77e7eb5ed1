"""What the object-centric and the full task have in common, for those who do not care which it is."""

from __future__ import annotations

from typing import ClassVar, Literal, Protocol, TypeVar

import numpy as np
from jaxtyping import Bool

from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.planning.problem import Budget
from roboassembly.task.rules.connections import Rules
from roboassembly.task.rules.groups import TaskState

SettingName = Literal["object-centric", "full"]
State = TypeVar("State")
State_co = TypeVar("State_co", covariant=True)
Step_co = TypeVar("Step_co", covariant=True)


class Outcome(Protocol[State_co, Step_co]):
    """What a step led to."""

    @property
    def state(self) -> State_co:
        """The new one; the old one unless merged."""
        ...

    @property
    def step(self) -> Step_co | None:
        """The record, if merged."""
        ...

    @property
    def verdict(self) -> str:
        """How it ended."""
        ...

    @property
    def planning_steps(self) -> int:
        """Configurations tested for collision."""
        ...

    @property
    def planning_seconds(self) -> float:
        """Wall time."""
        ...


class Task(Protocol[State, Step_co]):
    """The rules of a setting for one piece of furniture."""

    setting: ClassVar[SettingName]

    @property
    def furniture(self) -> Furniture:
        """The furniture that is assembled."""
        ...

    @property
    def rules(self) -> Rules:
        """About pairs."""
        ...

    @property
    def action_branches(self) -> tuple[int, ...]:
        """How many choices an action has after its pair: of `w`, or of `g_a` and `g_b`."""
        ...

    def initial_state(self, rng: np.random.Generator) -> State:
        """How an episode begins."""
        ...

    def groups_of(self, state: State) -> TaskState:
        """The groups of a state."""
        ...

    def existing_actions(
        self, state: State, max_parts: int = MAX_PARTS, max_points: int = MAX_POINTS
    ) -> Bool[np.ndarray, "P P K K ..."]:
        """Return the mask of actions that exist in a state, padded to `max_parts` and `max_points`."""
        ...

    def step(
        self, state: State, action: tuple[int, ...], seed: int, budget: Budget | None = None
    ) -> Outcome[State, Step_co]:
        """Carry out an action."""
        ...
