"""What an expert teaches the multi-task policy: its plays in the real environment, with its Q-values.

The first play takes the action with the highest Q throughout; in later ones any action that is almost as good may be
drawn, so that lessons show more than one way. With robots the first plays repeat those by which the chair was mastered:
from other starts the arms often cannot do what an expert, which does not see where things lie, tells them. As in the
paper only successful plays become lessons.
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
from roboassembly.learning.paper.dqn.network import Expert, Move, finished, play, told
from roboassembly.learning.paper.dqn.train import ExpertTraining, load, read
from roboassembly.parallel.processes import map_unordered
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask

_MARGIN = 0.06
"""Of Q, in shares of the best return: one merge is worth 0.05 to 0.25 of it."""
_SEEDS = 20_000
"""Seeds of the plays start here, where no other play of an expert is."""


@dataclass(frozen=True)
class Taught:
    """What one expert gave."""

    name: str
    plays: int
    finished: int
    lessons: int


def expert_course(
    expert: Expert, task: ObjectCentricTask | FullTask, name: str, plays: int, seed: int = 0, proofs: int = 0
) -> tuple[SampleSet, int]:
    """Lessons from an expert's plays, those that finish the chair only; Q-values are undiscounted returns.

    Args:
        expert: plays.
        task: of its chair.
        name: of the chair.
        plays: to try.
        seed: of their starts and draws.
        proofs: so many of the plays, the first, are those by which the chair was mastered.

    Returns:
        The course, and how many plays finished.
    """
    parts = task.furniture.parts
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in parts], np.float32)
    observer = Observer(task.furniture, len(parts), MAX_POINTS, 1)
    lessons: list[LabeledState] = []
    done = 0
    for index in range(plays):
        proof = index < proofs
        start = index if proof else _SEEDS + 1_000 * seed + index
        moves = play(expert, task, start, margin=_MARGIN if index and not proof else 0.0)
        if finished(moves, expert.chair):
            done += 1
            lessons += [_lesson(expert, task, observer, move) for move in moves]
    return SampleSet(name, clouds, tuple(lessons), observer.grasp_poses if isinstance(task, FullTask) else None), done


def _lesson(expert: Expert, task: ObjectCentricTask | FullTask, observer: Observer, move: Move) -> LabeledState:
    seen = observer.observe(move.state)
    free = task.rules.free_points(move.state)[: len(task.furniture.parts)]
    return LabeledState(
        seen["connection_points"],
        seen["connections"],
        free,
        seen["poses"],
        np.zeros((0, 11), np.int16),
        _values(expert, task, move),
    )


def _values(expert: Expert, task: ObjectCentricTask | FullTask, move: Move) -> Float16[np.ndarray, "n n w"]:
    """Q over free points in returns, as in `LabeledState`."""
    joined, free = told(task, move.state)
    rows = np.flatnonzero(free)
    some = [x[np.ix_(rows, rows)] for x in expert.added(joined, free)]
    return (np.concatenate(some, axis=2) * expert.chair.best).astype(np.float16)


def teach(
    picks: Sequence[FurnitureRef], experts: Path, folder: Path, training: ExpertTraining, *, plays: int, jobs: int
) -> Iterator[Taught]:
    """Write the lessons of all chairs whose experts are done, those that are there already excepted.

    Args:
        picks: the chairs.
        experts: folder of the experts' files.
        folder: gets a file for each chair, without lessons if no play finished.
        training: of the experts; its seed is that of starts and draws.
        plays: of each chair.
        jobs: chairs at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [p for p in picks if dataset_file(experts, p.name).is_file() and not dataset_file(folder, p.name).is_file()]
    left = [p for p in left if not read(dataset_file(experts, p.name)).refused]
    work = partial(_teach, experts=experts, folder=folder, training=training, plays=plays)
    yield from map_unordered(work, left, jobs)


def _teach(pick: FurnitureRef, *, experts: Path, folder: Path, training: ExpertTraining, plays: int) -> Taught:
    task = training.task_of(pick)
    proofs = training.proofs if training.setting == "full" else 0
    expert = load(dataset_file(experts, pick.name), task)
    course, done = expert_course(expert, task, pick.name, plays, training.seed, proofs)
    course.save(dataset_file(folder, pick.name))
    return Taught(pick.name, plays, done, len(course.samples))
