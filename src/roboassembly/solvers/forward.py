"""Forward half of the search, in any setting: tries the merges that disassembly or a guide suggests, depth first."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any, Generic, TypeVar

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.solvers.blocking import contained_in
from roboassembly.solvers.disassembly import Disassembly, Joinability, Partition, Parts, Split, partition_of
from roboassembly.solvers.exits import ExitPlanner, Motions
from roboassembly.solvers.guide import Guide
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Outcome, Task

Action = tuple[int, ...]
_GUIDED_STRAYS = 3
"""Number of dead ends that a guide may lead to before disassembly takes over."""
_GUIDED_SHARE = 4
"""Divisor of the limits that gives a guide's share; the rest is left for the rounds after it."""
_GUIDED_WIDTH = 5
"""Number of suggestions tried in each state."""
_GUIDED_SCORE = 0.1
"""Score below which suggestions are ignored."""
_MISLED_STATES = 3_000
"""Number of states left for a guide's branch once a right pair that it suggested cannot be joined."""


State = TypeVar("State")
AStep = TypeVar("AStep")
APlan = TypeVar("APlan")


@dataclass(frozen=True)
class SearchLimits:
    """Limits at which the search gives up."""

    states: int = 2_000_000
    """Number of configurations tested for collision."""
    attempts: int = 600
    """Number of merges handed to the planner."""


@dataclass(frozen=True, eq=False)
class SearchResult(Generic[APlan]):
    """A plan (possibly unfinished) and the effort of the search, failed attempts included."""

    plan: APlan
    planning_steps: int
    """Number of configurations tested for collision in the whole search."""
    planning_seconds: float
    """Time spent in the planner and in disassembly [s]."""
    attempts: int
    """Number of merges handed to the planner."""
    backtracks: int
    reason: str
    """Reason why there is no plan; empty if there is one."""
    guided: int = 0
    """Number of merges, from the first, that the guide suggested."""
    guide_seconds: float = 0.0
    """Time spent in the guide [s]; not part of `planning_seconds`."""
    states: tuple[Any, ...] = ()
    """State after each step of the plan, as of the task."""


@dataclass(frozen=True)
class Round:
    """Width of one pass of the search."""

    straight: bool
    """Use only splits whose leaving part moves straight out."""
    exhaustive: bool
    """Also use splits that blocking graphs do not offer."""
    budget: Budget | None
    """Budget of each merge; the task's own if None. Without states the planner tries retreats only."""
    first: Budget | None = None
    """Smaller budget with which all actions of a merge are tried first; None to try each once."""
    exits: int | None = None
    """States with which the way of one sub-assembly out of the other is planned for each split of an order, before any
    of its merges is tried; None to use splits without."""
    generalizes: bool = False
    """Whether to leave out splits that contain one for which no action could be planned: more parts around leave less
    room. This is a guess, so other rounds must follow."""
    share: int = 1
    """Divisor of the search's limits that gives this round's own; the rest is left for the rounds after it."""


Options = Callable[[Disassembly, State, TaskState, Parts, Parts, bool], Iterable[Action]]
"""Function that returns the actions that join two sub-assemblies.

Its arguments are `(disassembly, state, assigned, leaving, staying, straight)`; both sub-assemblies are slots of
`assigned`, the state in which every slot is claimed once.
"""


@dataclass(frozen=True)
class SearchProgress:
    """Progress of a search."""

    merges: int
    """Number of merges in the present branch."""
    attempts: int
    """Number of merges handed to the planner so far."""
    states: int
    """Configurations tested for collision so far."""


CarryOut = Callable[[State, Action, int, Budget | None, Motions], Outcome[State, AStep]]
"""Function that plans a merge: `(state, action, seed, budget, motions)`; see `ExitPlanner.motions`."""
Watch = Callable[[SearchProgress], bool]
"""Callback before each attempted merge; the search stops if it returns False."""


