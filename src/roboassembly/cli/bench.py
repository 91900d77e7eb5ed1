"""`roboassembly bench`: how fast, against what people would use instead, in the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.output import DONE, print_json, say, show
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.bench.planning import PlanningBenchReport
    from roboassembly.bench.robots import RobotBenchReport


@dataclass(frozen=True)
class Bench:
    """Measure the speed of planning, next to OMPL with PyBullet and with python-fcl as collision checkers."""

    what: Annotated[Literal["planning", "robots"], tyro.conf.Positional] = "planning"
    """What to measure. planning: parts that move by themselves. robots: motions of two mobile Franka robots."""
    furniture: str = "stool"
    """Piece that the robots assemble (robots)."""
    chairs: int = 3
    """Number of chairs of 15 parts whose merges are planned (planning)."""
    seed: int = 0
    """Random seed of the planners."""
    quick: bool = False
    """Plan a few merges only, to see that it works."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.chairs < 1:
            raise InputError(f"--chairs {self.chairs}; 1 or more would do")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} is negative; 0 or more would do")
        if self.what == "robots":
            return self._robots()
        from roboassembly.bench.planning import PlanningBenchConfig, run_planning_bench

        config = PlanningBenchConfig.quick() if self.quick else PlanningBenchConfig(chairs=self.chairs)
        return self._told(run_planning_bench(replace(config, seed=self.seed), progress=say))

    def _robots(self) -> int:
        from roboassembly.bench.robots import run_robot_bench

        states, merges = (200, 1) if self.quick else (2_000, None)
        return self._told(run_robot_bench(self.furniture, seed=self.seed, states=states, merges=merges, progress=say))

    def _told(self, report: PlanningBenchReport | RobotBenchReport) -> int:
        if self.json:
            print_json(report.to_json())
        else:
            show(*report.to_text().splitlines())
        return DONE
