"""Finds a whole action sequence: reason backward by disassembly, let the task's own planner judge every merge.

Backward: an order of merges by taking the furniture apart in the mind (`solvers.disassembly`). Forward: carry the
merges out. Where the planner refuses a merge, that split is struck out and the rest thought through again; where
nothing is left, the last merge is taken back.

Three rounds, each wider and dearer than the last: straight exits only and no sampling planner; everything that no
neighbour holds back; at last every split of a set into two connected halves, so that nothing assemblable is missed
but what the planner's budget cuts off.

A guide (`solvers.guide`) may go first: its suggestions are followed depth first, the planner judging each; where they
are spent the reasoning takes over, and where that sees no way left the last merge is taken back. What the guide gets
wrong costs time only: in the end the three rounds start over without it.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Partition, Parts, Split, partition_of
from roboassembly.solvers.guide import Guide
from roboassembly.task.groups import TaskState, corresponding_point
from roboassembly.task.object_centric import UP_AXES, ObjectCentricTask, Verdict
from roboassembly.task.plan import Plan, PlanStep

_HOPELESS = -0.5
"""Score of an option that the first round leaves out: it would end in the ground, or leave the joint downward."""
_GUIDED_BUDGET = Budget(states=0)
"""For each merge that a guide suggests: retreats only, as in the first round."""
_GUIDED_STRAYS = 3
"""Times that a guide may lead to where nothing goes on; then reasoning takes over."""
_GUIDED_SHARE = 4
"""A guide gets one part in so many of the limits, so that the rounds after it have enough left."""
_GUIDED_WIDTH = 5
"""Suggestions tried in each state."""
_GUIDED_SCORE = 0.1
"""Suggestions below it are left alone."""


@dataclass(frozen=True)
class SearchLimits:
    """When the search gives up."""

    states: int = 2_000_000
    """Configurations tested for collision in all."""
    attempts: int = 600
    """Merges handed to the planner."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """A plan (possibly unfinished), and what it took, failed attempts included."""

    plan: Plan
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


@dataclass(frozen=True)
class _Round:
    """How wide one pass of the search is."""

    straight: bool
    """Only splits whose leaving part goes straight out."""
    exhaustive: bool
    """Splits that blocking graphs do not offer, too."""
    budget: Budget
    """For each merge; with no states to spend the planner tries retreats only."""


_ROUNDS = (
    _Round(True, False, Budget(states=0)),
    _Round(False, False, Budget(states=4_000)),
    _Round(False, True, Budget(states=20_000)),
)


@dataclass(eq=False)
class _Search:
    task: ObjectCentricTask
    limits: SearchLimits
    seed: int
    round: _Round = _ROUNDS[0]
    refused: set[frozenset[Parts]] = field(default_factory=set)
    """Splits that the planner would not join, whoever moves and whatever points up."""
    dead: set[frozenset[Parts]] = field(default_factory=set)
    """Partitions from which nothing led on."""
    steps: list[PlanStep] = field(default_factory=list)
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
        return self.states() > self.limits.states or self.attempts >= self.limits.attempts

    def follow(self, guide: Guide, state: TaskState) -> bool:
        """Depth first from `state` along the guide's suggestions; the steps taken are kept if it succeeds."""
        if state.complete:
            return True
        begun = time.perf_counter()
        suggestions = guide(self.task, state)
        self.guide_seconds += time.perf_counter() - begun
        tries = followed = 0
        for suggestion in takewhile(lambda s: s.score >= _GUIDED_SCORE, suggestions):
            # Led astray once, think before following on.
            if self.exhausted() or tries == _GUIDED_WIDTH or self.strays == _GUIDED_STRAYS:
                break
            if self.strays and self.hopeless(state):
                break
            if self.strays and self.hopeless(self.joined(state, suggestion.action)):
                continue
            tries += 1
            after = self.attempt(state, suggestion.action, _GUIDED_BUDGET)
            if after is None:
                continue
            followed += 1
            self.guided += 1
            if self.follow(guide, after):
                return True
            self.guided -= 1
            self.steps.pop()
            self.backtracks += 1
        # With nothing taken over from the guide, the rounds will do this themselves.
        told = next(self.task.pairs.own_places(state), None)
        success = bool(self.steps) and told is not None and self.extend(told)
        self.strays += not success and not followed
        return success

    def hopeless(self, state: TaskState | None) -> bool:
        """Whether reasoning sees no way on from a state, in which equal parts may have swapped places."""
        told = next(self.task.pairs.own_places(state), None) if state is not None else None
        if told is None or (partition := partition_of(told)) in self.dead:
            return True
        return self.reasoned(partition, self.refused) is None

    def joined(self, state: TaskState, action: tuple[int, ...]) -> TaskState | None:
        """What would be joined after an action; nothing is planned, nothing moves. None if the pair is wrong."""
        if not self.task.exists(state, action):
            return None
        u, v, k, l, _ = action  # noqa: E741
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = self.task.pairs.judge(u_group, v_group, u, k, v, l)
        if merge is None:
            return None
        others = (g for g in state.groups if g is not u_group and g is not v_group)
        return TaskState((*others, merge.merged))

    def extend(self, state: TaskState, merges: Sequence[Split] = ()) -> bool:
        """Depth first from `state`; the steps taken are kept in `self.steps` if it succeeds.

        Args:
            state: where to go on.
            merges: what is left of the order that led here; thought out anew if empty.
        """
        if state.complete:
            return True
        partition = partition_of(state)
        if partition in self.dead:
            return False
        if merges and not partition.issuperset(merges[0]):
            merges = ()
        excluded: set[frozenset[Parts]] = set()
        while not self.exhausted():
            merges = merges or self.reasoned(partition, self.refused | excluded) or ()
            if not merges:
                break
            (leaving, staying), *rest = merges
            after = self.merge(state, leaving, staying)
            if after is None:
                self.refused.add(frozenset((leaving, staying)))
            elif self.extend(after, rest):
                return True
            else:
                self.steps.pop()
                self.backtracks += 1
                excluded.add(frozenset((leaving, staying)))
            merges = ()
        self.dead.add(partition)
        return False

    def merge(self, state: TaskState, leaving: Parts, staying: Parts) -> TaskState | None:
        """Try to join two groups: whoever moves, whatever points up, the most promising first."""
        for action in self.options(state, leaving, staying):
            if self.exhausted():
                return None
            after = self.attempt(state, action, self.round.budget)
            if after is not None:
                # From where equal parts had swapped places, the pair may have gone into other slots than these.
                told = next(self.task.pairs.own_places(after), None)
                if told is not None:
                    return told
                self.steps.pop()
        return None

    def attempt(self, state: TaskState, action: tuple[int, ...], budget: Budget) -> TaskState | None:
        """Hand one merge to the planner; None if it refuses, else its step is appended to `self.steps`."""
        self.attempts += 1
        words = np.random.SeedSequence([self.seed, zlib.crc32(repr(action).encode())]).generate_state(1)
        outcome = self.task.step(state, action, int(words[0]), budget)
        self.planning_steps += outcome.planning_steps
        self.planning_seconds += outcome.planning_seconds
        self.verdicts[outcome.verdict] = self.verdicts.get(outcome.verdict, 0) + 1
        if outcome.verdict is not Verdict.MERGED or outcome.step is None:
            return None
        self.steps.append(outcome.step)
        return outcome.state

    def options(self, state: TaskState, leaving: Parts, staying: Parts) -> list[tuple[int, ...]]:
        """Actions that join the two groups. Rising out of the joint is best; ending up in the ground is worst."""
        ends = self.joint(state, leaving, staying)
        if ends is None:
            return []
        (one, k), (two, l) = ends  # noqa: E741
        end = {one: k, two: l}
        scored: list[tuple[float, tuple[int, ...]]] = []
        for u, v, moving, waiting in ((one, two, leaving, staying), (two, one, staying, leaving)):
            directions = self.disassembly.exits(moving, waiting)
            low_moving, low_waiting = self.disassembly.lowest(moving), self.disassembly.lowest(waiting)
            for w, up in enumerate(UP_AXES):
                rise = max((float(d @ up) for d in directions), default=0.0)
                sinks = low_moving[w] < low_waiting[w] - 1e-3
                score = rise - 3.0 * sinks - 0.2 * (len(moving) > len(waiting))
                scored.append((round(score, 3), (u, v, end[u], end[v], w)))
        scored.sort(key=lambda item: -item[0])
        return [action for score, action in scored if score > _HOPELESS or not self.round.straight]

    def joint(self, state: TaskState, leaving: Parts, staying: Parts) -> tuple[tuple[int, int], tuple[int, int]] | None:
        """A part and point of each group that touch when the groups are joined: the leaving one's first."""
        furniture = self.task.furniture
        part_in = {slot: part for g in state.groups for part, slot in zip(g.parts, g.slots, strict=True)}
        for c in furniture.connections:
            a, b = (c.part_a, c.point_a), (c.part_b, c.point_b)
            if c.part_a in staying and c.part_b in leaving:
                a, b = b, a
            elif not (c.part_a in leaving and c.part_b in staying):
                continue
            one, two = part_in[a[0]], part_in[b[0]]
            k, l = corresponding_point(furniture, *a, one), corresponding_point(furniture, *b, two)  # noqa: E741
            if k is not None and l is not None:
                return (one, k), (two, l)
        return None

    def reasoned(self, partition: Partition, struck: set[frozenset[Parts]]) -> list[Split] | None:
        """An order that goes on from a partition, its time counted as planning."""
        begun = time.perf_counter()
        order = self.disassembly.order(partition, struck, self.round.straight, self.round.exhaustive)
        self.planning_seconds += time.perf_counter() - begun
        return order


