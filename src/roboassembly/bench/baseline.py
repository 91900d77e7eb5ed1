"""Benchmark of the paper's baseline: RRT-Connect over all parts at once, by number of parts and by clearance.

The paper's chairs have gaps between parts, ours have joints with 0.4 mm to spare. To tell how much that explains, the
surfaces of all parts move inward until neighbours are a given clearance apart. Everything else stays as it is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from roboassembly.bench.machine import Machine
from roboassembly.datasets.sets import FurnitureRef, set_hash
from roboassembly.furniture.model import Furniture
from roboassembly.generate.solids import Solid, from_triangles, triangles
from roboassembly.geometry.meshes import Mesh
from roboassembly.parallel.processes import map_unordered
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.solvers.joint_rrt import BUDGET, solve_jointly
from roboassembly.statistics import success

CLEARANCES = (0.0, 1.0, 5.0, 20.0)
"""Clearances between neighbours [mm]; 0 leaves the parts as they are."""
_SIZES = ((2, 5), (6, 8), (9, 12), (13, 20))
"""Smallest and largest number of parts of each row of the table."""


def with_clearance(furniture: Furniture, clearance: float) -> Furniture:
    """Return the furniture with a clearance between its parts, at the same places.

    Args:
        furniture: furniture with closed parts.
        clearance: least distance of neighbours [m].
    """
    if clearance == 0.0:
        return furniture
    # Equal parts share a mesh, and parts of one class may be equal only nearly.
    meshes = {mesh: shrunk(mesh, clearance) for mesh in dict.fromkeys(p.mesh for p in furniture.parts)}
    return replace(furniture, parts=tuple(replace(p, mesh=meshes[p.mesh]) for p in furniture.parts))


def shrunk(mesh: Mesh, clearance: float) -> Mesh:
    """Return a mesh with its surface moved inward by half of `clearance` [m], or less where nothing would be left.

    The solid is eroded by a cube of that size (Minkowski difference). Parts thinner than `clearance` are eroded by the
    largest of its halves, quarters and so on that leaves something.
    """
    solid = from_triangles(mesh.vertices, mesh.faces)
    while True:
        left = solid.minkowski_difference(Solid.cube((clearance,) * 3, True))
        if left.volume() > 0.0:
            return Mesh(*triangles(left))
        clearance /= 2.0


@dataclass(frozen=True)
class BaselineEpisode:
    """Result of one piece with one clearance."""

    furniture: str
    parts: int
    clearance: float
    """Clearance between neighbours [mm]."""
    solved: bool
    planning_steps: int
    planning_seconds: float


@dataclass(frozen=True, eq=False)
class BaselineBenchReport:
    """Results of the baseline's benchmark."""

    set: str
    set_hash: str
    seed: int
    states: int
    """Budget of each piece, in planning steps."""
    episodes: tuple[BaselineEpisode, ...]
    machine: Machine

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, strings, lists and dictionaries."""
        return {
            "set": self.set,
            "set_hash": self.set_hash,
            "seed": self.seed,
            "states": self.states,
            "rows": [
                {"clearance_mm": clearance, "parts": f"{low}-{high}", **success([e.solved for e in some])}
                for clearance in sorted({e.clearance for e in self.episodes})
                for low, high in (*_SIZES, (_SIZES[0][0], _SIZES[-1][1]))
                if (some := [e for e in self.episodes if e.clearance == clearance and low <= e.parts <= high])
            ],
            "machine": dataclasses.asdict(self.machine),
            "per_furniture": [dataclasses.asdict(e) for e in self.episodes],
        }

    def to_text(self) -> str:
        """Return a table in Markdown: a row for each number of parts, a column for each clearance."""
        clearances = sorted({e.clearance for e in self.episodes})
        lines = [
            f"RRT-Connect over all parts at once, {self.states:,} planning steps a piece, {self.set}, seed {self.seed}",
            "",
            f"| parts | {' | '.join(f'{c:g} mm' if c else 'as they are' for c in clearances)} |",
            f"|{' --- |' * (1 + len(clearances))}",
        ]
        for low, high in (*_SIZES, (_SIZES[0][0], _SIZES[-1][1])):
            cells = [self._cell([e.solved for e in self._some(c, low, high)]) for c in clearances]
            lines.append(f"| {low}–{high} | {' | '.join(cells)} |")
        return "\n".join(lines)

    def _some(self, clearance: float, low: int, high: int) -> list[BaselineEpisode]:
        return [e for e in self.episodes if e.clearance == clearance and low <= e.parts <= high]

    @staticmethod
    def _cell(outcomes: Sequence[bool]) -> str:
        if not outcomes:
            return "–"
        low, high = success(outcomes)["ci95"]
        share = 100 * sum(outcomes) / len(outcomes)
        return f"{sum(outcomes)} of {len(outcomes)}: {share:.1f} % ({100 * low:.1f}–{100 * high:.1f})"


def run_baseline_bench(
    refs: Sequence[FurnitureRef],
    name: str,
    *,
    clearances: Sequence[float] = CLEARANCES,
    states: int = BUDGET.states,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
) -> BaselineBenchReport:
    """Run the benchmark.

    Args:
        refs: the furniture.
        name: name of its set, for the report.
        clearances: clearances between neighbours [mm]; 0 leaves the parts as they are.
        states: budget of each piece, in planning steps.
        seed: seed of the starts and of the planner.
        jobs: number of processes.
        progress: receives a line for each result.
    """
    work = partial(_episode, states=states, seed=seed)
    items = [(ref, clearance) for clearance in clearances for ref in refs]
    episodes: list[BaselineEpisode] = []
    for episode in map_unordered(work, items, jobs):
        episodes.append(episode)
        if progress is not None:
            outcome = "solved" if episode.solved else "not solved"
            progress(f"{episode.furniture}, {episode.clearance:g} mm: {outcome}, {episode.planning_steps:,} steps")
    episodes.sort(key=lambda e: (e.clearance, e.furniture))
    return BaselineBenchReport(name, set_hash(refs), seed, states, tuple(episodes), Machine.here())


def _episode(item: tuple[FurnitureRef, float], *, states: int, seed: int) -> BaselineEpisode:
    ref, clearance = item
    furniture = with_clearance(ref.furniture(with_grasps=False), 1e-3 * clearance)
    result = solve_jointly(furniture, seed, Budget(states=states))
    solved = result.status is PlanningStatus.SOLVED
    return BaselineEpisode(
        ref.name, len(furniture.parts), clearance, solved, result.planning_steps, result.planning_seconds
    )
