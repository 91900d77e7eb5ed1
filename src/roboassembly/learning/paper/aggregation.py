"""Aggregation: states of the policy's own episodes, labelled by the experts (DAgger, Ross et al. 2011).

It is not in the paper. The policy acts in the experts' memory of their chairs (`dqn.memoized_env`), where an episode
takes a tenth of a second. A state becomes a sample if the expert can finish the chair from there. Where the policy
chooses another action than the expert, the states that the expert meets from there on become samples, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.datasets.sets import FurnitureRef
from roboassembly.envs.observation import Observer
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import SampleSet, dataset_file, group_labels
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.dqn.memoized_env import Action, State
from roboassembly.learning.paper.dqn.network import ExpertPolicy, first_best
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.learning.paper.dqn.results import load, read, with_expert
from roboassembly.learning.paper.dqn.train import ExpertTraining
from roboassembly.learning.paper.examples import scattered
from roboassembly.learning.paper.expert_dataset import SampleRecorder
from roboassembly.learning.paper.network import PaperPolicy
from roboassembly.learning.policy import Policy, chosen
from roboassembly.parallel.processes import map_unordered
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask


@dataclass(frozen=True)
class Aggregated:
    """Result of one chair."""

    name: str
    """Name of the chair."""
    episodes: int
    """Number of the policy's episodes."""
    finished: int
    """Number of episodes in which the policy finished the chair."""
    samples: int
    """Number of samples."""


class _ExpertPlan:
    """Plan of an expert in the memory of its chair: its action in each state, and the states that follow."""

    def __init__(self, expert: ExpertPolicy, buffer: ReplayBuffer) -> None:
        self.env = buffer.env
        self._expert = expert
        self._after: dict[State, State | None] = {}

    def action(self, state: State) -> Action:
        """Return the expert's action."""
        return first_best(self._expert.values(self.env.joined(state), self.env.owners(state) >= 0))

    def path(self, state: State) -> list[State]:
        """Return the states in which the expert acts from a state on; empty if it does not finish the chair."""
        out: list[State] = []
        at: State | None = state
        while at is not None and len(at) > 1:
            out.append(at)
            if at not in self._after:
                self._after[at] = self.env.step(at, self.action(at))
            at = self._after[at]
        return [] if at is None else out


def policy_samples(
    policy: Policy,
    expert: ExpertPolicy,
    buffer: ReplayBuffer,
    task: ObjectCentricTask | FullTask,
    name: str,
    episodes: int,
    rng: np.random.Generator,
) -> tuple[SampleSet, int]:
    """Return samples of a policy's episodes, labelled by the expert of the chair.

    Args:
        policy: acts.
        expert: gives the labels.
        buffer: its replay buffer, in whose environment the policy acts.
        task: task of the chair.
        name: name of the chair.
        episodes: number of episodes.
        rng: places the groups of each state anew.

    Returns:
        The samples, and the number of episodes in which the policy finished the chair.
    """
    env, plan, finished = buffer.env, _ExpertPlan(expert, buffer), 0
    observer = Observer(task.furniture, *task.furniture.padding, policy.cloud_points)
    row_of = {(int(part), int(point)): row for row, (part, point) in enumerate(zip(env.part, env.point, strict=True))}
    states: list[State] = []
    for _ in range(episodes):
        state: State | None = env.start
        while state is not None and len(state) > 1:
            groups = env.laid_out(state)
            observation = observer.observe(groups)
            groups_of_parts = group_labels(observation["connections"])
            observation["poses"] = scattered(observation["poses"], groups_of_parts, task.setting, rng)
            mask = task.existing_actions(groups, *task.furniture.padding)
            u, v, k, l, *choice = chosen(policy, observation, mask)  # noqa: E741
            action = row_of[u, k], row_of[v, l], int(np.ravel_multi_index(choice, task.action_branches))
            path = plan.path(state)
            states += path[:1] if path and plan.action(state) == action else path
            state = env.step(state, action)
        finished += state is not None
    recorder = SampleRecorder(expert, buffer, task)
    samples = tuple(recorder.sample(env.laid_out(state), state) for state in states)
    return recorder.sample_set(name, samples), finished


def collect(
    refs: Sequence[FurnitureRef],
    experts: Path,
    policy: Path,
    folder: Path,
    training: ExpertTraining,
    *,
    episodes: int,
    seed: int,
    jobs: int,
) -> Iterator[Aggregated]:
    """Write the samples of all chairs that have an expert; yields as chairs are done, and keeps existing files.

    Args:
        refs: the chairs.
        experts: folder of the experts' files.
        policy: checkpoint of the policy that acts.
        folder: gets a file for each chair.
        training: settings of the experts.
        episodes: number of episodes of each chair.
        seed: seed of the places of groups.
        jobs: number of processes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    trained = with_expert(refs, experts)
    left = [(i, r) for i, r in enumerate(refs) if r in trained and not dataset_file(folder, r.name).is_file()]
    work = partial(
        _collect, experts=experts, policy=policy, folder=folder, training=training, episodes=episodes, seed=seed
    )
    yield from map_unordered(work, left, jobs)


def _collect(
    numbered: tuple[int, FurnitureRef],
    *,
    experts: Path,
    policy: Path,
    folder: Path,
    training: ExpertTraining,
    episodes: int,
    seed: int,
) -> Aggregated:
    """Write the samples of one chair; there are none if its expert did not master it."""
    number, ref = numbered
    task = training.task_of(ref)
    expert, buffer = load(dataset_file(experts, ref.name), task)
    if not read(dataset_file(experts, ref.name)).mastered:
        episodes = 0
    rng = np.random.default_rng([seed, number])
    samples, finished = policy_samples(_policy(policy), expert, buffer, task, ref.name, episodes, rng)
    samples.save(dataset_file(folder, ref.name))
    return Aggregated(ref.name, episodes, finished, len(samples.samples))


@lru_cache(maxsize=1)
def _policy(path: Path) -> PaperPolicy:
    """Policy of a checkpoint, read once in each process."""
    return PaperPolicy.from_checkpoint(checkpoint.load(path, paper.KIND), str(path))
