"""Relations between parts: the same wherever the pair is, others where it is another, whichever of their like it is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roboassembly.datasets import catalogue
from roboassembly.learning.paper.dqn.memoized_env import MemoizedEnv
from roboassembly.learning.paper.dqn.relative_poses import PlacedPart, RelativePoses
from roboassembly.solvers.mate_checks import FAILS, MERGES
from roboassembly.task.object_centric.task import ObjectCentricTask


def square(part_class: int, at: tuple[float, float, float]) -> PlacedPart:
    """A part with four points, 0.1 m from its centre."""
    center = np.array(at)
    return PlacedPart(
        part_class, center, center + 0.1 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)
    )


def test_relations_depend_on_relative_poses_only():
    relative = RelativePoses()
    a, b = square(0, (0, 0, 0)), square(3, (0.5, 0, 0.2))
    number = relative.number(a, b)
    turn, shift = Rotation.from_euler("xyz", [0.3, -1.0, 2.0]).as_matrix(), np.array([1.0, 2.0, 3.0])
    assert relative.number(a.moved(turn, shift), b.moved(turn, shift)) == number
    assert relative.number(b, a) == number
    assert relative.number(a, b.moved(np.eye(3), np.array([0.0, 0.0, 0.01]))) != number
    assert relative.number(a, b.moved(turn, np.zeros(3))) != number
    assert relative.number(square(1, (0, 0, 0)), b) != number


def test_a_part_that_looks_the_same_turned_about_has_the_same_relations():
    relative = RelativePoses()
    a, b = square(0, (0, 0, 0)), square(0, (0.5, 0.1, 0.2))
    quarter = Rotation.from_euler("z", np.pi / 2).as_matrix()
    turned = PlacedPart(0, a.center, (a.points - a.center) @ quarter.T + a.center)
    assert relative.number(turned, b) == relative.number(a, b)


def test_only_seen_relations_are_known():
    relative = RelativePoses()
    a, b, c = square(0, (0, 0, 0)), square(1, (0.5, 0, 0)), square(2, (0, 0.7, 0))
    relative.see([a, b])
    assert relative.novel_count(relative.between([a], [b])) == 0
    assert relative.novel_count(relative.between([a, b], [c])) == 2
    relative.see([a, b, c])
    assert relative.novel_count(relative.between([a, b], [c])) == 0


@pytest.mark.parametrize("family", ["stool", "plank"])
def test_first_right_pair_makes_equal_pairs_known(family: str):
    """A rung that was joined to one leg is not strange to another; as wrong a pair as before stays strange."""
    env = MemoizedEnv(ObjectCentricTask(catalogue.make(family)), 0)
    start = env.start
    right = None
    for row, column in np.argwhere(np.triu(env.exists(start))).tolist():
        assert env.geometry.novelty(start, np.array([[row, column]])) == [1], "nothing was seen yet"
        for w in range(6):
            env.step(start, (row, column, w))
        if (env.known(start)[row, column] == MERGES).any():
            right = row, column
            break
    assert right is not None
    assert env.geometry.novelty(start, np.array([right])) == [0]
    for row, column in np.argwhere((env.known(start) == FAILS).all(axis=2)).tolist():
        assert env.geometry.novelty(start, np.array([[row, column]])) == [1]


def test_an_axis_is_that_of_the_larger_group_s_point():
    task = ObjectCentricTask(catalogue.make("plank"))
    env = MemoizedEnv(task, 0)
    for row, column in np.argwhere(np.triu(env.exists(env.start))).tolist():
        ends = [(int(env.part[r]), int(env.point[r])) for r in (row, column)]
        normals = [
            task.furniture.assembled[p].rotation @ task.furniture.parts[p].points[k].normal
            for p, k in ends
            if k < len(task.furniture.parts[p].points)
        ]
        assert env.geometry.axis(env.start, row, column) in [int(np.argmax(np.abs(n))) for n in normals]
