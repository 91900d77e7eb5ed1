"""Training pipeline of the relational policy, from nothing to a checkpoint: samples, imitation, rounds of DAgger.

In each round after the first, the policy acts itself, the oracle corrects its mistakes, and it trains on all samples so
far (DAgger, Ross et al. 2011). Everything is kept in one folder, and existing files are not made again, so a run that
was stopped continues where it was.

    samples/0/…         of random viable actions    policy-0.npz   trained on them
    samples/1/…         of episodes of policy-0     policy-1.npz   trained on both
    …                                               policy.npz     the last one

A run may start from the weights of a policy; the result is then a mean of these and of the trained ones. In the full
setting, it starts from an object-centric policy, keeps its weights, and trains the grasp network besides:

    grasps/0/…   of random grasps            grasps-0.npz   trained on them
    grasps/1/…   of episodes of acting-1     grasps-1.npz   trained on both

`policy.npz` then holds both networks.
"""

from __future__ import annotations

import contextlib
import os
import platform
import zlib
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from roboassembly.datasets.sets import RECIPES, FurnitureRef, furniture_refs, set_hash
from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture import storage
from roboassembly.furniture.resize import resized
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.fit import is_trained
from roboassembly.learning.generated import EXTRA_SEEDS, extra_names
from roboassembly.learning.layers import Params
from roboassembly.learning.policy_weights import load_weights
from roboassembly.learning.progress import Progress
from roboassembly.learning.relational import imitation
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import CollectResult, collect
from roboassembly.learning.relational.examples import SHOWN, Frames, TokenExample, load_examples
from roboassembly.learning.relational.grasps import imitation as grasp_imitation
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import collect_grasps
from roboassembly.learning.relational.grasps.on_policy import collect_on_policy
from roboassembly.learning.relational.imitation import RelationalTraining
from roboassembly.learning.relational.network import RelationalConfig
from roboassembly.learning.relational.policy import GRASP_PARAMS, RelationalPolicy
from roboassembly.parallel.processes import map_unordered
from roboassembly.settings import SETTINGS
from roboassembly.task.setting import SettingName

_LARGEST_FACTOR = 0.25
"""Largest logarithm of the factors between the sizes of an imported piece and of its versions."""
_VALIDATION_SEEDS = EXTRA_SEEDS + 1_000_000
"""First seed of the validation pieces."""


@dataclass(frozen=True)
class RelationalPipelineConfig:
    """Settings of the pipeline."""

    set: str = "chairs-412:train"
    """Generated furniture to train on, `NAME:SPLIT`."""
    limit: int | None = None
    """Number of pieces of the set, from the first on; all if None."""
    extra: int = 5_000
    """Number of further generated pieces: chairs of the set's training families, and simple frames."""
    validation: int = 60
    """Number of generated pieces for validation; none of them is trained on."""
    episodes: int = 1
    """Number of episodes of each piece in each round; the policy acts in the first of them."""
    rounds: int = 0
    """Number of rounds after the first; in the full setting, rounds of the grasp network."""
    steps: int = 16_000
    """Number of gradient steps in the first round; with robots in every round, each from fresh weights."""
    round_steps: int = 8_000
    """Number of gradient steps in each later round, without robots."""
    learning_rate: float = 2e-3
    """Largest learning rate in the first round; half of it in later ones."""
    batch: int = 16
    """Number of states of 48 tokens in a batch."""
    seed: int = 0
    """Random seed."""
    network: RelationalConfig = field(default_factory=RelationalConfig)
    """Sizes of the network."""
    frames: Frames = "both"
    """Frames in which the samples are shown."""
    imported: str = ""
    """Folder of imported furniture folders to train on besides; none if empty."""
    imported_episodes: int = 6
    """Number of episodes of each imported piece in each round."""
    imported_versions: int = 0
    """Number of versions of each imported piece, in other sizes along each axis, to train on besides."""
    version_episodes: int = 2
    """Number of episodes of each version in each round."""
    setting: SettingName = "object-centric"
    """Setting to train for: with robots, only the grasp network is trained."""
    start: str = ""
    """Policy whose weights come first, by name or path; none if empty. The full setting needs one. The result keeps its
    weights of the network that is not trained."""
    start_share: float = 0.2
    """Share of the weights of `start` in the trained ones. The mean is better on new furniture than the trained weights
    (Wortsman et al. 2022, "Robust Fine-Tuning of Zero-Shot Models")."""

    @property
    def rounds_of_networks(self) -> tuple[int, int]:
        """Number of rounds of the network that values pairs, and of the grasp network."""
        return SETTINGS[self.setting].rounds_of_networks(self.rounds)

    @staticmethod
    def default(setting: SettingName, *, continues: bool = False) -> RelationalPipelineConfig:
        """Return the default configuration of a setting.

        They made the shipped weights: that of a run from nothing, that of a run that
        `continues` from its weights, and that of the full setting.
        """
        return _DEFAULTS[setting][continues]


