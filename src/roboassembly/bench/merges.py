"""Planning problems of the benchmark: every merge of a few chairs, set up as in the task."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from jaxtyping import Float

from roboassembly.errors import InputError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance
from roboassembly.generate import generate
from roboassembly.geometry.scene import Scene
from roboassembly.planning.mating import SKY_CLEARANCE, MatingProblem
from roboassembly.planning.world import CollisionWorld
from roboassembly.solvers.search import SearchResult, solve
from roboassembly.task.object_centric.task import Mating, ObjectCentricTask
from roboassembly.task.plans.plan import Plan
from roboassembly.task.rules.groups import TaskState

_SEEDS_TRIED = 500
"""Number of generator seeds that are tried to find a chair with a given number of parts."""


@dataclass(frozen=True, eq=False)
class BenchChair:
    """A chair, solved once."""

    furniture: Furniture
    task: ObjectCentricTask
    result: SearchResult[Plan]
    wall_seconds: float
    """Wall time of the whole search, including what is computed once per piece [s]."""
    states: tuple[TaskState, ...]
    """States before each step of the plan."""


@dataclass(frozen=True, eq=False)
class BenchMerge:
    """One planning problem, in the forms for our planner and for the peers."""

    chair: BenchChair
    index: int
    """Index of the step in the chair's plan."""
    mating: Mating
    seed: int
    scene: Scene
    """Scene from which `ObjectCentricTask.plan` makes a `CollisionWorld`."""
    box_axes: Float[np.ndarray, "3 3"]
    problem: MatingProblem
    bounds: Float[np.ndarray, "2 3"]
    """Lowest and highest position of the moving body's origin in a tree search [m], world frame."""

    def world(self) -> CollisionWorld:
        """Return a new collision world of the merge."""
        return CollisionWorld(self.scene, box_axes=self.box_axes)


def find_chairs(family: str, parts: int, chairs: int, seed: int) -> tuple[BenchChair, ...]:
    """Return the first `chairs` chairs of the family with that many parts, by generator seed, each solved.

    Raises:
        InputError: the family has too few of them.
    """
    found: list[BenchChair] = []
    for variant in count():
        if len(found) == chairs:
            return tuple(found)
        if variant == _SEEDS_TRIED:
            raise InputError(
                f"family '{family}' has {len(found)} solvable chairs of {parts} parts among its first {variant} "
                f"variants, {chairs} were asked for; ask for fewer, or for another number of parts"
            )
        raw = generate(family, variant)
        if len(raw) != parts:
            continue
        furniture = annotate(f"{family}-{variant}", raw, Provenance("generated", f"{family}-{variant}"))
        chair = _solved(furniture, seed)
        if chair is not None:
            found.append(chair)
    raise AssertionError("unreachable: count() is endless")


def _solved(furniture: Furniture, seed: int) -> BenchChair | None:
    task = ObjectCentricTask(furniture)
    begun = time.perf_counter()
    result = solve(furniture, seed, task=task)
    wall_seconds = time.perf_counter() - begun
    if not result.plan.success:
        return None
    state = task.initial_state(np.random.default_rng(seed))
    states: list[TaskState] = []
    for index, step in enumerate(result.plan.steps):
        states.append(state)
        state = task.step(state, step.action, _seed(seed, index)).state
    return BenchChair(furniture, task, result, wall_seconds, tuple(states))


def merges_of(chair: BenchChair, seed: int) -> Iterator[BenchMerge]:
    """Yield the chair's merges in the order of its plan."""
    for index, (state, step) in enumerate(zip(chair.states, chair.result.plan.steps, strict=True)):
        mating = chair.task.prepare(state, step.action)
        if mating is not None:
            yield _set_up(chair, index, mating, _seed(seed, index))


def _seed(seed: int, index: int) -> int:
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def _set_up(chair: BenchChair, index: int, mating: Mating, seed: int) -> BenchMerge:
    scene, turn, problem = chair.task.planning_problem(mating)
    world = CollisionWorld(scene, box_axes=turn)
    return BenchMerge(chair, index, mating, seed, scene, turn, problem, _bounds(world, problem))


def _bounds(world: CollisionWorld, problem: MatingProblem) -> Float[np.ndarray, "2 3"]:
    """Return the bounds of the tree search in `plan_mating`."""
    ends = np.array([problem.start.translation, problem.goal.translation])
    extent = world.radius + 0.1
    low, high = ends.min(axis=0) - extent, ends.max(axis=0) + extent
    sky = world.top + world.radius + SKY_CLEARANCE
    return np.array([[low[0], low[1], 0.0], [high[0], high[1], max(sky, high[2])]])
