"""Finds a whole action sequence with robots, as `solvers.search` does without."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Parts
from roboassembly.solvers.forward import Action, Search, SearchLimits, SearchResult, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.options import grasping
from roboassembly.solvers.search import ROUNDS
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullPlan, FullState
from roboassembly.task.rules.groups import TaskState

_FIRST = Budget(states=2_000, stances=2)
"""Budget with which all actions of a merge are tried first."""
_ROUNDS = tuple(replace(r, budget=None, first=_FIRST) for r in ROUNDS)
FULL_LIMITS = SearchLimits(states=6_000_000, attempts=200)
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
    search = Search(task, partial(_grasping, task), limits, seed, _ROUNDS[0], watch=watch)
    success = search.run(initial, _ROUNDS, guide)
    steps = tuple(step for step, _ in search.steps)
    return search.result(FullPlan(task.furniture, initial, steps, success, seed), success)


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
