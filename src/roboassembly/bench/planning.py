"""Planning benchmark: ours, and OMPL over PyBullet and over python-fcl, in one run.

All plan every merge of a few chairs, with the same seed and the same budget of states:

- `ours`: `ObjectCentricTask.plan`, which builds a `CollisionWorld` and calls `plan_mating`;
- `ours_rrt`: our collision world and RRT-Connect with batched edges, without the retreats before it;
- `pybullet`, `fcl`: RRT-Connect with one Python callback for each state (`peers`), with the range,
  bounds, start and goal of `ours_rrt`. The module of each backend describes its representation of bodies.

Times include building the scene; all cache meshes between merges. A failure counts with the time that it spent: if a
tree search finds no way out of a connection within the budget, the ratio is a lower bound. `same_planner` compares our
planner with each peer's checks.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from roboassembly.bench.fcl_backend import FclPeer
from roboassembly.bench.machine import Machine
from roboassembly.bench.merges import BenchChair, BenchMerge, find_chairs, merges_of
from roboassembly.bench.peers import Peer, Run, plan_with_peer
from roboassembly.bench.per_state import StateTime, sampled_edges, time_ours, time_peer
from roboassembly.bench.pybullet_backend import PyBulletPeer
from roboassembly.bench.same_planner import plan_over_peer
from roboassembly.bench.steps import StepTimes, time_steps
from roboassembly.errors import MissingExtraError
from roboassembly.planning.problem import Budget
from roboassembly.planning.rrt import rrt_connect

PEERS: dict[str, Callable[[], Peer]] = {"pybullet": PyBulletPeer, "fcl": FclPeer}
_HULLS = "pybullet_hulls"


@dataclass(frozen=True)
class PlanningBenchConfig:
    """Settings of the benchmark."""

    family: str = "ladder"
    parts: int = 15
    chairs: int = 3
    """Number of chairs: the first variants of the family with exactly `parts` parts."""
    merges: int | None = None
    """Number of merges of each chair, from the first; all if None."""
    states: int = 20_000
    """Budget of configurations for each merge."""
    cap_seconds: float = 20.0
    """Wall time after which a peer is stopped on a merge [s]."""
    repeats: int = 3
    """Number of runs of each plan; the median time counts."""
    sampled_states: int = 1_000
    """Number of configurations of each merge on which single states are timed."""
    seed: int = 0

    @classmethod
    def quick(cls) -> PlanningBenchConfig:
        """Return settings for the first five merges of one chair, one run each."""
        return cls(chairs=1, merges=5, repeats=1, sampled_states=300)


@dataclass(frozen=True, eq=False)
class MergeRow:
    """Results of all planners on one merge."""

    chair: str
    step: int
    moving_parts: int
    runs: dict[str, Run]
    """Runs of whole plans, by backend."""
    same_planner: dict[str, Run]
    """Runs of our planner with a peer's checks."""
    state_times: dict[str, StateTime]
    hull_depth: float | None
    """Depth of the moving parts' convex hulls in the still parts at the mating pose, measured by Bullet [m]."""

    def ratio(self, backend: str) -> float:
        """Return the backend's time divided by ours."""
        return self.runs[backend].seconds / self.runs["ours"].seconds


