"""How well a policy, or a solver, does on a set of furniture."""

from __future__ import annotations

import math
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError, RoboAssemblyError, UnknownNameError
from roboassembly.furniture.datasets import Pick
from roboassembly.furniture.model import Furniture
from roboassembly.learning.loading import NAMES, load_policy
from roboassembly.learning.policies import RANDOM, Policy, RandomPolicy, guide_of
from roboassembly.learning.processes import one_thread_each
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.joint_rrt import solve_jointly
from roboassembly.solvers.prober import probe
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric import ObjectCentricTask, Verdict
from roboassembly.task.plan import Plan, PlanStep

_Z = 1.959963984540054
"""97.5 % of a standard normal distribution lies below."""


@dataclass(frozen=True)
class Episode:
    """One try at one piece."""

    furniture: str
    parts: int
    seed: int
    """Of the start, and of all that is drawn; `reset(seed=...)` of the environment."""
    success: bool
    merges: int
    verdict: str
    """How the last step ended (`task.object_centric.Verdict`); of a solver: `merged`, or why it did not get there."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float
    policy_seconds: float = 0.0
    """Time that the policy took to choose."""
    actions: tuple[tuple[int, ...], ...] = ()
    """`(u, v, k, l, w)` of each step, where the way of assembling has such."""
    family: str = ""
    """Empty if the set does not know."""
    unseen: bool | None = None
    """Whether the family occurs in no training; None if the set does not know."""


@dataclass(frozen=True)
class Evaluation:
    """What all episodes say together."""

    policy: str
    set: str
    seed: int
    episodes: tuple[Episode, ...]
    """At least one."""
    search: bool = False
    """Whether the policy guided the search instead of playing alone."""

    def to_json(self) -> dict[str, Any]:
        """Success with its 95 % Wilson interval over episodes, and effort, over all and over the solved.

        `unseen` is the same success over families that occur in no training; None if the set does not know them.
        """
        solved = [e for e in self.episodes if e.success]
        unseen = [e for e in self.episodes if e.unseen]
        return {
            "policy": self.policy,
            "search": self.search,
            "set": self.set,
            "seed": self.seed,
            **success([e.success for e in self.episodes]),
            "planning_steps_mean": _mean([e.planning_steps for e in self.episodes]),
            "planning_steps_mean_solved": _mean([e.planning_steps for e in solved]),
            "planning_seconds_mean": _mean([e.planning_seconds for e in self.episodes]),
            "policy_seconds_mean": _mean([e.policy_seconds for e in self.episodes]),
            "unseen": None if all(e.unseen is None for e in self.episodes) else success([e.success for e in unseen]),
            "per_furniture": [vars(e) for e in self.episodes],
        }


def success(outcomes: Sequence[bool]) -> dict[str, Any]:
    """How many, the share that succeeded, and its 95 % Wilson interval; None of none."""
    n, solved = len(outcomes), sum(outcomes)
    if not n:
        return {"n": 0, "success_rate": None, "ci95": None}
    low, high = wilson(solved, n)
    return {"n": n, "success_rate": solved / n, "ci95": [round(low, 4), round(high, 4)]}


def wilson(solved: int, n: int) -> tuple[float, float]:
    """The 95 % interval of a share of n > 0 (Wilson 1927)."""
    p, weight = solved / n, _Z**2 / n
    middle, half = p + weight / 2.0, _Z * math.sqrt(p * (1.0 - p) / n + weight / (4.0 * n))
    return max(0.0, (middle - half) / (1.0 + weight)), min(1.0, (middle + half) / (1.0 + weight))


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


@dataclass(frozen=True, eq=False)
class Play:
    """What a policy did alone."""

    plan: Plan
    """Its merges; not a success if it failed."""
    actions: tuple[tuple[int, ...], ...]
    """One more than merges if it failed."""
    verdict: str
    """Of the last step."""
    planning_steps: int
    planning_seconds: float
    policy_seconds: float


def play(policy: Policy, furniture: Furniture, seed: int) -> Play:
    """Let a policy play one episode of the environment, by `reset` and `step` alone."""
    env = ObjectCentricEnv(furniture, cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=seed)
    initial = env.state.part_poses
    actions: list[tuple[int, ...]] = []
    merges: list[PlanStep] = []
    states, planning, thinking, over = 0, 0.0, 0.0, False
    while not over:
        begun = time.perf_counter()
        action = policy.act(observation, info["action_mask"])
        thinking += time.perf_counter() - begun
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        actions.append(tuple(int(a) for a in action))
        states += info["planning_steps"]
        outcome = env.last_outcome
        if outcome is not None:
            planning += outcome.planning_seconds
            merges += [outcome.step] if outcome.step is not None else []
    plan = Plan(furniture, initial, tuple(merges), bool(info["success"]), seed)
    return Play(plan, tuple(actions), info["verdict"], states, planning, thinking)


def play_episode(policy: Policy, furniture: Furniture, seed: int) -> Episode:
    """One episode of a policy, your own included."""
    done = play(policy, furniture, seed)
    return Episode(
        furniture.name, len(furniture.parts), seed, done.plan.success, len(done.plan.steps), done.verdict,
        done.planning_steps, done.planning_seconds, done.policy_seconds, done.actions,
    )  # fmt: skip


def _search(furniture: Furniture, seed: int, guide: Guide | None = None) -> Episode:
    result = solve(furniture, seed, guide=guide)
    plan = result.plan
    return Episode(
        furniture.name, len(furniture.parts), seed, plan.success, len(plan.steps),
        Verdict.MERGED.value if plan.success else "no_plan", result.planning_steps, result.planning_seconds,
        result.guide_seconds, tuple(step.action for step in plan.steps),
    )  # fmt: skip


def _joint(furniture: Furniture, seed: int) -> Episode:
    result = solve_jointly(furniture, seed)
    parts, solved = len(furniture.parts), result.status is PlanningStatus.SOLVED
    verdict = Verdict.MERGED.value if solved else result.status.value
    merges = (parts - 1) * solved
    return Episode(furniture.name, parts, seed, solved, merges, verdict, result.planning_steps, result.planning_seconds)


def _right_pairs(furniture: Furniture, seed: int, best_w: bool) -> Episode:
    play = probe(ObjectCentricTask(furniture), seed, best_w=best_w, patient=False, budget=Budget())
    verdict = Verdict.MERGED.value if play.completed else "stuck"
    return Episode(
        furniture.name, len(furniture.parts), seed, play.completed, play.merges, verdict, play.planning_steps,
        play.planning_seconds,
    )  # fmt: skip


Player = Callable[[Furniture, int], Episode]
SOLVERS: dict[str, Player] = {
    "search": _search,
    "joint-rrt": _joint,
    "right-pairs": partial(_right_pairs, best_w=True),
    "right-pairs-random-w": partial(_right_pairs, best_w=False),
}
"""`search` knows how the furniture comes apart; `joint-rrt` is the paper's baseline; `right-pairs` always takes a right
pair, in random order, with its best `w` or a random one: what is left to learn once pairs are known."""
EXPORTABLE = ("search",)
"""Solvers whose episodes tell their actions."""


def player(policy: str | Policy, search: bool = False) -> Player:
    """What plays an episode.

    Args:
        policy: a solver's name, a policy's, the path of a checkpoint, or a policy.
        search: the policy guides the search; else it plays alone.

    Raises:
        UnknownNameError: no such policy.
        InputError: the checkpoint is of no use, or what is named cannot guide the search.
    """
    if isinstance(policy, str):
        if policy in SOLVERS:
            if search:
                raise InputError(f"'{policy}' cannot guide the search; a policy that values actions would do")
            return SOLVERS[policy]
        if policy == RANDOM and not search:
            # Fresh in each episode: what it draws must not depend on what the worker has played before.
            return lambda furniture, seed: play_episode(RandomPolicy(np.random.default_rng([seed, 1])), furniture, seed)
        try:
            policy = load_policy(policy)
        except UnknownNameError:
            raise UnknownNameError("policy", str(policy), [*SOLVERS, *NAMES, "PATH.npz"]) from None
    if search:
        return partial(_search, guide=guide_of(policy))
    return partial(play_episode, policy)


def episode_seed(seed: int, name: str, episode: int) -> int:
    """The seed of one episode: from the piece's name, so that what else is in the set does not matter."""
    words = np.random.SeedSequence([seed, zlib.crc32(name.encode()), episode]).generate_state(1)
    return int(words[0] >> 1)


