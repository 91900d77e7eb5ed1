"""Robots' benchmark: paths of a mobile Panda that holds a group, ours and OMPL over PyBullet's Pandas, in one run.

- *States*: the same configurations, exact, by our world and by Bullet (`bench.pybullet_cell`).
- *Paths*: start and goal of every segment that is not a straight line. Ours certifies an edge in a
  few tests. The peer is OMPL's RRT-Connect with one Python callback for each state, every 20 mm and 20 mrad: ten times
  coarser than ours.
- *Steps*: whole steps, of merges that succeed and of right pairs that cannot be joined.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from roboassembly.bench.machine import Machine
from roboassembly.bench.pybullet_cell import BulletCell
from roboassembly.datasets import catalogue
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.furniture.model import Furniture
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import Configuration, Floor, configuration_space, connect
from roboassembly.planning.rrt import exhaustion, run_rrt_connect
from roboassembly.solvers.full_search import solve_full
from roboassembly.task.full.cell_state import Segment
from roboassembly.task.full.failure import FullVerdict, Stage
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.rollout import draw_seed

_STEP = 0.02
"""Distance between two states of the peer [m, rad]."""
_CAP = 20.0
"""Time after which the peer's planner is stopped [s]."""
_BUDGET = Budget(states=20_000)
_SEARCHED = frozenset({Stage.DRIVE_TO_GROUP, Stage.DRIVE_TO_MATE, Stage.CARRY, Stage.LEAVE})
"""Stages whose paths come from a search."""


@dataclass(frozen=True)
class Path:
    """One segment, planned by ours and by the peer."""

    segment: str
    ours_seconds: float
    ours_states: int
    ours_solved: bool
    theirs_seconds: float | None
    theirs_states: int | None
    theirs_solved: bool | None


