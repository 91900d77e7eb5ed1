"""Meshes: what is refused, and the mass properties of shapes with formulas."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import shapes
from roboassembly.errors import FurnitureError
from roboassembly.geometry.meshes import Mesh, distance_to, nearest_points
from roboassembly.repair.proximity import Shell
from roboassembly.repair.surface import Surface

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (SQUARE, np.empty((0, 3), int), "no faces"),
        (np.empty((0, 3)), np.empty((0, 3), int), "no faces"),
        (SQUARE[:, :2], TWO, "shapes"),
        (SQUARE, np.array([[0, 1, 2, 3]]), "shapes"),
        (np.where(np.arange(12).reshape(4, 3) == 7, np.nan, SQUARE), TWO, "vertex 2 is not finite"),
        (np.where(np.arange(12).reshape(4, 3) == 3, np.inf, SQUARE), TWO, "vertex 1 is not finite"),
        (SQUARE, np.array([[0, 1, 4]]), "refers to vertex 4, but there are 4"),
        (SQUARE, np.array([[0, 1, -1]]), "refers to vertex -1, but there are 4"),
        (SQUARE, np.array([[0, 1, 1]]), "zero area"),
        (SQUARE * 1e-8, TWO, "zero area"),
    ],
)
def test_bad_meshes_are_refused(vertices: np.ndarray, faces: np.ndarray, message: str) -> None:
    with pytest.raises(FurnitureError, match=message):
        Mesh(vertices, faces)


def test_flat_mesh_has_no_hull() -> None:
    with pytest.raises(FurnitureError, match="flat"):
        _ = Mesh(SQUARE, TWO).hull


def test_box_by_formula() -> None:
    a, b, c = 0.3, 0.2, 0.1
    mesh = shapes.box((1.0, 2.0, 3.0), (1.0 + a, 2.0 + b, 3.0 + c))
    assert mesh.is_solid
    assert mesh.volume == pytest.approx(a * b * c, rel=1e-6)
    assert np.allclose(mesh.center_of_mass, [1.15, 2.1, 3.05], atol=1e-6)
    expected = a * b * c / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert np.allclose(mesh.inertia, expected, rtol=1e-4, atol=1e-9)
    assert np.allclose(mesh.bounds, [[1, 2, 3], [1.3, 2.2, 3.1]], atol=1e-6)
    assert mesh.radius == pytest.approx(np.linalg.norm([1.3, 2.2, 3.1]), rel=1e-6)
    assert len(mesh.hull_vertices) == 8


def test_hull_of_an_l_spans_the_notch() -> None:
    solid = shapes.block((0, 0, 0), (1, 1, 1)) - shapes.block((0.5, 0.5, -1), (2, 2, 2))
    mesh = shapes.of_solid(solid)
    assert mesh.volume == pytest.approx(0.75)
    # The hull cuts the notch off along its diagonal: half of the missing quarter comes back.
    assert mesh.hull.volume == pytest.approx(0.875)
    assert mesh.hull.is_watertight
    assert mesh.hull.is_winding_consistent
    corners = {tuple(np.round(v, 6)) for v in mesh.hull_vertices}
    assert (0.5, 0.5, 0.0) not in corners
    assert len(corners) == 10


def test_open_mesh_takes_the_hulls_mass() -> None:
    closed = shapes.brick(0.1, 0.2, 0.3)
    opened = Mesh(closed.vertices, closed.faces[2:])
    assert not opened.is_solid
    assert opened.volume == pytest.approx(closed.volume)
    assert np.allclose(opened.inertia, closed.inertia)
    assert np.allclose(opened.center_of_mass, 0, atol=1e-9)


def test_inside_out_is_not_solid() -> None:
    closed = shapes.brick(0.1, 0.2, 0.3)
    assert not Mesh(closed.vertices, closed.faces[:, ::-1]).is_solid
    assert Mesh(closed.vertices, closed.faces[:, ::-1]).volume == pytest.approx(closed.volume)


def test_rounding_to_32_bits_happens_once() -> None:
    rng = np.random.default_rng(0)
    box = shapes.brick(1, 1, 1)
    first = Mesh(rng.normal(size=(8, 3)), box.faces)
    again = Mesh(first.vertices, first.faces)
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.vertices, first.vertices.astype(np.float32))
    assert first.content_hash == again.content_hash
    assert first.content_hash != box.content_hash


def test_mesh_is_read_only_and_leaves_its_sources_alone() -> None:
    vertices, faces = SQUARE.copy(), TWO.copy()
    mesh = Mesh(vertices, faces)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0, 0] = 1
    vertices[0, 0], faces[0, 0] = 5.0, 3
    assert mesh.vertices[0, 0] == 0.0
    assert mesh.faces[0, 0] == 0


def test_trimesh_there_and_back() -> None:
    box = shapes.brick(0.1, 0.2, 0.3)
    again = Mesh.from_trimesh(trimesh.Trimesh(box.vertices, box.faces, process=False))
    assert np.array_equal(again.vertices, box.vertices)
    assert np.array_equal(again.faces, box.faces)


def test_transformed_moves_the_points_and_keeps_the_volume() -> None:
    shape = shapes.l_shape()
    pose = shapes.random_pose(np.random.default_rng(1), 1.0)
    moved = shape.transformed(pose)
    assert np.allclose(moved.vertices, [pose.act(v) for v in shape.vertices], atol=1e-6)
    assert np.allclose(moved.center_of_mass, pose.translation, atol=1e-6)
    assert np.allclose(moved.inertia, pose.rotation @ shape.inertia @ pose.rotation.T, atol=1e-9)


def test_nearest_points_of_two_boxes() -> None:
    a = shapes.box((0, 0, 0), (1, 1, 1))
    witness = nearest_points(a, shapes.box((1.5, 0.2, 0.2), (2, 0.8, 0.8)))
    assert witness.distance == pytest.approx(0.5)
    assert witness.point_a[0] == pytest.approx(1.0)
    assert witness.point_b[0] == pytest.approx(1.5)
    assert np.allclose(witness.point_b - witness.point_a, [0.5, 0, 0], atol=1e-6)
    diagonal = nearest_points(a, shapes.box((1.3, 1.4, 0), (2, 2, 1)))
    assert diagonal.distance == pytest.approx(0.5)
    assert nearest_points(a, shapes.box((1.0, 0, 0), (2, 1, 1))).distance == 0.0
    assert nearest_points(a, shapes.box((0.9, 0, 0), (2, 1, 1))).distance == 0.0


@pytest.mark.parametrize(
    ("point", "distance"),
    [((3, 0.5, 0.5), 2.0), ((2, 2, 0.5), 2**0.5), ((0.5, 0.5, 0.9), 0.1), ((0.5, -0.25, 0), 0.25), ((0.2, 1, 1), 0.0)],
)
def test_distance_from_a_point_past_triangles_that_are_lines(point: tuple[float, ...], distance: float) -> None:
    box = shapes.box((0, 0, 0), (1, 1, 1))
    # As cuts and rounding leave them: along an edge, and of one corner alone.
    vertices = np.concatenate([box.vertices, [[0.5, 0, 0], [0.25, 0, 0]]])
    faces = np.concatenate([[[0, 8, 1], [0, 9, 8], [0, 0, 3]], box.faces])
    here = np.array(point, dtype=float)
    assert distance_to(Mesh(vertices, faces).bvh, here) == pytest.approx(distance, abs=1e-6)
    assert Shell(Surface(vertices, faces)).distances_to(here[None])[0] == pytest.approx(distance, abs=1e-6)


def test_vertices_that_no_face_uses_do_not_count() -> None:
    box = shapes.brick(0.1, 0.2, 0.3)
    mesh = Mesh(np.concatenate([box.vertices, [[5.0, 0, 0]]]), box.faces)
    assert np.allclose(mesh.bounds, box.bounds)
    assert mesh.radius == pytest.approx(box.radius)
    assert len(mesh.hull_vertices) == 8
