"""Times of the environment's reset and step, including observation and action mask."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

import numpy as np

from roboassembly.bench.merges import BenchChair
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.furniture.model import Furniture
from roboassembly.task.object_centric.task import ObjectCentricVerdict
from roboassembly.task.rules.connections import UP_AXES

_WRONG_PAIRS = 10
"""Number of wrong pairs tried in each state of a plan."""
_RESETS = 10
"""Number of timed resets of each chair; an untimed reset before them computes what is cached per piece."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class StepTimes:
    """Median times [ms]."""

    wrong_pair_ms_median: float
    """Median time of a step that names two free points of no connection."""
    reset_ms_median: float
    right_merge_ms_median: float
    """Median time of a step that merges: plan, join and settle."""


def time_steps(chairs: Sequence[BenchChair], seed: int) -> StepTimes:
    """Time the environment along the chairs' plans."""
    wrong: list[float] = []
    reset: list[float] = []
    right: list[float] = []
    for chair in chairs:
        env, rng = ObjectCentricEnv(chair.furniture), np.random.default_rng(seed)
        env.reset(seed=seed)
        reset += [_timed(env.reset)[1] for _ in range(_RESETS)]
        env.reset(seed=seed)
        done: list[tuple[int, ...]] = []
        for step in chair.result.plan.steps:
            # Each wrong pair ends its episode, so the plan is replayed up to the same state.
            for _ in range(_WRONG_PAIRS):
                action = _random_action(chair.furniture, rng)
                if env.task.exists(env.state, action) and env.task.prepare(env.state, action) is None:
                    wrong.append(_step(env, action)[1])
                    env.reset(seed=seed)
                    for merge in done:
                        env.step(np.array(merge))
            verdict, milliseconds = _step(env, step.action)
            if verdict != ObjectCentricVerdict.MERGED:
                break
            right.append(milliseconds)
            done.append(step.action)
        env.close()
    return StepTimes(median(wrong), median(reset), median(right))


def _step(env: ObjectCentricEnv, action: tuple[int, ...]) -> tuple[str, float]:
    """Return the verdict of a step and its time [ms]."""
    (_, _, _, _, info), milliseconds = _timed(lambda: env.step(np.array(action)))
    return info["verdict"], milliseconds


def _random_action(furniture: Furniture, rng: np.random.Generator) -> tuple[int, ...]:
    pair: list[int] = rng.choice(len(furniture.parts), size=2, replace=False).tolist()
    u, v = pair
    k, l = (int(rng.integers(len(furniture.parts[p].points))) for p in pair)  # noqa: E741
    return u, v, k, l, int(rng.integers(len(UP_AXES)))


def _timed(call: Callable[[], _T]) -> tuple[_T, float]:
    """Return the result of a call and its time [ms]."""
    begun = time.perf_counter()
    result = call()
    return result, 1e3 * (time.perf_counter() - begun)
