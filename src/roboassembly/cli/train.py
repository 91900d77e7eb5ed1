"""`roboassembly train`: the auto-encoder, one expert per piece, and one policy for all pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from roboassembly.cli.multitask import PACKAGES, MultitaskCommand, follow, require_packages
from roboassembly.cli.options import CORES, Jobs, Ray, Setting, require_at_least, selected_furniture, workers
from roboassembly.cli.output import DONE, FAILED, print_json, show, writable_folder

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef
    from roboassembly.learning.paper.dqn.results import ExpertResult
    from roboassembly.learning.paper.pipeline import PipelineConfig


@dataclass(frozen=True)
class AutoencoderCommand:
    """Train the auto-encoder, which encodes the shape of a part as a short vector."""

    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Furniture to train on: `NAME:SPLIT` of a data set, or `folder:PATH`, a folder of furniture folders."""
    out: Path = Path("runs/experts")
    """Folder of the run; the result is autoencoder.npz. Run the same command again to resume an interrupted run."""
    limit: int | None = None
    """Use the first LIMIT pieces of the set only."""
    sample: int | None = None
    """Use SAMPLE random pieces of the set only."""
    steps: int | None = None
    """Number of gradient steps. Without it: 4,000."""
    seed: int = 0
    """Random seed of the weights, of the order of samples and of --sample."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        refs = self.select_furniture()
        with workers(self.ray, self.jobs) as jobs:
            last = self.train_autoencoder(refs, jobs)
        if self.json:
            chamfer = last.get("auto-encoder/chamfer")
            print_json({"set": self.set, "steps": self.config().autoencoder.steps, "chamfer": chamfer,
                        "out": str(self.out)})  # fmt: skip
        return DONE

    def select_furniture(self) -> list[FurnitureRef]:
        """Check all options, and return the furniture to train on."""
        require_at_least(0, seed=self.seed)
        require_at_least(1, jobs=self.jobs, steps=self.steps)
        require_packages(*PACKAGES)
        refs = selected_furniture(self.set, self.limit, self.sample, self.seed)
        writable_folder(self.out)
        return refs

    def config(self) -> PipelineConfig:
        """Return the configuration of the run."""
        from roboassembly.learning.paper.pipeline import PipelineConfig

        plain = PipelineConfig()
        autoencoder = plain.autoencoder if self.steps is None else replace(plain.autoencoder, steps=self.steps)
        return replace(plain, autoencoder=autoencoder).seeded(self.seed)

    def train_autoencoder(self, refs: Sequence[FurnitureRef], jobs: int) -> dict[str, float]:
        """Train the auto-encoder unless it is trained already; returns its last figures."""
        from roboassembly.learning.paper.pipeline import train_autoencoder

        notes = {"set": self.set, "limit": self.limit, "sample": self.sample}
        return follow(train_autoencoder(refs, self.out, self.config(), notes, jobs), self.out)


@dataclass(frozen=True)
class ExpertCommand(AutoencoderCommand):
    """Train the auto-encoder and a Double DQN expert per piece, and write the experts' samples."""

    steps: int | None = None
    """Largest number of environment steps per piece. Without it: 40,000."""
    setting: Setting = "object-centric"
    episodes: int | None = None
    """Number of episodes of each expert that become training samples. Without it: 2, or 4 with --setting full."""
    side_by_side: int = 4
    """Number of experts that each process trains at the same time; a GPU can train many more."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(1, side_by_side=self.side_by_side, episodes=self.episodes)
        refs = self.select_furniture()
        from roboassembly.learning.paper.pipeline import expert_results, train_experts

        with workers(self.ray, self.jobs) as jobs:
            self.train_autoencoder(refs, jobs)
            follow(train_experts(refs, self.out, self.config(), {"set": self.set}, jobs), self.out)
        trained = expert_results(refs, self.out)
        report = _report(refs, trained)
        if self.json:
            print_json({**report, "set": self.set, "seed": self.seed, "out": str(self.out)})
        else:
            for split, figures in report.items():
                show(f"{split}: {figures}")
        return DONE if any(r.mastered for r in trained) else FAILED

    def config(self) -> PipelineConfig:
        """Return the configuration of the run."""
        from roboassembly.learning.paper.pipeline import PipelineConfig

        usual = PipelineConfig.default(self.setting)
        experts = usual.experts if self.steps is None else replace(usual.experts, steps=self.steps)
        episodes = self.episodes or usual.episodes
        return replace(usual, experts=experts, side_by_side=self.side_by_side, episodes=episodes).seeded(self.seed)


def _report(refs: Sequence[FurnitureRef], results: Sequence[ExpertResult]) -> dict[str, object]:
    """Return figures for all pieces, and for each split of the set."""
    from roboassembly.learning.paper.dqn.results import summary

    split_of = {p.name: p.entry.split for p in refs if p.entry is not None}
    out: dict[str, object] = dict(summary(results))
    for split in sorted(set(split_of.values())):
        out[split] = summary([r for r in results if split_of.get(r.name) == split])
    out["per_furniture"] = [vars(r) for r in sorted(results, key=lambda r: r.name)]
    return out


@dataclass(frozen=True)
class TrainCommand:
    """Train networks; run the same command again to resume an interrupted run."""

    what: (
        Annotated[AutoencoderCommand, tyro.conf.subcommand("autoencoder")]
        | Annotated[ExpertCommand, tyro.conf.subcommand("expert")]
        | Annotated[MultitaskCommand, tyro.conf.subcommand("multitask")]
    )

    @property
    def json(self) -> bool:
        """Whether the result goes to stdout as JSON."""
        return self.what.json

    def run(self) -> int:
        """Run the command; returns the exit status."""
        return self.what.run()