@dataclass(frozen=True, eq=False)
class PlanningBenchReport:
    """Results of the benchmark."""

    config: PlanningBenchConfig
    chairs: tuple[BenchChair, ...]
    rows: tuple[MergeRow, ...]
    steps: StepTimes
    skipped: dict[str, str]
    """Reasons why backends were left out, by backend."""
    descriptions: dict[str, str]
    """Representations of the bodies, by backend."""
    machine: Machine

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, strings, lists and dictionaries; None if a backend was left out."""
        results = [chair.result for chair in self.chairs]
        names = ["ours", "ours_rrt", *PEERS]
        return {
            "us_per_state": {name: self._us_per_state(name) for name in ("ours", *PEERS, _HULLS)},
            "plan_seconds": {name: self._total(name) for name in names},
            "solved": {name: self._solved(name) for name in names},
            "states": {name: self._states(name) for name in names},
            "capped": {name: sum(r.runs[name].capped for r in self._took_part(name)) for name in PEERS},
            **{f"ratio_{name}": self._median_ratio(name) for name in PEERS},
            **{f"ratio_{name}_total": self._total_ratio(name) for name in PEERS},
            "same_planner": self._same_planner(),
            "merges": len(self.rows),
            "chair": {
                "parts": self.config.parts,
                "states_median": median(r.planning_steps for r in results),
                "planning_seconds_median": median(r.planning_seconds for r in results),
                "wall_seconds_median": median(chair.wall_seconds for chair in self.chairs),
                "chairs": len(self.chairs),
            },
            "step": dataclasses.asdict(self.steps),
            "skipped": self.skipped,
            "backends": self.descriptions,
            "machine": dataclasses.asdict(self.machine),
            "seed": self.config.seed,
            "config": dataclasses.asdict(self.config),
            "per_merge": [_row_json(row) for row in self.rows],
        }

    def to_text(self) -> str:
        """Return a table as text."""
        out = self.to_json()
        lines = [
            f"{out['merges']} merges of {len(self.chairs)} chairs with {self.config.parts} parts, "
            f"{self.config.states} states a merge, seed {self.config.seed}",
            f"{self.machine.cpu}, {self.machine.cores} cores, Python {self.machine.python}",
            "",
            f"{'':22}{'µs/state':>10}{'plans [s]':>11}{'solved':>9}{'states':>10}{'× ours':>9}{'× total':>9}",
        ]
        for name in ("ours", "ours_rrt", *PEERS):
            if name in self.skipped:
                lines.append(f"{name:22}skipped: {self.skipped[name]}")
                continue
            solved, of = out["solved"][name]
            lines.append(
                f"{name:22}{_cell(out['us_per_state'].get(name), 10, 2)}{_cell(out['plan_seconds'][name], 11, 3)}"
                f"{f'{solved}/{of}':>9}{out['states'][name]:>10}"
                f"{_cell(out.get(f'ratio_{name}'), 9, 1)}{_cell(out.get(f'ratio_{name}_total'), 9, 1)}"
            )
        same = out["same_planner"]
        for name in (n for n in PEERS if n not in self.skipped):
            solved, of = same["solved"][name]
            lines.append(
                f"{'our planner, ' + name:22}{'':>10}{_cell(same['plan_seconds'][name], 11, 3)}{f'{solved}/{of}':>9}"
                f"{same['states'][name]:>10}{_cell(same[f'ratio_{name}'], 9, 1)}"
            )
        chair, step = out["chair"], out["step"]
        lines += [
            "",
            f"a chair of {chair['parts']} parts: {chair['states_median']:.0f} states, "
            f"{chair['planning_seconds_median']:.3f} s in the planner, {chair['wall_seconds_median']:.3f} s in all",
            f"a step: wrong pair {step['wrong_pair_ms_median']:.3f} ms, "
            f"right merge {step['right_merge_ms_median']:.1f} ms; a reset {step['reset_ms_median']:.1f} ms",
        ]
        lines += [f"{name}: {text}" for name, text in self.descriptions.items()]
        return "\n".join(lines)

    def _took_part(self, name: str) -> list[MergeRow]:
        return [row for row in self.rows if name in row.runs]

    def _us_per_state(self, name: str) -> float | None:
        times = [row.state_times[name] for row in self.rows if name in row.state_times]
        return StateTime(sum(t.states for t in times), sum(t.seconds for t in times)).microseconds if times else None

    def _total(self, name: str) -> float | None:
        rows = self._took_part(name)
        return sum(row.runs[name].seconds for row in rows) if rows else None

    def _states(self, name: str) -> int | None:
        rows = self._took_part(name)
        return sum(row.runs[name].states for row in rows) if rows else None

    def _solved(self, name: str) -> list[int] | None:
        rows = self._took_part(name)
        return [sum(row.runs[name].solved for row in rows), len(rows)] if rows else None

    def _median_ratio(self, name: str) -> float | None:
        rows = self._took_part(name)
        return median(row.ratio(name) for row in rows) if rows else None

    def _total_ratio(self, name: str) -> float | None:
        theirs, ours = self._total(name), self._total("ours")
        return None if theirs is None or ours is None else theirs / ours

    def _same_planner(self) -> dict[str, Any]:
        out: dict[str, Any] = {"plan_seconds": {}, "solved": {}, "states": {}}
        for name in PEERS:
            rows = [row for row in self.rows if name in row.same_planner]
            runs = [row.same_planner[name] for row in rows]
            out["plan_seconds"][name] = sum(run.seconds for run in runs) if runs else None
            out["solved"][name] = [sum(run.solved for run in runs), len(runs)] if runs else None
            out["states"][name] = sum(run.states for run in runs) if runs else None
            ratios = [row.same_planner[name].seconds / row.runs["ours"].seconds for row in rows]
            out[f"ratio_{name}"] = median(ratios) if ratios else None
        return out


def run_planning_bench(
    config: PlanningBenchConfig | None = None, progress: Callable[[str], None] | None = None
) -> PlanningBenchReport:
    """Run the benchmark; `progress` receives a line from time to time.

    Raises:
        InputError: no such family, or too few chairs with that many parts.
    """
    config = config or PlanningBenchConfig()
    report: Callable[[str], None] = progress or (lambda line: None)
    peers: dict[str, Peer] = {}
    skipped: dict[str, str] = {}
    for name, make in PEERS.items():
        try:
            peers[name] = make()
        except MissingExtraError as error:
            skipped[name] = str(error)
    hulls = PyBulletPeer("hulls") if "pybullet" in peers else None
    try:
        report("solving the chairs")
        chairs = find_chairs(config.family, config.parts, config.chairs, config.seed)
        steps = time_steps(chairs, config.seed)
        merges = [m for chair in chairs for m in list(merges_of(chair, config.seed))[: config.merges]]
        rows: list[MergeRow] = []
        for count, merge in enumerate(merges):
            report(f"merge {count + 1} of {len(merges)}")
            rows.append(_measure(merge, config, peers, hulls))
    finally:
        for peer in (*peers.values(), *([hulls] if hulls else [])):
            peer.close()
    descriptions = {name: peer.description for name, peer in peers.items()}
    return PlanningBenchReport(config, chairs, tuple(rows), steps, skipped, descriptions, Machine.here())


def _measure(
    merge: BenchMerge, config: PlanningBenchConfig, peers: dict[str, Peer], hulls: PyBulletPeer | None
) -> MergeRow:
    ends = (merge.problem.start, merge.problem.goal)
    budget = Budget(states=config.states)
    # The untimed calls before the plans fill every library's cache of meshes.
    edges = sampled_edges(merge, config.sampled_states)
    state_times = {"ours": time_ours(merge, edges)}
    runs = {
        "ours": _repeated(config.repeats, lambda: _ours(merge, budget)),
        "ours_rrt": _repeated(config.repeats, lambda: _ours_rrt(merge, budget)),
    }
    same_planner: dict[str, Run] = {}
    for name, peer in peers.items():
        state_times[name] = time_peer(peer, merge, edges)
        runs[name] = _repeated(
            config.repeats,
            lambda peer=peer: plan_with_peer(
                peer, merge.scene, ends, merge.bounds, config.states, config.cap_seconds, merge.seed
            ),
        )
        same_planner[name] = _repeated(config.repeats, lambda peer=peer: plan_over_peer(peer, merge, budget))
    depth = None
    if hulls is not None:
        state_times[_HULLS] = time_peer(hulls, merge, edges)
        depth = hulls.depth(merge.problem.goal)
    return MergeRow(
        merge.chair.furniture.name,
        merge.index,
        len(merge.mating.u_group.parts),
        runs,
        same_planner,
        state_times,
        depth,
    )


def _ours(merge: BenchMerge, budget: Budget) -> Run:
    begun = time.perf_counter()
    result = merge.chair.task.plan(merge.mating, merge.seed, budget)
    return Run(result.solved, result.states, time.perf_counter() - begun)


def _ours_rrt(merge: BenchMerge, budget: Budget) -> Run:
    begun = time.perf_counter()
    world = merge.world()
    path = rrt_connect(world, merge.problem.start, [merge.problem.goal], merge.bounds, budget, merge.seed)
    return Run(path is not None, world.states, time.perf_counter() - begun)


def _repeated(repeats: int, plan: Callable[[], Run]) -> Run:
    """Return the run of median time."""
    runs: Sequence[Run] = [plan() for _ in range(repeats)]
    return sorted(runs, key=lambda run: run.seconds)[(repeats - 1) // 2]


def _row_json(row: MergeRow) -> dict[str, Any]:
    return {
        "chair": row.chair,
        "step": row.step,
        "moving_parts": row.moving_parts,
        "runs": {name: dataclasses.asdict(run) for name, run in row.runs.items()},
        "same_planner": {name: dataclasses.asdict(run) for name, run in row.same_planner.items()},
        "us_per_state": {name: t.microseconds for name, t in row.state_times.items()},
        "hull_goal_depth_mm": None if row.hull_depth is None else 1e3 * row.hull_depth,
    }


def _cell(value: float | None, width: int, digits: int) -> str:
    return " " * width if value is None else f"{value:>{width}.{digits}f}"
