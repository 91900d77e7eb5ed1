"""Lessons of grasps from the policy's own plays: what becomes of the hands that it would choose.

Hands drawn at random (`grasp_lessons`) say little of those that a policy prefers: among hundreds of hands it takes the
one whose chance it overrates most. So it plays, and every action carried out answers for its own hands; after one that
fails, the next best is tried in the same state.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.envs.observation import Observer, surface_points
from roboassembly.errors import InputError
from roboassembly.furniture import catalogue
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.gather import Gathered, file_of
from roboassembly.learning.grasp_lessons import NO, UNKNOWN, YES, GraspCourse, GraspLesson
from roboassembly.learning.lessons import CLOUD_POINTS
from roboassembly.learning.loading import load_policy
from roboassembly.learning.policies import ConfidentPolicy, guide_of
from roboassembly.processes import as_done
from roboassembly.solvers.guide import Guide
from roboassembly.task.full import FullOutcome, FullTask, FullVerdict
from roboassembly.task.full_plan import FullState
from roboassembly.task.rules import GRASPS

_TRIED = 5
"""Actions of a state before a play is given up."""
_CURIOUS = 0.25
"""Share of actions that are any of those suggested, not the best of them."""
_HANDS = (FullVerdict.GRASP_BLOCKED, FullVerdict.JOINT_BLOCKED, FullVerdict.CANNOT_LET_GO)
_TAKING = ("drive to", "grasp", "approach", "lift")
"""How the legs are called in which a group is fetched from its post."""


def practise(
    names: Sequence[str], folder: Path, policy: Path, *, plays: int, seed: int, jobs: int
) -> Iterator[Gathered]:
    """Write the lessons of generated furniture, those that are there already excepted; yields as pieces are done.

    Args:
        names: `family:seed` of each.
        folder: gets a file for each.
        policy: checkpoint of the relational policy that plays, with hands.
        plays: of each piece.
        seed: of the starts and all that is drawn.
        jobs: pieces at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not file_of(folder, name).is_file()]
    yield from as_done(partial(_practise, folder=folder, policy=policy, plays=plays, seed=seed), left, jobs)


def _practise(name: str, *, folder: Path, policy: Path, plays: int, seed: int) -> Gathered:
    begun = time.monotonic()
    family, _, number = name.partition(":")
    lessons: list[GraspLesson] = []
    clouds, hands = np.zeros((0, CLOUD_POINTS, 3), np.float32), np.zeros((0, GRASPS, 6), np.float32)
    try:
        task = FullTask(catalogue.make(family, int(number)))
        task.check_hands()
    except InputError:
        # Two robots could not assemble it whatever they did.
        plays = 0
    else:
        parts = task.furniture.parts
        clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in parts], np.float32)
        observer = Observer(task.furniture, len(parts), MAX_POINTS, 1)
        hands = observer.hands
        for index in range(plays):
            rng = np.random.default_rng([seed, int(number), index])
            state = task.initial_state(rng)
            lessons += play(task, state, observer, guide_of(_policy(policy)), rng)
    GraspCourse(name, clouds, hands, tuple(lessons)).save(file_of(folder, name))
    mistakes = sum(not (lesson.rest == YES).any() for lesson in lessons)
    return Gathered(name, len(lessons), mistakes, len(lessons), time.monotonic() - begun)


@lru_cache(maxsize=1)
def _policy(path: Path) -> ConfidentPolicy:
    policy = load_policy(str(path))
    assert isinstance(policy, ConfidentPolicy)
    return policy


def play(
    task: FullTask, state: FullState, observer: Observer, guide: Guide[FullState], rng: np.random.Generator
) -> Iterator[GraspLesson]:
    """One play, as far as it leads; a lesson for each action of which the pair was right."""
    ahead: FullState | None = state
    while ahead is not None and not ahead.groups.complete:
        state, ahead = ahead, None
        left = list(guide(task, state))
        for _ in range(_TRIED):
            if not left:
                break
            one = left.pop(int(rng.integers(len(left))) if rng.random() < _CURIOUS else 0)
            outcome = task.step(state, one.action, int(rng.integers(2**31 - 1)))
            if outcome.verdict in (FullVerdict.WRONG_PAIR, FullVerdict.NOT_AN_ACTION):
                continue
            yield lesson_of(task, state, observer, one.action, outcome)
            if outcome.step is not None:
                ahead = outcome.state
                break


def lesson_of(
    task: FullTask, state: FullState, observer: Observer, action: tuple[int, ...], outcome: FullOutcome
) -> GraspLesson:
    """What an action of a right pair tells of its own two hands, by how far it came."""
    u, v, k, l, g_a, g_b = action  # noqa: E741
    take = np.full((2, GRASPS), UNKNOWN, np.int8)
    room, meet, rest = (np.full((GRASPS, GRASPS), UNKNOWN, np.int8) for _ in range(3))
    at, hands = (g_a, g_b), ((0, g_a), (1, g_b))
    if outcome.verdict in _HANDS:
        room[at] = NO
    elif outcome.leg == "mate" and outcome.verdict is FullVerdict.NO_ARM_SOLUTION:
        room[at], meet[at] = YES, NO
    elif outcome.step is None and outcome.leg.startswith(_TAKING):
        room[at], meet[at] = YES, YES
        of_v = outcome.leg.endswith("v")
        if of_v:
            take[hands[0]] = YES
        take[hands[of_v]] = NO
    else:
        room[at], meet[at] = YES, YES
        take[hands[0]] = take[hands[1]] = YES
        rest[at] = NO if outcome.step is None else YES
    seen = observer.observe(state.groups)
    free = task.rules.free_points(state.groups)[: len(seen["poses"])]
    return GraspLesson(
        seen["connection_points"], seen["connections"], free, seen["poses"], (u, k, v, l), take, room, meet, rest
    )  # fmt: skip
