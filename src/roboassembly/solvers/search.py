"""Finds a whole action sequence: disassembly gives an order of merges, the task plans each merge.

Disassembly (`solvers.disassembly`) works backward and returns an order. The search works forward and plans its merges.
If the planner fails at a merge, its split is rejected and the order is computed again; if no order is left, the last
merge is undone.

There are several rounds, each wider or more expensive than the last. The first uses straight exits and no sampling
planner. The next two use all splits that no neighbour blocks, the fourth every split of a set into two connected
halves. In these, a split counts only if a way of one half out of the other is found (`solvers.exits`). The last round
drops that condition, so that only the planner's budget limits what is found.

A guide (`solvers.guide`) may come first. The search follows its suggestions depth first and plans each of them. If none
is left, disassembly continues; if it finds no order, the last merge is undone. Errors of the guide cost time only: at
the end the rounds start again without it. They start soon if a right pair that it suggested cannot be joined, because
an earlier merge may then have locked a part out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.disassembly import Disassembly, Parts
from roboassembly.solvers.forward import Options, Round, Search, SearchLimits, SearchResult, Watch
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.options import join_options, upright
from roboassembly.task.object_centric.stability import StandCheck, with_stability
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.plans.plan import Plan
from roboassembly.task.rules.groups import TaskState

ROUNDS = (
    Round(True, False, Budget(states=0)),
    Round(False, False, Budget(states=4_000)),
    Round(False, True, Budget(states=20_000)),
)
# The way of two sub-assemblies out of each other is planned before their merges, with more and more states. What that
# rejects is not proven hopeless, so the last round of all tries every merge itself.
_STAGES = (
    ROUNDS[0],
    *(
        Round(False, exhaustive, Budget(states=states), first=Budget(states=0), exits=states)
        for exhaustive, states in ((False, 1_000), (False, 4_000), (True, 20_000))
    ),
    ROUNDS[-1],
)
_NO_WAY = 3
"""Cost of a split that no axis up allows: more than that of two groups that must be held."""
_SAME_SLOTS = "two groups need the same place in the furniture"


def solve(
    furniture: Furniture,
    seed: int,
    *,
    task: ObjectCentricTask | None = None,
    limits: SearchLimits | None = None,
    guide: Guide[TaskState] | None = None,
    stable: bool = False,
) -> SearchResult[Plan]:
    """Search for an assembly from a random start; the same seed gives the same plan.

    Args:
        furniture: furniture that is assembled.
        seed: seed of the initial placement and of the planner.
        task: task of this furniture, whose cached results are reused; a new one if None.
        limits: limits at which the search gives up.
        guide: suggests merges; disassembly alone if None.
        stable: prefer orders in which few groups need a hand or a fixture, and return the stability of the plan's
            states. A guide knows nothing of stability and is not asked.
    """
    task = task or ObjectCentricTask(furniture)
    initial = task.initial_state(np.random.default_rng(seed))
    return solve_from(task, initial, seed, limits or SearchLimits(), guide, stable=stable)


def solve_from(
    task: ObjectCentricTask,
    initial: TaskState,
    seed: int,
    limits: SearchLimits,
    guide: Guide[TaskState] | None = None,
    watch: Watch | None = None,
    stable: bool = False,
) -> SearchResult[Plan]:
    """Search from a given state, in which equal parts may have swapped slots; see `solve`."""
    if task.pairs.assign_slots(initial) is None:
        nothing = Plan(task.furniture, initial.part_poses, (), False, seed)
        return SearchResult(nothing, 0, 0.0, 0, 0, _SAME_SLOTS)
    options, cost = (upright, None) if not stable else _preferring(StandCheck(task.furniture))
    search = Search(task, options, limits, seed, _STAGES[0], watch=watch, cost=cost, carry_out=task.step)
    success = search.run(initial, _STAGES, None if stable else guide)
    steps = tuple(step for step, _ in search.steps)
    plan = Plan(task.furniture, initial.part_poses, steps, success, seed)
    return search.result(with_stability(plan) if stable else plan, success)


def _preferring(stand_check: StandCheck) -> tuple[Options[TaskState], Callable[[Disassembly, Parts, Parts, bool], int]]:
    """Return the actions that join two groups, those that need no hand first, and the cost of a split in hands."""

    def cost(disassembly: Disassembly, leaving: Parts, staying: Parts, straight: bool) -> int:
        least = _NO_WAY
        for way in join_options(disassembly, leaving, staying, straight):
            least = min(least, way.unstable(stand_check))
            if least == 0:
                break
        return least

    return partial(upright, stand_check=stand_check), cost
