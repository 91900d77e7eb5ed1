"""Quick queries between solids give what the slow ones give, and results are kept for the same solids only."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import pytest

from roboassembly.geometry.meshes import all_within, distance_to, distances_to
from roboassembly.repair.cached import cached, forget
from roboassembly.repair.edges import numbered
from roboassembly.repair.proximity import Shell, shell_of

BALL = m3.Manifold.sphere(0.1, 48)


def shifted(gap: float) -> Shell:
    """Return a cube whose face is `gap` metres from the ball."""
    return shell_of(m3.Manifold.cube((0.2, 0.2, 0.2), True).translate((0.2 + gap, 0.0, 0.0)))


@pytest.mark.parametrize("gap", [-0.01, 0.0001, 0.0004, 0.00049, 0.00051, 0.004, 0.3])
@pytest.mark.parametrize("margin", [0.0001, 0.0005, 0.005])
def test_within_is_nearest_below_the_margin(gap: float, margin: float) -> None:
    ball, cube = shell_of(BALL), shifted(gap)
    assert ball.is_within(cube, margin) == (ball.nearest(cube)[0] < margin) == (gap < margin)
    assert cube.is_within(ball, margin) == ball.is_within(cube, margin)


@pytest.mark.parametrize("margin", [0.0005, 0.003, 0.02])
def test_near_triangles_are_those_of_all_near_pairs(margin: float) -> None:
    ball, cube = shell_of(BALL.rotate((10.0, 20.0, 30.0))), shifted(0.0002)
    near = ball.triangles_near(cube, margin)
    assert 0 < len(near) < len(ball.surface.faces)
    assert near.tolist() == np.unique(ball.pairs_near(cube, margin)[:, 0]).tolist()


def test_no_triangle_is_near_a_far_solid() -> None:
    assert not len(shell_of(BALL).triangles_near(shifted(0.1), 0.01))


def test_distances_of_many_points_are_those_of_each() -> None:
    model = shell_of(BALL).model
    points = np.random.default_rng(0).normal(scale=0.1, size=(50, 3))
    each = [distance_to(model, point) for point in points]
    assert distances_to(model, points).tolist() == each
    assert all_within(model, points, max(each))
    assert not all_within(model, points, 0.999 * max(each))


def test_result_is_kept_for_the_same_solid_until_forgotten() -> None:
    asked: list[m3.Manifold] = []

    @cached
    def volume(body: m3.Manifold) -> float:
        asked.append(body)
        return body.volume()

    cube, equal = m3.Manifold.cube(), m3.Manifold.cube()
    assert volume(cube) == volume(cube) == volume(equal) == 1.0
    assert asked == [cube, equal]
    forget()
    assert volume(cube) == 1.0
    assert asked == [cube, equal, cube]


def test_rows_with_the_same_vertices_have_one_number() -> None:
    rows = np.array([[5, 2, 9], [1, 0, 7], [9, 5, 2], [0, 1, 8], [7, 1, 0], [2, 9, 5]])
    number, count = numbered(rows)
    assert number.tolist() == [2, 0, 2, 1, 0, 2]
    assert count.tolist() == [2, 1, 3]
