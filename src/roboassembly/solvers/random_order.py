"""Random-order baseline: joins right pairs in random order until the furniture is complete or no pair can be joined.

It measures how much the order of the merges matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.solvers.options import End, ends
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rollout import Action, rollout
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import TaskState


@dataclass(frozen=True, eq=False)
class RandomOrderResult:
    """Result of one episode of the baseline."""

    completed: bool
    merges: int
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float


def assemble_in_random_order(
    task: ObjectCentricTask, seed: int, *, best_w: bool, patient: bool, budget: Budget
) -> RandomOrderResult:
    """Join right pairs in random order from a random start.

    Args:
        task: rules for the furniture.
        seed: seed of the start and of all choices.
        best_w: try all `w` for the drawn pair, and either group moving; else one random action.
        patient: draw another pair if the drawn one cannot be joined; the episode ends when none can. Otherwise the
            first pair that cannot be joined ends the episode.
        budget: limit of the planner for each merge.
    """
    rng = np.random.default_rng(seed)

    def propose(state: TaskState) -> Iterator[Action]:
        pairs = _open_pairs(task, state)
        for index in rng.permutation(len(pairs))[: None if patient else 1]:
            yield from _actions(pairs[int(index)], rng, best_w)

    tried = list(rollout(task, task.initial_state(rng), propose, rng, budget))
    return RandomOrderResult(
        bool(tried) and tried[-1].outcome.state.complete,
        sum(t.merged for t in tried),
        sum(t.outcome.planning_steps for t in tried),
        sum(t.outcome.planning_seconds for t in tried),
    )


def _open_pairs(task: ObjectCentricTask, state: TaskState) -> list[tuple[End, End]]:
    """Return one right pair of points for each connection that is not closed yet."""
    assigned = task.pairs.assign_slots(state)
    if assigned is None:
        return []
    pairs: list[tuple[End, End]] = []
    for first, second in combinations(assigned.groups, 2):
        pairs.extend(ends(task.furniture, state, assigned, frozenset(first.slots), frozenset(second.slots)))
    return pairs


def _actions(pair: tuple[End, End], rng: np.random.Generator, best_w: bool) -> list[Action]:
    """Return the actions that join two points: all in random order, or one."""
    (a, k), (b, l) = pair  # noqa: E741
    actions = [(u, v, i, j, w) for w in range(len(UP_AXES)) for u, i, v, j in ((a, k, b, l), (b, l, a, k))]
    order = rng.permutation(len(actions))
    return [actions[i] for i in (order if best_w else order[:1])]
