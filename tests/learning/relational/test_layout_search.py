"""The layout search: a table whose legs fit everywhere alone, and groups that have no layout."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from roboassembly.learning.relational.layout_search import Layout, LayoutProblem, find_layout

_UP = np.eye(3)
_DOWN = np.diag([1.0, -1.0, -1.0])
SURE, UNLIKELY = 0.01, 5.0


def frames_problem(wide: float = 0.4) -> LayoutProblem:
    """Return two posts, 0.4 m apart, a rail of that length and one that is 6 mm longer, which looks better.

    Posts are groups 0 and 1, each with a lower and an upper point; rails are groups 2 and 3, each with two ends.
    """
    outward, inward = _turn([1.0, 0.0, 0.0]), _turn([-1.0, 0.0, 0.0])
    points = [
        (0, [0.0, 0.0, 0.1], outward), (0, [0.0, 0.0, 0.5], outward), (1, [0.0, 0.0, 0.1], inward),
        (1, [0.0, 0.0, 0.5], inward), (2, [0.0, 0.0, 0.0], inward), (2, [wide, 0.0, 0.0], outward),
        (3, [0.0, 0.0, 0.0], inward), (3, [0.406, 0.0, 0.0], outward),
    ]  # fmt: skip
    group = np.array([g for g, _, _ in points])
    cost = np.full((8, 8), UNLIKELY)
    for post in range(4):
        for end in range(4, 8):
            right_side = (post < 2) == (end % 2 == 0)
            cost[post, end] = cost[end, post] = (0.2 if end < 6 else 0.1) if right_side else UNLIKELY
    cost[group[:, None] == group] = np.inf
    frame = np.array([f for _, _, f in points])
    return LayoutProblem(group, np.array([p for _, p, _ in points]), frame, cost, (0, 1, 2, 3))


def _turn(normal: list[float]) -> Float[np.ndarray, "3 3"]:
    """Frame of a point with this normal and the tangent z."""
    n, t = np.array(normal), np.array([0.0, 0.0, 1.0])
    return np.stack([t, np.cross(n, t), n], axis=1)


def test_two_rails_of_one_length_leave_no_point_alone() -> None:
    problem = frames_problem()
    layout = find_layout(problem)
    assert layout is not None
    assert layout.alone <= 1
    ends = [pair for pair in layout.mates if 4 in pair or 5 in pair]
    assert len(ends) == 2


def test_mates_of_a_layout_meet() -> None:
    problem = frames_problem()
    layout = find_layout(problem)
    assert layout is not None
    for k, l in layout.mates:
        at = [
            layout.rotation[problem.group[i]] @ problem.position[i] + layout.translation[problem.group[i]]
            for i in (k, l)
        ]
        assert np.linalg.norm(at[0] - at[1]) < 0.0051
        normals = [layout.rotation[problem.group[i]] @ problem.frame[i, :, 2] for i in (k, l)]
        assert normals[0] @ normals[1] < -0.99


def legs_problem(legs: int, places: int) -> LayoutProblem:
    """Return a top with some places along a line, and equal legs."""
    group = np.array([0] * places + list(range(1, legs + 1)))
    position = np.array([[0.1 * i, 0.0, 0.0] for i in range(places)] + [[0.0, 0.0, 0.4]] * legs)
    frame = np.array([_DOWN] * places + [_UP] * legs)
    cost = np.full((places + legs, places + legs), np.inf)
    cost[:places, places:] = cost[places:, :places] = SURE
    return LayoutProblem(group, position, frame, cost, (0, *[1] * legs))


def test_equal_legs_are_tried_once() -> None:
    """Four equal legs have 24 layouts that are alike; the first one is found without a detour."""
    layout = find_layout(legs_problem(4, 4), max_states=5)
    assert layout is not None
    assert sorted(layout.mates) == [(i, i + 4) for i in range(4)]
    assert (layout.alone, layout.placed_by) == (0, frozenset((i, i + 4) for i in range(4)))
    np.testing.assert_allclose(layout.cost, 4 * SURE)


def test_no_layout_leaves_many_points_alone() -> None:
    assert find_layout(legs_problem(2, 9)) is None


def test_the_same_problem_has_the_same_layout() -> None:
    first, second = find_layout(frames_problem()), find_layout(frames_problem())
    assert isinstance(first, Layout)
    assert first.mates == second.mates