_CONTINUES = RelationalPipelineConfig(
    extra=700, validation=24, steps=6_000, learning_rate=1e-3, imported_episodes=4, imported_versions=5, start_share=0.3
)
_FULL = RelationalPipelineConfig(extra=110, validation=0, rounds=1, steps=12_000, setting="full", start="relational")
_DEFAULTS: dict[SettingName, tuple[RelationalPipelineConfig, RelationalPipelineConfig]] = {
    fresh.setting: (fresh, continued) for fresh, continued in ((RelationalPipelineConfig(), _CONTINUES), (_FULL, _FULL))
}
"""Defaults of each setting, from nothing and continued."""


def run_pipeline(config: RelationalPipelineConfig, folder: Path, jobs: int) -> Iterator[Progress]:
    """Run the pipeline in a folder, from where it stopped; `policy.npz` is the result.

    Args:
        config: settings.
        folder: folder of the run.
        jobs: number of processes.

    Raises:
        InputError: the set is not built, `config.start` is missing or of another network, or the folder holds a run
            with other settings.
    """
    recipe = RECIPES.get(config.set.partition(":")[0])
    if recipe is None:
        raise InputError(f"--set {config.set}: the oracle labels generated furniture; one of {', '.join(RECIPES)}")
    start = _start_checkpoint(config, folder)
    refs = furniture_refs(config.set)[: config.limit]
    imported = furniture_refs(f"folder:{config.imported}") if config.imported else []
    versions = yield from _make_versions(imported, folder / "versions", config, jobs)
    extra = extra_names(config.extra, recipe.unseen_families)
    names = [*(ref.name for ref in refs), *extra]
    notes = {"pipeline": asdict(config), "set_hash": set_hash([*refs, *imported])}
    pair_rounds, grasp_rounds = config.rounds_of_networks
    started = None if start is None else checkpoint.load(start, relational.KIND)
    if grasp_rounds:
        assert started is not None
        described = {**started.config, "grasps": notes}
        yield from _grasp_rounds(started.params, described, [*refs, *imported, *versions], extra, folder, config, jobs)
        return

    held_out = extra_names(config.validation, recipe.unseen_families, first=_VALIDATION_SEEDS)
    yield from _collect("validation", held_out, folder / "samples" / "validation", config, jobs, None, config.episodes)
    validation = {
        shown: load_examples(folder / "samples" / "validation", held_out, jobs, shown) for shown in SHOWN[config.frames]
    }
    examples: list[TokenExample] = []
    last = start
    for index in range(pair_rounds):
        samples, path = folder / "samples" / str(index), folder / f"policy-{index}.npz"
        for stage, pieces, episodes in (
            ("samples", names, config.episodes),
            ("imported samples", imported, config.imported_episodes),
            ("samples of versions", versions, config.version_episodes),
        ):
            yield from _collect(f"{stage} {index}", pieces, samples, config, jobs, last, episodes)
        examples += load_examples(samples, [*names, *(ref.name for ref in (*imported, *versions))], jobs, config.frames)
        steps, rate = (
            (config.round_steps, 0.5 * config.learning_rate) if index else (config.steps, config.learning_rate)
        )
        if not is_trained(path, relational.KIND, steps):
            training = RelationalTraining(steps, rate, batch=config.batch, seed=config.seed + index)
            training_steps = imitation.train(examples, path, training, config.network, notes, last)
            yield from _validated(f"policy {index}", training_steps, steps, path, validation)
        last = path
    assert last is not None
    final = checkpoint.load(last, relational.KIND)
    params, description = final.params, {**final.config, "made": _made(last)}
    if started is not None:
        params = _mean(params, started.params, config.start_share)
        description["start"] = {key: value for key, value in started.config.items() if key != "grasps"}
        # The grasp network is kept, with the description of its own training.
        kept = load_weights(config.start).params.get(GRASP_PARAMS)
        params = params if kept is None else {**params, GRASP_PARAMS: kept}
        if "grasps" in started.config:
            description["grasps"] = started.config["grasps"]
    _save_policy(folder / "policy.npz", params, description)


