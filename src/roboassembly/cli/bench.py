"""`roboassembly bench`: speed of planning beside other software, measured in the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs, require_at_least, selected_furniture
from roboassembly.cli.output import DONE, print_json, say, show
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.bench.baseline import BaselineBenchReport
    from roboassembly.bench.planning import PlanningBenchReport
    from roboassembly.bench.robots import RobotBenchReport
    from roboassembly.bench.scaling import ScalingReport


_BASELINE_SET = "chairs-880:test"
"""Furniture of `baseline` if none is named."""


@dataclass(frozen=True)
class BenchCommand:
    """Measure planning beside other collision checkers, the paper's baseline, and the cost of many parts."""

    what: Annotated[Literal["planning", "robots", "baseline", "scaling"], tyro.conf.Positional] = "planning"
    """Subject of the measurement. planning: motions of parts. robots: motions of two mobile Franka robots. baseline:
    the paper's RRT-Connect over all parts at once, by number of parts and by clearance between them. scaling: search
    on growing shelves and frames, up to 100 parts."""
    furniture: str = "stool"
    """Piece that the robots assemble; for `robots` only."""
    chairs: int = 3
    """Number of chairs of 15 parts; for `planning` only."""
    set: Annotated[str | None, tyro.conf.arg(name="set")] = None
    """Furniture, as in `roboassembly evaluate`; for `baseline` only. Without it: chairs-880:test."""
    sample: int | None = None
    """Use SAMPLE random pieces of the set only; for `baseline` only."""
    clearances: tuple[float, ...] = (0.0, 1.0, 5.0, 20.0)
    """Clearances between parts [mm], 0 for the parts as they are; for `baseline` only."""
    states: int = 100_000
    """Planning steps for each piece; for `baseline` only."""
    largest: int = 100
    """Number of parts of the largest piece; for `scaling` only."""
    repeats: int = 3
    """Number of searches of each piece, of which the median counts; for `scaling` only."""
    seed: int = 0
    """Random seed of the planners."""
    jobs: Jobs = CORES
    """Number of processes; for `baseline` only."""
    quick: bool = False
    """Plan a few merges or pieces only, as a test of the installation."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(1, chairs=self.chairs)
        require_at_least(0, seed=self.seed)
        require_at_least(1, states=self.states, jobs=self.jobs)
        if self.what == "robots":
            return self._robots()
        if self.what == "baseline":
            return self._baseline()
        if self.what == "scaling":
            return self._scaling()
        from roboassembly.bench.planning import PlanningBenchConfig, run_planning_bench

        config = PlanningBenchConfig.quick() if self.quick else PlanningBenchConfig(chairs=self.chairs)
        return self._print_report(run_planning_bench(replace(config, seed=self.seed), progress=say))

    def _robots(self) -> int:
        from roboassembly.bench.robots import run_robot_bench

        states, merges = (200, 1) if self.quick else (2_000, None)
        return self._print_report(
            run_robot_bench(self.furniture, seed=self.seed, states=states, merges=merges, progress=say)
        )

    def _baseline(self) -> int:
        for clearance in self.clearances:
            if not 0.0 <= clearance <= 1_000.0:
                raise InputError(f"--clearances {clearance:g} must be from 0 to 1000 mm")
        name = self.set or _BASELINE_SET
        refs = selected_furniture(name, None, self.sample, self.seed)
        from roboassembly.bench.baseline import run_baseline_bench

        states = 1_000 if self.quick else self.states
        return self._print_report(
            run_baseline_bench(
                refs[:2] if self.quick else refs, name, clearances=self.clearances, states=states, seed=self.seed,
                jobs=self.jobs, progress=say,
            )
        )  # fmt: skip

    def _scaling(self) -> int:
        require_at_least(1, largest=self.largest, repeats=self.repeats)
        from roboassembly.bench.scaling import run_scaling_bench

        largest, repeats = (20, 1) if self.quick else (self.largest, self.repeats)
        return self._print_report(run_scaling_bench(largest=largest, seed=self.seed, repeats=repeats, progress=say))

    def _print_report(
        self, report: PlanningBenchReport | RobotBenchReport | BaselineBenchReport | ScalingReport
    ) -> int:
        if self.json:
            print_json(report.to_json())
        else:
            show(*report.to_text().splitlines())
        return DONE
