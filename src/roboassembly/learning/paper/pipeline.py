"""The paper's pipeline: auto-encoder, an expert for each chair, the experts' samples, the multi-task policy.

Everything is kept in one folder; what is there already is not done again.

    autoencoder.npz     encoder of the parts
    experts/…           one file a chair (`dqn.train`)
    samples/…           states of the experts' episodes with their Q-values (`expert_dataset`)

The policy has a folder of its own. With aggregation it trains again after each round of its own episodes:

    paper.npz           trained on the experts' samples
    aggregated/1/…      states of its episodes with the experts' Q-values (`aggregation`)
    paper-1.npz         trained on both
    …
    policy.npz          the last one
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import SampleSet, dataset_file, files_hash
from roboassembly.learning.fit import is_trained
from roboassembly.learning.layers import Params
from roboassembly.learning.paper import aggregation, autoencoder, expert_dataset, imitation
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.autoencoder import AutoencoderTraining
from roboassembly.learning.paper.dqn import train_all
from roboassembly.learning.paper.dqn.results import ExpertResult, read
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.learning.paper.examples import Augmentation, PaperExample, examples_of
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.part_clouds import collect_clouds
from roboassembly.learning.progress import Progress
from roboassembly.parallel.processes import one_thread_each
from roboassembly.task.setting import SettingName


@dataclass(frozen=True)
class AggregationConfig:
    """Settings of aggregation: rounds in which the policy learns from its own episodes."""

    refs: Sequence[FurnitureRef]
    """Chairs of the episodes."""
    experts: Path
    """Folder of their experts."""
    rounds: int
    """Number of rounds."""
    steps: int = 8_000
    """Number of gradient steps in each round."""
    episodes: int = 4
    """Number of episodes of each chair in each round."""
    training: ExpertTraining = field(default_factory=ExpertTraining)
    """Settings with which the experts were trained."""


@dataclass(frozen=True)
class PipelineConfig:
    """Settings of the auto-encoder, the experts and their samples."""

    autoencoder: AutoencoderTraining = field(default_factory=AutoencoderTraining)
    """Settings of the auto-encoder's training."""
    extra_clouds: int = 300
    """Number of generated pieces whose parts the auto-encoder sees in addition."""
    experts: ExpertTraining = field(default_factory=ExpertTraining)
    """Settings of the experts' training."""
    side_by_side: int = 4
    """Number of experts that one process trains at the same time."""
    episodes: int = 2
    """Number of episodes of each expert that become samples. From each start it takes the same actions."""
    memories: int = 100
    """Largest number of states from an expert's replay buffer that become samples."""

    @staticmethod
    def default(setting: SettingName) -> PipelineConfig:
        """Return the default configuration of a setting."""
        return _DEFAULTS[setting]

    def seeded(self, seed: int) -> PipelineConfig:
        """Return the same settings with another random seed."""
        return replace(self, autoencoder=replace(self.autoencoder, seed=seed), experts=replace(self.experts, seed=seed))


_DEFAULTS: dict[SettingName, PipelineConfig] = {
    config.experts.setting: config
    for config in (
        PipelineConfig(),
        # Episodes of this setting take long.
        PipelineConfig(experts=ExpertTraining(setting="full"), episodes=4),
    )
}


def autoencoder_file(folder: Path) -> Path:
    """Return where a run keeps its auto-encoder."""
    return folder / "autoencoder.npz"


def experts_folder(folder: Path) -> Path:
    """Return where a run keeps its experts."""
    return folder / "experts"


def samples_folder(folder: Path) -> Path:
    """Return where a run keeps the experts' samples."""
    return folder / "samples"


def train_autoencoder(
    refs: Sequence[FurnitureRef], folder: Path, config: PipelineConfig, notes: dict[str, Any], jobs: int
) -> Iterator[Progress]:
    """Train the auto-encoder, or go on; does nothing if it is trained.

    Args:
        refs: chairs whose parts it learns.
        folder: folder of the run.
        config: settings.
        notes: origin of the chairs, kept in the checkpoint.
        jobs: number of processes.

    Raises:
        InputError: the checkpoint is of other training.
    """
    path, training = autoencoder_file(folder), config.autoencoder
    if is_trained(path, autoencoder.KIND, training.steps):
        return
    # The networks are small: threads would only get in each other's way.
    with one_thread_each():
        clouds = collect_clouds(refs, jobs=jobs, extra=config.extra_clouds)
        for step, terms in autoencoder.train(clouds, path, training, notes):
            yield Progress("auto-encoder", step, training.steps, terms)


