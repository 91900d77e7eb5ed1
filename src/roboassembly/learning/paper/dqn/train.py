"""Trains experts: several chairs side by side in one compiled call, groups of them in processes of their own.

Each chair is by itself: its own replay memory, weights, random numbers and file. So a run can be killed at any moment;
started again it goes on from what each chair last wrote (at most a minute ago), whatever the number of processes.

    experts/<family>_<seed>.npz            a chair that is done: weights, what it took, how often it succeeds
    experts/<family>_<seed>.partial.npz    one on its way
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import wait
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from roboassembly.datasets.sets import FurnitureRef, furniture_hash
from roboassembly.envs.observation import surface_points
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.layers import Params
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.dqn import losses as double_q
from roboassembly.learning.paper.dqn import network as experts
from roboassembly.learning.paper.dqn.agent import Learner, LearnerConfig, Memory
from roboassembly.learning.paper.dqn.group_table import point_counts
from roboassembly.learning.paper.dqn.memoized_env import Rehearsal, State
from roboassembly.learning.paper.dqn.network import KIND, POINT_SIZES, Chair, Expert, chair_of, play
from roboassembly.parallel.processes import one_thread_each, worker_pool
from roboassembly.statistics import success
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.setting import SettingName

_TRIAL_SEEDS = 10_000
"""Seeds of the plays by which a finished expert is measured start here."""


@dataclass(frozen=True)
class ExpertTraining:
    """How experts are trained."""

    steps: int = 40_000
    """Of the environment, at most, as in the paper; a chair that is mastered earlier stops earlier."""
    least_steps: int = 1_600
    """Of the environment, even if the chair is mastered before: its values are to be taught, and must have settled."""
    update_every: int = 8
    """Steps."""
    target_every: int = 50
    """Updates."""
    learning_rate: float = 1.5e-3
    proofs: int = 3
    """Plays in the real environment that all have to succeed before a chair counts as mastered."""
    trials: int = 5
    """Plays in the real environment, from other starts, by which the expert is measured in the end."""
    seed: int = 0
    setting: SettingName = "object-centric"
    """Parts fly by themselves, or two robots move them."""
    learner: LearnerConfig = field(default_factory=LearnerConfig)

    def task_of(self, pick: FurnitureRef) -> ObjectCentricTask | FullTask:
        """The chair in the setting.

        Raises:
            InputError: it cannot be made, or two robots could not assemble it whatever they did.
        """
        if self.setting == "object-centric":
            return ObjectCentricTask(pick.furniture(with_grasps=False))
        task = FullTask(pick.furniture())
        task.check_graspable()
        return task


@dataclass(frozen=True)
class Mastery:
    """What became of one chair."""

    name: str
    mastered: bool
    """Within the steps allowed."""
    steps: int
    """Of the environment."""
    planned: int
    """Merges that were planned, all others were remembered."""
    success_rate: float
    """Of the trials."""
    seconds: float
    """Of training, shared with the chairs trained beside it."""
    refused: str = ""
    """Why the chair does not suit the setting; it is not trained then."""


@dataclass(eq=False)
class _Pupil:
    """One chair in training."""

    pick: FurnitureRef
    task: ObjectCentricTask | FullTask
    chair: Chair
    learner: Learner
    seconds: float = 0.0
    proven: int = 0
    """Steps at which the last proof was tried."""


def size_of(points: int) -> int:
    """The least size that holds so many points."""
    return next(s for s in POINT_SIZES if s >= points)


def partial_of(folder: Path, name: str) -> Path:
    """Where a chair on its way lies."""
    return dataset_file(folder, name).with_suffix(".partial.npz")


class Bench:
    """Several pupils of one size whose networks are updated in one call; a new one takes the place of one that leaves.

    Args:
        picks: chairs to train.
        folder: gets a file for each.
        training: how.
        side_by_side: at a time.
        extractor: weights of the auto-encoder.
        notes: kept in the files: what the chairs belong to.
    """

    def __init__(
        self, picks: Sequence[FurnitureRef], folder: Path, training: ExpertTraining, side_by_side: int,
        extractor: Params, notes: dict[str, Any],
    ) -> None:  # fmt: skip
        self._waiting = list(picks)
        self._folder, self._training, self._extractor, self._notes = folder, training, extractor, notes
        self._pupils: list[_Pupil] = []
        self._weights: list[tuple[Any, Any, Any]] = []
        self._fill(side_by_side)

    def run(self, keep_every: float) -> None:
        """Train all, writing what is on its way every `keep_every` seconds."""
        saved = time.monotonic()
        while self._pupils:
            begun = time.monotonic()
            self.advance()
            for pupil in self._pupils:
                pupil.seconds += (time.monotonic() - begun) / len(self._pupils)
            leaving = [i for i, p in enumerate(self._pupils) if self._is_done(p, i)]
            if leaving:
                self._replace(leaving)
            if time.monotonic() - saved > keep_every:
                for i in range(len(self._pupils)):
                    self.keep(i)
                saved = time.monotonic()

    def advance(self) -> None:
        """`update_every` steps of every pupil, then one update."""
        t, learners = self._training, [p.learner for p in self._pupils]
        for _ in range(t.update_every):
            joined = np.array([x.memory.joined[x.at] for x in learners], np.float32)
            free = np.array([x.memory.free[x.at] for x in learners], np.float32)
            q = np.asarray(double_q.values(self._params, self._features, self._part, joined, free))
            for learner, values in zip(learners, q, strict=True):
                learner.move(values)
        batches = [x.memory.sample(x.rng, t.learner) for x in learners]
        batch = {k: np.array([b[k] for b in batches]) for k in batches[0]}
        self._params, self._moments, _ = double_q.update(
            t.learning_rate, self._params, self._target, self._moments, batch
        )
        for learner in learners:
            learner.updates += 1
        due = np.array([x.updates % t.target_every == 0 for x in learners])
        if due.any():
            self._target = jax.tree.map(
                lambda new, old: jnp.where(due.reshape(-1, *[1] * (new.ndim - 1)), new, old), self._params, self._target
            )

    def _fill(self, count: int) -> None:
        """Let chairs in until there are so many."""
        while self._waiting and len(self._pupils) < count:
            pick = self._waiting.pop(0)
            try:
                task = self._training.task_of(pick)
            except InputError as error:
                if self._training.setting == "object-centric":
                    raise
                self._refuse(pick, str(error))
            else:
                self._enter(pick, task)
        self._stack()

    def _refuse(self, pick: FurnitureRef, why: str) -> None:
        result = Mastery(pick.name, False, 0, 0, 0.0, 0.0, why)
        config = {**self._notes, "furniture": pick.name, "training": asdict(self._training), "result": asdict(result)}
        checkpoint.save(dataset_file(self._folder, pick.name), checkpoint.Checkpoint(KIND, {}, config, {}))

    def _enter(self, pick: FurnitureRef, task: ObjectCentricTask | FullTask) -> None:
        t = self._training
        clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in task.furniture.parts], np.float32)
        chair = chair_of(task, autoencoder.encode(self._extractor, clouds))
        number = [t.seed, *pick.name.encode()]
        rng = np.random.default_rng(number)
        memory = Memory(Rehearsal(task, int(rng.integers(2**31))), chair)
        pupil = _Pupil(pick, task, chair, Learner(memory, t.learner, rng))
        params: Any = experts.init(rng, len(chair.part), chair.features.shape[1], chair.ways)
        target, moments = params, double_q.optimiser(t.learning_rate).init(params)
        path = partial_of(self._folder, pick.name)
        if path.exists():
            kept = checkpoint.load(path, KIND)
            if kept.config != self._config(pupil):
                raise InputError(f"'{path}' was trained otherwise; name another folder, or remove it")
            params = kept.params["online"]
            target = kept.params["target"]
            leaves = [kept.extra[f"moment{i}"] for i in range(len(jax.tree.leaves(moments)))]
            moments = jax.tree.unflatten(jax.tree.structure(moments), leaves)
            pupil.learner.restore(kept.params["learner"])
            pupil.seconds, pupil.proven = float(kept.extra["seconds"]), int(kept.extra["proven"])
        self._pupils.append(pupil)
        self._weights.append((params, target, moments))

    def _stack(self) -> None:
        if self._pupils:
            self._params, self._target, self._moments = (
                jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees) for trees in zip(*self._weights, strict=True)
            )
            self._features = np.array([p.chair.features for p in self._pupils])
            self._part = np.array([p.chair.part for p in self._pupils])

    def _one(self, i: int) -> tuple[Any, Any, Any]:
        """Weights, target and moments of one pupil."""
        return double_q.one_of((self._params, self._target, self._moments), i)

    def _replace(self, leaving: list[int]) -> None:
        stay = [i for i in range(len(self._pupils)) if i not in leaving]
        self._weights = [self._one(i) for i in stay]
        self._pupils = [self._pupils[i] for i in stay]
        self._fill(len(stay) + len(leaving))

    def _is_done(self, pupil: _Pupil, i: int) -> bool:
        """Whether the pupil has mastered the chair, or has had its steps; writes its file if so."""
        learner, t = pupil.learner, self._training
        mastered = False
        if learner.mastered and learner.steps >= t.least_steps and pupil.proven < learner.steps:
            mastered = self._proves(pupil, Expert(pupil.chair, self._one(i)[0]))
        if not mastered and learner.steps < t.steps:
            return False
        params = self._one(i)[0]
        expert = Expert(pupil.chair, params)
        trials = [play(expert, pupil.task, _TRIAL_SEEDS + k) for k in range(t.trials if mastered else 1)]
        rate = sum(experts.finished(moves, pupil.chair) for moves in trials) / len(trials)
        result = Mastery(
            pupil.pick.name, mastered, learner.steps, learner.memory.rehearsal.planned, rate, pupil.seconds
        )
        extra = {"features": pupil.chair.features, "depths": np.array(learner.depths, np.int32).reshape(-1, 2)}
        config = {**self._config(pupil), "result": asdict(result)}
        checkpoint.save(dataset_file(self._folder, pupil.pick.name), checkpoint.Checkpoint(KIND, params, config, extra))
        partial_of(self._folder, pupil.pick.name).unlink(missing_ok=True)
        return True

    def _proves(self, pupil: _Pupil, expert: Expert) -> bool:
        """Whether the expert succeeds in the real environment; what fails there is taken over into its memory."""
        learner = pupil.learner
        for k in range(self._training.proofs):
            moves = play(expert, pupil.task, k)
            learner.steps += len(moves)
            pupil.proven = learner.steps
            if not experts.finished(moves, pupil.chair):
                state: State | None = learner.memory.rehearsal.start
                for move in moves[:-1]:
                    state = learner.memory.rehearsal.step(state, move.action) if state is not None else None
                if state is not None and moves[-1].verdict != ObjectCentricVerdict.WRONG_PAIR:
                    learner.correct(state, moves[-1].action)
                return False
        return True

    def _config(self, pupil: _Pupil) -> dict[str, Any]:
        return {
            **self._notes,
            "furniture": pupil.pick.name,
            "furniture_hash": furniture_hash(pupil.task.furniture),
            "training": asdict(self._training),
        }

    def keep(self, i: int) -> None:
        """Write where a pupil stands."""
        pupil = self._pupils[i]
        params, target, moments = self._one(i)
        leaves = {f"moment{k}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(moments))}
        arrays = {"online": params, "target": target, "learner": pupil.learner.to_arrays()}
        extra = {**leaves, "seconds": np.array(pupil.seconds), "proven": np.array(pupil.proven)}
        path = partial_of(self._folder, pupil.pick.name)
        checkpoint.save(path, checkpoint.Checkpoint(KIND, arrays, self._config(pupil), extra))


def train(
    picks: Sequence[FurnitureRef], folder: Path, training: ExpertTraining, extractor: Path, notes: dict[str, Any],
    *, jobs: int, side_by_side: int, keep_every: float = 50.0,
) -> Iterator[Mastery]:  # fmt: skip
    """Train an expert for each chair that has none yet; yields all of them as they are done, those at hand first.

    Args:
        picks: the chairs.
        folder: gets a file for each.
        training: how.
        extractor: checkpoint of the auto-encoder.
        notes: kept in the files.
        jobs: processes.
        side_by_side: chairs trained in one call in each process.
        keep_every: seconds between what is written of chairs on their way.
    """
    folder.mkdir(parents=True, exist_ok=True)
    there = [p for p in picks if dataset_file(folder, p.name).is_file()]
    yield from (read(dataset_file(folder, p.name)) for p in there)
    left = [p for p in picks if p not in there]
    by_size: dict[int, list[FurnitureRef]] = {}
    for p in left:
        counts = point_counts(p.furniture(with_grasps=False))
        by_size.setdefault(size_of(int(counts.sum())), []).append(p)
    lots = [lot for size in sorted(by_size) for lot in _lots(by_size[size], jobs, side_by_side)]
    work = partial(
        _train_lot, folder=folder, training=training, extractor=extractor, notes=notes, side_by_side=side_by_side,
        keep_every=keep_every,
    )  # fmt: skip
    if jobs == 1:
        for lot in lots:
            work(lot)
            yield from (read(dataset_file(folder, p.name)) for p in lot)
        return
    with worker_pool(jobs) as pool:
        with one_thread_each():
            running = {pool.submit(work, lot) for lot in lots}
        while left:
            done, running = wait(running, timeout=2.0)
            for future in done:
                future.result()
            ready = [p for p in left if dataset_file(folder, p.name).is_file()]
            yield from (read(dataset_file(folder, p.name)) for p in ready)
            left = [p for p in left if p not in ready]


def _lots(picks: list[FurnitureRef], jobs: int, side_by_side: int) -> list[list[FurnitureRef]]:
    """Chairs of one size in as many lots as keep all processes busy."""
    count = min(len(picks), max(jobs, -(-len(picks) // (4 * side_by_side))))
    return [picks[i::count] for i in range(count)]


def _train_lot(
    picks: list[FurnitureRef], *, folder: Path, training: ExpertTraining, extractor: Path, notes: dict[str, Any],
    side_by_side: int, keep_every: float,
) -> None:  # fmt: skip
    weights = checkpoint.load(extractor, autoencoder.KIND).params
    Bench(picks, folder, training, side_by_side, weights, notes).run(keep_every)


def read(path: Path) -> Mastery:
    """What became of a chair.

    Raises:
        InputError: the file is not an expert's.
    """
    return Mastery(**checkpoint.load(path, KIND).config["result"])


def mastery(results: Sequence[Mastery]) -> dict[str, Any]:
    """How many chairs were mastered, with the 95 % Wilson interval, and what it took; the refused left out."""
    refused, results = sum(bool(r.refused) for r in results), [r for r in results if not r.refused]
    if not results:
        return {**success([]), "mastered": 0, "refused": refused}
    done = [r for r in results if r.mastered]
    return {
        **success([r.mastered for r in results]),
        "mastered": len(done),
        "refused": refused,
        "trials_success_rate": sum(r.success_rate for r in results) / len(results),
        "steps_mean": sum(r.steps for r in results) / len(results),
        "steps_mean_mastered": sum(r.steps for r in done) / len(done) if done else None,
        "planned_mean": sum(r.planned for r in results) / len(results),
        "seconds": sum(r.seconds for r in results),
    }


def load(path: Path, task: ObjectCentricTask | FullTask) -> Expert:
    """An expert that was trained.

    Raises:
        InputError: the file is not an expert's, or of another chair.
    """
    kept = checkpoint.load(path, KIND)
    if kept.config["furniture_hash"] != furniture_hash(task.furniture):
        raise InputError(f"'{path}' is an expert for {kept.config['furniture']}, which is not this furniture")
    shapes = np.zeros((len(task.furniture.parts), kept.extra["features"].shape[1] - 9), np.float32)
    plain = chair_of(task, shapes)
    return Expert(replace(plain, features=kept.extra["features"]), kept.params)
