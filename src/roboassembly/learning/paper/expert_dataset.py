"""Samples from experts: the states of their episodes, labelled with their Q-values.

The first episode always takes the action with the highest Q; in later ones any action that is almost as good may be
drawn, so that samples show more than one order. In the full setting the first episodes repeat those that validated the
expert: from other starts the arms often cannot carry out what an expert, which does not see where things lie, chooses.
As in the paper only successful episodes become samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float16

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.datasets import CLOUD_POINTS, LabeledState, SampleSet, dataset_file
from roboassembly.learning.paper.dqn.network import ExpertPolicy, ExpertStep, encode_state, finished, run_expert
from roboassembly.learning.paper.dqn.results import load, read
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.parallel.processes import map_unordered
from roboassembly.settings import SETTINGS
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask

_MARGIN = 0.06
"""Difference of Q within which actions count as almost as good, as a share of the largest return; one merge counts
0.05 to 0.25."""
_SEEDS = 20_000
"""First seed of the episodes; no other episode of an expert has one as large."""


@dataclass(frozen=True)
class Collected:
    """Result of one expert."""

    name: str
    """Name of the chair."""
    episodes: int
    """Number of episodes."""
    finished: int
    """Number of episodes that finished the chair."""
    samples: int
    """Number of samples."""


def expert_samples(
    expert: ExpertPolicy,
    task: ObjectCentricTask | FullTask,
    name: str,
    episodes: int,
    seed: int = 0,
    validation_episodes: int = 0,
) -> tuple[SampleSet, int]:
    """Return samples of an expert's episodes, of those that finish the chair only.

    The Q-values of the samples are undiscounted returns.

    Args:
        expert: acts.
        task: task of its chair.
        name: name of the chair.
        episodes: number of episodes.
        seed: random seed of the starts and draws.
        validation_episodes: the first so many episodes repeat those that validated the expert.

    Returns:
        The samples, and the number of episodes that finished the chair.
    """
    parts = task.furniture.parts
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in parts], np.float32)
    observer = Observer(task.furniture, len(parts), MAX_POINTS, 1)
    samples: list[LabeledState] = []
    done = 0
    for index in range(episodes):
        validates = index < validation_episodes
        start = index if validates else _SEEDS + 1_000 * seed + index
        steps = run_expert(expert, task, start, margin=_MARGIN if index and not validates else 0.0)
        if finished(steps, expert.inputs):
            done += 1
            samples += [_sample(expert, task, observer, step) for step in steps]
    grasps = SETTINGS[task.setting].grasp_inputs(observer)
    return SampleSet(name, clouds, tuple(samples), grasps), done


def _sample(
    expert: ExpertPolicy, task: ObjectCentricTask | FullTask, observer: Observer, step: ExpertStep
) -> LabeledState:
    seen = observer.observe(step.state)
    free = task.rules.free_points(step.state)[: len(task.furniture.parts)]
    return LabeledState(
        seen["connection_points"],
        seen["connections"],
        free,
        seen["poses"],
        np.zeros((0, 11), np.int16),
        _q_values(expert, task, step),
    )


def _q_values(
    expert: ExpertPolicy, task: ObjectCentricTask | FullTask, step: ExpertStep
) -> Float16[np.ndarray, "n n w"]:
    """Return Q over the free points as returns, as in `LabeledState`."""
    joined, free = encode_state(task, step.state)
    rows = np.flatnonzero(free)
    some = [x[np.ix_(rows, rows)] for x in expert.branch_values(joined, free)]
    return (np.concatenate(some, axis=2) * expert.inputs.max_return).astype(np.float16)


def collect(
    refs: Sequence[FurnitureRef],
    experts: Path,
    folder: Path,
    training: ExpertTraining,
    *,
    episodes: int,
    jobs: int,
) -> Iterator[Collected]:
    """Write the samples of all chairs that have an expert and no samples yet.

    Args:
        refs: the chairs.
        experts: folder of the experts' files.
        folder: gets a file for each chair, without samples if no episode finished.
        training: settings of the experts; its seed is that of starts and draws.
        episodes: number of episodes of each chair.
        jobs: number of chairs at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [r for r in refs if dataset_file(experts, r.name).is_file() and not dataset_file(folder, r.name).is_file()]
    left = [r for r in left if not read(dataset_file(experts, r.name)).refused]
    work = partial(_collect, experts=experts, folder=folder, training=training, episodes=episodes)
    yield from map_unordered(work, left, jobs)


def _collect(ref: FurnitureRef, *, experts: Path, folder: Path, training: ExpertTraining, episodes: int) -> Collected:
    task = training.task_of(ref)
    validation_episodes = min(training.validation_episodes, SETTINGS[training.setting].repeated_starts)
    expert = load(dataset_file(experts, ref.name), task)
    samples, done = expert_samples(expert, task, ref.name, episodes, training.seed, validation_episodes)
    samples.save(dataset_file(folder, ref.name))
    return Collected(ref.name, episodes, done, len(samples.samples))
