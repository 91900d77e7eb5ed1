"""Relations between parts: the same wherever the pair is, others where it is another, whichever of their like it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roboassembly.datasets import catalogue
from roboassembly.learning.paper.dqn.memoized_env import FAILS, MERGES, Rehearsal
from roboassembly.learning.paper.dqn.relative_poses import Placed, Relations
from roboassembly.task.object_centric.task import ObjectCentricTask


def square(like: int, at: tuple[float, float, float]) -> Placed:
    """A part with four points, 0.1 m from its centre."""
    center = np.array(at)
    return Placed(like, center, center + 0.1 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float))


def test_moving_both_changes_nothing_and_moving_one_does():
    relations = Relations()
    a, b = square(0, (0, 0, 0)), square(3, (0.5, 0, 0.2))
    number = relations.number(a, b)
    turn, shift = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix(), np.array([1.0, 2.0, 3.0])
    assert relations.number(a.moved(turn, shift), b.moved(turn, shift)) == number
    assert relations.number(b, a) == number
    assert relations.number(a, b.moved(np.eye(3), np.array([0.0, 0.0, 0.01]))) != number
    assert relations.number(a, b.moved(turn, np.zeros(3))) != number
    assert relations.number(square(1, (0, 0, 0)), b) != number


def test_a_part_that_looks_the_same_turned_about_has_the_same_relations():
    relations = Relations()
    a, b = square(0, (0, 0, 0)), square(0, (0.5, 0.1, 0.2))
    quarter = Rotation.from_euler("z", np.pi / 2).as_matrix()
    turned = Placed(0, a.center, (a.points - a.center) @ quarter.T + a.center)
    assert relations.number(turned, b) == relations.number(a, b)


def test_only_what_was_seen_is_not_strange():
    relations = Relations()
    a, b, c = square(0, (0, 0, 0)), square(1, (0.5, 0, 0)), square(2, (0, 0.7, 0))
    relations.see([a, b])
    assert relations.strange(relations.between([a], [b])) == 0
    assert relations.strange(relations.between([a, b], [c])) == 2
    relations.see([a, b, c])
    assert relations.strange(relations.between([a, b], [c])) == 0


@pytest.mark.parametrize("family", ["stool", "plank"])
def test_in_rehearsal_the_first_right_pair_makes_its_like_familiar(family: str):
    """A rung that was joined to one leg is not strange to another; as wrong a pair as before stays strange."""
    rehearsal = Rehearsal(ObjectCentricTask(catalogue.make(family)), 0)
    start = rehearsal.start
    right = None
    for row, column in np.argwhere(np.triu(rehearsal.exists(start))).tolist():
        assert rehearsal.joints.strange(start, row, column) == 1, "nothing was seen yet"
        for w in range(6):
            rehearsal.step(start, (row, column, w))
        if (rehearsal.known(start)[row, column] == MERGES).any():
            right = row, column
            break
    assert right is not None
    assert rehearsal.joints.strange(start, *right) == 0
    for row, column in np.argwhere((rehearsal.known(start) == FAILS).all(axis=2)).tolist():
        assert rehearsal.joints.strange(start, row, column) == 1


def test_an_axis_is_that_of_the_larger_group_s_point():
    task = ObjectCentricTask(catalogue.make("plank"))
    rehearsal = Rehearsal(task, 0)
    for row, column in np.argwhere(np.triu(rehearsal.exists(rehearsal.start))).tolist():
        ends = [(int(rehearsal.part[r]), int(rehearsal.point[r])) for r in (row, column)]
        normals = [
            task.furniture.assembled[p].rotation @ task.furniture.parts[p].points[k].normal
            for p, k in ends
            if k < len(task.furniture.parts[p].points)
        ]
        assert rehearsal.joints.axis(rehearsal.start, row, column) in [int(np.argmax(np.abs(n))) for n in normals]
