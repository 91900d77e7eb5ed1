"""`roboassembly train`: the auto-encoder, an expert for each chair, one policy for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from roboassembly.cli.multitask import PACKAGES, Multitask, follow, needs
from roboassembly.cli.options import CORES, Jobs, Ray, Setting, chosen
from roboassembly.cli.output import DONE, DONE_BADLY, print_json, show, writable_folder
from roboassembly.errors import InputError
from roboassembly.parallel.processes import use_cluster

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef
    from roboassembly.learning.paper.dqn.train import Mastery
    from roboassembly.learning.paper.pipeline import Schooling


@dataclass(frozen=True)
class Autoencoder:
    """Train the auto-encoder, which describes the shape of a part in a few numbers."""

    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Furniture to train on: `NAME:SPLIT` of a data set, or `folder:PATH` of a folder of furniture folders."""
    out: Path = Path("runs/experts")
    """Folder of the run. The result is autoencoder.npz in it. If the run is stopped, the same command continues it."""
    limit: int | None = None
    """Take only the first LIMIT pieces of the set."""
    sample: int | None = None
    """Take only SAMPLE pieces of the set, drawn by the seed."""
    steps: int | None = None
    """Number of gradient steps. Without it: 4,000."""
    seed: int = 0
    """Random seed of the weights, the order of samples and --sample."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        picks = self.prepared()
        with use_cluster(self.ray, self.jobs) as jobs:
            last = self.featured(picks, jobs)
        if self.json:
            chamfer = last.get("auto-encoder/chamfer")
            print_json({"set": self.set, "steps": self.schooling().features.steps, "chamfer": chamfer,
                        "out": str(self.out)})  # fmt: skip
        return DONE

    def prepared(self) -> list[FurnitureRef]:
        """The furniture, once everything is checked."""
        if self.seed < 0 or self.jobs < 1:
            raise InputError("--seed takes 0 or more, --jobs takes 1 or more")
        if self.steps is not None and self.steps < 1:
            raise InputError("--steps takes 1 or more")
        needs(*PACKAGES)
        picks = chosen(self.set, self.limit, self.sample, self.seed)
        writable_folder(self.out)
        return picks

    def schooling(self) -> Schooling:
        """How."""
        from roboassembly.learning.paper.pipeline import Schooling

        plain = Schooling()
        features = plain.features if self.steps is None else replace(plain.features, steps=self.steps)
        return replace(plain, features=features).seeded(self.seed)

    def featured(self, picks: Sequence[FurnitureRef], jobs: int) -> dict[str, float]:
        """Train the auto-encoder unless it is done; what it said last."""
        from roboassembly.learning.paper.pipeline import teach_features

        notes = {"set": self.set, "limit": self.limit, "sample": self.sample}
        return follow(teach_features(picks, self.out, self.schooling(), notes, jobs), self.out)


@dataclass(frozen=True)
class Expert(Autoencoder):
    """Train a Double DQN for each piece and write training samples of it; the auto-encoder comes first."""

    steps: int | None = None
    """Largest number of environment steps for each piece. Without it: 40,000."""
    setting: Setting = "object-centric"
    """What moves the parts. object-centric: parts move by themselves. full: two mobile Franka robots move them."""
    plays: int | None = None
    """Number of episodes of each expert that become training samples. Without it: 6, in the setting full 4."""
    side_by_side: int = 4
    """Number of experts that each process trains at the same time; a GPU takes many more."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if min(self.side_by_side, 1 if self.plays is None else self.plays) < 1:
            raise InputError("--side-by-side and --plays take 1 or more")
        picks = self.prepared()
        from roboassembly.learning.paper.pipeline import results, teach_experts

        with use_cluster(self.ray, self.jobs) as jobs:
            self.featured(picks, jobs)
            follow(teach_experts(picks, self.out, self.schooling(), {"set": self.set}, jobs), self.out)
        trained = results(picks, self.out)
        report = _report(picks, trained)
        if self.json:
            print_json({**report, "set": self.set, "seed": self.seed, "out": str(self.out)})
        else:
            for split, figures in report.items():
                show(f"{split}: {figures}")
        return DONE if any(r.mastered for r in trained) else DONE_BADLY

    def schooling(self) -> Schooling:
        """How."""
        from roboassembly.learning.paper.pipeline import Schooling

        usual = Schooling.usual(self.setting)
        experts = usual.experts if self.steps is None else replace(usual.experts, steps=self.steps)
        plays = self.plays or usual.plays
        return replace(usual, experts=experts, side_by_side=self.side_by_side, plays=plays).seeded(self.seed)


def _report(picks: Sequence[FurnitureRef], results: Sequence[Mastery]) -> dict[str, object]:
    """Figures over all chairs, and over those of each split if the set has any."""
    from roboassembly.learning.paper.dqn.train import mastery

    split_of = {p.name: p.entry.split for p in picks if p.entry is not None}
    out: dict[str, object] = dict(mastery(results))
    for split in sorted(set(split_of.values())):
        out[split] = mastery([r for r in results if split_of.get(r.name) == split])
    out["per_furniture"] = [vars(r) for r in sorted(results, key=lambda r: r.name)]
    return out


@dataclass(frozen=True)
class Train:
    """Train networks; the same command continues a run that was stopped."""

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