def _mean(value: Any, start: Any, share: float) -> Any:
    """Return the mean of weights and those that the training started from; what the start lacks stays as it is.

    Args:
        value: an array, or nested dictionaries of arrays.
        start: the same of the start; None if it has none.
        share: share of the start in the mean.
    """
    if start is None:
        return value
    if isinstance(value, dict):
        nested = cast("Params", value)
        return {name: _mean(inner, start.get(name), share) for name, inner in nested.items()}
    return (1.0 - share) * value + share * start


def _start_checkpoint(config: RelationalPipelineConfig, folder: Path) -> Path | None:
    """Checkpoint of the object-centric weights to start from; None if there are none.

    Raises:
        InputError: there is no such policy, it is of another network, or the full setting names none.
    """
    if not config.start:
        _, grasp_rounds = config.rounds_of_networks
        if grasp_rounds:
            raise InputError("--setting full starts from an object-centric policy; use --start relational")
        return None
    loaded = load_weights(config.start)
    policy = RelationalPolicy.from_checkpoint(loaded, config.start) if loaded.kind == relational.KIND else None
    if policy is None or loaded.config.get("network") != asdict(config.network):
        raise InputError(f"--start {config.start}: its network has other sizes or kind; use --start relational")
    path = folder / "start.npz"
    checkpoint.save(path, checkpoint.Checkpoint(loaded.kind, policy.params, loaded.config, {}))
    return path


def _collect(
    stage: str, pieces: Sequence[str | FurnitureRef], folder: Path, config: RelationalPipelineConfig, jobs: int,
    policy: Path | None, episodes: int,
) -> Iterator[Progress]:  # fmt: skip
    """Collect the samples of a round, of generated pieces by name and of imported ones."""
    folders = _folders(p for p in pieces if isinstance(p, FurnitureRef))
    names = [p if isinstance(p, str) else p.name for p in pieces]
    results = collect(names, folder, episodes=episodes, seed=config.seed, jobs=jobs, policy=policy, folders=folders)
    yield from _counted(stage, results, names, folder, mistakes=policy is not None)


def _make_versions(
    refs: Sequence[FurnitureRef], folder: Path, config: RelationalPipelineConfig, jobs: int
) -> Generator[Progress, None, list[FurnitureRef]]:
    """Write the versions of imported pieces that the folder does not hold yet; returns all of them."""
    sources = {f"{ref.name}-v{index}": ref for ref in refs for index in range(1, config.imported_versions + 1)}
    versions = [FurnitureRef(name, None, folder / name) for name in sources]
    left = [(sources[version.name], version) for version in versions if not _exists(version)]
    work = partial(_make_version, config=config)
    for done, _ in enumerate(map_unordered(work, left, jobs), len(versions) - len(left) + 1):
        yield Progress("versions", done, len(versions), {})
    return [version for version in versions if _exists(version)]


def _exists(version: FurnitureRef) -> bool:
    return version.folder is not None and version.folder.is_dir()


def _make_version(item: tuple[FurnitureRef, FurnitureRef], *, config: RelationalPipelineConfig) -> None:
    """Write one version of an imported piece; none if its parts come apart."""
    source, version = item
    assert version.folder is not None
    rng = np.random.default_rng([config.seed, zlib.crc32(version.name.encode())])
    factors = np.exp(rng.uniform(-_LARGEST_FACTOR, _LARGEST_FACTOR, 3))
    with contextlib.suppress(FurnitureError):
        grasps = SETTINGS[config.setting].needs_grasps
        storage.save(resized(source.furniture(), version.name, factors, with_grasps=grasps), version.folder)


