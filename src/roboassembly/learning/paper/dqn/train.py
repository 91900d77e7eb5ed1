"""Training of experts: several chairs side by side in one compiled call.

Each chair is independent: it has its own replay buffer, weights, random numbers and file. A run may therefore be killed
at any moment; started again, it continues from what each chair wrote last (at most a minute ago), with any number of
processes.

    experts/<family>_<seed>.npz            a finished chair: weights, steps, success rate
    experts/<family>_<seed>.partial.npz    a chair in training
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from roboassembly.datasets.sets import FurnitureRef, furniture_hash
from roboassembly.envs.observation import part_clouds
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.layers import Params
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.dqn import losses, network
from roboassembly.learning.paper.dqn.agent import AgentConfig, DQNAgent
from roboassembly.learning.paper.dqn.group_table import GroupTable
from roboassembly.learning.paper.dqn.memoized_env import Action, MemoizedEnv, State
from roboassembly.learning.paper.dqn.network import (
    KIND,
    ChairInputs,
    ExpertPolicy,
    ExpertStep,
    chair_inputs,
    finished,
    first_best,
    run_actions,
    run_expert,
)
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.learning.paper.dqn.results import ExpertResult, load_relative
from roboassembly.settings import SETTINGS
from roboassembly.task.full.failure import FullVerdict
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rollout import RememberedTask
from roboassembly.task.setting import SettingName

_TEST_SEEDS = 10_000
"""First seed of the test episodes of a trained expert."""
_SURVEY = 20
"""Largest number of environment steps between updates, as a multiple of `ExpertTraining.update_every`."""
_AGREEMENT = 0.95
"""Share of the states with a preferred action in which a network must choose it ..."""
_AGREEMENT_EVERY, _AGREEMENT_UPDATES = 20, 200
"""... which is looked at after so many updates, and not waited for longer than so many."""
_WRONG_PAIR = (ObjectCentricVerdict.WRONG_PAIR, FullVerdict.WRONG_PAIR)


@dataclass(frozen=True)
class ExpertTraining:
    """Settings of the experts' training."""

    steps: int = 40_000
    """Largest number of environment steps, as in the paper; a chair that is mastered earlier stops earlier."""
    least_updates: int = 150
    """Least number of updates: the Q-values become labels, and must have settled."""
    update_every: int = 8
    """Environment steps between updates; first steps of episodes that only find a wrong pair are not counted."""
    target_every: int = 50
    """Updates between copies to the target network."""
    learning_rate: float = 1.5e-3
    """Learning rate."""
    validation_episodes: int = 3
    """Number of episodes in the real environment that must all succeed before a chair counts as mastered."""
    test_episodes: int = 5
    """Number of episodes in the real environment, from other starts, that measure the trained expert."""
    seed: int = 0
    """Random seed."""
    setting: SettingName = "object-centric"
    """Setting of the task."""
    agent: AgentConfig = field(default_factory=AgentConfig)
    """Settings of exploration and replay."""

    def task_of(self, ref: FurnitureRef) -> ObjectCentricTask | FullTask:
        """Return the task of a chair in the setting.

        Raises:
            InputError: the chair cannot be made, or no two robots could assemble it.
        """
        setting = SETTINGS[self.setting]
        task = setting.make_task(ref.furniture(with_grasps=setting.needs_grasps))
        task.check_furniture()
        return task


@dataclass(eq=False)
class ExpertTrainer:
    """State of the training of one chair, without the network's weights."""

    ref: FurnitureRef
    task: ObjectCentricTask | FullTask
    inputs: ChairInputs
    agent: DQNAgent
    seconds: float = 0.0
    """Training time so far [s]."""
    validated_at: int = 0
    """Number of steps at the last validation episode."""
    recovered_at: int = 0
    """Number of updates when all recoveries were known; 0 before."""
    known: RememberedTask[Any, Any] = field(init=False)
    """Task of the validation episodes: each begins like the one before, as far as the network decides alike."""

    def __post_init__(self) -> None:
        self.known = RememberedTask(self.task)


