"""Collects training samples: one file for each piece of furniture, in parallel, and no file twice."""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import part_clouds
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS, LabeledState, SampleSet, dataset_file
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.oracle_dataset import Labeler, TokenPolicy
from roboassembly.parallel.processes import map_unordered
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.object_centric.task import ObjectCentricTask


@dataclass(frozen=True)
class CollectResult:
    """Summary of the samples of one piece."""

    name: str
    """Name of the piece, `family:seed`."""
    states: int
    """Number of samples."""
    mistakes: int
    """Number of the policy's choices that were not viable."""
    choices: int
    """Number of the policy's choices; 0 without a policy."""
    seconds: float
    """Duration [s]."""


def piece_number(name: str, folders: Mapping[str, Path]) -> int:
    """Return the number that the draws for a piece depend on: the seed of a generated one, else a hash of the name.

    Args:
        name: `family:seed` of a generated piece, else a key of `folders`.
        folders: furniture folders of pieces that are not generated, by name.
    """
    return zlib.crc32(name.encode()) if name in folders else int(name.partition(":")[2])


def load_piece(name: str, folders: Mapping[str, Path], *, with_grasps: bool = True) -> Furniture:
    """Return a piece by name; arguments as of `piece_number`.

    Raises:
        InputError: the generated piece is invalid, or the folder is no furniture.
    """
    if name in folders:
        return storage.load(folders[name])
    return catalogue.make(name.partition(":")[0], piece_number(name, folders), with_grasps=with_grasps)


def collect(
    names: Sequence[str], folder: Path, *, episodes: int, seed: int, jobs: int, policy: Path | None = None,
    folders: Mapping[str, Path] | None = None,
) -> Iterator[CollectResult]:  # fmt: skip
    """Write the samples of some furniture, and yield as pieces are done; existing files are kept.

    Args:
        names: names of the pieces: `family:seed` of generated ones, else keys of `folders`.
        folder: folder of the files, one for each piece.
        episodes: number of episodes of each piece, from loose parts to the finished furniture.
        seed: seed of starts and actions.
        jobs: number of processes.
        policy: checkpoint of the relational policy that acts in the first episode of each piece (its actions would be
            the same in the others); all other actions are random viable ones.
        folders: furniture folders of pieces that are not generated, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not dataset_file(folder, name).is_file()]
    work = partial(_collect, folder=folder, episodes=episodes, seed=seed, policy=policy, folders=dict(folders or {}))
    yield from map_unordered(work, left, jobs)


def _collect(
    name: str, *, folder: Path, episodes: int, seed: int, policy: Path | None, folders: Mapping[str, Path]
) -> CollectResult:
    """Write the samples of one piece."""
    start = time.monotonic()
    number = piece_number(name, folders)
    try:
        furniture = load_piece(name, folders, with_grasps=False)
    except InputError:
        # A few generated frames are invalid; they give no samples.
        SampleSet(name, np.zeros((0, CLOUD_POINTS, 3), np.float32), ()).save(dataset_file(folder, name))
        return CollectResult(name, 0, 0, 0, time.monotonic() - start)
    clouds = part_clouds(furniture, CLOUD_POINTS)
    labeler = Labeler(furniture, clouds, Oracle(ObjectCentricTask(furniture)))
    token_policy = None if policy is None else _token_policy(policy)
    samples: dict[bytes, LabeledState] = {}
    mistakes = choices = 0
    for index in range(episodes):
        rng = np.random.default_rng([seed, number, index])
        acting = token_policy if index == 0 else None
        episode = labeler.rollout(rng, acting)
        if acting is not None:
            mistakes, choices = episode.mistakes, len(episode.states)
        for sample in (*episode.states, *episode.dead_ends):
            samples.setdefault(sample.group.tobytes(), sample)
    labeler.sample_set(tuple(samples.values()), name).save(dataset_file(folder, name))
    return CollectResult(name, len(samples), mistakes, choices, time.monotonic() - start)


@lru_cache(maxsize=1)
def _token_policy(path: Path) -> TokenPolicy:
    """Policy of a checkpoint, read once in each process."""
    params = checkpoint.load(path, relational.KIND).params
    return partial(relational.best_action, params)