def _folders(refs: Iterable[FurnitureRef]) -> dict[str, Path]:
    """Furniture folders of the pieces that are not generated, by name."""
    return {ref.name: ref.folder for ref in refs if ref.folder is not None}


def _counted(
    stage: str, results: Iterable[CollectResult], names: Sequence[str], folder: Path, *, mistakes: bool
) -> Iterator[Progress]:
    """Progress of a collection, with the share of the policy's choices that were mistakes."""
    existing = sum(dataset_file(folder, name).is_file() for name in names)
    wrong = choices = 0
    for done, result in enumerate(results, 1):
        wrong, choices = wrong + result.mistakes, choices + result.choices
        scalars = {"mistakes": wrong / max(choices, 1)} if mistakes else {}
        yield Progress(stage, existing + done, len(names), scalars)


def _validated(
    stage: str, training_steps: Iterable[tuple[int, dict[str, float]]], steps: int, path: Path,
    validation: Mapping[str, Sequence[TokenExample]],
) -> Iterator[Progress]:  # fmt: skip
    """Progress of a training, with a validation every 1,000 steps and at the end."""
    for step, terms in training_steps:
        scalars = dict(terms)
        if step % 1_000 == 0 or step == steps:
            params = checkpoint.load(path, relational.KIND).params
            for shown, of_shown in validation.items():
                if of_shown:
                    scalars[f"validation_{shown}"] = imitation.viable_share(params, of_shown)
        yield Progress(stage, step, steps, scalars)


def _grasp_rounds(
    params: Params, description: dict[str, Any], pieces: Sequence[FurnitureRef], extra: Sequence[str], folder: Path,
    config: RelationalPipelineConfig, jobs: int,
) -> Iterator[Progress]:  # fmt: skip
    """Train the grasp network, and again after each round of its own episodes; writes `policy.npz`.

    Args:
        params: weights that value pairs.
        description: of these weights and of the run, for the checkpoint.
        pieces: pieces that the policy acts on.
        extra: names of further pieces, for random grasps only.
        folder: folder of the run.
        config: settings.
        jobs: number of processes.
    """
    names, sources = [ref.name for ref in pieces], _folders(pieces)
    files: list[Path] = []
    _, rounds = config.rounds_of_networks
    for index in range(rounds):
        samples, path = folder / "grasps" / str(index), folder / f"grasps-{index}.npz"
        if index:
            acting, seed = folder / f"acting-{index}.npz", config.seed + index
            results = collect_on_policy(names, samples, acting, episodes=1, seed=seed, jobs=jobs, folders=sources)
            yield from _counted(f"on policy {index}", results, names, samples, mistakes=True)
            files += [dataset_file(samples, name) for name in names]
        else:
            all_names = [*names, *extra]
            results = collect_grasps(
                all_names, samples, episodes=config.episodes, seed=config.seed, jobs=jobs, folders=sources
            )
            yield from _counted("grasp samples", results, all_names, samples, mistakes=False)
            files += [dataset_file(samples, name) for name in all_names]
        training = grasp_imitation.GraspTraining(steps=config.steps, seed=config.seed)
        if not is_trained(path, grasping.KIND, training.steps):
            examples = grasp_imitation.examples_of(files, jobs)
            for step, terms in grasp_imitation.train(examples, path, training, description["grasps"]):
                yield Progress("grasps", step, training.steps, terms)
        both = {**params, GRASP_PARAMS: checkpoint.load(path, grasping.KIND).params}
        last = index == rounds - 1
        made = {**description, "grasps": {**description["grasps"], "made": _made(path)}}
        _save_policy(folder / ("policy.npz" if last else f"acting-{index + 1}.npz"), both, made)


def _save_policy(path: Path, params: Params, config: dict[str, Any]) -> None:
    """Write the checkpoint of a policy, with 16-bit weights."""
    config = {**config, "weights_hash": checkpoint.arrays_hash(params)}
    checkpoint.save(path, checkpoint.Checkpoint(relational.KIND, params, config, {}), half=True)


def _made(path: Path) -> dict[str, Any]:
    """Return the hours of the training of a checkpoint, and the machine."""
    hours = float(checkpoint.load(path).extra.get("seconds", 0.0)) / 3600.0
    return {"hours": round(hours, 2), "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
