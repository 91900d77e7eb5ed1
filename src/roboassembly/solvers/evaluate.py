"""How well a way of assembling does on a set of furniture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

from scipy.stats import binomtest

from roboassembly.errors import UnknownNameError
from roboassembly.furniture.datasets import Pick
from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.solvers.joint_rrt import solve_jointly
from roboassembly.solvers.prober import probe
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric import ObjectCentricTask


@dataclass(frozen=True)
class Episode:
    """One try at one piece."""

    furniture: str
    parts: int
    success: bool
    planning_steps: int
    planning_seconds: float


@dataclass(frozen=True)
class Evaluation:
    """What all episodes say together."""

    policy: str
    episodes: tuple[Episode, ...]

    def to_json(self) -> dict[str, object]:
        """Success with its 95 % Wilson interval, and planning effort, over all and over the solved."""
        n, solved = len(self.episodes), [e for e in self.episodes if e.success]
        interval = binomtest(len(solved), n).proportion_ci(0.95, method="wilson")
        return {
            "policy": self.policy,
            "n": n,
            "success_rate": len(solved) / n,
            "ci95": [round(float(interval.low), 4), round(float(interval.high), 4)],
            "planning_steps_mean": sum(e.planning_steps for e in self.episodes) / n,
            "planning_steps_mean_solved": sum(e.planning_steps for e in solved) / len(solved) if solved else None,
            "planning_seconds_mean": sum(e.planning_seconds for e in self.episodes) / n,
            "per_furniture": [vars(e) for e in self.episodes],
        }


def _search(furniture: Furniture, seed: int) -> Episode:
    result = solve(furniture, seed)
    return Episode(
        furniture.name, len(furniture.parts), result.plan.success, result.planning_steps, result.planning_seconds
    )


def _joint(furniture: Furniture, seed: int) -> Episode:
    result = solve_jointly(furniture, seed)
    solved = result.status is PlanningStatus.SOLVED
    return Episode(furniture.name, len(furniture.parts), solved, result.planning_steps, result.planning_seconds)


def _right_pairs(furniture: Furniture, seed: int, best_w: bool) -> Episode:
    task = ObjectCentricTask(furniture)
    play = probe(task, seed, best_w=best_w, patient=False, budget=Budget())
    return Episode(furniture.name, len(furniture.parts), play.completed, play.planning_steps, play.planning_seconds)


POLICIES: dict[str, Callable[[Furniture, int], Episode]] = {
    "search": _search,
    "joint-rrt": _joint,
    "right-pairs": partial(_right_pairs, best_w=True),
    "right-pairs-random-w": partial(_right_pairs, best_w=False),
}
"""`search` knows how the furniture comes apart; `joint-rrt` is the paper's baseline; `right-pairs` always takes a right
pair, in random order, with its best `w` or a random one: what is left to learn once pairs are known."""


def evaluate(policy: str, picks: Sequence[Pick], seed: int, jobs: int) -> Iterator[Episode]:
    """One episode for each piece, in order.

    Raises:
        UnknownNameError: no such policy.
    """
    if policy not in POLICIES:
        raise UnknownNameError("policy", policy, POLICIES)
    seeds = [seed + i for i in range(len(picks))]
    if jobs == 1:
        yield from map(play, [policy] * len(picks), picks, seeds)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(play, [policy] * len(picks), picks, seeds)


def play(policy: str, pick: Pick, seed: int) -> Episode:
    """One episode."""
    return POLICIES[policy](pick.furniture(), seed)
