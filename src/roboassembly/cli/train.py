"""`roboassembly train`: the auto-encoder, an expert for each chair, one policy for all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tqdm import tqdm

from roboassembly.cli.multitask import Multitask, needs
from roboassembly.cli.output import DONE, DONE_BADLY, print_json, say, writable_folder
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.furniture.datasets import Pick
    from roboassembly.learning.apprentices import Mastery


@dataclass(frozen=True)
class Autoencoder:
    """What a part looks like, in a few numbers: the features that experts and the preset `paper` see."""

    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Chairs whose parts are taught: `NAME:SPLIT` or `folder:PATH`."""
    out: Path = Path("runs/experts")
    """Folder of the run; the result is autoencoder.npz in it."""
    limit: int | None = None
    """The first so many chairs only."""
    steps: int | None = None
    """Updates (4,000)."""
    seed: int = 0
    """Of weights and order."""
    jobs: int = os.cpu_count() or 1
    """Processes."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        picks = self.prepared()
        report = self.train(picks)
        if self.json:
            print_json(report)
        return DONE

    def prepared(self) -> list[Pick]:
        """The furniture, once everything is checked and JAX is told to keep to one thread."""
        if self.seed < 0 or self.jobs < 1:
            raise InputError("--seed takes 0 or more, --jobs takes 1 or more")
        if min(self.limit or 1, self.steps or 1) < 1 or 0 in (self.limit, self.steps):
            raise InputError("--limit and --steps take 1 or more")
        needs("jax", "optax")
        # Many small networks, one process each: threads would only get in each other's way.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
        from roboassembly.furniture.datasets import pick

        picks = pick(self.set)[: self.limit]
        writable_folder(self.out)
        return picks

    def train(self, picks: Sequence[Pick]) -> dict[str, object]:
        """Train, or go on; what is to be told."""
        from roboassembly.learning import autoencoder
        from roboassembly.learning.part_clouds import gather_clouds

        training = autoencoder.Training(seed=self.seed)
        training = training if self.steps is None else replace(training, steps=self.steps)
        clouds = gather_clouds(picks, jobs=self.jobs)
        loss = 0.0
        with tqdm(total=training.steps, unit="step") as progress:
            for step, terms in autoencoder.train(
                clouds, self.out / "autoencoder.npz", training, {"set": self.set, "limit": self.limit}
            ):
                loss = terms["chamfer"]
                progress.update(step - progress.n)
                progress.set_postfix(chamfer=f"{loss:.5f}")
        return {"clouds": len(clouds), "steps": training.steps, "chamfer": loss, "out": str(self.out)}


@dataclass(frozen=True)
class Expert(Autoencoder):
    """A Double DQN for each chair, and lessons of what it does; trains the auto-encoder first if there is none."""

    steps: int | None = None
    """Of the environment, for each chair, at most (40,000)."""
    plays: int = 6
    """Of each expert, to become lessons."""
    side_by_side: int = 4
    """Experts trained in one call in each process; many more on a GPU."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if min(self.side_by_side, self.plays) < 1:
            raise InputError("--side-by-side and --plays take 1 or more")
        picks = self.prepared()
        path = self.out / "autoencoder.npz"
        if not path.exists():
            say(f"no {path} yet: training the auto-encoder first")
            replace(self, steps=None).train(picks)
        return self._experts(picks, path)

    def _experts(self, picks: Sequence[Pick], extractor: Path) -> int:
        from roboassembly.learning import expert_lessons
        from roboassembly.learning.apprentices import ExpertTraining, train

        training = ExpertTraining(seed=self.seed)
        training = training if self.steps is None else replace(training, steps=self.steps)
        folder = self.out / "experts"
        results: list[Mastery] = []
        with tqdm(total=len(picks), unit="chair") as progress:
            for result in train(
                picks, folder, training, extractor, {"set": self.set}, jobs=self.jobs, side_by_side=self.side_by_side
            ):
                results.append(result)
                progress.update()
                progress.set_postfix(mastered=sum(r.mastered for r in results))
        with tqdm(total=len(picks), unit="chair", desc="lessons") as progress:
            lessons = 0
            for taught in expert_lessons.teach(
                picks, folder, self.out / "lessons", plays=self.plays, seed=self.seed, jobs=self.jobs
            ):
                lessons += taught.lessons
                progress.update()
        report = _report(picks, results)
        if self.json:
            print_json({**report, "set": self.set, "seed": self.seed, "out": str(self.out)})
        else:
            for split, figures in report.items():
                print(f"{split}: {figures}")
        return DONE if any(r.mastered for r in results) else DONE_BADLY


def _report(picks: Sequence[Pick], results: Sequence[Mastery]) -> dict[str, object]:
    """Figures over all chairs, and over those of each split if the set has any."""
    from roboassembly.learning.apprentices import mastery

    split_of = {p.name: p.entry.split for p in picks if p.entry is not None}
    out: dict[str, object] = dict(mastery(results))
    for split in sorted(set(split_of.values())):
        out[split] = mastery([r for r in results if split_of.get(r.name) == split])
    out["per_furniture"] = [vars(r) for r in sorted(results, key=lambda r: r.name)]
    return out


@dataclass(frozen=True)
class Train:
    """Train networks; stopped at any moment, the same command goes on where it was."""

    what: (
        Annotated[Autoencoder, tyro.conf.subcommand("autoencoder")]
        | Annotated[Expert, tyro.conf.subcommand("expert")]
        | Annotated[Multitask, tyro.conf.subcommand("multitask")]
    )

    @property
    def json(self) -> bool:
        """Whether the result goes to stdout as JSON."""
        return self.what.json

    def run(self) -> int:
        """Do it; returns the exit status."""
        return self.what.run()
