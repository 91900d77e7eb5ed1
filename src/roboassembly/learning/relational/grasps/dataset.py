"""What the relational policy is taught about hands: which of them could join right pairs, in plays of many chairs.

A play takes right pairs after which the furniture can still be finished, as the oracle knows, and tries grasps at
random until one works out. For each pair it is kept which hands can take the groups, which two have room at the joint,
where the arms reach it, and what became of those that were tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int8

from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning import archive
from roboassembly.learning.datasets import CLOUD_POINTS, group_labels
from roboassembly.learning.relational.policy_view import Situation
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import LabeledMate
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.task import FullTask, MateGrasp
from roboassembly.task.plans.full_plan import FullState
from roboassembly.task.rollout import draw_seed, rollout
from roboassembly.task.rules.connections import GRASPS

UNKNOWN, NO, YES = -1, 0, 1
"""What is known of a hand, or of two."""
_TOGETHER = 16
"""Pairs of hands that fit alone of which it is found out whether they fit together."""
_MEET = 6
"""Pairs of hands that fit together of which it is found out whether the arms reach the joint."""
_PAIRS = 3
"""Right pairs of a state that are tried before a play is given up."""


@dataclass(frozen=True, eq=False)
class GraspLesson:
    """One right pair of one state."""

    points: Float32[np.ndarray, "P K 9"]
    connections: Float32[np.ndarray, "P P 6"]
    free: Bool[np.ndarray, "P K"]
    poses: Float32[np.ndarray, "P 6"]
    pair: tuple[int, int, int, int]
    """u, k, v, l."""
    take: Int8[np.ndarray, "2 8"]
    """Whether R_a can take u's group from its post with each hand, and R_b v's."""
    room: Int8[np.ndarray, "8 8"]
    """Whether two hands have room at their parts and at the joint."""
    meet: Int8[np.ndarray, "8 8"]
    """Whether both arms reach the joint then, somewhere."""
    rest: Int8[np.ndarray, "8 8"]
    """Whether all else works out then, too."""


@dataclass(frozen=True, eq=False)
class GraspCourse:
    """The lessons of one chair."""

    name: str
    clouds: Float32[np.ndarray, "P C 3"]
    hands: Float32[np.ndarray, "P 8 6"]
    lessons: tuple[GraspLesson, ...]

    def situation(self, lesson: GraspLesson) -> Situation:
        """What a policy is told of a state."""
        connections = lesson.connections.astype(float)
        return Situation(
            self.clouds.astype(float), lesson.points.astype(float), connections, lesson.free, group_labels(connections),
            self.hands.astype(float), lesson.poses.astype(float),
        )  # fmt: skip

    def save(self, path: Path) -> None:
        """Write as npz, whole or not at all; clouds are rounded to half a millimetre."""
        arrays = {
            "name": np.array(self.name),
            "clouds": self.clouds.astype(np.float16),
            "hands": self.hands,
            "points": np.array([x.points for x in self.lessons]),
            "connections": np.array([x.connections for x in self.lessons]),
            "free": np.array([x.free for x in self.lessons]),
            "poses": np.array([x.poses for x in self.lessons]),
            "pairs": np.array([x.pair for x in self.lessons], np.int16).reshape(-1, 4),
            "take": np.array([x.take for x in self.lessons], np.int8).reshape(-1, 2, GRASPS),
            "together": np.array([(x.room, x.meet, x.rest) for x in self.lessons], np.int8).reshape(
                -1, 3, GRASPS, GRASPS
            ),
        }
        archive.write(path, arrays)

    @staticmethod
    def load(path: Path) -> GraspCourse:
        """Read what `save` wrote.

        Raises:
            InputError: the file is broken.
        """
        with archive.reading(path, "a course of grasps", "remove it and build it again") as z:
            names = ("points", "connections", "free", "poses", "pairs", "take", "together")
            lessons = tuple(
                GraspLesson(p, c, f, w, tuple(pair.tolist()), take, *together)
                for p, c, f, w, pair, take, together in zip(*(z[name] for name in names), strict=True)
            )
            return GraspCourse(str(z["name"]), z["clouds"].astype(np.float32), z["hands"], lessons)


class GraspTeacher:
    """Plays one chair with two robots, and watches which hands work.

    Args:
        task: the chair.
        tries: of pairs of hands that seem to work, for each pair of points.
        oracle: of the task, if there is one already.
    """

    def __init__(self, task: FullTask, tries: int, oracle: HandOracle | None = None) -> None:
        self.task, self.tries = task, tries
        self._oracle = oracle or HandOracle(task)
        self._observer = Observer(task.furniture, len(task.furniture.parts), MAX_POINTS, 1)

    def course(self, rng: np.random.Generator, plays: int) -> GraspCourse:
        """Lessons from some plays.

        Raises:
            InputError: the furniture does not suit the cell.
        """
        furniture = self.task.furniture
        clouds = np.array([surface_points(p.mesh, CLOUD_POINTS) for p in furniture.parts], np.float32)
        lessons: list[GraspLesson] = []
        for _ in range(plays):
            lessons += self.play(self.task.initial_state(rng), rng)
        return GraspCourse(furniture.name, clouds, self._observer.grasp_poses, tuple(lessons))

    def play(self, state: FullState, rng: np.random.Generator) -> list[GraspLesson]:
        """Play one episode of viable pairs, as far as it leads; a lesson for each pair that was looked at."""
        lessons: list[GraspLesson] = []

        def propose(state: FullState) -> Iterator[tuple[int, ...]]:
            mates = [m for m in self._oracle.mates(state.groups) if m.viable]
            for index in rng.permutation(len(mates))[:_PAIRS]:
                mate = mates[index]
                take, room, meet = self._tested(state, mate, rng)
                lesson = unanswered(self.task, state, self._observer, (mate.u, mate.k, mate.v, mate.l))
                lessons.append(replace(lesson, take=take, room=room, meet=meet))
                taken = (take[0, :, None] == YES) & (take[1] == YES)
                for g_a, g_b in rng.permutation(np.argwhere(taken & (meet == YES)))[: self.tries].tolist():
                    yield mate.u, mate.v, mate.k, mate.l, g_a, g_b

        for transition in rollout(self.task, state, propose, rng):
            lessons[-1].rest[transition.action[4:]] = YES if transition.merged else NO
        return lessons

    def _tested(
        self, state: FullState, joint: LabeledMate, rng: np.random.Generator
    ) -> tuple[Int8[np.ndarray, "2 8"], Int8[np.ndarray, "8 8"], Int8[np.ndarray, "8 8"]]:
        """Each hand alone, and some pairs of them together: `take`, `room` and `meet` of a lesson."""
        task, groups, merge = self.task, state.groups, joint.merge
        u_group, v_group = groups.groups[groups.group_of[joint.u]], groups.groups[groups.group_of[joint.v]]
        take = np.full((2, GRASPS), UNKNOWN, np.int8)
        room, meet = np.full((GRASPS, GRASPS), NO, np.int8), np.full((GRASPS, GRASPS), UNKNOWN, np.int8)
        hands: list[dict[int, Grip]] = []
        for robot, part in enumerate((joint.u, joint.v)):
            holds = task.free_grips(groups, part)
            for g, held in holds.items():
                take[robot, g] = task.can_pick(state, part, held, robot, draw_seed(rng))
            hands.append({g: h for g, h in holds.items() if task.grip_fits(u_group, v_group, merge, h, robot)})
        both = [(a, b) for a in hands[0] for b in hands[1]]
        room[tuple(np.array(both, int).reshape(-1, 2).T)] = UNKNOWN
        met = 0
        for index in rng.permutation(len(both))[:_TOGETHER]:
            a, b = both[index]
            fitted = task.check_grips(u_group, v_group, merge, hands[0][a], hands[1][b])
            room[a, b] = isinstance(fitted, MateGrasp)
            if isinstance(fitted, MateGrasp) and met < _MEET:
                met += 1
                meet[a, b] = task.can_mate(state, fitted, draw_seed(rng))
        return take, room, meet


def unanswered(
    task: FullTask, state: FullState, observer: Observer, pair: tuple[int, int, int, int]
) -> GraspLesson:  # fmt: skip
    """A lesson of a pair (u, k, v, l) of which nothing is known yet.

    Args:
        task: of the furniture.
        state: that it is in.
        observer: of the furniture.
        pair: right.
    """
    seen = observer.observe(state.groups)
    free = task.rules.free_points(state.groups)[: len(seen["poses"])]
    return GraspLesson(
        seen["connection_points"], seen["connections"], free, seen["poses"], pair,
        np.full((2, GRASPS), UNKNOWN, np.int8), *(np.full((GRASPS, GRASPS), UNKNOWN, np.int8) for _ in range(3)),
    )  # fmt: skip
