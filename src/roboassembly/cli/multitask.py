"""`roboassembly train multitask`: one policy for all chairs, by imitation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tqdm import tqdm

from roboassembly.cli.options import CORES, Jobs, Ray, Setting
from roboassembly.cli.output import DONE, print_json, progress_bar, say, show, writable_folder
from roboassembly.errors import InputError, MissingExtraError
from roboassembly.parallel.processes import use_cluster

if TYPE_CHECKING:
    from collections.abc import Iterable

    from roboassembly.learning.progress import Progress


PACKAGES = ("jax", "optax", "tensorboardX", "matplotlib")
"""That a run with logs and curves needs."""


@dataclass(frozen=True)
class Multitask:
    """Train one policy for all pieces by imitation; the same command continues a run that was stopped."""

    preset: Literal["relational", "paper"] = "relational"
    """relational: learn from an oracle, then in --rounds from its own episodes, corrected by the oracle. paper: learn
    the Q-values of the experts' samples in --lessons."""
    set: Annotated[str, tyro.conf.arg(name="set")] = "chairs-412:train"
    """Generated furniture to train on, `NAME:SPLIT` (preset relational)."""
    out: Path = Path("runs/multitask")
    """Folder of the run. The result is policy.npz in it."""
    limit: int | None = None
    """Take only the first LIMIT pieces of the set."""
    extra: int | None = None
    """Number of further generated pieces to train on (preset relational). Without it: 6,000, in the setting full
    1,500."""
    plays: int | None = None
    """Number of episodes for each piece in each round (preset relational). Without it: 1, in the setting full 3."""
    rounds: int | None = None
    """Number of rounds in which the policy's own episodes are corrected (preset relational). Without it: 0, in the
    setting full 1."""
    setting: Setting = "object-centric"
    """What moves the parts (preset relational). object-centric: parts move by themselves. full: two mobile Franka
    robots move them."""
    start: str | None = None
    """Policy to start from, `relational` or a checkpoint (preset relational). Without it: none, in the setting full
    `relational`."""
    steps: int | None = None
    """Number of gradient steps. Without it: 16,000 (preset relational, first round), 3,000 (the same in the setting
    full), 20,000 (preset paper)."""
    round_steps: int = 8_000
    """Number of gradient steps in each later round (preset relational)."""
    lessons: tuple[Path, ...] = ()
    """Folders of training samples, from `train expert` or from a run of the preset relational (preset paper)."""
    extractor: Path | None = None
    """Checkpoint of the auto-encoder, autoencoder.npz (preset paper)."""
    seed: int = 0
    """Random seed of the weights, the starts and the order of samples."""
    jobs: Jobs = CORES
    """Number of processes."""
    ray: Ray = None
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        if (
            self.seed < 0
            or min(self.extra or 0, self.rounds or 0) < 0
            or min(1 if self.plays is None else self.plays, self.jobs, self.round_steps) < 1
        ):
            raise InputError("--seed, --extra, --rounds take 0 or more, --plays, --round-steps and --jobs 1 or more")
        if 0 in (self.limit, self.steps) or min(self.limit or 1, self.steps or 1) < 1:
            raise InputError("--limit and --steps take 1 or more")
        needs(*PACKAGES)
        writable_folder(self.out)
        with use_cluster(self.ray, self.jobs) as jobs:
            last = follow(self._relational(jobs) if self.preset == "relational" else self._paper(), self.out)
        path = self.out / "policy.npz"
        report = {"preset": self.preset, "policy": str(path), "set": self.set, "seed": self.seed, "last": last}
        if self.json:
            print_json(report)
        else:
            show(f"{path}: try it with roboassembly evaluate --policy {path}")
        return DONE

    def _relational(self, jobs: int) -> Iterable[Progress]:
        from roboassembly.learning.relational.pipeline import Curriculum, teach

        usual = Curriculum.with_hands() if self.setting == "full" else Curriculum()
        curriculum = replace(
            usual, set=self.set, limit=self.limit, extra=usual.extra if self.extra is None else self.extra,
            plays=self.plays or usual.plays, rounds=usual.rounds if self.rounds is None else self.rounds,
            steps=self.steps or usual.steps, round_steps=self.round_steps, seed=self.seed,
            start=self.start or usual.start,
        )  # fmt: skip
        return teach(curriculum, self.out, jobs)

    def _paper(self) -> Iterable[Progress]:
        if not self.lessons or self.extractor is None:
            raise InputError("--preset paper takes --lessons FOLDER and --extractor CHECKPOINT (of `train expert`)")
        from roboassembly.learning.paper.imitation import Training
        from roboassembly.learning.paper.pipeline import teach_paper

        training = Training(steps=self.steps or Training.steps, seed=self.seed)
        return teach_paper(self.lessons, self.extractor, self.out, training)


def needs(*packages: str) -> None:
    """Refuse where what training needs is not installed; what JAX will compile is kept.

    Raises:
        MissingExtraError: it is not.
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingExtraError(package, "learn")
    from roboassembly.learning.compiled import keep_compiled

    keep_compiled()


def follow(progress: Iterable[Progress], folder: Path) -> dict[str, float]:
    """Show bars and write logs and curves of a run while it goes on; what it said last, by stage and name."""
    from roboassembly.learning import logs

    last: dict[str, float] = {}
    bar: tqdm | None = None
    stage = ""
    with logs.Log(folder) as log:
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
