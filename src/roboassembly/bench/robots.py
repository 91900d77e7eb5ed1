"""Robots' benchmark: paths of a mobile Panda that holds a group, ours and those of peers, in one run.

- *States*: the same configurations, exact, by our world, by Bullet (`bench.pybullet_cell`) and by RoboPlan
  (`bench.roboplan_cell`).
- *Paths*: start and goal of every segment that is not a straight line. Ours certifies an edge in a few tests, in the
  end every 2 mm, keeps 4 mm from everything, and shortens the path. The first peer is OMPL's RRT-Connect with one
  Python callback for each state of Bullet, every 20 mm and 20 mrad. The second is RoboPlan's RRT-Connect, compiled
  like its checks, every 20 mm and every 2 mm. Neither keeps a distance nor shortens anything.
- *Steps*: whole steps, of merges that succeed and of right pairs that cannot be joined.
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from statistics import median
from typing import Any, TypeVar

import numpy as np

from roboassembly.bench.machine import Machine
from roboassembly.bench.pybullet_cell import BulletCell
from roboassembly.bench.roboplan_cell import RoboPlanCell
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
_ROBOPLAN_STEPS = (0.02, 0.002)
"""Distances between two states that RoboPlan tests, in the norm of configurations [m, rad]."""
_CAP = 20.0
"""Time after which a peer's planner is stopped [s]."""
OURS = "ours"
_BUDGET = Budget(states=20_000)
T = TypeVar("T", BulletCell, RoboPlanCell)
_SEARCHED = frozenset({Stage.DRIVE_TO_GROUP, Stage.DRIVE_TO_MATE, Stage.CARRY, Stage.LEAVE})
"""Stages whose paths come from a search."""


@dataclass(frozen=True)
class PlannedPath:
    """A path as one planner plans it."""

    set_up_seconds: float
    """Time of setting the scene up [s]."""
    seconds: float
    """Time of planning in it [s]."""
    solved: bool
    states: int | None
    """Number of states tested; None if the planner does not tell."""


@dataclass(frozen=True)
class Path:
    """One segment, planned by ours and by the peers."""

    segment: str
    by: dict[str, PlannedPath]
    """Paths by planner; `ours` is ours."""