def evaluate(
    policy: str | Policy, picks: Sequence[Pick], seed: int, jobs: int, *, episodes: int = 1, search: bool = False
) -> Iterator[Episode]:
    """Play episodes of each piece, in order. Nothing but times depends on `jobs`, nor on what else is in the set.

    Args:
        policy: as for `player`; one of your own has to survive pickling if there are several jobs.
        picks: the pieces.
        seed: of all; episode `i` of a piece has the seed `episode_seed(seed, its name, i)`.
        jobs: pieces at a time, each in a process of its own; in this process if 1.
        episodes: of each piece.
        search: the policy guides the search.

    Raises:
        UnknownNameError: no such policy.
        InputError: the policy or a piece is of no use.
        RoboAssemblyError: a worker died.
    """
    own = player(policy, search)
    work = [(pick, [episode_seed(seed, pick.name, i) for i in range(episodes)]) for pick in picks]
    if jobs == 1:
        return (episode for pick, seeds in work for episode in _play_piece(own, pick, seeds))
    return _in_processes(policy, search, work, jobs)


def _in_processes(
    policy: str | Policy, search: bool, work: Sequence[tuple[Pick, list[int]]], jobs: int
) -> Iterator[Episode]:
    # Spawned, because a fork would share the planner's and the renderer's threads.
    futures: list[Future[list[Episode]]] = []
    pool = ProcessPoolExecutor(min(jobs, len(work)), get_context("spawn"), _start, (policy, search))
    try:
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
    finally:
        pool.shutdown(cancel_futures=True)


_here: dict[str, Player] = {}
"""Of a worker process: what it plays with."""


def _start(policy: str | Policy, search: bool) -> None:
    _here["player"] = player(policy, search)


def _play_here(pick: Pick, seeds: list[int]) -> list[Episode]:
    return _play_piece(_here["player"], pick, seeds)


def _play_piece(own: Player, pick: Pick, seeds: list[int]) -> list[Episode]:
    furniture = pick.furniture()
    known: dict[str, Any] = {}
    if pick.entry is not None:
        known = {"family": pick.entry.family, "unseen": pick.entry.unseen}
    return [replace(own(furniture, seed), **known) for seed in seeds]
