"""How long an environment step takes: the rules of the task alone, without the observation."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from roboassembly.bench.merges import BenchChair
from roboassembly.furniture.model import Furniture
from roboassembly.task.groups import TaskState
from roboassembly.task.object_centric import UP_AXES

_WRONG_PAIRS = 10
"""Timed in each state of a plan."""
_RESETS = 10
"""Timed for each chair."""


@dataclass(frozen=True)
class StepTimes:
    """Medians, milliseconds."""

    wrong_pair_ms_median: float
    reset_ms_median: float
    right_merge_ms_median: float


def time_steps(chairs: Sequence[BenchChair], seed: int) -> StepTimes:
    """Time `ObjectCentricTask.step` on wrong and on right pairs, and `initial_state`."""
    wrong, reset, right = [], [], []
    for chair in chairs:
        task, rng = chair.task, np.random.default_rng(seed)
        reset += [_milliseconds(lambda task=task, rng=rng: task.initial_state(rng)) for _ in range(_RESETS)]
        for state, step in zip(chair.states, chair.result.plan.steps, strict=True):
            right.append(_milliseconds(lambda t=task, s=state, a=step.action: t.step(s, a, seed)))
            for _ in range(_WRONG_PAIRS):
                action = _random_action(chair.furniture, rng)
                if task.exists(state, action) and task.prepare(state, action) is None:
                    fresh = _copy(state)
                    wrong.append(_milliseconds(lambda t=task, s=fresh, a=action: t.step(s, a, seed)))
    return StepTimes(median(wrong), median(reset), median(right))


def _copy(state: TaskState) -> TaskState:
    """The state without what it has remembered: an environment meets each state once."""
    return TaskState(state.groups)


def _random_action(furniture: Furniture, rng: np.random.Generator) -> tuple[int, ...]:
    u, v = rng.choice(len(furniture.parts), size=2, replace=False).tolist()
    k, l = (int(rng.integers(len(furniture.parts[p].points))) for p in (u, v))  # noqa: E741
    return u, v, k, l, int(rng.integers(len(UP_AXES)))


def _milliseconds(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - begun)
