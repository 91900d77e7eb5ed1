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
from roboassembly.processes import spread

if TYPE_CHECKING:
    from roboassembly.furniture.datasets import Pick
    from roboassembly.learning.apprentices import Mastery
    from roboassembly.learning.single_task import Schooling


@dataclass(frozen=True)
class Autoencoder:
    """What a part looks like, in a few numbers: the features that experts and the preset `paper` see."""

    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Chairs whose parts are taught: `NAME:SPLIT` or `folder:PATH`."""
    out: Path = Path("runs/experts")
    """Folder of the run; the result is autoencoder.npz in it."""
    limit: int | None = None
    """The first so many chairs only."""
    sample: int | None = None
    """So many of the chairs, drawn by the seed."""
    steps: int | None = None
    """Updates (4,000)."""
    seed: int = 0
    """Of weights, order and the sample."""
    jobs: Jobs = CORES
    """Processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        picks = self.prepared()
        with spread(self.ray, self.jobs) as jobs:
            last = self.featured(picks, jobs)
        if self.json:
            chamfer = last.get("auto-encoder/chamfer")
            print_json({"set": self.set, "steps": self.schooling().features.steps, "chamfer": chamfer,
                        "out": str(self.out)})  # fmt: skip
        return DONE

    def prepared(self) -> list[Pick]:
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
        from roboassembly.learning.single_task import Schooling

        plain = Schooling()
        features = plain.features if self.steps is None else replace(plain.features, steps=self.steps)
        return replace(plain, features=features).seeded(self.seed)

    def featured(self, picks: Sequence[Pick], jobs: int) -> dict[str, float]:
        """Train the auto-encoder unless it is done; what it said last."""
        from roboassembly.learning.single_task import teach_features

        notes = {"set": self.set, "limit": self.limit, "sample": self.sample}
        return follow(teach_features(picks, self.out, self.schooling(), notes, jobs), self.out)


@dataclass(frozen=True)
class Expert(Autoencoder):
    """A Double DQN for each chair, and lessons of what it does; trains the auto-encoder first if there is none."""

    steps: int | None = None
    """Of the environment, for each chair, at most (40,000)."""
    setting: Setting = "object-centric"
    """What moves the parts: they fly by themselves, or two mobile Frankas move them."""
    plays: int | None = None
    """Of each expert, to become lessons; 6, with robots 4."""
    side_by_side: int = 4
    """Experts trained in one call in each process; many more on a GPU."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if min(self.side_by_side, 1 if self.plays is None else self.plays) < 1:
            raise InputError("--side-by-side and --plays take 1 or more")
        picks = self.prepared()
        from roboassembly.learning.single_task import results, teach_experts

        with spread(self.ray, self.jobs) as jobs:
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
        from roboassembly.learning.single_task import Schooling

        usual = Schooling.usual(self.setting)
        experts = usual.experts if self.steps is None else replace(usual.experts, steps=self.steps)
        plays = self.plays or usual.plays
        return replace(usual, experts=experts, side_by_side=self.side_by_side, plays=plays).seeded(self.seed)


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
