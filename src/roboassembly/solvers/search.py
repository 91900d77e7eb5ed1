"""Finds a whole action sequence, in either setting: reason backward by disassembly, let the task judge every merge.

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

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Parts
from roboassembly.solvers.forward import Action, Round, Search, SearchLimits, SearchResult, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.options import grasping, upright
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.plans.full_plan import FullPlan, FullState
from roboassembly.task.plans.plan import Plan
from roboassembly.task.rules.groups import TaskState

_ROUNDS = (
    Round(True, False, Budget(states=0)),
    Round(False, False, Budget(states=4_000)),
    Round(False, True, Budget(states=20_000)),
)


_FULL_ROUNDS = tuple(replace(r, budget=None) for r in _ROUNDS)
FULL_LIMITS = SearchLimits(states=6_000_000, attempts=200)
"""Unless told otherwise, with robots."""
_NO_PLACE = "two groups need the same place in the furniture"


def solve(
    furniture: Furniture,
    seed: int,
    *,
    task: ObjectCentricTask | None = None,
    limits: SearchLimits | None = None,
    guide: Guide[TaskState] | None = None,
) -> SearchResult[Plan]:
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
    task: ObjectCentricTask,
    initial: TaskState,
    seed: int,
    limits: SearchLimits,
    guide: Guide[TaskState] | None = None,
    watch: Watch | None = None,
) -> SearchResult[Plan]:
    """As `solve`, from a state that is given, in which equal parts may have taken each other's places."""
    if task.pairs.assign_slots(initial) is None:
        nothing = Plan(task.furniture, initial.part_poses, (), False, seed)
        return SearchResult(nothing, 0, 0.0, 0, 0, _NO_PLACE)
    search = Search(task, upright, limits, seed, _ROUNDS[0], watch=watch)
    success = search.run(initial, _ROUNDS, guide)
    steps = tuple(step for step, _ in search.taken)
    return search.result(Plan(task.furniture, initial.part_poses, steps, success, seed), success)


def solve_full(
    furniture: Furniture,
    seed: int,
    *,
    task: FullTask | None = None,
    limits: SearchLimits | None = None,
    guide: Guide[FullState] | None = None,
) -> SearchResult[FullPlan]:
    """As `solve`, for two robots in the workcell.

    Args:
        furniture: what is assembled.
        seed: of the cell's layout and of the planner.
        task: of this furniture, to share what it has computed; a new one if None.
        limits: when to give up.
        guide: suggests merges; plain reasoning if None.

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
    """As `solve_full`, from a state that is given."""
    search = Search(task, partial(_grasping, task), limits, seed, _FULL_ROUNDS[0], watch=watch)
    success = search.run(initial, _FULL_ROUNDS, guide)
    steps = tuple(step for step, _ in search.taken)
    return search.result(FullPlan(task.furniture, initial, steps, success, seed), success)


def _grasping(
    task: FullTask, _: Disassembly, state: FullState, told: TaskState, leaving: Parts, staying: Parts, straight: bool
) -> Iterable[Action]:
    return grasping(task, state, told, leaving, staying)
