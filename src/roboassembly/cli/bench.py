"""`roboassembly bench`: speed of planning beside other software, measured in the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.options import require_at_least
from roboassembly.cli.output import DONE, print_json, say, show

if TYPE_CHECKING:
    from roboassembly.bench.planning import PlanningBenchReport
    from roboassembly.bench.robots import RobotBenchReport


@dataclass(frozen=True)
class BenchCommand:
    """Measure the speed of planning, beside OMPL with PyBullet and with python-fcl as collision checkers."""

    what: Annotated[Literal["planning", "robots"], tyro.conf.Positional] = "planning"
    """Subject of the measurement. planning: motions of parts. robots: motions of two mobile Franka robots."""
    furniture: str = "stool"
    """Piece that the robots assemble; for `robots` only."""
    chairs: int = 3
    """Number of chairs of 15 parts; for `planning` only."""
    seed: int = 0
    """Random seed of the planners."""
    quick: bool = False
    """Plan a few merges only, as a test of the installation."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(1, chairs=self.chairs)
        require_at_least(0, seed=self.seed)
        if self.what == "robots":
            return self._robots()
        from roboassembly.bench.planning import PlanningBenchConfig, run_planning_bench

        config = PlanningBenchConfig.quick() if self.quick else PlanningBenchConfig(chairs=self.chairs)
        return self._print_report(run_planning_bench(replace(config, seed=self.seed), progress=say))

    def _robots(self) -> int:
        from roboassembly.bench.robots import run_robot_bench

        states, merges = (200, 1) if self.quick else (2_000, None)
        return self._print_report(
            run_robot_bench(self.furniture, seed=self.seed, states=states, merges=merges, progress=say)
        )

    def _print_report(self, report: PlanningBenchReport | RobotBenchReport) -> int:
        if self.json:
            print_json(report.to_json())
        else:
            show(*report.to_text().splitlines())
        return DONE
