"""What the multi-task policy is taught: states of many chairs, with the exact worth of every action in them.

Worth is the oracle's: 1 where the furniture can still be finished after the action, 0 where the pair is wrong, cannot
be joined, or leads into a dead end.

States come from plays that never leave the path on which the furniture can be finished: with nobody to learn from yet
the moves are drawn at random among the good ones; later the student moves as long as it is right, and its mistakes
become lessons (DAgger, Ross et al. 2011, "A Reduction of Imitation Learning and Structured Prediction").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float16, Float32, Int16, UInt8

from roboassembly.envs.observation import Observer
from roboassembly.furniture.model import MAX_POINTS, Furniture
from roboassembly.learning import archive
from roboassembly.learning.relational.policy_view import Situation, groups_of
from roboassembly.learning.relational.tokens import Memory, Tokens, tokens_of
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import LabeledMate, Oracle
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import GRASPS, UP_AXES
from roboassembly.task.rules.groups import TaskState

CLOUD_POINTS = 2048
"""A part, as the relational policy sees it: fine enough to show tenons and holes."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """One state of one chair, and its right pairs."""

    points: Float32[np.ndarray, "P K 9"]
    connections: Float32[np.ndarray, "P P 6"]
    free: Bool[np.ndarray, "P K"]
    poses: Float32[np.ndarray, "P 6"]
    """World pose of each part, as in the observation."""
    joints: Int16[np.ndarray, "j 11"]
    """Ordered right pairs: u, k, v, l, whether the furniture can be finished after it, and the six ways."""
    values: Float16[np.ndarray, "n n w"] | None = None
    """An expert's Q-values over free points in the order of parts and points, not limited to what can be had, nor to
    actions that exist: of each `w`, or what each `g_a` and then what each `g_b` adds. None where the oracle taught."""

    @property
    def group(self) -> np.ndarray:
        """Each part's group, named by its first part."""
        return groups_of(self.connections)


@dataclass(frozen=True, eq=False)
class Course:
    """The lessons of one chair."""

    name: str
    clouds: Float32[np.ndarray, "P C 3"]
    lessons: tuple[Lesson, ...]
    hands: Float32[np.ndarray, "P 8 6"] | None = None
    """The hand at each grasp, as in the observation; None in the object-centric setting."""

    def tokens(self, lesson: Lesson, memory: Memory | None = None) -> Tokens:
        """What the policy sees of a state, as `tokens_of` tells it; of hands, too, where there are some."""
        return tokens_of(self.situation(lesson), memory, hands=self.hands is not None)

    def situation(self, lesson: Lesson) -> Situation:
        """What a policy is told of a state."""
        return Situation(
            self.clouds.astype(float),
            lesson.points.astype(float),
            lesson.connections.astype(float),
            lesson.free,
            lesson.group,
            np.zeros((len(self.clouds), GRASPS, 6)) if self.hands is None else self.hands.astype(float),
            lesson.poses.astype(float),
        )

    def save(self, path: Path) -> None:
        """Write as npz, whole or not at all; clouds are rounded to half a millimetre."""
        count = len(self.lessons)
        joints = [lesson.joints for lesson in self.lessons]
        values = [lesson.values.ravel() for lesson in self.lessons if lesson.values is not None]
        arrays = {
            "name": np.array(self.name),
            "clouds": self.clouds.astype(np.float16),
            "hands": np.zeros((0, GRASPS, 6), np.float32) if self.hands is None else self.hands,
            "points": np.array([lesson.points for lesson in self.lessons]),
            "connections": np.array([lesson.connections for lesson in self.lessons]),
            "free": np.array([lesson.free for lesson in self.lessons]),
            "poses": np.array([lesson.poses for lesson in self.lessons]),
            "valued": np.array([lesson.values is not None for lesson in self.lessons], bool),
            "values": np.concatenate(values) if values else np.zeros(0, np.float16),
            "choices": np.array(max((x.values.shape[2] for x in self.lessons if x.values is not None), default=0)),
            "joints": np.concatenate(joints) if count else np.zeros((0, 11), np.int16),
            "state": np.repeat(np.arange(count), [len(j) for j in joints]),
        }
        archive.write(path, arrays)

    @staticmethod
    def load(path: Path) -> Course:
        """Read what `save` wrote.

        Raises:
            InputError: the file is broken.
        """
        with archive.reading(path, "a course of lessons", "remove it and build it again") as z:
            joints, state = z["joints"], z["state"]
            points, connections, free, poses = z["points"], z["connections"], z["free"], z["poses"]
            shapes = [(n, n, int(z["choices"])) for n in free.sum(axis=(1, 2)) * z["valued"]] if len(free) else []
            ends = np.cumsum([np.prod(shape) for shape in shapes], dtype=int)
            values = [v.reshape(s) for v, s in zip(np.split(z["values"], ends)[:-1], shapes, strict=True)]
            lessons = tuple(
                Lesson(
                    points[i], connections[i], free[i], poses[i], joints[state == i],
                    values[i] if z["valued"][i] else None,
                )
                for i in range(len(points))
            )  # fmt: skip
            hands = z["hands"] if len(z["hands"]) else None
            return Course(str(z["name"]), z["clouds"].astype(np.float32), lessons, hands)


_DEAD = 0.5
"""Share of states with a way into a dead end where one is looked at."""
_TURNED = 0.02
"""Largest difference of two rotations that count as one."""
Student = Callable[[Tokens], tuple[int, int, int]]
"""Picks the ordered pair of tokens and `w` that it thinks best."""


