"""How much order matters: right merges in random order, each in its best way, until done or stuck."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.solvers.options import End, ends
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState


@dataclass(frozen=True, eq=False)
class RandomOrderResult:
    """How one random play ended."""

    completed: bool
    merges: int
    planning_steps: int
    planning_seconds: float


def assemble_in_random_order(
    task: ObjectCentricTask, seed: int, *, best_w: bool, patient: bool, budget: Budget
) -> RandomOrderResult:
    """Play right pairs in random order from a random start.

    Args:
        task: of the furniture.
        seed: of the start and of all choices.
        best_w: try all `w` for the drawn pair, and either group moving; else one random way.
        patient: if the drawn pair cannot be joined, draw another; the play is stuck when none can. Else the first
            pair that cannot be joined ends the play, as it ends an episode.
        budget: of the planner for each merge.
    """
    rng = np.random.default_rng(seed)
    state = task.initial_state(rng)
    merges = steps = 0
    seconds = 0.0
    while not state.complete:
        after = None
        joints = _open_joints(task, state)
        for index in rng.permutation(len(joints))[: None if patient else 1]:
            for action in _ways(joints[index], rng, best_w):
                outcome = task.step(state, action, int(rng.integers(2**31)), budget)
                steps += outcome.planning_steps
                seconds += outcome.planning_seconds
                if outcome.verdict is ObjectCentricVerdict.MERGED:
                    after = outcome.state
                    break
            if after is not None:
                break
        if after is None:
            return RandomOrderResult(False, merges, steps, seconds)
        state, merges = after, merges + 1
    return RandomOrderResult(True, merges, steps, seconds)


def _open_joints(task: ObjectCentricTask, state: TaskState) -> list[tuple[End, End]]:
    """One right pair of points for each connection that is not closed yet."""
    told = task.pairs.assign_slots(state)
    if told is None:
        return []
    joints: list[tuple[End, End]] = []
    for one, two in combinations(told.groups, 2):
        joints.extend(ends(task.furniture, state, told, frozenset(one.slots), frozenset(two.slots)))
    return joints


def _ways(joint: tuple[End, End], rng: np.random.Generator, best_w: bool) -> list[tuple[int, ...]]:
    """Actions that join at these two points: all in random order, or one."""
    (a, k), (b, l) = joint  # noqa: E741
    ways = [(u, v, i, j, w) for w in range(len(UP_AXES)) for u, i, v, j in ((a, k, b, l), (b, l, a, k))]
    order = rng.permutation(len(ways))
    return [ways[i] for i in (order if best_w else order[:1])]
