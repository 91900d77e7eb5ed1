"""Tests of episodes that remember what they carried out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric.task import ObjectCentricOutcome, ObjectCentricTask
from roboassembly.task.rollout import RememberedTask, Stepping, rollout
from roboassembly.task.rules.groups import TaskState


@dataclass
class _Counting:
    """A task that counts what it carries out."""

    task: ObjectCentricTask
    carried_out: list[tuple[int, ...]] = field(default_factory=list)

    def initial_state(self, rng: np.random.Generator) -> TaskState:
        return self.task.initial_state(rng)

    def groups_of(self, state: TaskState) -> TaskState:
        return self.task.groups_of(state)

    def step(
        self, state: TaskState, action: tuple[int, ...], seed: int, budget: Budget | None = None
    ) -> ObjectCentricOutcome:
        self.carried_out.append(action)
        return self.task.step(state, action, seed, budget)


def _episode(
    task: RememberedTask[TaskState, ObjectCentricOutcome] | _Counting, actions: Sequence[tuple[int, ...]], seed: int
) -> tuple[list[tuple[str, bytes]], int]:
    """Verdict of each step with the poses after it, and what the generator draws next."""
    rng, left = np.random.default_rng(seed), iter(actions)
    steps: Stepping[TaskState, ObjectCentricOutcome] = task
    out: list[tuple[str, bytes]] = []
    for transition in rollout(steps, task.initial_state(rng), lambda _: [next(left)], rng):
        poses = [pose.homogeneous for pose in transition.outcome.state.part_poses]
        out.append((transition.outcome.verdict, np.array(poses).tobytes()))
    return out, int(rng.integers(1 << 30))


def test_a_remembered_episode_is_the_same_and_plans_only_what_differs(table: Furniture) -> None:
    plain = ObjectCentricTask(table)
    actions = [step.action for step in solve(table, 0).plan.steps]
    counting = _Counting(plain)
    known = RememberedTask(counting)
    whole = _episode(known, actions, 7)
    assert whole == _episode(_Counting(plain), actions, 7)
    assert len(counting.carried_out) == len(actions)

    assert _episode(known, actions, 7) == whole
    assert len(counting.carried_out) == len(actions)

    u, v, k, l, w = actions[2]  # noqa: E741
    other = [*actions[:2], (v, u, l, k, w)]
    assert _episode(known, other, 7) == _episode(_Counting(plain), other, 7)
    assert counting.carried_out[len(actions) :] == other[2:]

    # Another start, and other seeds of the planner.
    assert _episode(known, actions, 8) == _episode(_Counting(plain), actions, 8)
    assert counting.carried_out[len(actions) + 1 :] == actions
