"""The episode loop: someone proposes actions, the task carries them out, until the furniture is complete or none works.

Policies, experts, labelers and baselines differ only in what they propose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Outcome

Action = tuple[int, ...]
"""`(u, v, k, l, w)`, or `(u, v, k, l, g_a, g_b)` in the full setting."""
State = TypeVar("State")
State_contra = TypeVar("State_contra", contravariant=True)
AnOutcome = TypeVar("AnOutcome", bound=Outcome[Any, Any])
AnOutcome_co = TypeVar("AnOutcome_co", bound=Outcome[Any, Any], covariant=True)
Proposer = Callable[[State], Iterable[Action]]
"""Returns the actions to try in a state, in their order. A generator is asked for one action at a time."""


class Stepping(Protocol[State_contra, AnOutcome_co]):
    """The part of a task that an episode needs."""

    def groups_of(self, state: State_contra) -> TaskState:
        """Return the groups of a state."""
        ...

    def step(self, state: State_contra, action: Action, seed: int, budget: Budget | None = None) -> AnOutcome_co:
        """Carry out an action."""
        ...


class Starting(Stepping[State, AnOutcome_co], Protocol[State, AnOutcome_co]):
    """The part of a task that whole episodes need."""

    def initial_state(self, rng: np.random.Generator) -> State:
        """Return the start of an episode."""
        ...


@dataclass(frozen=True, eq=False)
class Transition(Generic[State, AnOutcome]):
    """One action of an episode and its outcome."""

    state: State
    """State in which the action is tried."""
    action: Action
    outcome: AnOutcome

    @property
    def merged(self) -> bool:
        """Whether the action joined two groups."""
        return self.outcome.step is not None


def rollout(
    task: Stepping[State, AnOutcome],
    state: State,
    propose: Proposer[State],
    rng: np.random.Generator,
    budget: Budget | None = None,
) -> Iterator[Transition[State, AnOutcome]]:
    """Run one episode and yield every action that is tried.

    The first proposed action that merges leads to the next state. The episode ends when the furniture is complete, or
    in a state in which no proposed action merges.

    Args:
        task: rules for the furniture.
        state: start of the episode.
        propose: chooses the actions.
        rng: source of the planner's seeds; `propose` may draw from it too.
        budget: limit of each motion plan; the task's own if None.
    """
    while not task.groups_of(state).complete:
        for action in propose(state):
            outcome = task.step(state, action, draw_seed(rng), budget)
            yield Transition(state, action, outcome)
            if outcome.step is not None:
                state = outcome.state
                break
        else:
            return


class RememberedTask(Generic[State, AnOutcome]):
    """A task for episodes that begin alike: what it carried out once, it remembers.

    The outcome of a step follows from its state, action and seed, so episodes are the same as without the memory. An
    episode that repeats the beginning of an earlier one plans only what differs.

    Args:
        task: carries out what is new.
    """

    def __init__(self, task: Starting[State, AnOutcome]) -> None:
        self._task = task
        self._starts: dict[str, tuple[State, Any]] = {}
        """Start and generator's state after it, by the generator's state before."""
        self._outcomes: dict[tuple[int, Action, int], AnOutcome] = {}
        """Outcomes by identity of the state, action and seed."""
        self._states: dict[int, State] = {}
        """States by identity."""

    def initial_state(self, rng: np.random.Generator) -> State:
        """Return the start of an episode, and leave the generator as the task does."""
        before = repr(rng.bit_generator.state)
        if before not in self._starts:
            state = self._task.initial_state(rng)
            self._starts[before] = state, rng.bit_generator.state
        state, rng.bit_generator.state = self._starts[before]
        return state

    def groups_of(self, state: State) -> TaskState:
        """Return the groups of a state."""
        return self._task.groups_of(state)

    def step(self, state: State, action: Action, seed: int, budget: Budget | None = None) -> AnOutcome:
        """Carry out an action, or return its outcome of before; all calls have the same budget."""
        # The states are kept, so no other one gets the identity of one of them.
        self._states.setdefault(id(state), state)
        key = id(state), action, seed
        if key not in self._outcomes:
            self._outcomes[key] = self._task.step(state, action, seed, budget)
        return self._outcomes[key]


def draw_seed(rng: np.random.Generator) -> int:
    """Draw a seed for a planner."""
    return int(rng.integers(2**31 - 1))
