"""Lessons of grasps from the policy's own plays: what becomes of the hands that it would choose.

Hands drawn at random (`grasp_lessons`) say little of those that a policy prefers: among hundreds of hands it takes the
one whose chance it overrates most. So it plays, and every action carried out answers for its own hands; after one that
fails, the next best is tried in the same state. Of more of the actions that it would choose in a state it is asked what
can be told without planning: whether both hands have room, and of some whether the arms could do it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.datasets import CLOUD_POINTS, dataset_file
from roboassembly.learning.policy import guide_of
from roboassembly.learning.policy_weights import load_weights
from roboassembly.learning.relational.collect import Gathered
from roboassembly.learning.relational.grasps.dataset import (
    NO,
    UNKNOWN,
    YES,
    GraspCourse,
    GraspLesson,
    unanswered,
)
from roboassembly.learning.relational.policy import RelationalPolicy
from roboassembly.parallel.processes import map_unordered
from roboassembly.solvers.guide import Guide
from roboassembly.task.full.task import FullOutcome, FullTask, FullVerdict, MateGrasp, Refusal
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rollout import draw_seed, rollout
from roboassembly.task.rules.connections import GRASPS

_TRIED = 5
"""Actions of a state before a play is given up."""
_CURIOUS = 0.25
"""Share of actions that are any of those suggested, not the best of them."""
_ASKED, _ARMS_ASKED = 12, 3
"""Suggestions of a state of which it is asked whether the hands have room; and, of those that have, whether the arms
take both groups and reach the joint."""
_HANDS = (FullVerdict.GRASP_BLOCKED, FullVerdict.JOINT_BLOCKED, FullVerdict.CANNOT_RELEASE)
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
    left = [name for name in names if not dataset_file(folder, name).is_file()]
    yield from map_unordered(partial(_practise, folder=folder, policy=policy, plays=plays, seed=seed), left, jobs)


def _practise(name: str, *, folder: Path, policy: Path, plays: int, seed: int) -> Gathered:
    begun = time.monotonic()
    family, _, number = name.partition(":")
    lessons: list[GraspLesson] = []
    mistakes = choices = 0
    clouds, hands = np.zeros((0, CLOUD_POINTS, 3), np.float32), np.zeros((0, GRASPS, 6), np.float32)
    try:
        task = FullTask(catalogue.make(family, int(number)))
        task.check_graspable()
    except InputError:
        # Two robots could not assemble it whatever they did.
        plays = 0
    else:
        parts = task.furniture.parts
        clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in parts], np.float32)
        observer = Observer(task.furniture, len(parts), MAX_POINTS, 1)
        hands = observer.grasp_poses
        for index in range(plays):
            rng = np.random.default_rng([seed, int(number), index])
            state = task.initial_state(rng)
            seen, tried = play(task, state, observer, guide_of(_policy(policy)), rng)
            lessons += seen
            choices += len(tried)
            mistakes += sum(not (lesson.rest == YES).any() for lesson in tried)
    GraspCourse(name, clouds, hands, tuple(lessons)).save(dataset_file(folder, name))
    return Gathered(name, len(lessons), mistakes, choices, time.monotonic() - begun)


@lru_cache(maxsize=1)
def _policy(path: Path) -> RelationalPolicy:
    return RelationalPolicy.from_checkpoint(load_weights(str(path)), str(path))


def play(
    task: FullTask, state: FullState, observer: Observer, guide: Guide[FullState], rng: np.random.Generator
) -> tuple[list[GraspLesson], list[GraspLesson]]:
    """Play one episode, as far as it leads.

    Returns:
        All its lessons, and those among them of actions that were carried out and whose pair was right.
    """
    lessons: list[GraspLesson] = []
    tried: list[GraspLesson] = []

    def propose(state: FullState) -> Iterator[tuple[int, ...]]:
        left = list(guide(task, state))
        lessons.extend(ask(task, state, observer, [one.action for one in left[:_ASKED]], rng))
        for _ in range(min(_TRIED, len(left))):
            yield left.pop(int(rng.integers(len(left))) if rng.random() < _CURIOUS else 0).action

    for transition in rollout(task, state, propose, rng):
        outcome = transition.outcome
        if outcome.verdict not in (FullVerdict.WRONG_PAIR, FullVerdict.NOT_AN_ACTION):
            tried.append(lesson_of(task, transition.state, observer, transition.action, outcome))
            lessons.append(tried[-1])
    return lessons, tried


def ask(
    task: FullTask, state: FullState, observer: Observer, actions: Sequence[tuple[int, ...]], rng: np.random.Generator
) -> Iterator[GraspLesson]:
    """What can be told of some actions without carrying them out; a lesson for each right pair.

    Args:
        task: of the furniture.
        state: unchanged.
        observer: of the furniture.
        actions: that exist.
        rng: draws for the arms.
    """
    lessons: dict[tuple[int, ...], GraspLesson] = {}
    arms = 0
    for action in actions:
        u, v, k, l, g_a, g_b = action  # noqa: E741
        joint = task.mate_grasp(state.groups, action)
        if isinstance(joint, Refusal) and joint.verdict is FullVerdict.WRONG_PAIR:
            continue
        if (u, v, k, l) not in lessons:
            lessons[u, v, k, l] = unanswered(task, state, observer, (u, k, v, l))
        lesson = lessons[u, v, k, l]
        lesson.room[g_a, g_b] = NO if isinstance(joint, Refusal) else YES
        if isinstance(joint, MateGrasp) and arms < _ARMS_ASKED:
            arms += 1
            lesson.meet[g_a, g_b] = task.can_mate(state, joint, draw_seed(rng))
            for robot, part, g, held in ((0, u, g_a, joint.grip_a), (1, v, g_b, joint.grip_b)):
                if lesson.take[robot, g] == UNKNOWN:
                    lesson.take[robot, g] = task.can_pick(state, part, held, robot, draw_seed(rng))
    yield from lessons.values()


def lesson_of(
    task: FullTask, state: FullState, observer: Observer, action: tuple[int, ...], outcome: FullOutcome
) -> GraspLesson:
    """What an action of a right pair tells of its own two hands, by how far it came."""
    u, v, k, l, g_a, g_b = action  # noqa: E741
    lesson = unanswered(task, state, observer, (u, k, v, l))
    take, room, meet, rest = lesson.take, lesson.room, lesson.meet, lesson.rest
    at, hands = (g_a, g_b), ((0, g_a), (1, g_b))
    if outcome.verdict in _HANDS:
        room[at] = NO
    elif outcome.segment == "mate" and outcome.verdict is FullVerdict.NO_ARM_SOLUTION:
        room[at], meet[at] = YES, NO
    elif outcome.step is None and outcome.segment.startswith(_TAKING):
        room[at], meet[at] = YES, YES
        of_v = outcome.segment.endswith("v")
        if of_v:
            take[hands[0]] = YES
        take[hands[of_v]] = NO
    else:
        room[at], meet[at] = YES, YES
        take[hands[0]] = take[hands[1]] = YES
        rest[at] = NO if outcome.step is None else YES
    return lesson
