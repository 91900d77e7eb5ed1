"""Collects lessons for the multi-task policy: one file a chair, made in parallel, never made twice."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import CLOUD_POINTS, LabeledState, SampleSet, dataset_file
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.grasps.dataset import GraspTeacher
from roboassembly.learning.relational.oracle_dataset import Student, Teacher
from roboassembly.parallel.processes import map_unordered
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import Oracle
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.setting import SettingName

_TRIES = 3
"""Pairs of hands that are tried at a pair of points, until one joins them."""
_MOST_HELD = 16
"""Parts, at most, of furniture taught with robots: what the oracle asks of hands grows exponentially with them."""


@dataclass(frozen=True)
class Gathered:
    """What one chair gave."""

    name: str
    states: int
    mistakes: int
    """Choices of the student that were not good."""
    choices: int
    """That the student made or a good move replaced; 0 without one."""
    seconds: float


def hands_of(folder: Path) -> Path:
    """Where the lessons of grasps (`grasp_lessons`) lie that belong to those of a folder, under the same names."""
    return folder / "hands"


def gather(
    names: Sequence[str], folder: Path, *, plays: int, seed: int, jobs: int, student: Path | None = None,
    setting: SettingName = "object-centric", with_grasps: Collection[str] = (),
) -> Iterator[Gathered]:  # fmt: skip
    """Write the lessons of generated chairs, those that are there already excepted; yields as chairs are done.

    In the full setting there may be lessons of grasps besides (`hands_of`); they take several times as long.

    Args:
        names: `family:seed` of each.
        folder: gets a file for each.
        plays: of each chair, from loose parts to the end.
        seed: of the starts and moves.
        jobs: chairs at a time.
        student: checkpoint of the relational policy that moves in the first play, as it would play alike each time;
            random good moves in the others, and without one.
        setting: whose rules are taught. Furniture that does not suit robots gives no lessons in the full one.
        with_grasps: names of those of which there are lessons of grasps, of one play each.
    """
    (hands_of(folder) if setting == "full" else folder).mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not dataset_file(folder, name).is_file()]
    work = partial(
        _gather, folder=folder, plays=plays, seed=seed, student=student, setting=setting,
        with_grasps=frozenset(with_grasps),
    )  # fmt: skip
    yield from map_unordered(work, left, jobs)


def _gather(
    name: str, *, folder: Path, plays: int, seed: int, student: Path | None, setting: SettingName,
    with_grasps: frozenset[str],
) -> Gathered:  # fmt: skip
    begun = time.monotonic()
    family, _, number = name.partition(":")
    try:
        furniture = catalogue.make(family, int(number), with_grasps=setting == "full")
        oracle = _oracle(furniture, setting)
    except InputError:
        # One in some hundred practice frames does not come out, hands cannot hold it, or it has too many parts; nothing
        # is learnt from it.
        SampleSet(name, np.zeros((0, CLOUD_POINTS, 3), np.float32), ()).save(dataset_file(folder, name))
        return Gathered(name, 0, 0, 0, time.monotonic() - begun)
    clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in furniture.parts], np.float32)
    teacher = Teacher(furniture, clouds, oracle)
    moves = None if student is None else _student(student)
    found: dict[bytes, LabeledState] = {}
    mistakes = choices = 0
    for index in range(plays):
        rng = np.random.default_rng([seed, int(number), index])
        student_moves = moves if index == 0 else None
        play = teacher.play(rng, student_moves)
        if student_moves is not None:
            mistakes, choices = play.mistakes, len(play.lessons)
        for lesson in (*play.lessons, *play.dead_ends):
            found.setdefault(lesson.group.tobytes(), lesson)
    if isinstance(oracle, HandOracle) and name in with_grasps:
        hands = GraspTeacher(oracle.full, _TRIES, oracle).course(np.random.default_rng([seed, int(number)]), 1)
        hands.save(dataset_file(hands_of(folder), name))
    replace(teacher.course, name=name, samples=tuple(found.values())).save(dataset_file(folder, name))
    return Gathered(name, len(found), mistakes, choices, time.monotonic() - begun)


def _oracle(furniture: Furniture, setting: SettingName) -> Oracle:
    if setting == "object-centric":
        return Oracle(ObjectCentricTask(furniture))
    if len(furniture.parts) > _MOST_HELD:
        raise InputError(
            f"{furniture.name} has {len(furniture.parts)} parts; with robots at most {_MOST_HELD} are taught"
        )
    task = FullTask(furniture)
    task.check_graspable()
    return HandOracle(task)


@lru_cache(maxsize=1)
def _student(path: Path) -> Student:
    params = checkpoint.load(path, relational.KIND).params
    return partial(relational.best, params)
