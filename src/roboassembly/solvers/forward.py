"""The forward half of the search, in any setting: merges that reasoning or a guide suggests are carried out in turn."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any, Generic, TypeVar

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Partition, Parts, Split, partition_of
from roboassembly.solvers.guide import Guide
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Task

Action = tuple[int, ...]
_GUIDED_STRAYS = 3
"""Times that a guide may lead to where nothing goes on; then reasoning takes over."""
_GUIDED_SHARE = 4
"""A guide gets one part in so many of the limits, so that the rounds after it have enough left."""
_GUIDED_WIDTH = 5
"""Suggestions tried in each state."""
_GUIDED_SCORE = 0.1
"""Suggestions below it are left alone."""


State = TypeVar("State")
AStep = TypeVar("AStep")
APlan = TypeVar("APlan")


@dataclass(frozen=True)
class SearchLimits:
    """When the search gives up."""

    states: int = 2_000_000
    """Configurations tested for collision in all."""
    attempts: int = 600
    """Merges handed to the planner."""


@dataclass(frozen=True, eq=False)
class SearchResult(Generic[APlan]):
    """A plan (possibly unfinished), and what it took, failed attempts included."""

    plan: APlan
    planning_steps: int
    """Configurations tested for collision by all that the search did."""
    planning_seconds: float
    """Time within the planner and in thinking out the order."""
    attempts: int
    """Merges handed to the planner."""
    backtracks: int
    reason: str
    """Why there is no plan; empty if there is one."""
    guided: int = 0
    """The plan's first so many merges are the guide's."""
    guide_seconds: float = 0.0
    """Time that the guide took; not part of `planning_seconds`."""
    states: tuple[Any, ...] = ()
    """What each of the plan's steps led to, in the task's own terms."""


@dataclass(frozen=True)
class Round:
    """How wide one pass of the search is."""

    straight: bool
    """Only splits whose leaving part goes straight out."""
    exhaustive: bool
    """Splits that blocking graphs do not offer, too."""
    budget: Budget | None
    """For each merge, the task's own if None; with no states to spend the planner tries retreats only."""


Options = Callable[[Disassembly, State, TaskState, Parts, Parts, bool], Iterable[Action]]
"""Actions that join two sub-assemblies: `(disassembly, state, told, leaving, staying, straight)`, slots of `told`."""


@dataclass(frozen=True)
class SearchProgress:
    """How far a search is."""

    merges: int
    """Taken at present; they may be taken back."""
    attempts: int
    """Merges handed to the planner so far."""
    states: int
    """Configurations tested for collision so far."""


Watch = Callable[[SearchProgress], bool]
"""Asked before each merge that is tried; the search gives up where it says False."""


def planner_seed(seed: int, action: Action) -> int:
    """What the planner draws from for an action, wherever in a plan it stands."""
    return int(np.random.SeedSequence([seed, zlib.crc32(repr(action).encode())]).generate_state(1)[0])


