"""`roboassembly bench`: how fast, against what people would use instead, in the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import tyro

from roboassembly.cli.output import DONE, print_json, say
from roboassembly.errors import InputError


@dataclass(frozen=True)
class Bench:
    """Measure planning against OMPL with per-state callbacks over PyBullet and python-fcl."""

    what: Annotated[Literal["planning"], tyro.conf.Positional] = "planning"
    """What to measure."""
    chairs: int = 3
    """Chairs of 15 parts whose merges are planned."""
    seed: int = 0
    """Of the planners."""
    quick: bool = False
    """A few merges only: to see that it works."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.chairs < 1:
            raise InputError(f"--chairs {self.chairs}; 1 or more would do")
        from roboassembly.bench.planning import PlanningBenchConfig, run_planning_bench

        config = PlanningBenchConfig.quick() if self.quick else PlanningBenchConfig(chairs=self.chairs)
        report = run_planning_bench(replace(config, seed=self.seed), progress=say)
        if self.json:
            print_json(report.to_json())
        else:
            print(report.to_text())
        return DONE
