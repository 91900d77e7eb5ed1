"""Contact patches against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from roboassembly.errors import FurnitureError
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.geometry.meshes import Mesh


def contact(a: Mesh, b: Mesh) -> Contact:
    (found,) = find_contacts([a, b], ["a", "b"])
    return found


def test_faces_with_partial_overlap() -> None:
    lower = shapes.box((0, 0, 0), (0.2, 0.2, 0.1))
    upper = shapes.box((0.15, 0.1, 0.101), (0.4, 0.5, 0.3))
    found = contact(lower, upper)
    # They overlap over 0.15 .. 0.2 by 0.1 .. 0.2, and lie 1 mm apart.
    assert found.area == pytest.approx(0.05 * 0.1, rel=1e-4)
    assert np.allclose(found.center, [0.175, 0.15, 0.1005], atol=1e-6)
    assert np.allclose(found.normal, [0, 0, 1], atol=1e-6)
    assert found.gap == pytest.approx(0.001, abs=1e-7)


def test_two_feet_of_one_part_share_a_patch_between_them() -> None:
    board = shapes.box((-0.5, -0.5, -0.1), (0.5, 0.5, 0.0))
    bridge = shapes.of_solid(
        shapes.block((-0.2, -0.1, 0.0005), (-0.1, 0.1, 0.2))
        + shapes.block((-0.2, -0.1, 0.1), (0.3, 0.1, 0.2))
        + shapes.block((0.1, -0.1, 0.0005), (0.3, 0.1, 0.2))
    )
    found = contact(board, bridge)
    # Feet of 0.1 x 0.2 at x = -0.15 and of 0.2 x 0.2 at x = 0.2.
    assert found.area == pytest.approx(0.06, rel=1e-4)
    assert found.center[0] == pytest.approx((-0.15 * 0.02 + 0.2 * 0.04) / 0.06, abs=1e-6)
    assert np.allclose(found.normal, [0, 0, 1], atol=1e-6)


def test_faces_deeper_than_the_patch_do_not_count() -> None:
    board = shapes.box((-0.5, -0.5, -0.1), (0.5, 0.5, 0.0))
    stair = shapes.of_solid(
        shapes.block((0, 0, 0.0005), (0.1, 0.1, 0.2)) + shapes.block((0.1, 0, 0.003), (0.4, 0.1, 0.2))
    )
    found = contact(board, stair)
    # The lower step is 0.5 mm away; the higher one, at 3 mm, is not the contact though it is nearer than 5 mm.
    assert found.area == pytest.approx(0.01, rel=1e-4)
    assert np.allclose(found.center[:2], [0.05, 0.05], atol=1e-6)
    assert found.gap == pytest.approx(0.0005, abs=1e-7)


def test_edge_over_a_face() -> None:
    board = shapes.box((-0.5, -0.5, -0.1), (0.5, 0.5, 0.0))
    # A blade along y with an edge of 60 degrees: no face is opposed, and the nearest points are what there is.
    outline = [(0.0, 0.002), (0.05, 0.002 + 0.05 * np.sqrt(3)), (-0.05, 0.002 + 0.05 * np.sqrt(3))]
    corners = [(0.1 + x, y, z) for y in (-0.1, 0.1) for x, z in outline]
    faces = [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 3], [2, 3, 0]]
    roof = Mesh(np.array(corners), np.array(faces))
    assert roof.is_solid
    found = contact(board, roof)
    assert np.allclose(found.normal, [0, 0, 1], atol=1e-5)
    assert found.gap == pytest.approx(0.002, abs=1e-5)
    assert found.area == 0.0
    assert found.center[0] == pytest.approx(0.1, abs=1e-6)
    assert found.center[2] == pytest.approx(0.001, abs=1e-6)
    assert abs(found.center[1]) <= 0.1 + 1e-6


def test_corner_to_corner() -> None:
    a = shapes.box((0, 0, 0), (0.1, 0.1, 0.1))
    b = shapes.box((0.101, 0.101, 0.101), (0.2, 0.2, 0.2))
    found = contact(a, b)
    assert found.area == 0.0
    assert np.allclose(found.normal, np.ones(3) / np.sqrt(3), atol=1e-4)
    assert found.gap == pytest.approx(0.001 * np.sqrt(3), rel=1e-3)
    assert np.allclose(found.center, 0.1005, atol=1e-5)


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_peg_in_a_blind_hole_points_along_the_axis(tilt: float) -> None:
    c = 0.0005
    board = shapes.block((-0.1, -0.1, 0.0), (0.1, 0.1, 0.05)) - shapes.block(
        (-0.01 - c, -0.01 - c, 0.02), (0.01 + c, 0.01 + c, 1)
    )
    peg = shapes.block((-0.01, -0.01, 0.02 + c), (0.01, 0.01, 0.4))
    pose = shapes.pose(0.3, 0.2, 0.1, shapes.turn((1, 2, 0), tilt))
    found = contact(shapes.of_solid(board).transformed(pose), shapes.of_solid(peg).transformed(pose))
    assert np.allclose(found.normal, pose.rotation[:, 2], atol=1e-3)
    assert found.gap == pytest.approx(c, abs=1e-5)
    # On the axis: four walls of 0.02 x 0.03 around it and the bottom of 0.02 x 0.02.
    local = pose.actInv(found.center)
    assert np.allclose(local[:2], 0, atol=1e-4)
    assert found.area == pytest.approx(4 * 0.02 * 0.03 + 0.02 * 0.02, rel=0.03)
    bottom, walls = 0.0004, 0.0024
    assert local[2] == pytest.approx((bottom * (0.02 + c / 2) + walls * (0.035 + c / 2)) / (bottom + walls), abs=5e-4)


@pytest.mark.parametrize(("apart", "count"), [(0.0002, 1), (0.0049, 1), (0.0051, 0), (0.1, 0)])
def test_five_millimetres_are_the_limit(apart: float, count: int) -> None:
    a, b = shapes.box((0, 0, 0), (0.1, 0.1, 0.1)), shapes.box((0.1 + apart, 0, 0), (0.3, 0.1, 0.1))
    assert len(find_contacts([a, b], ["a", "b"])) == count


def test_diagonal_distance_counts_and_not_the_boxes() -> None:
    # 4 mm along each axis: the boxes' gap is below 5 mm on each, the corner is 6.9 mm away.
    a, b = shapes.box((0, 0, 0), (0.1, 0.1, 0.1)), shapes.box((0.104, 0.104, 0.104), (0.2, 0.2, 0.2))
    assert find_contacts([a, b], ["a", "b"]) == ()


@pytest.mark.parametrize("depth", [0.0, 0.001, 0.05])
def test_touching_and_penetrating_parts_are_refused(depth: float) -> None:
    a, b = shapes.box((0, 0, 0), (0.1, 0.1, 0.1)), shapes.box((0.1 - depth, 0.02, 0.02), (0.3, 0.08, 0.08))
    with pytest.raises(FurnitureError, match=r"'seat' and 'leg' touch or penetrate.*0\.1 mm"):
        find_contacts([a, b], ["seat", "leg"])


@pytest.mark.parametrize("gap", [0.002, 0.02])
def test_a_part_wholly_inside_another_is_refused(gap: float) -> None:
    outer = shapes.brick(0.1, 0.1, 0.1)
    inner = shapes.brick(0.1 - 2 * gap, 0.1 - 2 * gap, 0.1 - 2 * gap)
    for pair in ([outer, inner], [inner, outer]):
        with pytest.raises(FurnitureError, match="lies inside part"):
            find_contacts(pair, ["seat", "leg"])


def test_a_part_inside_a_hollow_one_is_fine() -> None:
    hollow = shapes.block((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)) - shapes.block((-0.08, -0.08, -0.08), (0.08, 0.08, 0.08))
    inner = shapes.brick(0.159, 0.159, 0.159)
    found = contact(shapes.of_solid(hollow), inner)
    assert found.gap == pytest.approx(0.0005, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_order_of_the_two_parts_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.2, size=3)
    other = rng.uniform(0.02, 0.2, size=3)
    shift = rng.uniform(-0.5, 0.5, size=3) * (size + other) * 0.6
    shift[2] = (size[2] + other[2]) / 2 + rng.uniform(0.0003, 0.004)
    pose = shapes.random_pose(rng, 1.0)
    a = shapes.brick(*size).transformed(pose)
    b = shapes.brick(*other).transformed(pose * shapes.pose(*shift))
    one, two = contact(a, b), contact(b, a)
    assert np.allclose(one.normal, -two.normal, atol=1e-4)
    assert np.allclose(one.center, two.center, atol=1e-5)
    assert one.gap == pytest.approx(two.gap, abs=1e-6)
    assert one.area == pytest.approx(two.area, rel=1e-4)
    # Overlap of two rectangles, by hand.
    overlap = np.minimum(size / 2, shift + other / 2) - np.maximum(-size / 2, shift - other / 2)
    assert one.area == pytest.approx(overlap[0] * overlap[1], rel=1e-3)
    assert np.allclose(one.normal, pose.rotation[:, 2], atol=1e-4)


def test_triangulation_does_not_matter() -> None:
    a, b = shapes.box((0, 0, 0), (0.2, 0.2, 0.1)), shapes.box((0.05, 0.1, 0.1005), (0.4, 0.5, 0.3))
    fine = a.trimesh.subdivide().subdivide()
    one, two = contact(a, b), contact(Mesh.from_trimesh(fine), b)
    assert two.area == pytest.approx(one.area, rel=1e-4)
    assert np.allclose(two.center, one.center, atol=1e-6)


def _tenon_in_bent_board(tilt: float) -> tuple[Mesh, Mesh]:
    """A tenon deep in a board whose mouth is cut at an angle, so that its two walls have different areas."""
    tongue = shapes.block((-0.02, -0.006, -0.05), (0.02, 0.006, 0.06))
    board = shapes.block((-0.1, -0.03, 0.0), (0.1, 0.03, 0.2)) - shapes.block(
        (-0.0204, -0.0064, -0.1), (0.0204, 0.0064, 0.0604)
    )
    board = board - shapes.block((-0.2, -0.2, -0.2), (0.2, 0.2, 0.0)).rotate((tilt, 0, 0)).translate((0, 0, 0.01))
    return shapes.of_solid(tongue), shapes.of_solid(board)


@pytest.mark.parametrize("tilt", [0.0, 5.0, 12.0])
def test_a_deep_tenon_points_along_its_walls(tilt: float) -> None:
    found = contact(*_tenon_in_bent_board(tilt))
    assert np.allclose(found.normal, [0, 0, 1], atol=1e-6)


def test_a_contact_does_not_depend_on_which_part_comes_first() -> None:
    for a, b in (
        _tenon_in_bent_board(15.0),
        (shapes.prism(9, 0.05, 0.2), shapes.box((0.0, 0.0, 0.1005), (0.3, 0.2, 0.3))),
    ):
        one, other = contact(a, b), contact(b, a)
        assert np.allclose(one.center, other.center, atol=1e-12)
        assert np.allclose(one.normal, -other.normal, atol=1e-12)
        assert one.gap == pytest.approx(other.gap, abs=1e-12)
        assert one.area == pytest.approx(other.area, rel=1e-12)
