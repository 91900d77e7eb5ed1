"""From chairs to experts and their lessons: auto-encoder, Double DQN for each chair, plays that become lessons.

Everything is kept in one folder; whatever is there already is not done again.

    autoencoder.npz     what parts look like
    experts/…           one file a chair (`apprentices`)
    lessons/…           of the experts' plays (`expert_lessons`)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import SampleSet, dataset_file, files_hash
from roboassembly.learning.paper import autoencoder, imitation
from roboassembly.learning.paper import expert_dataset as expert_lessons
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.dqn import train as apprentices
from roboassembly.learning.paper.dqn.train import ExpertTraining, Mastery
from roboassembly.learning.paper.part_clouds import gather_clouds
from roboassembly.learning.progress import Progress
from roboassembly.parallel.processes import one_thread_each
from roboassembly.task.setting import SettingName


@dataclass(frozen=True)
class Schooling:
    """How experts come about."""

    features: autoencoder.Training = field(default_factory=autoencoder.Training)
    extra_clouds: int = 300
    """Generated pieces whose parts the auto-encoder sees besides."""
    experts: ExpertTraining = field(default_factory=ExpertTraining)
    side_by_side: int = 4
    """Experts trained in one call in each process."""
    plays: int = 6
    """Of each expert, to become lessons."""

    @staticmethod
    def usual(setting: SettingName) -> Schooling:
        """In a setting: with robots plays take long."""
        return Schooling(experts=ExpertTraining(setting=setting), plays=4 if setting == "full" else 6)

    def seeded(self, seed: int) -> Schooling:
        """The same with another seed."""
        return replace(self, features=replace(self.features, seed=seed), experts=replace(self.experts, seed=seed))


def extractor_of(folder: Path) -> Path:
    """Where the auto-encoder of a run lies."""
    return folder / "autoencoder.npz"


def teach_features(
    picks: Sequence[FurnitureRef], folder: Path, schooling: Schooling, notes: dict[str, Any], jobs: int
) -> Iterator[Progress]:
    """Train the auto-encoder, or go on; nothing if it is done.

    Args:
        picks: chairs whose parts are taught.
        folder: of the run.
        schooling: how.
        notes: kept in the checkpoint: what it was trained on.
        jobs: processes.

    Raises:
        InputError: the checkpoint is of other training.
    """
    path, training = extractor_of(folder), schooling.features
    if path.is_file() and int(checkpoint.load(path, autoencoder.KIND).extra["step"]) >= training.steps:
        return
    # Small networks: threads would only get in each other's way.
    with one_thread_each():
        clouds = gather_clouds(picks, jobs=jobs, extra=schooling.extra_clouds)
        for step, terms in autoencoder.train(clouds, path, training, notes):
            yield Progress("auto-encoder", step, training.steps, terms)


def teach_experts(
    picks: Sequence[FurnitureRef], folder: Path, schooling: Schooling, notes: dict[str, Any], jobs: int
) -> Iterator[Progress]:
    """Train an expert for each chair, then write the lessons of those that finish it, from where the run was left.

    Args:
        picks: the chairs.
        folder: of the run, with the auto-encoder in it.
        schooling: how.
        notes: kept in the experts' files.
        jobs: processes.
    """
    experts = folder / "experts"
    training = apprentices.train(
        picks, experts, schooling.experts, extractor_of(folder), notes, jobs=jobs, side_by_side=schooling.side_by_side
    )
    mastered = lessons = 0
    for done, result in enumerate(training, 1):
        mastered += result.mastered
        yield Progress("experts", done, len(picks), {"mastered": mastered})
    teaching = expert_lessons.teach(
        picks, experts, folder / "lessons", schooling.experts, plays=schooling.plays, jobs=jobs
    )
    for done, taught in enumerate(teaching, 1):
        lessons += taught.lessons
        yield Progress("experts' lessons", done, len(picks), {"lessons": lessons})


def results(picks: Sequence[FurnitureRef], folder: Path) -> list[Mastery]:
    """What became of the chairs of a run that is done."""
    return [apprentices.read(dataset_file(folder / "experts", p.name)) for p in picks]


def teach_paper(
    folders: Sequence[Path], extractor: Path, folder: Path, training: imitation.Training
) -> Iterator[Progress]:
    """Train the multi-task policy on all samples of some folders, or go on; `policy.npz` is the result.

    Args:
        folders: folders of samples, of experts or of the oracle.
        extractor: checkpoint of the auto-encoder.
        folder: folder of the run.
        training: settings of the training.

    Raises:
        InputError: no samples, a broken file, or the folder holds another run.
    """
    encoder = checkpoint.load(extractor, autoencoder.KIND).params
    files = sorted(path for f in folders for path in f.glob("*.npz"))
    sets = [loaded for path in files if (loaded := SampleSet.load(path)).samples]
    if not sets:
        raise InputError(f"no samples in {', '.join(map(str, folders))}; `roboassembly train expert` makes some")
    notes = {"samples": files_hash(files)}
    examples = imitation.examples_of(sets, encoder, imitation.Augmentation(seed=training.seed))
    path = folder / "paper.npz"
    steps = imitation.train(examples, encoder, path, training, paper.PaperConfig(), notes)
    for step, terms in steps:
        yield Progress("paper", step, training.steps, terms)
    done = checkpoint.load(path, paper.KIND)
    checkpoint.save(folder / "policy.npz", checkpoint.Checkpoint(done.kind, done.params, done.config, {}), half=True)
