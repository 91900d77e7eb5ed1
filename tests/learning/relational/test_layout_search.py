"""The layout search: a table whose legs fit everywhere alone, and groups that have no layout."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from roboassembly.learning.relational.layout_search import BEAM_WIDTH, Layout, LayoutProblem, find_layouts

_UP = np.eye(3)
_DOWN = np.diag([1.0, -1.0, -1.0])
SURE, UNLIKELY = 0.01, 5.0
KNOB_PLACE, KNOB = 2, 9
"""Numbers of the post's point for the knob and of the knob's point."""


def best_layout(problem: LayoutProblem, width: int = BEAM_WIDTH) -> Layout:
    return find_layouts(problem, width)[0]


def frames_problem() -> LayoutProblem:
    """Return two posts, two rails between them, and a knob for the outside of a post, which looks better elsewhere.

    Posts are groups 0 and 1; each has a lower and an upper point for rails, the first one a point for the knob, too.
    Rails are groups 2 and 3, each with two ends; the knob is group 4.
    """
    outward, inward = _turn([1.0, 0.0, 0.0]), _turn([-1.0, 0.0, 0.0])
    points = [
        (0, [0.0, 0.0, 0.1], outward), (0, [0.0, 0.0, 0.5], outward), (0, [-0.02, 0.0, 0.3], inward),
        (1, [0.0, 0.0, 0.1], inward), (1, [0.0, 0.0, 0.5], inward), (2, [0.0, 0.0, 0.0], inward),
        (2, [0.4, 0.0, 0.0], outward), (3, [0.0, 0.0, 0.0], inward), (3, [0.4, 0.0, 0.0], outward),
        (4, [0.0, 0.0, 0.0], inward),
    ]  # fmt: skip
    group = np.array([g for g, _, _ in points])
    cost = np.full((10, 10), np.inf)
    for post in range(5):
        for end in range(5, 10):
            cost[post, end] = cost[end, post] = UNLIKELY if post == KNOB_PLACE else 0.2
    for post, value in ((0, 0.01), (KNOB_PLACE, 0.4)):
        cost[post, KNOB] = cost[KNOB, post] = value
    frame = np.array([f for _, _, f in points])
    return LayoutProblem(group, np.array([p for _, p, _ in points]), frame, cost, (0, 1, 2, 2, 4))


def _turn(normal: list[float]) -> Float[np.ndarray, "3 3"]:
    """Frame of a point with this normal and the tangent z."""
    n, t = np.array(normal), np.array([0.0, 0.0, 1.0])
    return np.stack([t, np.cross(n, t), n], axis=1)


def test_a_pair_that_looks_best_is_left_if_it_leaves_other_points_alone() -> None:
    problem = frames_problem()
    assert problem.cost[KNOB].argmin() == 0
    layout = best_layout(problem)
    assert layout.alone == 0
    assert (KNOB_PLACE, KNOB) in layout.placed_by
    # Both rails reach from the first post to the second.
    posts_of_rail = {
        rail: {int(problem.group[k]) for pair in layout.mates if rail in problem.group[list(pair)] for k in pair}
        for rail in (2, 3)
    }
    assert posts_of_rail == {2: {0, 1, 2}, 3: {0, 1, 3}}


def test_mates_of_a_layout_meet() -> None:
    problem = frames_problem()
    layout = best_layout(problem)
    for k, l in layout.mates:  # noqa: E741
        at = [
            layout.rotation[problem.group[i]] @ problem.position[i] + layout.translation[problem.group[i]]
            for i in (k, l)
        ]
        assert np.linalg.norm(at[0] - at[1]) < 0.0051
        normals = [layout.rotation[problem.group[i]] @ problem.frame[i, :, 2] for i in (k, l)]
        assert normals[0] @ normals[1] < -0.99


def legs_problem(legs: int, places: int, apart: float = 0.1) -> LayoutProblem:
    """Return a top with some places along a line, `apart` metres from each other, and equal legs."""
    group = np.array([0] * places + list(range(1, legs + 1)))
    position = np.array([[apart * i, 0.0, 0.0] for i in range(places)] + [[0.0, 0.0, 0.4]] * legs)
    frame = np.array([_DOWN] * places + [_UP] * legs)
    cost = np.full((places + legs, places + legs), np.inf)
    cost[:places, places:] = cost[places:, :places] = SURE
    return LayoutProblem(group, position, frame, cost, (0, *[1] * legs))


def test_equal_legs_are_tried_once() -> None:
    """Four equal legs have 24 layouts that are alike; the first one is found without a detour."""
    layout = best_layout(legs_problem(4, 4), width=1)
    assert sorted(layout.mates) == [(i, i + 4) for i in range(4)]
    assert (layout.alone, layout.placed_by) == (0, frozenset((i, i + 4) for i in range(4)))
    np.testing.assert_allclose(layout.cost, 4 * SURE)


def test_no_layout_leaves_many_points_alone() -> None:
    """Seven of eleven points have no mate."""
    assert find_layouts(legs_problem(2, 9)) == []


def test_points_may_be_left_alone_if_the_mates_are_beyond_doubt() -> None:
    """Three legs fit a top with four places; which place stays empty is open."""
    layouts = find_layouts(legs_problem(3, 4))
    assert {layout.alone for layout in layouts} == {1}
    assert len({frozenset(k for k, _ in layout.mates) for layout in layouts}) == len(layouts) == 4
    doubtful = legs_problem(3, 4)
    doubtful.cost[np.isfinite(doubtful.cost)] = 1.1
    assert find_layouts(doubtful) == []


def test_layouts_of_nearly_equal_cost_are_all_returned() -> None:
    """A leg fits either of two places; one that costs much more is not worth a layout."""
    for more, count in ((0.3, 2), (0.7, 1)):
        problem = legs_problem(1, 2)
        problem.cost[1, 2] = problem.cost[2, 1] = SURE + more
        layouts = find_layouts(problem)
        assert [layout.mates for layout in layouts] == [((0, 2),), ((1, 2),)][:count]
        np.testing.assert_allclose([layout.doubt for layout in layouts], [SURE, SURE + more][:count])


def test_two_places_may_lie_closer_together_than_points_that_meet() -> None:
    """Each of two legs meets both places 3 mm apart, and mates with its own."""
    layout = best_layout(legs_problem(2, 2, apart=0.003))
    assert sorted(layout.mates) == [(0, 2), (1, 3)]
    assert layout.alone == 0


def test_points_left_alone_count_in_a_complete_layout() -> None:
    """A comb that looks a little better one tooth beside its place leaves a tooth and a hole alone there."""
    teeth = 10
    line = np.stack([0.1 * np.arange(teeth), np.zeros(teeth), np.zeros(teeth)], axis=1)
    frame = np.array([_DOWN] * teeth + [_UP] * teeth)
    cost = np.full((2 * teeth, 2 * teeth), np.inf)
    cost[:teeth, teeth:] = UNLIKELY
    cost[np.arange(1, teeth), teeth + np.arange(1, teeth)] = 0.1
    cost[np.arange(1, teeth), teeth + np.arange(teeth - 1)] = SURE
    cost = np.minimum(cost, cost.T)
    layout = best_layout(LayoutProblem(np.repeat([0, 1], teeth), np.tile(line, (2, 1)), frame, cost, (0, 1)))
    assert sorted(layout.mates) == [(i, i + teeth) for i in range(teeth)]


def test_the_same_problem_has_the_same_layout() -> None:
    first, second = find_layouts(frames_problem()), find_layouts(frames_problem())
    assert first
    assert [layout.mates for layout in first] == [layout.mates for layout in second]
