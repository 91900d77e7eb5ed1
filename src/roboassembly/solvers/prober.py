"""How much order matters: right merges in random order, each in its best way, until done or stuck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.planning.problem import Budget
from roboassembly.task.groups import TaskState, corresponding_point
from roboassembly.task.object_centric import ObjectCentricTask, Verdict
from roboassembly.task.rules import UP_AXES


@dataclass(frozen=True, eq=False)
class Probe:
    """How one random play ended."""

    completed: bool
    merges: int
    planning_steps: int
    planning_seconds: float


def probe(task: ObjectCentricTask, seed: int, *, best_w: bool, patient: bool, budget: Budget) -> Probe:
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
                if outcome.verdict is Verdict.MERGED:
                    after = outcome.state
                    break
            if after is not None:
                break
        if after is None:
            return Probe(False, merges, steps, seconds)
        state, merges = after, merges + 1
    return Probe(True, merges, steps, seconds)


_End = tuple[int, int]
"""Part and point."""


def _open_joints(task: ObjectCentricTask, state: TaskState) -> list[tuple[_End, _End]]:
    """One right pair of points for each connection that is not closed yet."""
    furniture = task.furniture
    part_in = {slot: part for g in state.groups for part, slot in zip(g.parts, g.slots, strict=True)}
    joints = []
    for c in furniture.connections:
        a, b = part_in[c.part_a], part_in[c.part_b]
        k = corresponding_point(furniture, c.part_a, c.point_a, a)
        l = corresponding_point(furniture, c.part_b, c.point_b, b)  # noqa: E741
        if state.group_of[a] != state.group_of[b] and k is not None and l is not None:
            joints.append(((a, k), (b, l)))
    return joints


def _ways(joint: tuple[_End, _End], rng: np.random.Generator, best_w: bool) -> list[tuple[int, ...]]:
    """Actions that join at these two points: all in random order, or one."""
    (a, k), (b, l) = joint  # noqa: E741
    ways = [(u, v, i, j, w) for w in range(len(UP_AXES)) for u, i, v, j in ((a, k, b, l), (b, l, a, k))]
    order = rng.permutation(len(ways))
    return [ways[i] for i in (order if best_w else order[:1])]
