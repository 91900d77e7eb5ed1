"""`roboassembly train multitask`: one policy for all pieces, by imitation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs, Ray, Setting, require_at_least, selected_furniture, workers
from roboassembly.cli.output import DONE, print_json, progress_bar, say, show, writable_folder
from roboassembly.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tqdm import tqdm

    from roboassembly.learning.progress import Progress


PACKAGES = ("jax", "optax", "tensorboardX", "matplotlib")
"""Packages that a training run needs."""


@dataclass(frozen=True)
class MultitaskCommand:
    """Train one policy for all pieces by imitation; run it again to resume an interrupted run."""

    preset: Literal["relational", "paper"] = "relational"
    """relational: imitate an oracle. paper: imitate the Q-values of the experts, from their samples in --samples. In
    later --rounds, both learn from the policy's own episodes, with the same teacher."""
    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Generated furniture to train on, `NAME:SPLIT`; for the preset relational, and --rounds of the preset paper."""
    out: Path = Path("runs/multitask")
    """Folder of the run; the result is policy.npz."""
    limit: int | None = None
    """Use the first LIMIT pieces of the set only."""
    extra: int | None = None
    """Number of additional generated pieces to train on; for the preset relational. Without it: 5,000; 700 with
    --start, or 110 with --setting full."""
    imported: Path | None = None
    """Folder of imported furniture folders to train on besides; for the preset relational."""
    imported_versions: int | None = None
    """Number of versions of each imported piece, in other sizes along each axis, to train on besides. Without it: 0, or
    5 with --start in the object-centric setting."""
    frames: Literal["both", "aligned", "own"] = "both"
    """Frames in which samples describe the parts; for the preset relational. own: the principal axes of each part, with
    clouds of its own, noise and imprecise points. both: a third of the pieces aligned, the others own."""
    episodes: int | None = None
    """Number of episodes per piece and round. Without it: 1; 4 for the preset paper."""
    rounds: int | None = None
    """Number of rounds with corrected episodes of the policy. Without it: 0, or 1 with --setting full. For the preset
    paper they need --experts."""
    setting: Setting = "object-centric"
    """Setting of the task; for the preset paper, of the experts in --experts, which only --rounds needs."""
    start: str | None = None
    """Policy to start from, `relational` or a checkpoint; for the preset relational. Without it: none, or `relational`
    with --setting full."""
    steps: int | None = None
    """Number of gradient steps. Without it: 30,000 for the preset paper; 16,000 for the first round of the preset
    relational, 6,000 with --start, or 12,000 with --setting full."""
    round_steps: int = 8_000
    """Number of gradient steps in each later round."""
    samples: tuple[Path, ...] = ()
    """Folders of training samples from `train expert` or from a run of the preset relational; for the preset paper."""
    extractor: Path | None = None
    """Checkpoint autoencoder.npz of the auto-encoder; for the preset paper."""
    experts: Path | None = None
    """Folder of the experts of the pieces in --set, from `train expert`; for --rounds of the preset paper."""
    seed: int = 0
    """Random seed of the weights, of the initial placements and of the order of samples."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        require_at_least(
            0, seed=self.seed, extra=self.extra, rounds=self.rounds, imported_versions=self.imported_versions
        )
        require_at_least(1, episodes=self.episodes, round_steps=self.round_steps, jobs=self.jobs)
        require_at_least(1, limit=self.limit, steps=self.steps)
        require_packages(*PACKAGES)
        writable_folder(self.out)
        with workers(self.ray, self.jobs) as jobs:
            last = follow(self._relational(jobs) if self.preset == "relational" else self._paper(jobs), self.out)
        path = self.out / "policy.npz"
        source = {"set": self.set} if self.preset == "relational" else {"samples": [str(s) for s in self.samples]}
        report = {"preset": self.preset, "policy": str(path), **source, "seed": self.seed, "last": last}
        if self.json:
            print_json(report)
        else:
            show(f"{path}: evaluate it with roboassembly evaluate --policy {path}")
        return DONE

    def _relational(self, jobs: int) -> Iterable[Progress]:
        from roboassembly.learning.relational.pipeline import RelationalPipelineConfig, run_pipeline

        default = RelationalPipelineConfig.default(self.setting, continues=self.start is not None)
        options = ("extra", "imported_versions", "episodes", "rounds", "steps")
        given = {name: value for name in options if (value := getattr(self, name)) is not None}
        config = replace(
            default, set=self.set, limit=self.limit, round_steps=self.round_steps, seed=self.seed,
            start=self.start or default.start, frames=self.frames,
            imported="" if self.imported is None else str(self.imported), **given,
        )  # fmt: skip
        return run_pipeline(config, self.out, jobs)

    def _paper(self, jobs: int) -> Iterable[Progress]:
        if not self.samples or self.extractor is None:
            raise InputError(
                "--preset paper needs --samples FOLDER and --extractor CHECKPOINT, both from `train expert`"
            )
        from roboassembly.learning.paper.dqn.train import ExpertTraining
        from roboassembly.learning.paper.imitation import PaperTraining
        from roboassembly.learning.paper.pipeline import AggregationConfig, train_policy

        aggregation = None
        if self.rounds:
            if self.experts is None or not self.experts.is_dir():
                raise InputError(
                    f"--rounds {self.rounds} of --preset paper needs --experts FOLDER, the folder `experts` that "
                    f"`train expert` made; got {self.experts}"
                )
            refs = selected_furniture(self.set, self.limit, None, self.seed)
            aggregation = AggregationConfig(
                refs, self.experts, self.rounds, self.round_steps, self.episodes or AggregationConfig.episodes,
                ExpertTraining(setting=self.setting),
            )  # fmt: skip
        training = PaperTraining(steps=self.steps or PaperTraining.steps, seed=self.seed)
        return train_policy(self.samples, self.extractor, self.out, training, aggregation, jobs)


def require_packages(*packages: str) -> None:
    """Check that packages are installed, and switch the cache of compiled JAX functions on.

    Raises:
        MissingExtraError: a package is not installed.
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingExtraError(package, "learn")
    from roboassembly.learning.compiled import keep_compiled

    keep_compiled()


def follow(progress: Iterable[Progress], folder: Path) -> dict[str, float]:
    """Show progress bars and write logs and curves of a run; returns the last figures by stage and name."""
    from roboassembly.learning import logs

    last: dict[str, float] = {}
    bar: tqdm[Any] | None = None
    stage = ""
    with logs.TrainingLog(folder) as log:
        for p in progress:
            if bar is None or stage != p.stage:
                if bar is not None:
                    bar.close()
                bar, stage = progress_bar(desc=p.stage, total=p.total), p.stage
            bar.update(p.done - bar.n)
            log.add(p.stage, p.done, p.scalars, last=p.done == p.total)
            last.update({f"{p.stage}/{name}": value for name, value in p.scalars.items()})
            if p.done == p.total:
                say(f"{p.stage}: " + ", ".join(f"{k} {v:.4f}" for k, v in p.scalars.items()))
    if bar is not None:
        bar.close()
        logs.draw(folder)
    return last
