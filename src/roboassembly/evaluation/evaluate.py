"""How well a policy, or a solver, does on a set of furniture."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.errors import RoboAssemblyError
from roboassembly.evaluation.rollout import Agent, Episode, RolloutConfig, make_agent
from roboassembly.parallel.processes import one_thread_each, worker_pool
from roboassembly.statistics import success
from roboassembly.task.full.failure import AFTER_MATING, FullVerdict

KINDS = {
    FullVerdict.WRONG_PAIR: "wrong pair", FullVerdict.GRASP_BLOCKED: "grasp blocked",
    FullVerdict.CANNOT_RELEASE: "grasp blocked", FullVerdict.NO_ARM_SOLUTION: "no arm solution",
    FullVerdict.JOINT_BLOCKED: "mating path", FullVerdict.NO_PLACEMENT: "placing",
}  # fmt: skip
"""What ended an episode with robots, told coarsely."""


@dataclass(frozen=True)
class Evaluation:
    """What all episodes say together."""

    way: RolloutConfig
    set: str
    seed: int
    episodes: tuple[Episode, ...]
    """At least one."""

    def to_json(self) -> dict[str, Any]:
        """Success with its 95 % Wilson interval over episodes, and effort, over all and over the solved.

        `unseen` is the same success over families that occur in no training; None if the set does not know them.
        `planned` is the share that was planned, where plans were carried out besides; `failures` what ended the others
        with robots.
        """
        solved = [e for e in self.episodes if e.success]
        unseen = [e for e in self.episodes if e.unseen]
        merges = [seconds for e in self.episodes for seconds in e.step_seconds]
        way = self.way
        more: dict[str, Any] = {}
        if way.execution == "dynamic":
            more["planned"] = success([e.executed is not None for e in self.episodes])
        if way.setting == "full":
            more["failures"] = dict(Counter(failure_of(e) for e in self.episodes if not e.success).most_common())
        if way.audit:
            more["violations"] = sum(e.violations or 0 for e in self.episodes)
        return {
            "policy": way.policy if isinstance(way.policy, str) else way.policy.name,
            "search": way.search,
            "setting": way.setting,
            "execution": way.execution,
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


def failure_of(episode: Episode) -> str:
    """What ended an episode with robots that did not succeed: one of `KINDS`, `path`, or its verdict."""
    verdict = episode.verdict
    if verdict == FullVerdict.NO_PATH:
        return "placing" if episode.stage in AFTER_MATING else "path"
    return next((kind for known, kind in KINDS.items() if verdict == known), verdict.replace("_", " "))


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def episode_seed(seed: int, name: str, episode: int) -> int:
    """The seed of one episode: from the piece's name, so that what else is in the set does not matter."""
    words = np.random.SeedSequence([seed, zlib.crc32(name.encode()), episode]).generate_state(1)
    return int(words[0] >> 1)


def evaluate(
    way: RolloutConfig, picks: Sequence[FurnitureRef], seed: int, jobs: int, *, episodes: int = 1, played: int = 0
) -> Iterator[Episode]:
    """Play episodes of each piece, in order. Nothing but times depends on `jobs`, nor on what else is in the set.

    Args:
        way: how; a policy of your own has to survive pickling if there are several jobs.
        picks: the pieces.
        seed: of all; episode `i` of a piece has the seed `episode_seed(seed, its name, i)`.
        jobs: pieces at a time, each in a process of its own; in this process if 1.
        episodes: of each piece.
        played: so many of all episodes, the first ones, are left out.

    Raises:
        UnknownNameError: no such policy.
        InputError: the policy or a piece is of no use.
        MissingExtraError: an audit without python-fcl.
        RoboAssemblyError: a worker died.
    """
    own = make_agent(way)
    left = [range(max(0, played - index * episodes), episodes) for index in range(len(picks))]
    work = [
        (pick, [episode_seed(seed, pick.name, i) for i in some]) for pick, some in zip(picks, left, strict=True) if some
    ]
    if jobs == 1 or not work:
        return (episode for pick, seeds in work for episode in _play_piece(own, pick, seeds))
    return _in_processes(way, work, jobs)


def _in_processes(way: RolloutConfig, work: Sequence[tuple[FurnitureRef, list[int]]], jobs: int) -> Iterator[Episode]:
    futures: list[Future[list[Episode]]] = []
    try:
        with worker_pool(min(jobs, len(work)), _start, (way,)) as pool:
            with one_thread_each():
                futures = [pool.submit(_play_here, pick, seeds) for pick, seeds in work]
            for future in futures:
                yield from future.result()
    except BrokenProcessPool:
        done = sum(f.done() and not f.exception() for f in futures)
        late = ", ".join(pick.name for (pick, _), f in zip(work, futures, strict=False) if f.exception())
        raise RoboAssemblyError(
            f"a worker process died (out of memory?) after {done} of {len(work)} pieces, among them not: {late:.200}; "
            "fewer --jobs would take less memory, --jobs 1 would show which piece it was"
        ) from None


_here: dict[str, Agent] = {}
"""Of a worker process: what it plays with."""


def _start(way: RolloutConfig) -> None:
    _here["agent"] = make_agent(way)


def _play_here(pick: FurnitureRef, seeds: list[int]) -> list[Episode]:
    return _play_piece(_here["agent"], pick, seeds)


def _play_piece(own: Agent, pick: FurnitureRef, seeds: list[int]) -> list[Episode]:
    furniture = pick.furniture()
    known: dict[str, Any] = {}
    if pick.entry is not None:
        known = {"family": pick.entry.family, "unseen": pick.entry.unseen}
    return [replace(own(furniture, seed), **known) for seed in seeds]