def solve(
    furniture: Furniture,
    seed: int,
    *,
    task: ObjectCentricTask | None = None,
    limits: SearchLimits | None = None,
    guide: Guide | None = None,
) -> SearchResult:
    """Search for an assembly from a random start; the same seed gives the same plan.

    Args:
        seed: of the initial placement and of the planner.
        task: of this furniture, to share what it has computed; a new one if None.
        guide: suggests merges; plain reasoning if None.
    """
    task = task or ObjectCentricTask(furniture)
    initial = task.initial_state(np.random.default_rng(seed))
    return solve_from(task, initial, seed, limits or SearchLimits(), guide)


def solve_from(
    task: ObjectCentricTask, initial: TaskState, seed: int, limits: SearchLimits, guide: Guide | None = None
) -> SearchResult:
    """As `solve`, from a state that is given, in which equal parts may have taken each other's places."""
    state = next(task.pairs.own_places(initial), None)
    if state is None:
        nothing = Plan(task.furniture, initial.part_poses, (), False, seed)
        return SearchResult(nothing, 0, 0.0, 0, 0, "two groups need the same place in the furniture")
    search = _Search(task, limits, seed)
    success = False
    if guide is not None:
        search.limits = SearchLimits(limits.states // _GUIDED_SHARE, limits.attempts // _GUIDED_SHARE)
        success = search.follow(guide, state)
        search.limits = limits
    for search.round in () if success else _ROUNDS:
        search.refused.clear()
        search.dead.clear()
        success = search.extend(state)
        if success or search.exhausted():
            break
    reason = ""
    if not success:
        spent = "limits reached" if search.exhausted() else "no order of merges is left"
        verdicts = ", ".join(f"{n} {v}" for v, n in sorted(search.verdicts.items()))
        reason = f"{spent} after {search.attempts} merges tried ({verdicts or 'none'})"
    return SearchResult(
        Plan(task.furniture, initial.part_poses, tuple(search.steps), success, seed),
        search.states(),
        search.planning_seconds,
        search.attempts,
        search.backtracks,
        reason,
        search.guided,
        search.guide_seconds,
    )
