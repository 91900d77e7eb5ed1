"""Line drawings: areas worked out by hand, and what rays see."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import CrossSection

from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import transform_points
from roboassembly.manual.line_drawing import Figure, LineDrawing, Projection, draw
from shapes import HERE, block, box, mirrored, of_solid, pose, prism, turn

FRONT = Projection.looking(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
CORNER = Projection.looking(np.array([1.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0]))


def whole(drawing: LineDrawing) -> float:
    return sum(r.shape.area() for r in drawing.regions)


def test_a_camera_has_right_handed_axes() -> None:
    assert FRONT.right == pytest.approx([1, 0, 0])
    assert FRONT.up == pytest.approx([0, 0, 1])
    axes = np.array([CORNER.right, CORNER.up, CORNER.toward])
    assert axes @ axes.T == pytest.approx(np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_cube_shows_one_face_from_the_front_and_three_from_a_corner() -> None:
    cube = Figure(box((0, 0, 0), (0.1, 0.1, 0.1)), HERE, 0)
    (face,) = draw([cube], FRONT).regions
    assert face.shape.area() == pytest.approx(100.0**2, rel=1e-6)
    assert face.shape.bounds() == pytest.approx((0, 0, 100, 100), abs=1e-5)
    faces = draw([cube], CORNER).regions
    assert [r.shape.area() for r in faces] == pytest.approx([100.0**2 / np.sqrt(3.0)] * 3, rel=1e-5)
    # The top is the brightest: light falls from above.
    tops = sorted(faces, key=lambda r: r.shape.bounds()[3])
    assert tops[-1].tone == max(r.tone for r in faces)


def test_a_plate_hides_what_is_behind_it_and_nothing_else() -> None:
    plate = Figure(box((0.0, 0.0, 0.0), (0.4, 0.01, 0.3)), HERE, 0)
    behind = Figure(box((0.3, 0.1, 0.1), (0.5, 0.2, 0.2)), HERE, 1)
    before = Figure(box((0.1, -0.2, 0.1), (0.2, -0.1, 0.2)), HERE, 2)
    unseen = Figure(box((0.1, 0.1, 0.1), (0.2, 0.2, 0.2)), HERE, 3)
    drawing = draw([plate, behind, before, unseen], FRONT)
    areas = [drawing.area(key) for key in range(4)]
    assert areas == pytest.approx([400 * 300 - 100 * 100, 100 * 100, 100 * 100, 0.0], rel=1e-6)


def test_a_hole_shows_what_is_behind_it() -> None:
    plate = of_solid(block((0, 0, 0), (0.3, 0.02, 0.3)) - block((0.1, -0.01, 0.1), (0.2, 0.03, 0.2)))
    back = box((-0.1, 0.2, -0.1), (0.4, 0.25, 0.4))
    drawing = draw([Figure(plate, HERE, 0), Figure(back, HERE, 1)], FRONT)
    assert drawing.area(0) == pytest.approx(300**2 - 100**2, rel=1e-6)
    assert drawing.area(1) == pytest.approx(500**2 - 300**2 + 100**2, rel=1e-6)


def test_three_bars_that_hide_each_other_in_a_ring_are_drawn_right() -> None:
    # No order of drawing whole bars one over the other does this.
    bar = box((-0.2, 0.0, -0.02), (0.2, 0.01, 0.02))
    figures = []
    for k in range(3):
        outward = turn((0, 1, 0), 2 * np.pi * k / 3)
        tilt = turn((0, 0, 1), 0.25)
        figures.append(Figure(bar, pose(*(outward @ [0.0, 0.0, 0.08]), rotation=outward @ tilt), k))
    drawing = draw(figures, FRONT)
    areas = [drawing.area(k) for k in range(3)]
    alone = [draw([f], FRONT).area(k) for k, f in enumerate(figures)]
    assert areas == pytest.approx([areas[0]] * 3, rel=1e-4)
    assert all(seen < own - 500.0 for seen, own in zip(areas, alone, strict=True))
    _agrees_with_rays(drawing, figures, FRONT, 400)


def test_facets_of_round_parts_are_no_lines() -> None:
    drawing = draw([Figure(prism(24, 0.05, 0.3), HERE, 0)], CORNER)
    assert len(drawing.regions) == 2  # one side and one end


@pytest.mark.parametrize(("depth", "faces"), [(0.0002, 1), (0.002, 2)])
def test_a_shallow_step_of_repair_is_no_line(depth: float, faces: int) -> None:
    """A pocket in the front of a board, 0.2 or 2 mm deep, is drawn only if it is a feature of the board."""
    board = of_solid(block((0, 0, 0), (0.3, 0.02, 0.3)) - block((0.1, -0.01, 0.1), (0.2, depth, 0.2)))
    drawing = draw([Figure(board, HERE, 0)], FRONT)
    assert len(drawing.regions) == faces
    assert whole(drawing) == pytest.approx(300.0**2, rel=1e-6)


def test_a_sheet_thinner_than_such_a_step_keeps_its_sides() -> None:
    side = Projection.looking(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    (edge,) = draw([Figure(box((0, 0, 0), (0.3, 0.0004, 0.3)), HERE, 0)], side).regions
    assert edge.shape.area() == pytest.approx(0.4 * 300.0, rel=1e-6)


def test_an_open_surface_is_drawn_from_both_sides() -> None:
    square = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1], [0, 0, 0.1]]), np.array([[0, 1, 2], [0, 2, 3]]))
    for mesh in (square, mirrored(square)):
        assert draw([Figure(mesh, HERE, 0)], FRONT).area(0) == pytest.approx(100.0**2, rel=1e-6)


def test_a_window_cuts_exactly() -> None:
    plate = Figure(box((-1, 0, -1), (1, 0.1, 1)), HERE, 0)
    window = CrossSection.circle(50.0, 256)
    assert whole(draw([plate], FRONT).clipped(window)) == pytest.approx(window.area(), rel=1e-9)


@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("ladder", 0),
        ("windsor", 3),
        *(pytest.param(*p, marks=pytest.mark.slow) for p in (("lattice", 1), ("pedestal", 2))),
    ],
)
def test_every_point_of_a_chair_shows_the_part_that_a_ray_hits(chair, family: str, seed: int) -> None:
    furniture = chair(family, seed)
    figures = [Figure(p.mesh, q, i) for i, (p, q) in enumerate(zip(furniture.parts, furniture.assembled, strict=True))]
    drawing = draw(figures, CORNER)
    _agrees_with_rays(drawing, figures, CORNER, 600)
    again = draw(figures, CORNER)
    assert [r.shape.to_polygons()[0].tolist() for r in drawing.regions] == [
        r.shape.to_polygons()[0].tolist() for r in again.regions
    ]


def _agrees_with_rays(drawing: LineDrawing, figures: list[Figure], camera: Projection, count: int) -> None:
    """Points of the picture, not near a line, show the part that Embree finds first."""
    rng = np.random.default_rng(0)
    left, low, right, high = drawing.bounds
    points = rng.uniform((left, low), (right, high), (count, 2))
    start = (points @ np.array([camera.right, camera.up])) / 1e3 + 5.0 * camera.toward
    reach = np.array(
        [
            Rays(Mesh(transform_points(f.pose, f.mesh.vertices), f.mesh.faces)).first_hits(
                start, np.repeat(-camera.toward[None], count, axis=0)
            )[0]
            for f in figures
        ]
    )
    seen = np.where(np.isfinite(reach).any(axis=0), reach.argmin(axis=0), -1)
    tested = wrong = 0
    for point, key in zip(points, seen.tolist(), strict=True):
        dot = CrossSection.circle(1.5, 8).translate(tuple(point.tolist()))
        shown = [r.key for r in drawing.regions if not (r.shape ^ dot).is_empty()]
        if len(set(shown)) > 1:
            continue  # on a line
        inner = [r.key for r in drawing.regions if (r.shape ^ dot).area() > 0.99 * dot.area()]
        if not inner and shown:
            continue  # on the outline
        tested += 1
        wrong += (inner[0] if inner else -1) != key
    assert tested > 0.5 * count
    assert wrong == 0