def train_experts(
    refs: Sequence[FurnitureRef], folder: Path, config: PipelineConfig, notes: dict[str, Any], jobs: int
) -> Iterator[Progress]:
    """Train an expert for each chair, then write the samples of those that finish it; continues a stopped run.

    Args:
        refs: the chairs.
        folder: folder of the run, with the auto-encoder in it.
        config: settings.
        notes: kept in the experts' files.
        jobs: number of processes.
    """
    experts = experts_folder(folder)
    training = train_all.train(
        refs, experts, config.experts, autoencoder_file(folder), notes, jobs=jobs, side_by_side=config.side_by_side
    )
    mastered = states = 0
    for done, result in enumerate(training, 1):
        mastered += result.mastered
        yield Progress("experts", done, len(refs), {"mastered": mastered})
    collecting = expert_dataset.collect(
        refs, experts, samples_folder(folder), config.experts, episodes=config.episodes, memories=config.memories,
        jobs=jobs,
    )  # fmt: skip
    for done, collected in enumerate(collecting, 1):
        states += collected.samples
        yield Progress("experts' samples", done, len(refs), {"samples": states})


def expert_results(refs: Sequence[FurnitureRef], folder: Path) -> list[ExpertResult]:
    """Return what became of the chairs of a finished run."""
    return [read(dataset_file(experts_folder(folder), ref.name)) for ref in refs]


def train_policy(
    folders: Sequence[Path],
    encoder_file: Path,
    folder: Path,
    training: PaperTraining,
    aggregate: AggregationConfig | None = None,
    jobs: int = 1,
    result: str = "policy.npz",
) -> Iterator[Progress]:
    """Train the multi-task policy on all samples of some folders, or go on.

    Args:
        folders: folders of samples, from experts or from the oracle.
        encoder_file: checkpoint of the auto-encoder.
        folder: folder of the run.
        training: settings.
        aggregate: settings of aggregation; None without it.
        jobs: number of processes of aggregation.
        result: name of the file that gets the trained policy.

    Raises:
        InputError: there are no samples, a file is broken, or the folder holds another run.
    """
    files = sorted(path for f in folders for path in f.glob("*.npz"))
    rounds = 0 if aggregate is None else aggregate.rounds
    later = [folder / "aggregated" / str(index) for index in range(1, rounds + 1)]
    trainings = [training, *(_of_round(training, aggregate, index) for index in range(1, rounds + 1) if aggregate)]
    paths = [folder / "paper.npz", *(folder / f"paper-{index}.npz" for index in range(1, rounds + 1))]
    # Examples take minutes to make.
    all_files = [*files, *(path for f in later for path in sorted(f.glob("*.npz")))]
    if _is_result(folder / result, trainings[-1], all_files):
        return
    encoder = checkpoint.load(encoder_file, autoencoder.KIND).params
    examples = _examples_of(files, encoder, training.seed)
    if not examples:
        raise InputError(f"no samples in {', '.join(map(str, folders))}; `roboassembly train expert` makes some")
    last: Path | None = None
    for index, (path, of_round) in enumerate(zip(paths, trainings, strict=True)):
        if last is not None and aggregate is not None:
            samples = later[index - 1]
            yield from _aggregate(aggregate, last, samples, of_round.seed, index, jobs)
            added = sorted(samples.glob("*.npz"))
            files += added
            examples += _examples_of(added, encoder, of_round.seed)
        notes = {"samples": files_hash(files)}
        for step, terms in imitation.train(examples, encoder, path, of_round, paper.PaperConfig(), notes, last):
            yield Progress("paper" if last is None else f"paper {index}", step, of_round.steps, terms)
        last = path
    done = checkpoint.load(paths[-1], paper.KIND)
    checkpoint.save(folder / result, checkpoint.Checkpoint(done.kind, done.params, done.config, {}), half=True)


def _of_round(training: PaperTraining, aggregate: AggregationConfig, index: int) -> PaperTraining:
    """Return the settings of the training in a round of aggregation."""
    return replace(
        training, steps=aggregate.steps, seed=training.seed + index, learning_rate=0.5 * training.learning_rate
    )


def _is_result(path: Path, training: PaperTraining, files: Sequence[Path]) -> bool:
    """Return whether a policy is there that was trained on some files of samples."""
    if not path.is_file():
        return False
    config = checkpoint.load(path, paper.KIND).config
    return config["training"] == asdict(training) and config["samples"] == files_hash(files)


def _examples_of(files: Sequence[Path], encoder: Params, seed: int) -> list[PaperExample]:
    """Return the augmented examples of some files of samples."""
    sets = [loaded for path in files if (loaded := SampleSet.load(path)).samples]
    return examples_of(sets, encoder, Augmentation(seed=seed))


def _aggregate(
    config: AggregationConfig, policy: Path, folder: Path, seed: int, index: int, jobs: int
) -> Iterator[Progress]:
    """Collect the samples of a round; tells which share of the policy's episodes finishes the chair."""
    existing = sum(dataset_file(folder, ref.name).is_file() for ref in config.refs)
    collecting = aggregation.collect(
        config.refs, config.experts, policy, folder, config.training, episodes=config.episodes, seed=seed, jobs=jobs
    )
    finished = episodes = 0
    for done, result in enumerate(collecting, 1):
        finished, episodes = finished + result.finished, episodes + result.episodes
        yield Progress(
            f"aggregation {index}", existing + done, len(config.refs), {"finished": finished / max(episodes, 1)}
        )