def partial_file(folder: Path, name: str) -> Path:
    """Return where a folder keeps a chair in training."""
    return dataset_file(folder, name).with_suffix(".partial.npz")


def demonstration(task: ObjectCentricTask | FullTask, table: GroupTable) -> list[Action]:
    """Return the actions of the search; none if it does not finish the chair."""
    plan = SETTINGS[task.setting].solve(task.furniture, 0, task=task).plan
    if not plan.success:
        return []
    return [
        (table.row(u, k), table.row(v, l), int(np.ravel_multi_index(choice, task.action_branches)))
        for u, v, k, l, *choice in (step.action for step in plan.steps)  # noqa: E741
    ]


class ExpertRun:
    """Trains several chairs of one padded size, updated in one call; a waiting chair replaces one that is finished.

    Args:
        refs: chairs to train.
        folder: gets a file for each.
        training: settings.
        side_by_side: number of chairs at a time.
        encoder: weights of the auto-encoder.
        notes: origin of the chairs, kept in the files.
    """

    def __init__(
        self,
        refs: Sequence[FurnitureRef],
        folder: Path,
        training: ExpertTraining,
        side_by_side: int,
        encoder: Params,
        notes: dict[str, Any],
    ) -> None:
        self._waiting = list(refs)
        self._folder, self._training, self._encoder, self._notes = folder, training, encoder, notes
        self._trainers: list[ExpertTrainer] = []
        self._weights: list[tuple[Any, Any, Any]] = []
        self._fill(side_by_side)

    def run(self, keep_every: float) -> None:
        """Train all chairs; writes those in training every `keep_every` seconds."""
        saved = time.monotonic()
        while self._trainers:
            begun = time.monotonic()
            self.advance()
            for trainer in self._trainers:
                trainer.seconds += (time.monotonic() - begun) / len(self._trainers)
            leaving = [i for i, t in enumerate(self._trainers) if self._finish(t, i)]
            if leaving:
                self._replace(leaving)
            if time.monotonic() - saved > keep_every:
                for i in range(len(self._trainers)):
                    self.keep(i)
                saved = time.monotonic()

    def advance(self) -> None:
        """Make steps of every chair until there is enough to learn, then one update."""
        t, agents = self._training, [x.agent for x in self._trainers]
        # A network of one state is too small for JAX: the call takes longer than the network.
        params = jax.tree.map(np.asarray, self._params)
        for i, trainer in enumerate(self._trainers):
            self._step(trainer, ExpertPolicy(trainer.inputs, jax.tree.map(itemgetter(i), params)))
        batches = [x.buffer.sample(x.rng, t.agent.batch, t.agent.backups) for x in agents]
        batch = {k: np.array([b[k] for b in batches]) for k in batches[0]}
        self._params, self._opt_state, _ = losses.update(
            t.learning_rate, self._params, self._target, self._opt_state, batch
        )
        for agent in agents:
            agent.updates += 1
        due = np.array([x.updates % t.target_every == 0 for x in agents])
        if due.any():
            self._target = jax.tree.map(
                lambda new, old: jnp.where(due.reshape(-1, *[1] * (new.ndim - 1)), new, old), self._params, self._target
            )

    def _step(self, trainer: ExpertTrainer, policy: ExpertPolicy) -> None:
        """Step until there is as much to learn as one update takes in."""
        agent, t = trainer.agent, self._training
        learnable = 0
        for _ in range(_SURVEY * t.update_every):
            learnable += agent.step(lambda: policy.values(agent.buffer.joined[agent.at], agent.buffer.free[agent.at]))
            if learnable == t.update_every or agent.steps >= t.steps:
                return

    def _fill(self, count: int) -> None:
        """Let waiting chairs in until there are so many."""
        while self._waiting and len(self._trainers) < count:
            ref = self._waiting.pop(0)
            try:
                task = self._training.task_of(ref)
            except SETTINGS[self._training.setting].refusals as error:
                self._refuse(ref, str(error))
            else:
                self._enter(ref, task)
        self._stack()

    def _refuse(self, ref: FurnitureRef, why: str) -> None:
        result = ExpertResult(ref.name, False, 0, 0, 0.0, 0.0, refused=why)
        config = {**self._notes, "furniture": ref.name, "training": asdict(self._training), "result": asdict(result)}
        checkpoint.save(dataset_file(self._folder, ref.name), checkpoint.Checkpoint(KIND, {}, config, {}))

    def _enter(self, ref: FurnitureRef, task: ObjectCentricTask | FullTask) -> None:
        t = self._training
        clouds = part_clouds(task.furniture, CLOUD_POINTS)
        inputs = chair_inputs(task, autoencoder.encode(self._encoder, clouds))
        rng = np.random.default_rng([t.seed, *ref.name.encode()])
        buffer = ReplayBuffer(MemoizedEnv(task, int(rng.integers(2**31))), inputs)
        agent = DQNAgent(buffer, t.agent, rng, partial(demonstration, task, buffer.env.table))
        trainer = ExpertTrainer(ref, task, inputs, agent)
        params: Any = network.init(rng, len(inputs.part), inputs.features.shape[1], inputs.branches)
        source = None if ref.source is None else load_relative(dataset_file(self._folder, ref.source), inputs)
        if source is not None:
            params = source[0]
            trainer.agent.start_from(source[1])
        target, opt_state = params, losses.optimiser(t.learning_rate).init(params)
        path = partial_file(self._folder, ref.name)
        if path.exists():
            kept = checkpoint.load(path, KIND)
            if kept.config != self._config(trainer):
                raise InputError(f"'{path}' was trained otherwise; name another folder, or remove it")
            params = kept.params["online"]
            target = kept.params["target"]
            structure = jax.tree.structure(opt_state)
            leaves = [kept.extra[f"optimiser{i}"] for i in range(structure.num_leaves)]
            opt_state = jax.tree.unflatten(structure, leaves)
            trainer.agent.restore(kept.params["agent"])
            trainer.seconds, trainer.validated_at = float(kept.extra["seconds"]), int(kept.extra["validated_at"])
            trainer.recovered_at = int(kept.extra["recovered_at"])
        self._trainers.append(trainer)
        self._weights.append((params, target, opt_state))

    def _stack(self) -> None:
        if self._trainers:
            self._params, self._target, self._opt_state = (
                jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees) for trees in zip(*self._weights, strict=True)
            )

    def _slice(self, i: int) -> tuple[Any, Any, Any]:
        """Return weights, target weights and optimiser state of one chair."""
        return losses.slice_of((self._params, self._target, self._opt_state), i)

    def _replace(self, leaving: list[int]) -> None:
        stay = [i for i in range(len(self._trainers)) if i not in leaving]
        self._weights = [self._slice(i) for i in stay]
        self._trainers = [self._trainers[i] for i in stay]
        self._fill(len(stay) + len(leaving))

    def _finish(self, trainer: ExpertTrainer, i: int) -> bool:
        """Return whether a chair is mastered or has had its steps; writes its file if so."""
        agent, t = trainer.agent, self._training
        mastered, over = False, agent.steps >= t.steps
        if not agent.recovers and agent.settled and not over:
            if trainer.validated_at < agent.steps and self._first_episode_works(trainer):
                agent.begin_recovery()
        elif agent.mastered and (over or self._is_ready(trainer, i)):
            mastered = self._validates(trainer, partial(run_expert, ExpertPolicy(trainer.inputs, self._slice(i)[0])))
        if not mastered and not over:
            return False
        params = self._slice(i)[0]
        expert = ExpertPolicy(trainer.inputs, params)
        count = t.test_episodes if mastered else 1
        tests = [run_expert(expert, trainer.task, _TEST_SEEDS + k) for k in range(count)]
        rate = sum(finished(steps, trainer.inputs) for steps in tests) / count
        planned = agent.buffer.env.planned
        result = ExpertResult(
            trainer.ref.name, mastered, agent.steps, planned, rate, trainer.seconds, agent.demonstrated
        )
        extra = {
            "features": trainer.inputs.features,
            "depths": np.array(agent.depths, np.int32).reshape(-1, 2),
            "env_seed": np.array(agent.buffer.env.seed),
        }
        arrays = {"network": params, "agent": agent.to_arrays()}
        config = {**self._config(trainer), "result": asdict(result)}
        checkpoint.save(
            dataset_file(self._folder, trainer.ref.name), checkpoint.Checkpoint(KIND, arrays, config, extra)
        )
        partial_file(self._folder, trainer.ref.name).unlink(missing_ok=True)
        return True

    def _is_ready(self, trainer: ExpertTrainer, i: int) -> bool:
        """Return whether the network has learnt enough to be validated, and something since it last was."""
        agent = trainer.agent
        news = trainer.validated_at < agent.steps and agent.updates >= self._training.least_updates
        return news and self._has_fitted(trainer, i)

    def _has_fitted(self, trainer: ExpertTrainer, i: int) -> bool:
        """Return whether all recoveries are known, and the network chooses the preferred actions, or had its time."""
        agent, buffer = trainer.agent, trainer.agent.buffer
        if not agent.recovery_known:
            trainer.recovered_at = 0
            return False
        trainer.recovered_at = trainer.recovered_at or agent.updates
        since = agent.updates - trainer.recovered_at
        if since >= _AGREEMENT_UPDATES:
            return True
        if since == 0 or since % _AGREEMENT_EVERY:
            return False
        expert = ExpertPolicy(trainer.inputs, self._slice(i)[0])
        points = trainer.inputs.points
        agreeing = [
            first_best(expert.values(buffer.joined[j], buffer.free[j][:points])) == action
            for j, action in buffer.preferred.items()
        ]
        return sum(agreeing) >= _AGREEMENT * len(agreeing)

    def _first_episode_works(self, trainer: ExpertTrainer) -> bool:
        """Return whether the first episode that finishes the chair in memory does so in the real environment.

        What comes before it in number order has been tried; so all labels follow from it, and it must be known to work
        before anything else is learnt.
        """
        actions = [action for _, action in trainer.agent.buffer.first_episode()]
        return bool(actions) and self._validates(trainer, partial(run_actions, actions, trainer.inputs))

    def _validates(self, trainer: ExpertTrainer, run: Callable[..., list[ExpertStep]]) -> bool:
        """Return whether episodes succeed in the real environment; the agent learns what fails there.

        Args:
            trainer: trains the chair.
            run: runs an episode of a task, a seed and the task with what it remembers.
        """
        agent, env = trainer.agent, trainer.agent.buffer.env
        for k in range(self._training.validation_episodes):
            steps = run(trainer.task, k, trainer.known)
            agent.steps += len(steps)
            trainer.validated_at = agent.steps
            if not finished(steps, trainer.inputs):
                state: State | None = env.start
                for step in steps[:-1]:
                    state = env.step(state, step.action) if state is not None else None
                if state is not None and steps[-1].verdict not in _WRONG_PAIR:
                    agent.mark_failed(state, steps[-1].action)
                return False
        return True

    def _config(self, trainer: ExpertTrainer) -> dict[str, Any]:
        return {
            **self._notes,
            "furniture": trainer.ref.name,
            "furniture_hash": furniture_hash(trainer.task.furniture),
            "training": asdict(self._training),
        }

    def keep(self, i: int) -> None:
        """Write the state of one chair's training."""
        trainer = self._trainers[i]
        params, target, opt_state = self._slice(i)
        leaves = {f"optimiser{k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(opt_state))}
        arrays = {"online": params, "target": target, "agent": trainer.agent.to_arrays()}
        extra = {
            **leaves, "seconds": np.array(trainer.seconds), "validated_at": np.array(trainer.validated_at),
            "recovered_at": np.array(trainer.recovered_at),
        }  # fmt: skip
        path = partial_file(self._folder, trainer.ref.name)
        checkpoint.save(path, checkpoint.Checkpoint(KIND, arrays, self._config(trainer), extra))