@dataclass(frozen=True, eq=False)
class RobotBenchReport:
    """Results of the robots' benchmark."""

    furniture: str
    parts: int
    microseconds: dict[str, float]
    """Mean time of an exact collision test [µs], by backend."""
    agreement: float | None
    """Share of states for which Bullet and ours give the same result."""
    paths: tuple[Path, ...]
    step_seconds: tuple[float, ...]
    """Times of the merges of the plan [s]."""
    hopeless_seconds: tuple[float, ...]
    """Times of right pairs that cannot be joined [s]."""
    skipped: dict[str, str]
    seed: int
    machine: Machine

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, strings, lists and dictionaries."""
        both = [p for p in self.paths if p.theirs_seconds is not None]
        ratios = [p.theirs_seconds / p.ours_seconds for p in both if p.theirs_seconds is not None]
        return {
            "furniture": self.furniture,
            "parts": self.parts,
            "us_per_state": self.microseconds,
            "states_agree": self.agreement,
            "paths": len(self.paths),
            "path_seconds_median": {
                "ours": median(p.ours_seconds for p in self.paths),
                "pybullet": median(p.theirs_seconds or 0.0 for p in both) if both else None,
            },
            "path_states_median": {
                "ours": median(p.ours_states for p in self.paths),
                "pybullet": median(p.theirs_states or 0 for p in both) if both else None,
            },
            "path_solved": {
                "ours": sum(p.ours_solved for p in self.paths),
                "pybullet": sum(bool(p.theirs_solved) for p in both) if both else None,
            },
            "path_ratio_median": median(ratios) if ratios else None,
            "segments": {
                name: median(p.ours_seconds for p in self.paths if p.segment == name)
                for name in sorted({p.segment for p in self.paths})
            },
            "step_seconds_median": median(self.step_seconds),
            "assembly_seconds": sum(self.step_seconds),
            "hopeless_seconds_median": median(self.hopeless_seconds) if self.hopeless_seconds else None,
            "hopeless": len(self.hopeless_seconds),
            "skipped": self.skipped,
            "seed": self.seed,
            "machine": dataclasses.asdict(self.machine),
            "per_path": [dataclasses.asdict(p) for p in self.paths],
        }

    def to_text(self) -> str:
        """Return a few lines of text."""
        out = self.to_json()
        lines = [
            f"{self.furniture}, {self.parts} parts, {len(self.step_seconds)} merges, seed {self.seed}",
            f"{self.machine.cpu}, {self.machine.cores} cores, Python {self.machine.python}",
            "",
            *(f"{name:24}{us:8.1f} µs a state" for name, us in self.microseconds.items()),
            f"{'ours':24}{1e3 * out['path_seconds_median']['ours']:8.1f} ms a path, "
            f"{out['path_states_median']['ours']:.0f} states, "
            f"{out['path_solved']['ours']} of {out['paths']} found (medians)",
        ]
        if out["path_ratio_median"] is not None:
            lines.append(
                f"{'OMPL over PyBullet':24}{1e3 * out['path_seconds_median']['pybullet']:8.1f} ms a path, "
                f"{out['path_states_median']['pybullet']:.0f} states, {out['path_solved']['pybullet']} found; "
                f"{out['path_ratio_median']:.1f} times ours"
            )
        lines += [f"{name}: skipped, {why}" for name, why in self.skipped.items()]
        lines.append(
            f"a merge {out['step_seconds_median']:.2f} s, all of them {out['assembly_seconds']:.2f} s"
            + ("" if not self.hopeless_seconds else f"; a hopeless one {1e3 * out['hopeless_seconds_median']:.1f} ms")
        )
        return "\n".join(lines)


def run_robot_bench(
    name: str = "stool",
    *,
    seed: int = 0,
    states: int = 2_000,
    merges: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> RobotBenchReport:
    """Run the benchmark.

    Args:
        name: name of built-in furniture.
        seed: seed of the cell and the planners.
        states: number of configurations whose checks are timed.
        merges: number of merges, from the first, whose segments are planned; all if None.
        progress: receives a line from time to time.

    Raises:
        InputError: the furniture does not suit the cell, or is not assembled.
    """
    report: Callable[[str], None] = progress or (lambda line: None)
    furniture = catalogue.find(name)
    report("searching an assembly")
    result = solve_full(furniture, seed)
    if not result.plan.success:
        raise InputError(f"{furniture.name} is not assembled by two robots with seed {seed}: {result.reason}")
    skipped: dict[str, str] = {}
    bullet: BulletCell | None = None
    try:
        bullet = BulletCell()
    except MissingExtraError as error:
        skipped["pybullet"] = str(error)
    try:
        steps = result.plan.steps[:merges]
        segments = [segment for step in steps for segment in step.segments if segment.stage in _SEARCHED]
        report("timing states")
        microseconds, agreement = _states(furniture, segments, states, bullet, seed)
        paths: list[Path] = []
        for count, segment in enumerate(segments):
            report(f"path {count + 1} of {len(segments)}")
            paths.append(_path(furniture, result.plan, segment, bullet, seed))
    finally:
        if bullet is not None:
            bullet.close()
    report("hopeless merges")
    hopeless = _hopeless(furniture, result.plan, seed)
    return RobotBenchReport(
        furniture.name, len(furniture.parts), microseconds, agreement, tuple(paths),
        tuple(s.planning_seconds for s in result.plan.steps), hopeless, skipped, seed, Machine.here(),
    )  # fmt: skip


def _states(
    furniture: Furniture, segments: list[Segment], count: int, bullet: BulletCell | None, seed: int
) -> tuple[dict[str, float], float | None]:
    """Return the time per state [µs], on configurations around paths of loaded segments."""
    rng = np.random.default_rng(seed)
    loaded = [segment for segment in segments if segment.before.robots[segment.robot].payload is not None] or segments
    share = max(1, count // len(loaded))
    ours = theirs = 0.0
    same = total = 0
    for segment in loaded:
        a, b = segment.path[0], segment.path[-1]
        q = a + rng.random((share, 1)) * (b - a) + rng.normal(0.0, 0.15, (share, len(a)))
        world = segment.before.world(furniture, segment.robot)
        world.free(q)  # sets up, as `set_up` does for Bullet
        begun = time.perf_counter()
        free = world.free(q)
        ours += time.perf_counter() - begun
        total += share
        if bullet is not None:
            is_free = bullet.set_up(furniture, segment)
            begun = time.perf_counter()
            answers = [is_free(c) for c in q]
            theirs += time.perf_counter() - begun
            same += int((np.array(answers) == free).sum())
    out = {"ours": 1e6 * ours / total}
    if bullet is None:
        return out, None
    return {**out, "pybullet": 1e6 * theirs / total}, same / total


def _path(furniture: Furniture, plan: FullPlan, segment: Segment, bullet: BulletCell | None, seed: int) -> Path:
    start, goal = segment.path[0], segment.path[-1]
    floor = Floor(plan.initial.cell.floor)
    begun = time.perf_counter()
    world = segment.before.world(furniture, segment.robot)
    found = connect(world, start, goal, floor, _BUDGET, seed)
    ours = time.perf_counter() - begun
    if bullet is None:
        return Path(segment.name, ours, world.states, found is not None, None, None, None)
    begun = time.perf_counter()
    is_free = bullet.set_up(furniture, segment)
    count = 0

    def counted(q: Configuration) -> bool:
        nonlocal count
        count += 1
        return is_free(q)

    def edge(a: Configuration, b: Configuration) -> bool:
        steps = max(1, int(np.ceil(np.abs(b - a).max() / _STEP)))
        return all(counted(a + (b - a) * i / steps) for i in range(1, steps + 1))

    space, state, read = configuration_space(start, goal, floor)
    solved = run_rrt_connect(
        space, state(start), [state(goal)], lambda a, b: edge(read(a), read(b)), lambda s: counted(read(s)),
        exhaustion(lambda: count, Budget(1_000_000, _CAP), begun), seed, None,
    )  # fmt: skip
    return Path(
        segment.name, ours, world.states, found is not None, time.perf_counter() - begun, count, solved is not None
    )


def _hopeless(furniture: Furniture, plan: FullPlan, seed: int, tries: int = 60) -> tuple[float, ...]:
    """Time right pairs of the first state with random grasps; returns the times of those that fail [s]."""
    task, rng = FullTask(furniture), np.random.default_rng(seed)
    out: list[float] = []
    for _ in range(tries):
        c = furniture.connections[int(rng.integers(len(furniture.connections)))]
        pair = (c.part_a, c.part_b, c.point_a, c.point_b)
        ordered = pair if rng.random() < 0.5 else (pair[1], pair[0], pair[3], pair[2])
        grasps: list[int] = rng.integers(8, size=2).tolist()
        outcome = task.step(plan.initial, (*ordered, *grasps), draw_seed(rng))
        if outcome.verdict not in (FullVerdict.MERGED, FullVerdict.NOT_AN_ACTION):
            out.append(outcome.planning_seconds)
    return tuple(out)
