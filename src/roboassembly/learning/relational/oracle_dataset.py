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

import numpy as np
from jaxtyping import Float32, UInt8

from roboassembly.envs.observation import Observer
from roboassembly.furniture.model import MAX_POINTS, Furniture
from roboassembly.learning.datasets import LabeledState, SampleSet
from roboassembly.learning.relational.policy_view import Situation
from roboassembly.learning.relational.tokens import Memory, Tokens, tokens_of
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.solvers.oracle import LabeledMate, Oracle
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.connections import GRASPS, UP_AXES
from roboassembly.task.rules.groups import TaskState


def tokens_in(samples: SampleSet, sample: LabeledState, memory: Memory | None = None) -> Tokens:
    """Return what the policy sees of a state; of the grippers, too, in the full setting."""
    return tokens_of(situation_of(samples, sample), memory, hands=samples.grasps is not None)


def situation_of(samples: SampleSet, sample: LabeledState) -> Situation:
    """Return what a policy is given of a state."""
    return Situation(
        samples.clouds.astype(float),
        sample.points.astype(float),
        sample.connections.astype(float),
        sample.free,
        sample.group,
        np.zeros((len(samples.clouds), GRASPS, 6)) if samples.grasps is None else samples.grasps.astype(float),
        sample.poses.astype(float),
    )


_DEAD = 0.5
"""Share of states with a way into a dead end where one is looked at."""
_TURNED = 0.02
"""Largest difference of two rotations that count as one."""
Student = Callable[[Tokens], tuple[int, int, int]]
"""Picks the ordered pair of tokens and `w` that it thinks best."""


@dataclass(frozen=True, eq=False)
class Play:
    """What one play from loose parts to the end gave."""

    lessons: tuple[LabeledState, ...]
    """Of each state."""
    dead_ends: tuple[LabeledState, ...]
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
        self.course = SampleSet(
            furniture.name, clouds, (), self._observer.grasp_poses if isinstance(oracle, HandOracle) else None
        )

    def lesson(self, state: TaskState, joints: list[LabeledMate]) -> LabeledState:
        """A state as the policy sees it, with the answers."""
        seen = self._observer.observe(state)
        rows = [(j.u, j.k, j.v, j.l, j.solvable, *j.feasible_w) for j in joints]
        free = self.oracle.task.free_points(state)[: len(seen["poses"])]
        return LabeledState(
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

    def _judge(self, student: Student, lesson: LabeledState, good: list[LabeledMate]) -> LabeledMate | None:
        """The student's choice if it is good."""
        tokens = tokens_in(self.course, lesson)
        row, column, w = student(tokens)
        wanted = (tokens.part[row], tokens.point[row], tokens.part[column], tokens.point[column])
        return next((j for j in good if (j.u, j.k, j.v, j.l) == wanted and j.feasible_w[w]), None)


def answers(tokens: Tokens, lesson: LabeledState) -> tuple[UInt8[np.ndarray, "n n"], UInt8[np.ndarray, "n n 6"]]:
    """Which ordered pairs of tokens are right, and which actions are good."""
    n = len(tokens.part)
    index = np.full(lesson.free.shape, -1)
    index[tokens.part, tokens.point] = np.arange(n)
    right, good = np.zeros((n, n), np.uint8), np.zeros((n, n, len(UP_AXES)), np.uint8)
    u, k, v, l, solvable = lesson.mates[:, :5].T  # noqa: E741
    rows, columns = index[u, k], index[v, l]
    right[rows, columns] = 1
    good[rows, columns] = lesson.mates[:, 5:] * solvable[:, None]
    return right, good
