"""Samples from experts: states of their episodes and of their replay memories, labelled with their Q-values.

An expert's own episodes all take the same actions. A policy that imitates it will err now and then, and has to know how
to go on; so states that the expert met while it explored become samples, too, wherever it knows how to finish the chair
from there.

In the full setting the first episodes repeat those that validated the expert: from other starts the arms often cannot
carry out what an expert, which does not see where things lie, chooses. As in the paper only experts that finish their
chair give samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float16

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs.observation import Observer, part_clouds
from roboassembly.furniture.model import PAPER_POINTS
from roboassembly.learning.datasets import CLOUD_POINTS, LabeledState, SampleSet, dataset_file, structure_of
from roboassembly.learning.paper.dqn.memoized_env import State
from roboassembly.learning.paper.dqn.network import (
    ExpertPolicy,
    ExpertStep,
    encode_state,
    finished,
    first_best,
    run_expert,
)
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.learning.paper.dqn.results import load, with_expert
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.parallel.processes import map_unordered
from roboassembly.settings import SETTINGS
from roboassembly.solvers.mate_checks import UNKNOWN
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.groups import TaskState

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
    buffer: ReplayBuffer,
    task: ObjectCentricTask | FullTask,
    name: str,
    episodes: int,
    memories: int,
    seed: int = 0,
    validation_episodes: int = 0,
) -> tuple[SampleSet, int]:
    """Return samples of an expert, if any of its episodes finishes the chair.

    The Q-values of the samples are undiscounted returns.

    Args:
        expert: acts.
        buffer: its replay buffer.
        task: task of its chair.
        name: name of the chair.
        episodes: number of episodes.
        memories: largest number of states from the replay buffer.
        seed: random seed of the starts and draws.
        validation_episodes: the first so many episodes repeat those that validated the expert.

    Returns:
        The samples, and the number of episodes that finished the chair.
    """
    states: list[tuple[TaskState, State | None]] = []
    done = 0
    for index in range(episodes):
        start = index if index < validation_episodes else _SEEDS + 1_000 * seed + index
        steps = run_expert(expert, task, start)
        if finished(steps, expert.inputs):
            done += 1
            states += zip([step.state for step in steps], _remembered(buffer, steps), strict=True)
    if done:
        rng = np.random.default_rng([_SEEDS, seed])
        states += [(buffer.env.laid_out(state), state) for state in known_states(expert, buffer, memories, rng)]
    recorder = SampleRecorder(expert, buffer, task)
    samples = tuple(recorder.sample(state, memory) for state, memory in states)
    return recorder.sample_set(name, samples), done


def _remembered(buffer: ReplayBuffer, steps: Sequence[ExpertStep]) -> list[State | None]:
    """Return the states of an episode as the replay buffer has them; None from where it was never."""
    out: list[State | None] = []
    at: int | None = 0
    for step in steps:
        out.append(None if at is None else buffer.states[at])
        at = None if at is None else buffer.merges[at].get(step.action)
    return out


def known_states(
    expert: ExpertPolicy,
    buffer: ReplayBuffer,
    count: int,
    rng: np.random.Generator,
) -> list[State]:
    """Return random states of the replay buffer in which the expert takes the preferred action; see `dqn.recovery`.

    Args:
        expert: takes the action.
        buffer: its replay buffer.
        count: largest number of states.
        rng: random numbers.
    """
    out: list[State] = []
    numbers = list(buffer.preferred)
    order: list[int] = rng.permutation(len(numbers)).tolist()
    for i in order:
        if len(out) == count:
            break
        at = numbers[i]
        values = expert.values(buffer.joined[at], buffer.free[at][: expert.inputs.points])
        if first_best(values) == buffer.preferred[at]:
            out.append(buffer.states[at])
    return out


class SampleRecorder:
    """Makes samples of states of one chair, labelled by its expert.

    Args:
        expert: gives the labels.
        buffer: its replay buffer.
        task: task of its chair.
    """

    def __init__(self, expert: ExpertPolicy, buffer: ReplayBuffer, task: ObjectCentricTask | FullTask) -> None:
        self._expert, self._env, self._task = expert, buffer.env, task
        self._right = self._env.right_pairs
        self._observer = Observer(task.furniture, len(task.furniture.parts), PAPER_POINTS, 1)

    def sample(self, state: TaskState, memory: State | None) -> LabeledState:
        """Return the sample of a state.

        Args:
            state: the state.
            memory: the same state in the replay buffer; None if it is not there.
        """
        seen = self._observer.observe(state)
        free = self._task.rules.free_points(state, max_points=PAPER_POINTS)
        return LabeledState(
            seen["connection_points"],
            seen["connections"],
            free,
            seen["poses"],
            np.zeros((0, 11), np.int16),
            self._q_values(state, memory),
        )

    def sample_set(self, name: str, samples: tuple[LabeledState, ...]) -> SampleSet:
        """Return the samples of the chair, under its name, with its clouds, grasps and structure."""
        furniture = self._task.furniture
        clouds = part_clouds(furniture, CLOUD_POINTS)
        grasps = SETTINGS[self._task.setting].grasp_inputs(self._observer)
        return SampleSet(name, clouds, samples, grasps, structure_of(furniture))

    def _q_values(self, state: TaskState, memory: State | None) -> Float16[np.ndarray, "n n h"]:
        """Return Q over the free points as returns, as in `LabeledState`.

        It is 0 for pairs that the expert never found to be right, in any groups, and for actions of a known state that
        it never tried. What a network says of these differs from expert to expert: with robots, it is more than half of
        the largest value for hundreds of wrong pairs. There a value is a sum over two grasps, and each counts as tried
        if it was tried with any other.
        """
        joined, free = encode_state(self._task, state)
        rows = np.flatnonzero(free)
        some = np.ix_(rows, rows)
        values = [x[some] * self._right[some][:, :, None] for x in self._expert.branch_values(joined, free)]
        if memory is not None:
            tried = self._env.known(memory) != UNKNOWN
            by_branch = tried[some].reshape(len(rows), len(rows), *self._task.action_branches)
            axes = range(len(values))
            values = [x * by_branch.any(axis=tuple(2 + j for j in axes if j != i)) for i, x in enumerate(values)]
        return (np.concatenate(values, axis=2) * self._expert.inputs.max_return).astype(np.float16)


def collect(
    refs: Sequence[FurnitureRef],
    experts: Path,
    folder: Path,
    training: ExpertTraining,
    *,
    episodes: int,
    memories: int,
    jobs: int,
) -> Iterator[Collected]:
    """Write the samples of all chairs that have an expert and no samples yet.

    Args:
        refs: the chairs.
        experts: folder of the experts' files.
        folder: gets a file for each chair, without samples if no episode finished.
        training: settings of the experts; its seed is that of starts and draws.
        episodes: number of episodes of each chair.
        memories: largest number of states of each chair from the replay buffer.
        jobs: number of chairs at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [r for r in with_expert(refs, experts) if not dataset_file(folder, r.name).is_file()]
    work = partial(
        _collect, experts=experts, folder=folder, training=training, episodes=episodes, memories=memories
    )  # fmt: skip
    yield from map_unordered(work, left, jobs)


def _collect(
    ref: FurnitureRef, *, experts: Path, folder: Path, training: ExpertTraining, episodes: int, memories: int
) -> Collected:
    task = training.task_of(ref)
    validation_episodes = min(training.validation_episodes, SETTINGS[training.setting].repeated_starts)
    expert, buffer = load(dataset_file(experts, ref.name), task)
    samples, done = expert_samples(
        expert, buffer, task, ref.name, episodes, memories, training.seed, validation_episodes
    )
    samples.save(dataset_file(folder, ref.name))
    return Collected(ref.name, episodes, done, len(samples.samples))
