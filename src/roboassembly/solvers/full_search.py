"""Finds a whole action sequence with robots, as `solvers.search` does without."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Parts, partition_of
from roboassembly.solvers.forward import Action, Search, SearchLimits, SearchResult, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.hand_joints import HandJoints
from roboassembly.solvers.options import grasping
from roboassembly.solvers.search import ROUNDS
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullPlan, FullState, FullStep
from roboassembly.task.rules.groups import TaskState

_FIRST = Budget(states=2_000, stances=2)
"""Budget with which all actions of a merge are tried first."""
_ROUNDS = (
    # Another order mostly costs less than the full budget for a merge that the first one does not find.
    *(replace(r, budget=_FIRST, generalizes=True, share=4) for r in (ROUNDS[0], ROUNDS[-1])),
    *(replace(r, budget=None, first=_FIRST) for r in ROUNDS),
)
FULL_LIMITS = SearchLimits(states=6_000_000, attempts=600)
"""Default limits with robots."""


def solve_full(
    furniture: Furniture,
    seed: int,
    *,
    task: FullTask | None = None,
    limits: SearchLimits | None = None,
    guide: Guide[FullState] | None = None,
) -> SearchResult[FullPlan]:
    """Search for an assembly by two robots in the workcell; see `solve`.

    Args:
        furniture: furniture that is assembled.
        seed: seed of the cell's layout and of the planner.
        task: task of this furniture, whose cached results are reused; a new one if None.
        limits: limits at which the search gives up.
        guide: suggests merges; disassembly alone if None.

    Raises:
        InputError: the furniture does not suit the cell.
    """
    task = task or FullTask(furniture)
    initial = task.initial_state(np.random.default_rng(seed))
    return solve_full_from(task, initial, seed, limits or FULL_LIMITS, guide)


def solve_full_from(
    task: FullTask,
    initial: FullState,
    seed: int,
    limits: SearchLimits,
    guide: Guide[FullState] | None = None,
    watch: Watch | None = None,
) -> SearchResult[FullPlan]:
    """Search from a given state; see `solve_full`."""
    search = _search(task, seed, limits, watch)
    success = search.run(initial, _ROUNDS, guide)
    steps = tuple(step for step, _ in search.steps)
    return search.result(FullPlan(task.furniture, initial, steps, success, seed), success)


class MergePlanner:
    """Plans one merge at a time, each from the state that the last one really ended in.

    It looks ahead by disassembly only and undoes nothing, as befits robots that act while the plan is made.

    Args:
        task: task of the piece.
        seed: seed of the planner.
        limits: limits on all merges together at which it gives up.
    """

    def __init__(self, task: FullTask, seed: int, limits: SearchLimits | None = None) -> None:
        self._search = _search(task, seed, limits or FULL_LIMITS)

    def next_step(self, state: FullState) -> FullStep | None:
        """Plan the merge that comes next in an order that finishes the piece; None if no merge can be planned."""
        search = self._search
        assigned = search.task.rules.pairs.assign_slots(state.groups)
        if assigned is None:
            return None
        for search.round in _ROUNDS:
            search.refused.clear()
            while not search.exhausted():
                order = search.reasoned(partition_of(assigned), search.refused)
                if not order:
                    break
                step = self._planned(state, assigned, *order[0])
                if step is not None:
                    return step
                search.refused.add(frozenset(order[0]))
        return None

    def step_that_joins(self, state: FullState, first: Parts, second: Parts) -> FullStep | None:
        """Plan the merge of two groups, each in its own slots; None if it cannot be planned.

        Args:
            state: state in which both are groups.
            first: parts of one group.
            second: parts of the other group.
        """
        return self._planned(state, state.groups, first, second)

    def _planned(self, state: FullState, assigned: TaskState, leaving: Parts, staying: Parts) -> FullStep | None:
        self._search.steps.clear()
        self._search.merge(state, assigned, leaving, staying)
        return self._search.steps[0][0] if self._search.steps else None


def _search(task: FullTask, seed: int, limits: SearchLimits, watch: Watch | None = None) -> Search[FullState, FullStep]:
    return Search(task, partial(_grasping, task), limits, seed, _ROUNDS[0], watch=watch, joinability=HandJoints(task))


def _grasping(
    task: FullTask,
    _: Disassembly,
    state: FullState,
    assigned: TaskState,
    leaving: Parts,
    staying: Parts,
    straight: bool,
) -> Iterable[Action]:
    return grasping(task, state, assigned, leaving, staying)
