"""`roboassembly benchmark`: the paper's table, ours beside it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

from roboassembly.cli.multitask import PACKAGES, follow, needs
from roboassembly.cli.options import CORES, Jobs, Ray, Setting
from roboassembly.cli.output import DONE, check_writable_file, print_json, show, writable_folder
from roboassembly.errors import InputError
from roboassembly.parallel.processes import use_cluster


@dataclass(frozen=True)
class Benchmark:
    """Make the paper's table; the same command continues a run that was stopped."""

    setting: Setting = "object-centric"
    """What moves the parts. object-centric: parts move by themselves. full: two mobile Franka robots move them."""
    quick: bool = False
    """Run all of it on a tiny scale in three minutes, to see that it works."""
    retrain: bool = False
    """Train the relational policy too, instead of taking the one that comes with the package."""
    real: tuple[str, ...] = ()
    """Sets of real furniture to measure as well, each `folder:PATH` of a folder of furniture folders."""
    sample: int | None = None
    """Measure on only SAMPLE pieces of each set, drawn by the seed."""
    experts: int | None = None
    """Train experts for only EXPERTS of the training pieces, drawn by the seed."""
    out: Path | None = None
    """Folder of the run. Without it: runs/benchmark, with -full and -quick appended for these."""
    write: Path | None = None
    """Document, like docs/results.md, whose table between the marks is replaced by the new one."""
    seed: int = 0
    """Random seed of the whole run."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.seed < 0 or self.jobs < 1:
            raise InputError("--seed takes 0 or more, --jobs takes 1 or more")
        if min(n for n in (self.sample, self.experts, 1) if n is not None) < 1:
            raise InputError("--sample and --experts take 1 or more")
        needs(*PACKAGES)
        from roboassembly.datasets.sets import furniture_refs
        from roboassembly.evaluation import benchmark

        usual = "runs/benchmark" + "-full" * (self.setting == "full") + "-quick" * self.quick
        out = self.out or Path(usual)
        writable_folder(out)
        for real in self.real:
            furniture_refs(real)
        if self.write is not None:
            benchmark.check_marks(self.write, self.setting)
            check_writable_file(self.write)
        make = benchmark.Benchmark.quick if self.quick else benchmark.Benchmark.whole
        plan = make(self.setting, self.seed)
        plan = replace(
            plan, real=self.real, shipped=plan.shipped and not self.retrain, sample=self.sample or plan.sample,
            taught=self.experts or plan.taught,
        )  # fmt: skip
        with use_cluster(self.ray, self.jobs) as jobs:
            follow(benchmark.run(plan, out, jobs), out)
        told = benchmark.report(plan, out)
        lines = benchmark.table(told)
        (out / "benchmark.json").write_text(json.dumps(told, indent=1) + "\n")
        (out / "table.md").write_text("\n".join(lines) + "\n")
        if self.write is not None:
            benchmark.put_into(self.write, lines, self.setting)
        if self.json:
            print_json(told)
        else:
            show(*lines)
        return DONE