@dataclass(frozen=True, eq=False)
class RobotBenchReport:
    """Results of the robots' benchmark."""

    furniture: str
    parts: int
    microseconds: dict[str, float]
    """Mean time of an exact collision test [µs], by backend."""
    agreement: dict[str, float]
    """Share of states for which a peer and ours give the same result, by backend."""
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
        planners = list(self.paths[0].by) if self.paths else []

        def ratio(name: str) -> float:
            return median(p.by[name].seconds / p.by[OURS].seconds for p in self.paths)

        return {
            "furniture": self.furniture,
            "parts": self.parts,
            "us_per_state": self.microseconds,
            "states_agree": self.agreement,
            "paths": len(self.paths),
            "path_seconds_median": {name: median(p.by[name].seconds for p in self.paths) for name in planners},
            "set_up_seconds_median": {name: median(p.by[name].set_up_seconds for p in self.paths) for name in planners},
            "path_states_median": {
                name: median(p.by[name].states or 0 for p in self.paths)
                for name in planners
                if self.paths[0].by[name].states is not None
            },
            "path_solved": {name: sum(p.by[name].solved for p in self.paths) for name in planners},
            "path_ratio_median": {name: ratio(name) for name in planners if name != OURS},
            "segments": {
                name: median(p.by[OURS].seconds for p in self.paths if p.segment == name)
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
            *(
                f"{name:24}{1e3 * seconds:8.1f} ms a path, {1e3 * out['set_up_seconds_median'][name]:.0f} ms set-up, "
                f"{out['path_solved'][name]} of {out['paths']} found"
                + (f", {out['path_states_median'][name]:.0f} states" if name in out["path_states_median"] else "")
                + (f"; {out['path_ratio_median'][name]:.1f} times ours" if name != OURS else "")
                for name, seconds in out["path_seconds_median"].items()
            ),
        ]
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
    with ExitStack() as stack:

        def peer(name: str, make: Callable[[], T]) -> T | None:
            try:
                made = make()
            except MissingExtraError as error:
                skipped[name] = str(error)
                return None
            stack.callback(made.close)
            return made

        cells = _Cells(peer("pybullet", BulletCell), peer("roboplan", RoboPlanCell))
        steps = result.plan.steps[:merges]
        segments = [segment for step in steps for segment in step.segments if segment.stage in _SEARCHED]
        report("timing states")
        microseconds, agreement = _states(result.plan, segments, states, cells, seed)
        paths: list[Path] = []
        for count, segment in enumerate(segments):
            report(f"path {count + 1} of {len(segments)}")
            paths.append(_path(result.plan, segment, cells, seed))
    report("hopeless merges")
    hopeless = _hopeless(furniture, result.plan, seed)
    return RobotBenchReport(
        furniture.name, len(furniture.parts), microseconds, agreement, tuple(paths),
        tuple(s.planning_seconds for s in result.plan.steps), hopeless, skipped, seed, Machine.here(),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Cells:
    """Peers that are installed."""

    bullet: BulletCell | None
    roboplan: RoboPlanCell | None

    def set_up(self, plan: FullPlan, segment: Segment) -> dict[str, Callable[[Configuration], bool]]:
        """Return each peer's test whether a configuration of a segment's robot is free."""
        out: dict[str, Callable[[Configuration], bool]] = {}
        if self.bullet is not None:
            out["pybullet"] = self.bullet.set_up(plan.furniture, segment)
        if self.roboplan is not None:
            self.roboplan.set_up(plan.furniture, segment, plan.initial.cell.floor)
            out["roboplan"] = self.roboplan.is_free
        return out


def _states(
    plan: FullPlan, segments: list[Segment], count: int, cells: _Cells, seed: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the time per state [µs] and the agreement with ours, on configurations around paths of loaded segments."""
    rng = np.random.default_rng(seed)
    loaded = [segment for segment in segments if segment.before.robots[segment.robot].payload is not None] or segments
    share = max(1, count // len(loaded))
    seconds, same = defaultdict[str, float](float), Counter[str]()
    for segment in loaded:
        a, b = segment.path[0], segment.path[-1]
        q = a + rng.random((share, 1)) * (b - a) + rng.normal(0.0, 0.15, (share, len(a)))
        world = segment.before.world(plan.furniture, segment.robot)
        world.free(q)  # sets up, as `set_up` does for the peers
        begun = time.perf_counter()
        free = world.free(q)
        seconds[OURS] += time.perf_counter() - begun
        for name, is_free in cells.set_up(plan, segment).items():
            is_free(q[0])
            begun = time.perf_counter()
            answers = [is_free(c) for c in q]
            seconds[name] += time.perf_counter() - begun
            same[name] += int((np.array(answers) == free).sum())
    total = share * len(loaded)
    return (
        {name: 1e6 * spent / total for name, spent in seconds.items()},
        {name: agreed / total for name, agreed in same.items()},
    )


def _path(plan: FullPlan, segment: Segment, cells: _Cells, seed: int) -> Path:
    start, goal = segment.path[0], segment.path[-1]
    floor = Floor(plan.initial.cell.floor)
    begun = time.perf_counter()
    world = segment.before.world(plan.furniture, segment.robot)
    world.free(start[None])
    ready = time.perf_counter()
    found = connect(world, start, goal[None], floor, _BUDGET, seed)
    out = {OURS: PlannedPath(ready - begun, time.perf_counter() - ready, found is not None, world.states)}
    if cells.bullet is not None:
        out["OMPL over PyBullet"] = _over_bullet(plan, segment, cells.bullet, seed)
    if cells.roboplan is not None:
        for step in _ROBOPLAN_STEPS:
            begun = time.perf_counter()
            cells.roboplan.set_up(plan.furniture, segment, floor.half)
            cells.roboplan.is_free(start)
            ready = time.perf_counter()
            solved = cells.roboplan.plan(start, goal, step, _CAP, seed)
            out[f"RoboPlan, {1e3 * step:.0f} mm"] = PlannedPath(
                ready - begun, time.perf_counter() - ready, solved, None
            )
    return Path(segment.name, out)


def _over_bullet(plan: FullPlan, segment: Segment, bullet: BulletCell, seed: int) -> PlannedPath:
    """Plan a segment with OMPL's RRT-Connect over Bullet."""
    start, goal = segment.path[0], segment.path[-1]
    begun = time.perf_counter()
    is_free = bullet.set_up(plan.furniture, segment)
    ready = time.perf_counter()
    count = 0

    def counted(q: Configuration) -> bool:
        nonlocal count
        count += 1
        return is_free(q)

    def edge(a: Configuration, b: Configuration) -> bool:
        steps = max(1, int(np.ceil(np.abs(b - a).max() / _STEP)))
        return all(counted(a + (b - a) * i / steps) for i in range(1, steps + 1))

    space, state, read = configuration_space(start, goal[None], Floor(plan.initial.cell.floor))
    solved = run_rrt_connect(
        space, state(start), [state(goal)], lambda a, b: edge(read(a), read(b)), lambda s: counted(read(s)),
        exhaustion(lambda: count, Budget(1_000_000, _CAP), ready), seed, None,
    )  # fmt: skip
    return PlannedPath(ready - begun, time.perf_counter() - ready, solved is not None, count)


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