@dataclass(frozen=True, eq=False)
class Play:
    """What one play from loose parts to the end gave."""

    lessons: tuple[Lesson, ...]
    """Of each state."""
    dead_ends: tuple[Lesson, ...]
    """Of some states next to those, from which the furniture cannot be finished."""
    mistakes: int
    """Choices of the student that were not good."""


def _after(state: TaskState, joint: LabeledMate) -> TaskState:
    """What is left to be joined."""
    u_group, v_group = state.groups[state.group_of[joint.u]], state.groups[state.group_of[joint.v]]
    rest = (g for g in state.groups if g is not u_group and g is not v_group)
    return TaskState((*rest, joint.merge.merged))


class Teacher:
    """Knows one chair by heart and examines plays of it.

    Args:
        furniture: the chair.
        clouds: of its parts, as the policy sees them.
        oracle: of the setting that is taught; the object-centric one if not given.
    """

    def __init__(
        self, furniture: Furniture, clouds: Float32[np.ndarray, "P C 3"], oracle: Oracle | None = None
    ) -> None:
        self.oracle = oracle or Oracle(ObjectCentricTask(furniture))
        self._alone = {c.members[0] for c in furniture.classes if len(c.members) == 1}
        self._observer = Observer(furniture, len(furniture.parts), MAX_POINTS, 1)
        self.course = Course(
            furniture.name, clouds, (), self._observer.grasp_poses if isinstance(oracle, HandOracle) else None
        )

    def lesson(self, state: TaskState, joints: list[LabeledMate]) -> Lesson:
        """A state as the policy sees it, with the answers."""
        seen = self._observer.observe(state)
        rows = [(j.u, j.k, j.v, j.l, j.solvable, *j.feasible_w) for j in joints]
        free = self.oracle.task.free_points(state)[: len(seen["poses"])]
        return Lesson(
            seen["connection_points"],
            seen["connections"],
            free,
            seen["poses"],
            np.array(rows, np.int16).reshape(-1, 5 + len(UP_AXES)),
        )

    def play(self, rng: np.random.Generator, student: Student | None = None) -> Play:
        """One play from loose parts to the end.

        Args:
            rng: draws among good moves where there is no student or it errs.
            student: moves as long as it is right.
        """
        task = self.oracle.task
        state, lessons, ends, mistakes = task.initial_state(rng), [], [], 0
        before: list[tuple[TaskState, list[LabeledMate], LabeledMate]] = []
        while not state.complete:
            joints = self.oracle.mates(state)
            good = self._upright([j for j in joints if j.viable])
            if not good:
                # Equal parts whose points differ: slots alone do not tell that this cannot go on. Take it back.
                if not before:
                    break
                state, joints, joint = before.pop()
                lessons.pop()
                joints = [replace(j, solvable=False) if j is joint else j for j in joints]
                good = self._upright([j for j in joints if j.viable])
                if not good:
                    break
                lessons.append(self.lesson(state, joints))
                joint = good[rng.integers(len(good))]
            else:
                lessons.append(self.lesson(state, joints))
                joint = self._judge(student, lessons[-1], good) if student is not None else None
                mistakes += student is not None and joint is None
                joint = joint or good[rng.integers(len(good))]
            before.append((state, joints, joint))
            dead = [j for j in self._upright(joints) if any(j.feasible_w) and not j.solvable]
            if dead and rng.random() < _DEAD:
                end = _after(state, dead[rng.integers(len(dead))])
                ends.append(self.lesson(end, [replace(j, solvable=False) for j in self.oracle.mates(end)]))
            state = _after(state, joint)
        return Play(tuple(lessons), tuple(ends), mistakes)

    def _upright(self, joints: list[LabeledMate]) -> list[LabeledMate]:
        """Those that leave parts without a like of their own standing as delivered, if there are any.

        A symmetric part may be turned as well, but one who sees from the parts' frames how the furniture stands has no
        reason to.
        """

        def turned(joint: LabeledMate) -> bool:
            merged = joint.merge.merged
            alone = [
                r.rotation for p, r in zip(merged.parts, merged.furniture_from_part, strict=True) if p in self._alone
            ]
            return any(np.abs(r - alone[0]).max() > _TURNED for r in alone[1:])

        return [j for j in joints if not turned(j)] or joints

    def _judge(self, student: Student, lesson: Lesson, good: list[LabeledMate]) -> LabeledMate | None:
        """The student's choice if it is good."""
        tokens = self.course.tokens(lesson)
        row, column, w = student(tokens)
        wanted = (tokens.part[row], tokens.point[row], tokens.part[column], tokens.point[column])
        return next((j for j in good if (j.u, j.k, j.v, j.l) == wanted and j.feasible_w[w]), None)


def answers(tokens: Tokens, lesson: Lesson) -> tuple[UInt8[np.ndarray, "n n"], UInt8[np.ndarray, "n n 6"]]:
    """Which ordered pairs of tokens are right, and which actions are good."""
    n = len(tokens.part)
    index = np.full(lesson.free.shape, -1)
    index[tokens.part, tokens.point] = np.arange(n)
    right, good = np.zeros((n, n), np.uint8), np.zeros((n, n, len(UP_AXES)), np.uint8)
    u, k, v, l, solvable = lesson.joints[:, :5].T  # noqa: E741
    rows, columns = index[u, k], index[v, l]
    right[rows, columns] = 1
    good[rows, columns] = lesson.joints[:, 5:] * solvable[:, None]
    return right, good