def planner_seed(seed: int, action: Action) -> int:
    """Return the planner's seed for an action; it does not depend on the action's place in the plan."""
    return int(np.random.SeedSequence([seed, zlib.crc32(repr(action).encode())]).generate_state(1)[0])


@dataclass(eq=False)
class Search(Generic[State, AStep]):
    """One search, in any setting."""

    task: Task[State, AStep]
    options: Options[State]
    limits: SearchLimits
    seed: int
    round: Round
    """Present round; at first the one in which a guide's suggestions are tried."""
    refused: set[frozenset[Parts]] = field(default_factory=set[frozenset[Parts]])
    """Splits for which no action could be planned."""
    watch: Watch | None = None
    cost: Callable[[Disassembly, Parts, Parts, bool], int] | None = None
    """Cost of a split, `(disassembly, leaving, staying, straight)`, that orders should keep low; see `Disassembly`."""
    carry_out: CarryOut[State, AStep] | None = None
    """Function that plans the merges, if they can use motions out of each other; the task's `step` otherwise."""
    joinability: Joinability | None = None
    """Tests whether the two sub-assemblies of a split can be joined; all can if None."""
    failed: list[Split] = field(default_factory=list[Split])
    """Splits that a round which generalizes leaves out, and those that contain them."""
    dead: set[frozenset[Parts]] = field(default_factory=set[frozenset[Parts]])
    """Partitions from which the search failed."""
    steps: list[tuple[AStep, State]] = field(default_factory=list[tuple[AStep, State]])
    """Steps of the present branch, each with the state after it."""
    stopped: bool = False
    """Whether `watch` stopped the search."""
    planning_steps: int = 0
    planning_seconds: float = 0.0
    attempts: int = 0
    backtracks: int = 0
    guided: int = 0
    guide_seconds: float = 0.0
    strays: int = 0
    """Number of dead ends that the guide led to."""
    misled: bool = False
    """Whether a right pair that the guide suggested could not be joined."""
    verdicts: dict[str, int] = field(default_factory=dict[str, int])

    def __post_init__(self) -> None:
        cost = None if self.cost is None else self._cost_of
        self.disassembly = Disassembly(self.task.furniture, self.exhausted, cost, self.may_join)
        self.exits = ExitPlanner(self.task.rules, self.disassembly.graphs, self.seed)

    def _cost_of(self, leaving: Parts, staying: Parts, straight: bool) -> int:
        assert self.cost is not None
        return self.cost(self.disassembly, leaving, staying, straight)

    def may_join(self, leaving: Parts, staying: Parts) -> bool:
        """Return whether a split counts: no failed one is contained in it, and `joinability` does not exclude it."""
        if any(contained_in(split, (leaving, staying)) for split in self.failed):
            return False
        return self.joinability is None or self.joinability.may_join(leaving, staying)

    def states(self) -> int:
        """Return the number of configurations tested for collision so far."""
        return self.planning_steps + self.disassembly.graphs.states + self.exits.states

    def exhausted(self) -> bool:
        """Return whether the limits are reached or the search was stopped."""
        return self.stopped or self.states() > self.limits.states or self.attempts >= self.limits.attempts

    def follow(self, guide: Guide[State], state: State) -> bool:
        """Search depth first from `state` along the guide's suggestions; returns whether the furniture is complete.

        If it is, `steps` holds the plan.
        """
        if self.task.groups_of(state).complete:
            return True
        begun = time.perf_counter()
        suggestions = guide(self.task, state)
        self.guide_seconds += time.perf_counter() - begun
        tries = followed = 0
        for suggestion in takewhile(lambda s: s.score >= _GUIDED_SCORE, suggestions):
            if self.exhausted() or tries == _GUIDED_WIDTH or self.strays == _GUIDED_STRAYS:
                break
            # Disassembly checks every suggestion after a first costly failure or dead end, or from the first where its
            # answers are good. Its own tests would cost more than they save before.
            checked = self.misled or self.strays > 0 or self.joinability is not None
            if checked and self.hopeless(self.task.groups_of(state)):
                break
            if checked and self.hopeless(self.joined(self.task.groups_of(state), suggestion.action)):
                continue
            tries += 1
            outcome = self.attempt(state, suggestion.action, self.round.first or self.round.budget)
            if outcome is None or outcome.step is None:
                if outcome is not None and outcome.planning_steps > 0:
                    self._limit_branch()
                continue
            followed += 1
            self.guided += 1
            if self.follow(guide, outcome.state):
                return True
            self.guided -= 1
            self.steps.pop()
            self.backtracks += 1
        # Without any merge of the guide, the rounds start from the same state anyway.
        success = bool(self.steps) and self.extend(state)
        self.strays += not success and not followed
        return success

    def _limit_branch(self) -> None:
        """Limit the rest of the guide's branch, because an earlier merge of it may lock a part out.

        `_within` restores the limits. Robots have other reasons to fail, and disassembly checks all their suggestions.
        """
        if not self.misled and self.joinability is None:
            self.misled = True
            self.limits = replace(self.limits, states=min(self.limits.states, self.states() + _MISLED_STATES))

    def hopeless(self, state: TaskState | None) -> bool:
        """Return whether disassembly finds no order from a state; equal parts may have swapped slots."""
        assigned = self.task.rules.pairs.assign_slots(state) if state is not None else None
        if assigned is None or (partition := partition_of(assigned)) in self.dead:
            return True
        return self.reasoned(partition, self.refused) is None

    def joined(self, state: TaskState, action: Action) -> TaskState | None:
        """Return the groups after an action, without planning it; None if the pair is wrong."""
        u, v, k, l, *_ = action  # noqa: E741
        if not self.task.rules.pair_exists(state, u, v, k, l):
            return None
        merge = self.task.rules.pairs.judge_in(state, u, k, v, l)
        return None if merge is None else state.after_merge(merge.merged)

    def extend(self, state: State, merges: Sequence[Split] = ()) -> bool:
        """Search depth first from `state`; returns whether the furniture is complete, with the plan in `steps`.

        Args:
            state: state to continue from.
            merges: rest of the order that led here; computed anew if empty.
        """
        if self.task.groups_of(state).complete:
            return True
        assigned = self.task.rules.pairs.assign_slots(self.task.groups_of(state))
        if assigned is None or (partition := partition_of(assigned)) in self.dead:
            return False
        if merges and not partition.issuperset(merges[0]):
            merges = ()
        excluded: set[frozenset[Parts]] = set()
        while not self.exhausted():
            merges = merges or self.reasoned(partition, self.refused | excluded) or ()
            if not merges:
                break
            (leaving, staying), *rest = merges
            after = self.merge(state, assigned, leaving, staying)
            if after is None:
                self.refused.add(frozenset((leaving, staying)))
                if self.round.generalizes:
                    self.failed.append((leaving, staying))
            elif self.extend(after, rest):
                return True
            else:
                self.steps.pop()
                self.backtracks += 1
                excluded.add(frozenset((leaving, staying)))
            merges = ()
        self.dead.add(partition)
        return False

    def merge(self, state: State, assigned: TaskState, leaving: Parts, staying: Parts) -> State | None:
        """Try the actions that join two groups, the most promising first; returns the state after, None if all fail."""
        actions = self.options(self.disassembly, state, assigned, leaving, staying, self.round.straight)
        group_of = self.task.groups_of(state).group_of
        # Another action often works where the first few ways to carry one out do not.
        for budget in (self.round.budget,) if self.round.first is None else (self.round.first, self.round.budget):
            left: list[Action] = []
            for action in actions:
                if self.exhausted():
                    return None
                roles = (assigned.groups[group_of[part]] for part in action[:2])
                motions = self.exits.motions(*(frozenset(group.slots) for group in roles))
                outcome = self.attempt(state, action, budget, motions)
                if outcome is None:
                    return None
                if outcome.step is None:
                    if outcome.failure is None or not outcome.failure.final:
                        left.append(action)
                    continue
                return outcome.state
            actions = left
        return None

    def attempt(
        self, state: State, action: Action, budget: Budget | None, motions: Motions = ()
    ) -> Outcome[State, AStep] | None:
        """Plan one merge and append its step to `steps` if it succeeds; returns None if the search is stopped."""
        if self.watch is not None and not self.watch(SearchProgress(len(self.steps), self.attempts, self.states())):
            self.stopped = True
            return None
        self.attempts += 1
        seed = planner_seed(self.seed, action)
        if self.carry_out is None:
            outcome = self.task.step(state, action, seed, budget)
        else:
            outcome = self.carry_out(state, action, seed, budget, motions)
        self.planning_steps += outcome.planning_steps
        self.planning_seconds += outcome.planning_seconds
        self.verdicts[outcome.verdict] = self.verdicts.get(outcome.verdict, 0) + 1
        if outcome.step is not None:
            self.steps.append((outcome.step, outcome.state))
        return outcome

    def reasoned(self, partition: Partition, rejected: set[frozenset[Parts]]) -> list[Split] | None:
        """Return an order of merges from a partition; its time counts as planning."""
        begun = time.perf_counter()
        rejected = set(rejected)
        while True:
            order = self.disassembly.order(partition, rejected, self.round.straight, self.round.exhaustive)
            stuck = self.first_stuck(order or ())
            if stuck is None:
                break
            rejected.add(frozenset(stuck))
        self.planning_seconds += time.perf_counter() - begun
        return order

    def first_stuck(self, order: Sequence[Split]) -> Split | None:
        """Return the first split, as the furniture comes apart, that cannot be joined or has no way out, if any."""
        if self.joinability is not None:
            for split in reversed(order):
                if not self.joinability.can_join(*split):
                    return split
        budget = self.round.exits
        if budget is None:
            return None
        return next((split for split in reversed(order) if not self.exits.separable(*split, budget)), None)

    def run(self, state: State, rounds: Sequence[Round], guide: Guide[State] | None) -> bool:
        """Run the whole search, the guide first; returns whether `steps` assembles the furniture."""
        if guide is not None and self._within(_GUIDED_SHARE, lambda: self.follow(guide, state)):
            return True
        for self.round in rounds:
            self.refused.clear()
            self.dead.clear()
            self.failed.clear()
            if self._within(self.round.share, lambda: self.extend(state)):
                return True
            if self.exhausted():
                break
        return False

    def _within(self, share: int, search: Callable[[], bool]) -> bool:
        """Return what a search returns that gets only a share of the limits, and no more than is left of them."""
        whole = self.limits
        states, attempts = self.states() + whole.states // share, self.attempts + whole.attempts // share
        self.limits = SearchLimits(min(whole.states, states), min(whole.attempts, attempts))
        success = search()
        self.limits = whole
        return success

    def _failure(self) -> str:
        """Return the reason why the search found no plan."""
        if not self.exhausted():
            if self.attempts == 0:
                robots = " in which two hands can join the parts" if self.joinability is not None else ""
                return f"no order of merges exists{robots}"
            spent = "no order of merges is left"
        else:
            spent = "stopped" if self.stopped else "limits reached"
        verdicts = ", ".join(f"{n} {v}" for v, n in sorted(self.verdicts.items()))
        return f"{spent} after {self.attempts} merges tried ({verdicts or 'none'})"

    def result(self, plan: APlan, success: bool) -> SearchResult[APlan]:
        """Return the result of the search for a plan made of `steps`."""
        reason = ""
        if not success:
            reason = self._failure()
        return SearchResult(
            plan, self.states(), self.planning_seconds, self.attempts, self.backtracks, reason, self.guided,
            self.guide_seconds, tuple(state for _, state in self.steps),
        )  # fmt: skip
