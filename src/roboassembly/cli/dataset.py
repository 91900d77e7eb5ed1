"""`roboassembly dataset`: build, list and show data sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs, Ray, require_at_least, workers
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, show
from roboassembly.errors import InputError


@dataclass(frozen=True)
class DatasetCommand:
    """Build, list or show data sets of generated furniture."""

    what: Annotated[Literal["build", "list", "show"], tyro.conf.Positional]
    """build: generate a set; run it again to resume an interrupted run. list: list all sets. show: describe a set."""
    name: Annotated[str, tyro.conf.Positional] = "chairs-412"
    """Name of the set."""
    seed: int = 0
    """Random seed of `build`; another seed gives other chairs."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    force: bool = False
    """Build the set again if it was built with another seed."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(0, seed=self.seed)
        require_at_least(1, jobs=self.jobs)
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
        """Check that building replaces no set of another seed, for which results may exist.

        Raises:
            InputError: the set was built with another seed, or the folder cannot be written.
        """
        from roboassembly.datasets import sets as datasets

        path = datasets.manifest_path(self.name)
        check_writable(path.parent)
        if self.force or not path.is_file():
            return
        try:
            built = datasets.load_manifest(self.name)
        except InputError:
            return  # a set of an older version, or a broken one, may be replaced
        if built.seed != self.seed:
            raise InputError(
                f"data set {self.name} was built with seed {built.seed}, not {self.seed}; replace it with --force"
            )

    def _build(self) -> None:
        from roboassembly.datasets.sets import RECIPES
        from roboassembly.solvers.dataset_builder import build_dataset

        with (
            workers(self.ray, self.jobs) as jobs,
            progress_bar(desc=f"building {self.name}", unit="chair") as progress,
        ):
            for done, total in build_dataset(RECIPES[self.name], self.seed, jobs):
                progress.total = total
                progress.update(done - progress.n)

    def _show(self) -> int:
        from statistics import median

        from roboassembly.datasets import sets as datasets

        manifest = datasets.load_manifest(self.name)
        summary: dict[str, dict[str, float]] = {}
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
