"""`roboassembly dataset`: build, list and show data sets."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs, Ray
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, show
from roboassembly.errors import InputError
from roboassembly.parallel.processes import use_cluster


@dataclass(frozen=True)
class Dataset:
    """Build, list or show data sets of certified furniture."""

    what: Annotated[Literal["build", "list", "show"], tyro.conf.Positional]
    """build: make the set; if it is stopped, the same command continues. list: name all sets. show: describe one."""
    name: Annotated[str, tyro.conf.Positional] = "chairs-412"
    """Name of the set."""
    seed: int = 0
    """Random seed of `build`: another seed makes a set of other chairs."""
    jobs: Jobs = CORES
    """Number of chairs to work on at the same time."""
    ray: Ray = None
    force: bool = False
    """Build the set again if it is there already, made with another seed."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if self.seed < 0 or self.jobs < 1:
            raise InputError(f"--seed {self.seed} --jobs {self.jobs}: 0 or more, and 1 or more, would do")
        from roboassembly.datasets import sets as datasets

        if self.what == "list":
            rows = [
                {"name": r.name, "description": r.description, "built": datasets.manifest_path(r.name).is_file()}
                for r in datasets.RECIPES.values()
            ]
            if self.json:
                print_json({"datasets": rows})
            else:
                for row in rows:
                    show(f"{row['name']}: {row['description']}{'' if row['built'] else ' (not built yet)'}")
            return DONE
        datasets.manifest_path(self.name)
        if self.what == "build":
            self._check_built()
            self._build()
        return self._show()

    def _check_built(self) -> None:
        """Refuse to replace a set that others may have results for.

        Raises:
            InputError: it is built with another seed, or the folder cannot be written.
        """
        from roboassembly.datasets import sets as datasets

        path = datasets.manifest_path(self.name)
        check_writable(path.parent)
        if self.force or not path.is_file():
            return
        try:
            built = datasets.load_manifest(self.name)
        except InputError:
            return  # of an older version, or broken: it is of no use to anybody
        if built.seed != self.seed:
            raise InputError(
                f"{self.name} is built already with seed {built.seed}; --force builds it again with seed {self.seed}"
            )

    def _build(self) -> None:
        from roboassembly.datasets.sets import RECIPES
        from roboassembly.solvers.dataset_builder import build_dataset

        with (
            use_cluster(self.ray, self.jobs) as jobs,
            progress_bar(desc=f"building {self.name}", unit="chair") as progress,
        ):
            for done, of in build_dataset(RECIPES[self.name], self.seed, jobs):
                progress.total = of
                progress.update(done - progress.n)

    def _show(self) -> int:
        from roboassembly.datasets import sets as datasets

        manifest = datasets.load_manifest(self.name)
        summary = {}
        for split in (datasets.EASY, datasets.HARD, datasets.TEST):
            entries = [e for e in manifest.entries if e.split == split]
            summary[split] = {
                "chairs": len(entries),
                "families": len({e.family for e in entries}),
                "unseen": sum(e.unseen for e in entries),
                "parts_median": median(e.parts for e in entries),
                "with_dead_ends": sum(e.dead_end for e in entries),
                "difficulty_mean": round(sum(e.difficulty for e in entries) / len(entries), 4),
                "planning_steps_median": median(e.planning_steps for e in entries),
            }
        path = datasets.manifest_path(self.name)
        if self.json:
            print_json({"name": manifest.name, "version": manifest.version, "seed": manifest.seed,
                        "manifest": str(path), "splits": summary})  # fmt: skip
            return DONE
        show(f"{manifest.name}, version {manifest.version}, seed {manifest.seed}: {path}")
        for split, row in summary.items():
            show(f"  {split}: " + ", ".join(f"{k} {v}" for k, v in row.items()))
        return DONE
