"""Evaluates a policy or a solver on a set of furniture."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import Any

import numpy as np

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.errors import RoboAssemblyError
from roboassembly.evaluation.episodes import Episode
from roboassembly.evaluation.rollout import Agent, RolloutConfig, make_agent
from roboassembly.parallel.processes import one_thread_each, worker_pool
from roboassembly.settings import SETTINGS
from roboassembly.statistics import success


@dataclass(frozen=True)
class Evaluation:
    """Episodes of one configuration on one set, and their summary."""

    config: RolloutConfig
    set: str
    seed: int
    episodes: tuple[Episode, ...]
    """One or more."""

    def to_json(self) -> dict[str, Any]:
        """Return success with its 95 % Wilson interval over episodes, and effort, over all and over the solved.

        `unseen` is the success over families that occur in no training; None if the set does not know them. `planned`
        is the share that was planned, where plans are carried out as well; `failures` counts what ended the failed
        episodes with robots.
        """
        solved = [e for e in self.episodes if e.success]
        unseen = [e for e in self.episodes if e.unseen]
        merges = [seconds for e in self.episodes for seconds in e.step_seconds]
        config = self.config
        more: dict[str, Any] = {}
        if config.execution == "dynamic":
            more["planned"] = success([e.executed is not None for e in self.episodes])
        more |= SETTINGS[config.setting].failures((e.verdict, e.stage) for e in self.episodes if not e.success)
        if config.audit:
            more["violations"] = sum(e.violations or 0 for e in self.episodes)
        return {
            "policy": config.policy if isinstance(config.policy, str) else config.policy.name,
            "search": config.search,
            "setting": config.setting,
            "execution": config.execution,
            **asdict(config.observes),
            "tries": config.tries,
            "meshes": config.tells_meshes,
            "set": self.set,
            "seed": self.seed,
            **success([e.success for e in self.episodes]),
            **more,
            "planning_steps_mean": _mean([e.planning_steps for e in self.episodes]),
            "planning_steps_mean_solved": _mean([e.planning_steps for e in solved]),
            "planning_seconds_mean": _mean([e.planning_seconds for e in self.episodes]),
            "merge_seconds_median": median(merges) if merges else None,
            "policy_seconds_mean": _mean([e.policy_seconds for e in self.episodes]),
            "unseen": None if all(e.unseen is None for e in self.episodes) else success([e.success for e in unseen]),
            "per_furniture": [vars(e) for e in self.episodes],
        }


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def episode_seed(seed: int, name: str, episode: int) -> int:
    """Return the seed of one episode; it depends on the piece's name, not on the rest of the set."""
    state = np.random.SeedSequence([seed, zlib.crc32(name.encode()), episode]).generate_state(1)
    return int(state[0] >> 1)


def evaluate(
    config: RolloutConfig, refs: Sequence[FurnitureRef], seed: int, jobs: int, *, episodes: int = 1, done: int = 0
) -> Iterator[Episode]:
    """Run episodes of each piece, in order. Only times depend on `jobs`; nothing depends on the rest of the set.

    Args:
        config: how episodes are run; a policy object must be picklable if there are several jobs.
        refs: the pieces.
        seed: seed of all; episode `i` of a piece has the seed `episode_seed(seed, its name, i)`.
        jobs: pieces at a time, each in a process of its own; in this process if 1.
        episodes: number of episodes of each piece.
        done: number of episodes, from the first, that are left out.

    Raises:
        UnknownNameError: no such policy.
        InputError: the policy or a piece cannot be used.
        MissingExtraError: an audit without python-fcl.
        RoboAssemblyError: a worker died.
    """
    agent = make_agent(config)
    left = [range(max(0, done - index * episodes), episodes) for index in range(len(refs))]
    work = [
        (ref, [episode_seed(seed, ref.name, i) for i in some]) for ref, some in zip(refs, left, strict=True) if some
    ]
    if jobs == 1 or not work:
        return (episode for ref, seeds in work for episode in _run_piece(agent, ref, seeds))
    return _run_in_processes(config, work, jobs)


def _run_in_processes(
    config: RolloutConfig, work: Sequence[tuple[FurnitureRef, list[int]]], jobs: int
) -> Iterator[Episode]:
    futures: list[Future[list[Episode]]] = []
    try:
        with worker_pool(min(jobs, len(work)), _start_worker, (config,)) as pool:
            with one_thread_each():
                futures = [pool.submit(_run_in_worker, ref, seeds) for ref, seeds in work]
            for future in futures:
                yield from future.result()
    except BrokenProcessPool:
        ended = sum(f.done() and not f.exception() for f in futures)
        missing = ", ".join(ref.name for (ref, _), f in zip(work, futures, strict=False) if f.exception())
        raise RoboAssemblyError(
            f"a worker process died (out of memory?) after {ended} of {len(work)} pieces; missing: {missing:.200}; "
            "fewer --jobs would take less memory, --jobs 1 would show which piece it was"
        ) from None


_worker: dict[str, Agent] = {}
"""Agent of this worker process."""


def _start_worker(config: RolloutConfig) -> None:
    _worker["agent"] = make_agent(config)


def _run_in_worker(ref: FurnitureRef, seeds: list[int]) -> list[Episode]:
    return _run_piece(_worker["agent"], ref, seeds)


def _run_piece(agent: Agent, ref: FurnitureRef, seeds: list[int]) -> list[Episode]:
    furniture = ref.furniture()
    known: dict[str, Any] = {}
    if ref.entry is not None:
        known = {"family": ref.entry.family, "unseen": ref.entry.unseen}
    return [replace(agent(furniture, seed), **known) for seed in seeds]