@dataclass(eq=False)
class Search(Generic[State, AStep]):
    """One search, in any setting."""

    task: Task[State, AStep]
    options: Options[State]
    limits: SearchLimits
    seed: int
    round: Round
    """Present one; that by which a guide's suggestions are thought over, at first."""
    refused: set[frozenset[Parts]] = field(default_factory=set)
    """Splits that the planner would not join, whoever moves and whatever points up."""
    watch: Watch | None = None
    dead: set[frozenset[Parts]] = field(default_factory=set)
    """Partitions from which nothing led on."""
    taken: list[tuple[AStep, State]] = field(default_factory=list)
    """The steps taken, and what each led to."""
    stopped: bool = False
    """By whom watches."""
    planning_steps: int = 0
    planning_seconds: float = 0.0
    attempts: int = 0
    backtracks: int = 0
    guided: int = 0
    guide_seconds: float = 0.0
    strays: int = 0
    verdicts: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.disassembly = Disassembly(self.task.furniture, self.exhausted)

    def states(self) -> int:
        """Configurations tested for collision so far."""
        return self.planning_steps + self.disassembly.graphs.states

    def exhausted(self) -> bool:
        """Whether the limits are reached, or the search is to give up."""
        return self.stopped or self.states() > self.limits.states or self.attempts >= self.limits.attempts

    def follow(self, guide: Guide[State], state: State) -> bool:
        """Depth first from `state` along the guide's suggestions; the steps taken are kept if it succeeds."""
        if self.task.groups_of(state).complete:
            return True
        begun = time.perf_counter()
        suggestions = guide(self.task, state)
        self.guide_seconds += time.perf_counter() - begun
        tries = followed = 0
        for suggestion in takewhile(lambda s: s.score >= _GUIDED_SCORE, suggestions):
            # Led astray once, think before following on.
            if self.exhausted() or tries == _GUIDED_WIDTH or self.strays == _GUIDED_STRAYS:
                break
            if self.strays and self.hopeless(self.task.groups_of(state)):
                break
            if self.strays and self.hopeless(self.joined(self.task.groups_of(state), suggestion.action)):
                continue
            tries += 1
            after = self.attempt(state, suggestion.action, self.round.budget)
            if after is None:
                continue
            followed += 1
            self.guided += 1
            if self.follow(guide, after):
                return True
            self.guided -= 1
            self.taken.pop()
            self.backtracks += 1
        # With nothing taken over from the guide, the rounds will do this themselves.
        success = bool(self.taken) and self.extend(state)
        self.strays += not success and not followed
        return success

    def hopeless(self, state: TaskState | None) -> bool:
        """Whether reasoning sees no way on from a state, in which equal parts may have swapped places."""
        told = self.task.rules.pairs.assign_slots(state) if state is not None else None
        if told is None or (partition := partition_of(told)) in self.dead:
            return True
        return self.reasoned(partition, self.refused) is None

    def joined(self, state: TaskState, action: Action) -> TaskState | None:
        """What would be joined after an action; nothing is planned, nothing moves. None if the pair is wrong."""
        u, v, k, l, *_ = action  # noqa: E741
        if not self.task.rules.pair_exists(state, u, v, k, l):
            return None
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = self.task.rules.pairs.judge(u_group, v_group, u, k, v, l)
        if merge is None:
            return None
        others = (g for g in state.groups if g is not u_group and g is not v_group)
        return TaskState((*others, merge.merged))

    def extend(self, state: State, merges: Sequence[Split] = ()) -> bool:
        """Depth first from `state`; the steps taken are kept in `self.taken` if it succeeds.

        Args:
            state: where to go on.
            merges: what is left of the order that led here; thought out anew if empty.
        """
        if self.task.groups_of(state).complete:
            return True
        told = self.task.rules.pairs.assign_slots(self.task.groups_of(state))
        if told is None or (partition := partition_of(told)) in self.dead:
            return False
        if merges and not partition.issuperset(merges[0]):
            merges = ()
        excluded: set[frozenset[Parts]] = set()
        while not self.exhausted():
            merges = merges or self.reasoned(partition, self.refused | excluded) or ()
            if not merges:
                break
            (leaving, staying), *rest = merges
            after = self.merge(state, told, leaving, staying)
            if after is None:
                self.refused.add(frozenset((leaving, staying)))
            elif self.extend(after, rest):
                return True
            else:
                self.taken.pop()
                self.backtracks += 1
                excluded.add(frozenset((leaving, staying)))
            merges = ()
        self.dead.add(partition)
        return False

    def merge(self, state: State, told: TaskState, leaving: Parts, staying: Parts) -> State | None:
        """Try to join two groups: whoever moves, whatever points up, the most promising first."""
        for action in self.options(self.disassembly, state, told, leaving, staying, self.round.straight):
            if self.exhausted():
                return None
            after = self.attempt(state, action, self.round.budget)
            if after is not None:
                # From where equal parts had swapped places, the pair may have gone into other slots than these.
                if self.task.rules.pairs.assign_slots(self.task.groups_of(after)) is not None:
                    return after
                self.taken.pop()
        return None

    def attempt(self, state: State, action: Action, budget: Budget | None) -> State | None:
        """Hand one merge to the planner; None if it refuses, else its step is appended to `self.taken`."""
        if self.watch is not None and not self.watch(SearchProgress(len(self.taken), self.attempts, self.states())):
            self.stopped = True
            return None
        self.attempts += 1
        outcome = self.task.step(state, action, planner_seed(self.seed, action), budget)
        self.planning_steps += outcome.planning_steps
        self.planning_seconds += outcome.planning_seconds
        self.verdicts[outcome.verdict] = self.verdicts.get(outcome.verdict, 0) + 1
        if outcome.step is None:
            return None
        self.taken.append((outcome.step, outcome.state))
        return outcome.state

    def reasoned(self, partition: Partition, struck: set[frozenset[Parts]]) -> list[Split] | None:
        """An order that goes on from a partition, its time counted as planning."""
        begun = time.perf_counter()
        order = self.disassembly.order(partition, struck, self.round.straight, self.round.exhaustive)
        self.planning_seconds += time.perf_counter() - begun
        return order

    def run(self, state: State, rounds: Sequence[Round], guide: Guide[State] | None) -> bool:
        """All of it, the guide first; whether `taken` assembles the furniture."""
        if guide is not None:
            whole = self.limits
            self.limits = SearchLimits(whole.states // _GUIDED_SHARE, whole.attempts // _GUIDED_SHARE)
            success = self.follow(guide, state)
            self.limits = whole
            if success:
                return True
        for self.round in rounds:
            self.refused.clear()
            self.dead.clear()
            if self.extend(state):
                return True
            if self.exhausted():
                break
        return False

    def result(self, plan: APlan, success: bool) -> SearchResult[APlan]:
        """A plan of `taken`, and what it took."""
        reason = ""
        if not success:
            spent = "no order of merges is left"
            if self.exhausted():
                spent = "stopped" if self.stopped else "limits reached"
            verdicts = ", ".join(f"{n} {v}" for v, n in sorted(self.verdicts.items()))
            reason = f"{spent} after {self.attempts} merges tried ({verdicts or 'none'})"
        return SearchResult(
            plan, self.states(), self.planning_seconds, self.attempts, self.backtracks, reason, self.guided,
            self.guide_seconds, tuple(state for _, state in self.taken),
        )  # fmt: skip
