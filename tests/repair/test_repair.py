"""Repair: hand-made shapes with hand-computed numbers, refusals, determinism, and three real chairs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import fcl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import shapes
from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import CONTACT_DISTANCE, RawPart
from roboassembly.furniture.symmetry import symmetries
from roboassembly.furniture.turns import MAX_TURNS, groups
from roboassembly.geometry.meshes import Mesh
from roboassembly.importers import ikea_manual
from roboassembly.repair import RepairLimits, repair

GAP = 0.0002
SET_BACK = 0.75 * GAP
"""Distance that all faces of parts that overlap or touch move inward [m]."""


def box(name, size, centre, faces=slice(None)):
    mesh = trimesh.creation.box(size)
    return RawPart(name, Mesh(mesh.vertices + np.asarray(centre), mesh.faces[faces]))


def cylinder(name, radius, bottom, top, centre=(0.0, 0.0)):
    mesh = trimesh.creation.cylinder(radius, height=top - bottom, sections=32)
    return RawPart(name, Mesh(mesh.vertices + np.array([*centre, 0.5 * (top + bottom)]), mesh.faces))


def fcl_object(part, shift=(0.0, 0.0, 0.0)):
    model = fcl.BVHModel()
    model.beginModel(len(part.mesh.vertices), len(part.mesh.faces))
    model.addSubModel(part.mesh.vertices, part.mesh.faces)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform(np.asarray(shift, dtype=float)))


def collide(a, b, shift=(0.0, 0.0, 0.0)):
    return bool(fcl.collide(fcl_object(a, shift), fcl_object(b), fcl.CollisionRequest(), fcl.CollisionResult()))


def distance(a, b):
    return fcl.distance(fcl_object(a), fcl_object(b), fcl.DistanceRequest(), fcl.DistanceResult())


def leaves(part, others, direction, length=0.6):
    """Return whether a part can move out along a direction, in steps of 2 mm."""
    steps = np.arange(0.0, length, 0.002)[:, None] * np.asarray(direction, dtype=float)
    return not any(collide(part, other, step) for other in others for step in steps)


def assert_clear(result, gap=GAP):
    for a, b in combinations(result.parts, 2):
        assert not collide(a, b), f"{a.name} meets {b.name}"
        assert distance(a, b) >= 0.5 * gap - 1e-7
    assert all(part.mesh.is_solid for part in result.parts)


def test_boxes_overlapping_by_3_mm():
    # 100 mm cube on a 100 x 100 x 200 one, 3 mm deep, 2.7 mm once their faces are set back. One of them loses 2.9 mm:
    # the taller one, which it costs 1.5 %.
    lower, upper = box("lower", (0.1, 0.1, 0.2), (0, 0, 0.1)), box("upper", (0.1, 0.1, 0.1), (0, 0, 0.247))
    result = repair([lower, upper], gap=GAP)
    assert_clear(result)
    assert distance(*result.parts) == pytest.approx(GAP, abs=2e-5)
    trimmed = {r.name: r.trimmed for r in result.report}
    assert trimmed["lower"] == pytest.approx(0.0029 / 0.1997, rel=1e-3)
    assert trimmed["upper"] == 0.0
    assert result.parts[1].mesh.volume == pytest.approx(0.0997**3, rel=1e-5)
    assert all(r.displacement == 0.0 for r in result.report)
    assert {r.how for r in result.report} == {"as delivered"}


@pytest.mark.parametrize("gap", [0.0001, 0.0003])
def test_boxes_that_just_touch_are_not_cut(gap):
    a, b = box("a", (0.1, 0.1, 0.1), (0, 0, 0.05)), box("b", (0.1, 0.1, 0.3), (0, 0, 0.25))
    assert collide(a, b)
    result = repair([a, b], gap=gap)
    assert_clear(result, gap)
    assert distance(*result.parts) == pytest.approx(1.5 * gap, abs=1e-6)
    assert [r.trimmed for r in result.report] == [0.0, 0.0]


def test_parts_that_are_clear_of_one_another_stay_as_they_are():
    a, b = box("a", (0.1, 0.1, 0.1), (0, 0, 0.05)), box("b", (0.1, 0.1, 0.3), (0, 0, 0.2502))
    result = repair([a, b], gap=GAP)
    for part, before in zip(result.parts, (a, b), strict=True):
        assert part.mesh.bounds == pytest.approx(before.mesh.bounds, abs=1e-9)


def test_a_board_slides_along_a_longer_one_that_it_lay_on():
    # A cut for the gap would leave the longer board with a rim, on which the other one would catch.
    long, short = box("long", (0.8, 0.3, 0.02), (0, 0, 0.01)), box("short", (0.2, 0.2, 0.02), (0, 0, 0.03))
    result = repair([long, short], gap=GAP)
    assert_clear(result)
    for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
        assert leaves(result.parts[1], result.parts[:1], direction)


def test_equal_boards_between_two_sides_slide_in_either_way():
    # Exactly as wide as the space between the sides, as in files from CAD.
    sides = [box(f"side {x:+}", (0.02, 0.3, 0.6), (0.21 * x, 0, 0.3)) for x in (-1, 1)]
    shelves = [box(f"shelf {z}", (0.4, 0.28, 0.02), (0, 0, z)) for z in (0.1, 0.5)]
    result = repair([*sides, *shelves], gap=GAP)
    assert_clear(result)
    for shelf in result.parts[2:]:
        for direction in ((0, 1, 0), (0, -1, 0)):
            assert leaves(shelf, result.parts[:2], direction)


def test_leg_shallow_in_a_seat_is_cut_flush():
    seat, leg = box("seat", (0.4, 0.4, 0.04), (0, 0, 0.42)), box("leg", (0.04, 0.04, 0.402), (0.15, 0.15, 0.201))
    result = repair([seat, leg])
    assert_clear(result)
    assert result.report[0].trimmed == 0.0
    assert result.report[1].trimmed == pytest.approx(0.0019 / 0.4017, rel=1e-3)
    assert leaves(result.parts[1], result.parts[:1], (0, 0, -1))
    assert leaves(result.parts[1], result.parts[:1], (1, 0, 0))


def test_leg_three_millimetres_in_a_seat_keeps_its_length():
    seat, leg = box("seat", (0.4, 0.4, 0.04), (0, 0, 0.42)), box("leg", (0.04, 0.04, 0.403), (0.15, 0.15, 0.2015))
    result = repair([seat, leg])
    assert_clear(result)
    socket = 0.0401**2 * 0.0029
    assert result.report[0].trimmed == pytest.approx(socket / (0.3997 * 0.3997 * 0.0397), rel=1e-3)
    assert result.report[1].trimmed == 0.0
    assert leaves(result.parts[1], result.parts[:1], (0, 0, -1))


def test_peg_deep_in_a_plate_gets_a_socket():
    # To cut the peg flush would take half of it; the plate loses a hole 19.9 mm deep instead.
    plate, peg = box("plate", (0.2, 0.2, 0.04), (0, 0, 0.02)), cylinder("peg", 0.005, 0.02, 0.06)
    result = repair([plate, peg])
    assert_clear(result)
    assert result.report[1].trimmed == 0.0
    circle = 16 * np.sin(2 * np.pi / 32)
    hole = circle * (0.005 + (GAP - SET_BACK) / np.cos(np.pi / 32)) ** 2 * 0.0199
    assert result.report[0].trimmed == pytest.approx(hole / (0.1997 * 0.1997 * 0.0397), rel=0.01)
    assert any("socket for 'peg'" in note for note in result.report[0].notes)
    assert leaves(result.parts[1], result.parts[:1], (0, 0, 1))
    assert not leaves(result.parts[1], result.parts[:1], (1, 0, 0))


def test_pole_through_a_plate_stays_whole():
    plate, pole = box("plate", (0.2, 0.2, 0.02), (0, 0, 0.1)), cylinder("pole", 0.01, 0.0, 0.4)
    result = repair([plate, pole])
    assert_clear(result)
    assert result.report[1].trimmed == 0.0
    assert leaves(result.parts[1], result.parts[:1], (0, 0, 1))


def turns_of(part: RawPart) -> int:
    return len(symmetries(Mesh(part.mesh.vertices - part.mesh.center_of_mass, part.mesh.faces)))


def drilled_board(name: str, centre: Sequence[float]) -> RawPart:
    """Return a board of 600 x 300 x 20 mm with a hole near each corner: it has four rotational symmetries."""
    holes = [shapes.block((x - 0.02, y - 0.02, -0.1), (x + 0.02, y + 0.02, 0.1))
             for x in (-0.25, 0.25) for y in (-0.1, 0.1)]  # fmt: skip
    solid = shapes.block((-0.3, -0.15, -0.01), (0.3, 0.15, 0.01))
    for hole in holes:
        solid -= hole
    mesh = shapes.of_solid(solid)
    return RawPart(name, Mesh(mesh.vertices + np.asarray(centre), mesh.faces))


def test_board_against_a_rail_is_trimmed_at_both_ends():
    # They overlap by 0.5 mm, so the board loses 0.4 mm of one end once faces are set back. That alone would leave it
    # with holes that are nearer to that end.
    board, rail = drilled_board("board", (0.3, 0, 0.2)), box("rail", (0.02, 0.3, 0.02), (-0.0095, 0, 0.2))
    result = repair([board, rail], gap=GAP)
    assert_clear(result)
    assert turns_of(board) == turns_of(result.parts[0]) == 4
    low, high = np.min(result.parts[0].mesh.vertices, axis=0), np.max(result.parts[0].mesh.vertices, axis=0)
    end = 0.0005 - SET_BACK + GAP
    assert low == pytest.approx([end, SET_BACK - 0.15, 0.19 + SET_BACK], abs=2e-5)
    assert high == pytest.approx([0.6 - end, 0.15 - SET_BACK, 0.21 - SET_BACK], abs=2e-5)
    assert "cut alike all round" in result.report[0].notes


def test_congruent_boards_trimmed_at_different_ends_stay_congruent_and_symmetric():
    boards = [drilled_board("left", (0.3, 0, 0.2)), drilled_board("right", (-0.32, 0, 0.2))]
    rail = box("rail", (0.021, 0.3, 0.02), (-0.01, 0, 0.2))
    result = repair([*boards, rail], gap=GAP)
    assert_clear(result)
    assert [turns_of(part) for part in result.parts[:2]] == [4, 4]
    assert result.parts[0].mesh.volume == pytest.approx(result.parts[1].mesh.volume, rel=1e-6)


@pytest.mark.parametrize(("name", "sizes"), [
    ("D2", [4, 2, 2, 2, 1]), ("D3", [6, 3, 2, 2, 2, 1]), ("D4", [8, 4, 2, 2, 2, 2, 1]), ("C4", [4, 1]), ("C1", [1]),
])  # fmt: skip
def test_groups_of_turns_are_exact(name: str, sizes: list[int]):
    rng = np.random.default_rng(3)
    tilt = Rotation.random(random_state=rng).as_matrix()
    true = tilt @ Rotation.create_group(name).as_matrix() @ tilt.T
    found = Rotation.from_rotvec(rng.normal(0.0, 0.002, (len(true), 3))).as_matrix() @ true
    out = groups(found[rng.permutation(len(found))])
    assert [len(group) for group in out] == sizes
    for group in out:
        products = np.einsum("aij,bjk->abik", group, group)
        assert np.abs(products[:, :, None] - group).max(axis=(3, 4)).min(axis=2).max() < 1e-9
        assert np.abs(group[:, None] - true).max(axis=(2, 3)).min(axis=1).max() < 0.02
        assert np.allclose(group[0], np.eye(3), atol=1e-9)


def test_large_cyclic_groups_are_reduced_to_evenly_spaced_rotations():
    fine = Rotation.from_rotvec(2 * np.pi * np.arange(64)[:, None] / 64 * np.array([0.0, 0.0, 1.0])).as_matrix()
    first, last = groups(fine)
    assert len(first) == MAX_TURNS
    assert len(last) == 1
    steps = Rotation.from_matrix(first).magnitude()
    assert np.sort(steps)[1:3] == pytest.approx(2 * np.pi / 16)


def test_bar_between_two_posts_is_not_trapped():
    posts = [box(f"post {s}", (0.04, 0.04, 0.4), (s * 0.2, 0, 0.2)) for s in (-1, 1)]
    bar = box("bar", (0.39, 0.02, 0.02), (0, 0, 0.2))
    result = repair([*posts, bar])
    assert_clear(result)
    # Each post gets a socket 14.9 mm deep; the bar keeps its length, and each post can be drawn off it.
    socket = 0.0149 * 0.0201**2 / (0.0397 * 0.0397 * 0.3997)
    assert [r.trimmed for r in result.report] == pytest.approx([socket, socket, 0.0], rel=1e-3)
    assert np.ptp(result.parts[2].mesh.vertices, axis=0) == pytest.approx([0.3897, 0.0197, 0.0197], abs=1e-6)
    assert leaves(result.parts[0], result.parts[1:], (-1, 0, 0))


def test_open_box_becomes_solid():
    open_box = box("open", (0.1, 0.1, 0.1), (0, 0, 0.05), faces=slice(2, None))
    assert not open_box.mesh.is_solid
    result = repair([open_box, box("other", (0.1, 0.1, 0.1), (0.1001, 0, 0.05))])
    assert_clear(result)
    assert result.report[0].how == "holes filled"
    assert result.parts[0].mesh.volume == pytest.approx(1e-3, rel=0.01)


def test_open_end_of_a_tube_gets_a_ring():
    tube = trimesh.creation.annulus(0.02, 0.03, 0.2)
    side = tube.face_normals[:, 2] < 0.5
    part = RawPart("tube", Mesh(tube.vertices, tube.faces[side]))
    result = repair([part, box("other", (0.05, 0.05, 0.05), (0, 0, 0.1255))])
    assert result.parts[0].mesh.volume == pytest.approx(tube.volume, rel=0.01)


def test_reversed_duplicates_and_mixed_winding():
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    faces = np.concatenate([mesh.faces[:, ::-1], mesh.faces[6:], mesh.faces[:6]])
    faces[::3] = faces[::3, ::-1]
    result = repair([RawPart("double", Mesh(mesh.vertices, faces)), box("other", (0.1, 0.1, 0.1), (0.1, 0, 0))])
    assert_clear(result)
    assert "12 duplicate triangles removed" in result.report[0].notes
    assert sum(p.mesh.volume for p in result.parts) == pytest.approx(2 * 0.0997**3, rel=1e-4)


def test_inside_out_part_is_turned():
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    part = RawPart("inverted", Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    result = repair([part, box("other", (0.1, 0.1, 0.1), (0.101, 0, 0))])
    assert result.parts[0].mesh.volume == pytest.approx(1e-3, rel=1e-5)


def test_sheet_beside_a_solid_is_made_thick():
    rail, sheet = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.1))
    vertices = np.concatenate([rail.vertices, sheet.vertices + np.array([0.3, 0, 0])])
    one_side = sheet.faces[np.abs(sheet.face_normals[:, 0] - 1.0) < 0.1] + 8
    part = RawPart("mixed", Mesh(vertices, np.concatenate([rail.faces, one_side])))
    result = repair([part, box("other", (0.1, 0.1, 0.1), (0, 0, 0.1))])
    assert "sheet thickened" in result.report[0].how
    assert result.parts[0].mesh.bounds[1, 0] == pytest.approx(0.35, abs=0.002)


def test_loose_part_is_moved_to_the_rest():
    a, b = box("a", (0.1, 0.1, 0.1), (0, 0, 0.05)), box("b", (0.1, 0.1, 0.3), (0.107, 0, 0.15))
    result = repair([a, b], gap=GAP)
    assert_clear(result)
    assert result.report[0].displacement == pytest.approx(0.007 - GAP, abs=1e-6)
    assert result.report[1].displacement == 0.0
    assert distance(*result.parts) == pytest.approx(GAP, abs=1e-6)


@pytest.mark.slow
def test_curved_neighbours_and_many_faces():
    ball = trimesh.creation.icosphere(5, 0.1)
    result = repair([RawPart("ball", Mesh(ball.vertices, ball.faces)), box("floor", (0.3, 0.3, 0.1), (0, 0, -0.145))])
    assert_clear(result)
    assert len(result.parts[0].mesh.faces) <= 1.2 * RepairLimits().faces


def test_flat_part_gets_a_thickness():
    square = RawPart(
        "square", Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    )
    result = repair([square, box("a", (0.1, 0.1, 0.1), (0.5, 0.5, 0.05))])
    assert_clear(result)
    assert result.report[0].how == "sheet thickened"
    assert any("10000 cm²" in note or "1e+04 cm²" in note for note in result.report[0].notes)
    # 1 mm thick before its faces are set back.
    assert result.parts[0].mesh.volume == pytest.approx(0.9997**2 * 0.0007, rel=0.01)


def test_too_much_overlap_is_refused():
    a, b = box("a", (0.1, 0.1, 0.1), (0, 0, 0)), box("b", (0.1, 0.1, 0.1), (0.05, 0, 0))
    with pytest.raises(FurnitureError, match=r"would lose 5\d\.\d% of its volume .*at most 20\.0% .*`trimmed`"):
        repair([a, b])
    assert_clear(repair([a, b], limits=RepairLimits(trimmed=0.6, shortening=0.06)))


def test_parts_too_far_apart_are_refused():
    a, b = box("a", (0.1, 0.1, 0.1), (0, 0, 0)), box("b", (0.1, 0.1, 0.1), (0.15, 0, 0))
    with pytest.raises(FurnitureError, match=r"hangs 50\.0 mm off .*`displacement`"):
        repair([a, b])


@pytest.mark.parametrize("gap", [0.0, -1.0, 0.01, float("nan")])
def test_bad_gap(gap):
    parts = [box("a", (0.1, 0.1, 0.1), (0, 0, 0)), box("b", (0.1, 0.1, 0.1), (0.1, 0, 0))]
    with pytest.raises(FurnitureError, match=r"gap .* expected a number between 0\.00001 and 0\.001 m"):
        repair(parts, gap=gap)


def test_part_count_and_names():
    a = box("a", (0.1, 0.1, 0.1), (0, 0, 0))
    with pytest.raises(FurnitureError, match="1 part; furniture has 2 or more"):
        repair([a])
    with pytest.raises(FurnitureError, match="not all different"):
        repair([a, a])


def test_order_and_labels_are_kept_and_the_outcome_is_repeatable():
    seat = RawPart("seat", box("", (0.4, 0.4, 0.04), (0, 0, 0.42)).mesh, "seat_surface")
    leg = RawPart("leg", cylinder("", 0.02, 0.0, 0.405).mesh, "leg")
    one, two = repair([seat, leg]), repair([seat, leg])
    assert [(p.name, p.label) for p in one.parts] == [("seat", "seat_surface"), ("leg", "leg")]
    assert [p.mesh.content_hash for p in one.parts] == [p.mesh.content_hash for p in two.parts]
    assert one.report == two.report
    assert str(one.report[1]).startswith("leg: as delivered, shape error 0.00 mm, trimmed 0.00%")
    assert "has a socket for 'leg'" in one.report[0].notes


SAMPLES = Path(os.environ.get("ROBOASSEMBLY_SAMPLES", "/nonexistent")) / "ikea_manuals_at_work" / "parts"
needs_samples = pytest.mark.skipif(
    not SAMPLES.is_dir(), reason="set ROBOASSEMBLY_SAMPLES to the folder of sample furniture"
)


def assert_connected(result):
    left, reached = set(range(len(result.parts))), [0]
    left.discard(0)
    while reached:
        p = reached.pop()
        joined = {q for q in left if distance(result.parts[p], result.parts[q]) < CONTACT_DISTANCE}
        left -= joined
        reached += joined
    assert not left


@needs_samples
@pytest.mark.parametrize("name", ["kyrre", "sjalland", "mammut_1"])
def test_real_chairs(name):
    before = ikea_manual.read(SAMPLES / "Chair" / name).parts
    result = repair(before)
    assert_clear(result)
    assert_connected(result)
    for old, new, report in zip(before, result.parts, result.report, strict=True):
        assert new.name == old.name
        assert report.shape_error < 0.002
        assert np.allclose(old.mesh.bounds, new.mesh.bounds, atol=0.003)


@needs_samples
@pytest.mark.slow
@pytest.mark.parametrize("name", ["grubban", "kaustby", "poang_2", "ragrund", "ingolf_2", "nilsolle", "skogsta_2"])
def test_more_real_chairs(name):
    result = repair(ikea_manual.read(SAMPLES / "Chair" / name).parts)
    assert_clear(result)
    assert_connected(result)
