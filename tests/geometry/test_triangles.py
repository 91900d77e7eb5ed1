"""Areas, volumes and winding numbers of triangles, against numbers worked out by hand."""

import numpy as np
import pytest

from roboassembly.geometry.triangles import areas, scaled_normals, triple_products, unit_normals, winding_number

_TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
_CORNERS = _TETRAHEDRON[_FACES]


def test_normals_point_outward_and_are_as_long_as_twice_the_area():
    assert np.array_equal(scaled_normals(_CORNERS), [[0, 0, -2], [0, -3, 0], [-6, 0, 0], [6, 3, 2]])
    assert np.allclose(areas(_CORNERS), [1.0, 1.5, 3.0, 3.5])


def test_unit_normals_of_triangles_with_and_without_area():
    corners = np.array([*_CORNERS, np.outer([1.0, 2.0, 3.0], [1.0, 1.0, 0.0])])
    normals, area = unit_normals(corners)
    expected = [[0, 0, -1], [0, -1, 0], [-1, 0, 0], np.array([6, 3, 2]) / 7.0, [0, 0, 0]]
    assert np.allclose(normals, expected)
    assert np.allclose(area, [1.0, 1.5, 3.0, 3.5, 0.0])


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (4.0, -5.0, 6.0)])
def test_triple_products_add_up_to_six_times_the_volume_wherever_the_origin_is(shift):
    assert triple_products(_CORNERS + shift).sum() == pytest.approx(6.0)
    assert triple_products(_CORNERS[:, ::-1] + shift).sum() == pytest.approx(-6.0)


def test_surface_winds_once_around_points_inside_and_not_around_those_outside():
    inside, outside = np.array([0.2, 0.2, 0.2]), np.array([0.6, 1.2, 1.8])
    assert winding_number(_CORNERS - inside) == pytest.approx(1.0)
    assert winding_number(_CORNERS[:, ::-1] - inside) == pytest.approx(-1.0)
    assert winding_number(_CORNERS - outside) == pytest.approx(0.0, abs=1e-12)


def test_no_triangles_have_no_area_volume_or_winding():
    none = np.zeros((0, 3, 3))
    assert areas(none).sum() == triple_products(none).sum() == winding_number(none) == 0.0
