"""What an expert teaches the multi-task policy: its plays in the real environment, with its Q-values.

The first play takes the action with the highest Q throughout; in later ones any action that is almost as good may be
drawn, so that lessons show more than one way. As in the paper only successful plays become lessons.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float16

from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.datasets import Pick
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.apprentices import load
from roboassembly.learning.experts import Expert, Move, finished, play
from roboassembly.learning.gather import file_of
from roboassembly.learning.lessons import CLOUD_POINTS, Course, Lesson
from roboassembly.processes import as_done
from roboassembly.task.object_centric import ObjectCentricTask

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


def expert_course(expert: Expert, task: ObjectCentricTask, name: str, plays: int, seed: int = 0) -> tuple[Course, int]:
    """Lessons from an expert's plays, those that finish the chair only; Q-values are undiscounted returns.

    Args:
        expert: plays.
        task: of its chair.
        name: of the chair.
        plays: to try.
        seed: of their starts and draws.

    Returns:
        The course, and how many plays finished.
    """
    parts = task.furniture.parts
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in parts], np.float32)
    observer = Observer(task.furniture, len(parts), MAX_POINTS, 1)
    lessons: list[Lesson] = []
    done = 0
    for index in range(plays):
        moves = play(expert, task, _SEEDS + 1_000 * seed + index, margin=_MARGIN if index else 0.0)
        if finished(moves, expert.chair):
            done += 1
            lessons += [_lesson(expert, task, observer, move) for move in moves]
    return Course(name, clouds, tuple(lessons)), done


def _lesson(expert: Expert, task: ObjectCentricTask, observer: Observer, move: Move) -> Lesson:
    seen = observer.observe(move.state)
    free = task.free_points(move.state)[: len(task.furniture.parts)]
    return Lesson(
        seen["connection_points"],
        seen["connections"],
        free,
        seen["poses"],
        np.zeros((0, 11), np.int16),
        _values(expert, move),
    )


def _values(expert: Expert, move: Move) -> Float16[np.ndarray, "n n 6"]:
    """Q over free points in returns, at most what is left to be had; 0 where the action does not exist."""
    rows = np.flatnonzero(np.isfinite(move.values).any(axis=(1, 2)))
    values = move.values[np.ix_(rows, rows)]
    most = len(move.state.groups) + 3.0  # a point a merge, four more for the last
    return np.where(np.isfinite(values), np.minimum(values * expert.chair.best, most), 0.0).astype(np.float16)


def teach(picks: Sequence[Pick], experts: Path, folder: Path, *, plays: int, seed: int, jobs: int) -> Iterator[Taught]:
    """Write the lessons of all chairs whose experts are done, those that are there already excepted.

    Args:
        picks: the chairs.
        experts: folder of the experts' files.
        folder: gets a file of lessons for each chair of which a play finished.
        plays: of each chair.
        seed: of starts and draws.
        jobs: chairs at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [p for p in picks if file_of(experts, p.name).is_file() and not file_of(folder, p.name).is_file()]
    work = partial(_teach, experts=experts, folder=folder, plays=plays, seed=seed)
    yield from as_done(work, left, jobs)


def _teach(pick: Pick, *, experts: Path, folder: Path, plays: int, seed: int) -> Taught:
    task = ObjectCentricTask(pick.furniture(with_grasps=False))
    course, done = expert_course(load(file_of(experts, pick.name), task), task, pick.name, plays, seed)
    if course.lessons:
        course.save(file_of(folder, pick.name))
    return Taught(pick.name, plays, done, len(course.lessons))
