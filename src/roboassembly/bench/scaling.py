"""Benchmark of the cost against the number of parts: search, object-centric, on series of growing furniture.

Two series grow by repetition: open shelves with more and more boards, where most orders work, and frames of posts and
rails with more and more bays, where the order matters.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from roboassembly.bench.machine import Machine
from roboassembly.furniture import annotate, model
from roboassembly.generate.design import Design, as_parts
from roboassembly.generate.lattice import Lattice, RailRow
from roboassembly.generate.shelves import OpenShelf
from roboassembly.solvers.search import solve

SHELVES = (8, 12, 20, 36, 52, 100)
"""Numbers of parts of the shelves."""
LATTICES = (10, 17, 24, 38, 59, 80)
"""Numbers of parts of the frames: 7 for each bay, and 3."""
_PITCH = 0.28
"""Distance between the boards of a shelf [m]."""


def shelf(parts: int) -> Design:
    """Return an open shelf: two sides, two bars and otherwise boards."""
    return _design(OpenShelf, height=_PITCH * (parts - 4), shelves=parts - 4, bars=2)


def lattice(parts: int) -> Design:
    """Return a frame of two rows of posts: each bay has two rails in front and two behind, each pair of posts one."""
    bays = (parts - 3) // 7
    long = [RailRow(i, j, "x", 2, 4, "none") for i in range(bays) for j in (0, 1)]
    across = [RailRow(i, 0, "y", 1, 1, "none") for i in range(bays + 1)]
    return _design(Lattice, posts=(bays + 1, 2), rows=(*long, *across), top=False, base=False)


def _design(family: type[Design], **values: Any) -> Design:
    """Return the catalogue model of a family with some values of its own."""
    return family(**values)


SERIES: dict[str, tuple[Callable[[int], Design], Sequence[int]]] = {
    "shelves": (shelf, SHELVES),
    "lattices": (lattice, LATTICES),
}
"""Design and numbers of parts of each series."""


@dataclass(frozen=True)
class ScalingRow:
    """Result of one piece."""

    series: str
    parts: int
    solved: bool
    attempts: int
    """Number of merges handed to the planner."""
    planning_steps: int
    seconds: float
    """Processor time of the search, from the random start to the plan [s]; the median of the repetitions."""


@dataclass(frozen=True, eq=False)
class ScalingReport:
    """Results of the benchmark."""

    seed: int
    repeats: int
    rows: tuple[ScalingRow, ...]
    machine: Machine

    def to_json(self) -> dict[str, Any]:
        """Return plain numbers, strings, lists and dictionaries."""
        return {
            "seed": self.seed,
            "repeats": self.repeats,
            "exponents": {name: exponent(self._rows(name)) for name in self._series()},
            "rows": [dataclasses.asdict(row) for row in self.rows],
            "machine": dataclasses.asdict(self.machine),
        }

    def to_text(self) -> str:
        """Return a table in Markdown for each series."""
        lines: list[str] = []
        for name in self._series():
            rows = self._rows(name)
            cells = {
                "parts": [f"{row.parts}" for row in rows],
                "s": [f"{row.seconds:.2f}" if row.solved else "not solved" for row in rows],
                "merges tried": [f"{row.attempts}" for row in rows],
                "planning steps": [f"{row.planning_steps:,}" for row in rows],
                "planning steps a merge": [f"{row.planning_steps / (row.parts - 1):.0f}" for row in rows],
            }
            table = [f"| {title} | {' | '.join(values)} |" for title, values in cells.items()]
            lines += [table[0], f"|{' --- |' * (len(rows) + 1)}", *table[1:]]
            lines += ["", f"{name}: the time grows with the parts to the power of {exponent(rows):.2f}", ""]
        return "\n".join(lines[:-1])

    def _series(self) -> list[str]:
        return list(dict.fromkeys(row.series for row in self.rows))

    def _rows(self, series: str) -> list[ScalingRow]:
        return [row for row in self.rows if row.series == series]


def exponent(rows: Sequence[ScalingRow]) -> float:
    """Return the exponent of the power of the number of parts that fits the solved pieces' seconds best; NaN if none.

    Least squares of the logarithms.
    """
    solved = [row for row in rows if row.solved]
    if len({row.parts for row in solved}) < 2:
        return float("nan")
    parts, seconds = (np.log([getattr(row, name) for row in solved]) for name in ("parts", "seconds"))
    return float(np.polyfit(parts, seconds, 1)[0])


def run_scaling_bench(
    *, largest: int = 100, seed: int = 0, repeats: int = 1, progress: Callable[[str], None] | None = None
) -> ScalingReport:
    """Run the benchmark.

    Args:
        largest: number of parts up to which pieces are searched.
        seed: seed of the starts and of the planner.
        repeats: number of searches of each piece.
        progress: receives a line for each piece.
    """
    rows: list[ScalingRow] = []
    for series, (design, sizes) in SERIES.items():
        for parts in (size for size in sizes if size <= largest):
            row = _measured(series, design(parts), seed, repeats)
            rows.append(row)
            if progress is not None:
                outcome = "solved" if row.solved else "not solved"
                progress(f"{series}, {row.parts} parts: {outcome}, {row.planning_steps:,} steps, {row.seconds:.2f} s")
    return ScalingReport(seed, repeats, tuple(rows), Machine.here())


def _measured(series: str, design: Design, seed: int, repeats: int) -> ScalingRow:
    furniture = annotate.annotate(
        series, as_parts(design.parts()), model.Provenance("generated"), with_grasps=False, most_points=model.MOST_PARTS
    )
    # The search does not include results of the shapes alone, such as the poses in which they rest.
    result = solve(furniture, seed)
    seconds: list[float] = []
    for _ in range(repeats):
        begun = time.process_time()
        result = solve(furniture, seed)
        seconds.append(time.process_time() - begun)
    parts = len(furniture.parts)
    return ScalingRow(series, parts, result.plan.success, result.attempts, result.planning_steps, median(seconds))
