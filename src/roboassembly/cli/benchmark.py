"""`roboassembly benchmark`: the paper's table, with the results of this package beside it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.multitask import PACKAGES, follow, require_packages
from roboassembly.cli.options import CORES, Jobs, Ray, Setting, require_at_least, workers
from roboassembly.cli.output import DONE, check_writable_file, print_json, show, writable_folder
from roboassembly.errors import InputError


@dataclass(frozen=True)
class BenchmarkCommand:
    """Reproduce the paper's table; run the same command again to resume an interrupted run."""

    setting: Setting = "object-centric"
    set: Annotated[str | None, tyro.conf.arg(name="set")] = None
    """Data set to train and to evaluate on. Without it: chairs-412, or chairs-24 with --quick."""
    quick: bool = False
    """Run everything on a tiny scale, in about three minutes, as a test of the installation."""
    retrain: bool = False
    """Train the relational policy as well, instead of using the one of this package."""
    train: bool = True
    """Train experts and the paper's network, which takes hours and adds their rows."""
    real: tuple[str, ...] = ()
    """Sets of real furniture to evaluate as well; each is `folder:PATH`, a folder of furniture folders."""
    sample: int | None = None
    """Evaluate on SAMPLE random pieces of each set."""
    experts: int | None = None
    """Train experts for EXPERTS random training pieces only."""
    out: Path | None = None
    """Folder of the run. Without it: runs/benchmark, with the suffix -full, -quick or -NAME of the set if these are
    given."""
    write: Path | None = None
    """Document, such as docs/results.md, in which the table between the markers is replaced."""
    seed: int = 0
    """Random seed of the whole run."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(0, seed=self.seed)
        require_at_least(1, jobs=self.jobs, sample=self.sample, experts=self.experts)
        for option, given in (("--experts", self.experts is not None), ("--retrain", self.retrain)):
            if given and not self.train:
                raise InputError(f"{option} and --no-train contradict each other; use one of them")
        require_packages(*PACKAGES)
        from roboassembly.datasets.sets import furniture_refs
        from roboassembly.evaluation import benchmark, report
        from roboassembly.settings import SETTINGS

        suffix = "" if self.set is None else f"-{self.set}"
        default = "runs/benchmark" + SETTINGS[self.setting].suffix + "-quick" * self.quick + suffix
        out = self.out or Path(default)
        writable_folder(out)
        for real in self.real:
            furniture_refs(real)
        make = benchmark.BenchmarkConfig.quick if self.quick else benchmark.BenchmarkConfig.whole
        plan = make(self.setting, self.seed)
        if self.write is not None:
            report.check_marks(self.write, self.setting, self.set or plan.set)
            check_writable_file(self.write)
        plan = replace(
            plan, set=self.set or plan.set, real=self.real, train=self.train,
            shipped=not self.train or (plan.shipped and not self.retrain),
            sample=self.sample or plan.sample, experts=self.experts or plan.experts,
        )  # fmt: skip
        with workers(self.ray, self.jobs) as jobs:
            follow(benchmark.run(plan, out, jobs), out)
        results = benchmark.report(plan, out)
        lines = report.table(results)
        (out / "benchmark.json").write_text(json.dumps(results, indent=1) + "\n")
        (out / "table.md").write_text("\n".join(lines) + "\n")
        if self.write is not None:
            report.put_into(self.write, lines, self.setting, plan.set)
        if self.json:
            print_json(results)
        else:
            show(*lines)
        return DONE
