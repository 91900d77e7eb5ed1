"""From raw parts to furniture: frames, classes of like parts, and connection points that give back the assembly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import shapes
from roboassembly.errors import FurnitureError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.contacts import find_contacts
from roboassembly.furniture.model import PAPER_POINTS, ConnectionPoint, Furniture, Provenance, RawPart
from roboassembly.furniture.symmetry import MAX_SYMMETRIES, rotations_onto, symmetries
from roboassembly.generate import FAMILIES, generate
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.task.rules.pairs import mate

ORIGIN = Provenance("test")
CHAIRS = [(family, 0) for family in FAMILIES]
CHAIRS += [pytest.param(family, 1, marks=pytest.mark.slow) for family in FAMILIES]


def relative_error(furniture: Furniture) -> float:
    """How far aligning the two frames of a connection is from the assembled relative pose, at worst."""
    worst = 0.0
    for c in furniture.connections:
        a, b = furniture.parts[c.part_a].points[c.point_a], furniture.parts[c.part_b].points[c.point_b]
        slot_a, slot_b = furniture.assembled[c.part_a], furniture.assembled[c.part_b]
        for one, other, expected in ((a, b, slot_a.actInv(slot_b)), (b, a, slot_b.actInv(slot_a))):
            worst = max(worst, float(np.abs(mate(one, other).homogeneous - expected.homogeneous).max()))
    return worst


def contact_pairs(furniture: Furniture) -> set[tuple[int, int]]:
    placed = [p.mesh.transformed(s) for p, s in zip(furniture.parts, furniture.assembled, strict=True)]
    return {(c.a, c.b) for c in find_contacts(placed, [p.name for p in furniture.parts])}


def alike(points: Sequence[ConnectionPoint], others: Sequence[ConnectionPoint], turns: np.ndarray) -> float:
    """How far the worst of `points` lies from the nearest of `others`, up to the symmetries of the shape."""
    return max(
        min(
            float(np.linalg.norm(t @ p.position - o.position) + np.linalg.norm(t @ p.normal - o.normal))
            for o in others
            for t in turns
        )
        for p in points
    )


def check_structure(furniture: Furniture) -> None:
    for part in furniture.parts:
        assert np.abs(part.mesh.center_of_mass).max() < 1e-6
        assert 1 <= len(part.points) <= PAPER_POINTS
        for point in part.points:
            assert np.linalg.norm(point.normal) == pytest.approx(1.0, abs=1e-9)
            assert np.linalg.norm(point.tangent) == pytest.approx(1.0, abs=1e-9)
            assert abs(point.normal @ point.tangent) < 1e-9
            assert 0.0 < point.gap < 0.005 + 1e-9
            assert np.allclose(point.frame.rotation.T @ point.frame.rotation, np.eye(3), atol=1e-9)
            assert np.linalg.det(point.frame.rotation) == pytest.approx(1.0)
    for c in furniture.connections:
        normals = [
            furniture.assembled[p].rotation @ furniture.parts[p].points[k].normal
            for p, k in ((c.part_a, c.point_a), (c.part_b, c.point_b))
        ]
        assert np.allclose(normals[0], -normals[1], atol=1e-6)
    for shape_class in furniture.classes:
        first = furniture.parts[shape_class.members[0]]
        assert np.allclose(shape_class.symmetries[0], np.eye(3))
        for member in shape_class.members[1:]:
            # In frames of their own, like parts are the same thing.
            part = furniture.parts[member]
            assert np.abs(part.mesh.bounds - first.mesh.bounds).max() < 2e-4
            assert part.mesh.volume == pytest.approx(first.mesh.volume, rel=1e-3)
            assert alike(part.points, first.points, shape_class.symmetries) < 5e-3
            assert alike(first.points, part.points, shape_class.symmetries) < 5e-3


@pytest.mark.parametrize(("family", "seed"), CHAIRS)
def test_aligned_frames_give_the_assembled_poses(chair, family: str, seed: int) -> None:
    furniture = chair(family, seed)
    check_structure(furniture)
    assert relative_error(furniture) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 12))
@pytest.mark.parametrize("family", FAMILIES)
def test_aligned_frames_give_the_assembled_poses_of_many_chairs(chair, family: str, seed: int) -> None:
    furniture = chair(family, seed)
    check_structure(furniture)
    assert relative_error(furniture) < 1e-6
    assert contact_pairs(furniture) == {(c.part_a, c.part_b) for c in furniture.connections}


@pytest.mark.parametrize(("family", "seed"), CHAIRS)
def test_furniture_has_the_names_and_solids_of_the_raw_parts(chair, family: str, seed: int) -> None:
    furniture = chair(family, seed)
    for part, slot, raw in zip(furniture.parts, furniture.assembled, shapes.generated(family, seed), strict=True):
        assert part.name == raw.name
        assert part.label == raw.label
        placed = part.mesh.transformed(slot)
        # The same solid at the same place, whatever vertices it is made of.
        assert np.allclose(placed.center_of_mass, raw.mesh.center_of_mass, atol=2e-6)
        assert np.allclose(placed.bounds, raw.mesh.bounds, atol=2e-4)
        assert np.allclose(placed.inertia, raw.mesh.inertia, rtol=1e-3, atol=1e-3 * np.trace(raw.mesh.inertia))
    assert contact_pairs(furniture) == {(c.part_a, c.part_b) for c in furniture.connections}


def test_table_by_hand() -> None:
    table = shapes.table()
    assert sorted(c.members for c in table.classes) == [(0,), (1, 2, 3, 4)]
    assert len({id(p.mesh) for p in table.parts[1:]}) == 1
    assert np.allclose(table.assembled[0].translation, [0, 0, 0.415 + shapes.GAP], atol=1e-6)
    for i, (x, y) in enumerate(shapes.LEGS):
        assert np.allclose(table.assembled[i + 1].translation, [x, y, 0.2], atol=1e-6)
        (point,) = table.parts[i + 1].points
        top = table.parts[0].points[i]
        assert np.allclose(table.assembled[i + 1].act(point.position), [x, y, 0.4], atol=1e-6)
        assert np.allclose(table.assembled[0].act(top.position), [x, y, 0.4 + shapes.GAP], atol=1e-6)
        assert np.allclose(table.assembled[i + 1].rotation @ point.normal, [0, 0, 1], atol=1e-6)
        assert point.gap == pytest.approx(shapes.GAP, abs=1e-7)
        assert table.mate_of[i + 1, 0] == (0, i)


def test_equal_legs_have_the_same_points(table: Furniture) -> None:
    first = table.parts[1].points[0]
    (turns,) = (c.symmetries for c in table.classes if 1 in c.members)
    for leg in table.parts[2:]:
        frame = leg.points[0].frame.homogeneous
        assert (
            min(np.abs(SE3(t, np.zeros(3)).homogeneous @ first.frame.homogeneous - frame).max() for t in turns) < 1e-6
        )


def test_mirror_images_are_different_classes(armchair: Furniture) -> None:
    assert sorted(c.members for c in armchair.classes) == [(0,), (1,), (2,)]


def test_annotation_moves_with_the_furniture() -> None:
    turn = Rotation.from_euler("xyz", [0.4, -1.1, 2.2]).as_matrix()
    motion = SE3(turn, np.array([0.3, -0.2, 0.7]))
    for family in ("stool", "panel"):
        raw = generate(family, 1)
        moved = [RawPart(p.name, p.mesh.transformed(motion), p.label) for p in raw]
        here, there = (annotate("x", parts, ORIGIN, with_grasps=False) for parts in (raw, moved))
        assert [c.members for c in here.classes] == [c.members for c in there.classes]
        assert [len(c.symmetries) for c in here.classes] == [len(c.symmetries) for c in there.classes]
        pairs = [{(c.part_a, c.part_b) for c in f.connections} for f in (here, there)]
        assert pairs[0] == pairs[1]
        for a, b in zip(here.assembled, there.assembled, strict=True):
            assert np.allclose(motion.act(a.translation), b.translation, atol=1e-5)
        ends = {(c.part_a, c.part_b): c for c in there.connections}
        for c in here.connections:
            d = ends[c.part_a, c.part_b]
            for p, k, m in ((c.part_a, c.point_a, d.point_a), (c.part_b, c.point_b, d.point_b)):
                one, other = here.parts[p].points[k], there.parts[p].points[m]
                spot = motion.act(here.assembled[p].act(one.position))
                # Points of like parts may be taken over from one another, so they agree to what SAME_POINT allows.
                assert np.linalg.norm(spot - there.assembled[p].act(other.position)) < 5e-3
                outward = motion.rotation @ here.assembled[p].rotation @ one.normal
                assert outward @ (there.assembled[p].rotation @ other.normal) > 0.99
        assert relative_error(there) < 1e-6


def test_annotation_leaves_the_global_random_state_alone() -> None:
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    shapes.table()
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_annotation_is_deterministic() -> None:
    one, two = (annotate("a", generate("sled", 2), ORIGIN) for _ in range(2))
    for p, q in zip(one.parts, two.parts, strict=True):
        assert np.array_equal(p.mesh.vertices, q.mesh.vertices)
        for a, b in zip(p.points, q.points, strict=True):
            assert np.array_equal(a.frame.homogeneous, b.frame.homogeneous)
    assert all(np.array_equal(a.homogeneous, b.homogeneous) for a, b in zip(one.assembled, two.assembled, strict=True))


def row(count: int, step: float = 0.1) -> list[RawPart]:
    return [
        RawPart(f"p{i}", shapes.box((i * step, 0, 0), (i * step + 0.0995, 0.1 + 0.001 * i, 0.1))) for i in range(count)
    ]


def test_twenty_parts_are_fine() -> None:
    assert len(annotate("row", row(20), ORIGIN).connections) == 19


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ([], "0 parts; furniture has 2 or more"),
        (row(1), "1 part; furniture has 2 or more"),
        (row(3, step=0.2), "do not touch the rest within 5 mm: p0"),
        ([*row(2), RawPart("far", shapes.box((1, 1, 1), (1.1, 1.1, 1.1)))], "5 mm: far"),
        ([*row(2), RawPart("p1", shapes.box((0, 0, 0.1005), (0.1, 0.1, 0.2)))], "part name 'p1' is used twice"),
        ([*row(2), RawPart("in", shapes.box((0, 0, 0.05), (0.1, 0.1, 0.2)))], "'p0' and 'in' touch or penetrate"),
    ],
)
def test_invalid_raw_parts_are_refused(raw: list[RawPart], message: str) -> None:
    with pytest.raises(FurnitureError, match=message):
        annotate("thing", raw, ORIGIN)


def comb(teeth: int) -> list[RawPart]:
    """A board with many sticks upon it, of unequal thickness; the first two also lean on each other."""
    sticks = [
        RawPart(f"s{i}", shapes.box((0.05 * i, 0, 0.0005), (0.05 * i + 0.01 + 0.001 * i, 0.01, 0.2)))
        for i in range(teeth)
    ]
    bridge = RawPart("bridge", shapes.box((0.0, 0.0, 0.2005), (0.065, 0.01, 0.22)))
    return [RawPart("board", shapes.box((0, -0.1, -0.05), (1.0, 0.1, 0.0))), *sticks, bridge]


def test_the_smallest_contact_of_a_crowded_part_is_left_out() -> None:
    furniture = annotate("comb", comb(11), ORIGIN, with_grasps=False)
    assert len(furniture.parts[0].points) == PAPER_POINTS
    # The first stick is the thinnest; the bridge holds it.
    assert 1 not in furniture.neighbours[0]
    assert 1 in furniture.neighbours[12]
    assert any("'board' and 's0' left out" in note for note in furniture.provenance.notes)


def test_contacts_that_alone_hold_a_part_all_stay() -> None:
    furniture = annotate("comb", comb(12), ORIGIN, with_grasps=False)
    assert len(furniture.parts[0].points) == 11
    assert furniture.padding == (20, 11)


def test_furniture_of_more_parts_than_the_papers_keeps_all_contacts() -> None:
    """The board holds twenty sticks, and the bridge between two of them changes nothing."""
    furniture = annotate("comb", comb(20), ORIGIN, with_grasps=False)
    assert len(furniture.neighbours[0]) == 20
    assert furniture.padding == (22, 20)
    assert not furniture.provenance.notes


# Congruence


def is_group(rotations: np.ndarray) -> bool:
    products = np.einsum("aij,bjk->abik", rotations, rotations).reshape(-1, 3, 3)
    return all(min(np.abs(rotations - p).max(axis=(1, 2))) < 1e-3 for p in products)


@pytest.mark.parametrize(
    ("mesh", "size"),
    [
        (shapes.brick(0.1, 0.2, 0.3), 4),
        (shapes.brick(0.1, 0.1, 0.3), 8),
        (shapes.brick(0.1, 0.1, 0.1), 24),
        (shapes.prism(3, 0.05, 0.3), 6),
        (shapes.prism(5, 0.02, 0.3), 10),
        (shapes.prism(12, 0.02, 0.4), 24),
        (shapes.prism(16, 0.02, 0.4, top=0.015), 16),
        (shapes.prism(7, 0.02, 0.4, top=0.03), 7),
        (shapes.prism(4, 0.02, 0.3, top=0.01), 4),
        (shapes.l_shape(), 1),
        (shapes.mirrored(shapes.l_shape()), 1),
    ],
)
def test_symmetry_group_sizes(mesh: Mesh, size: int) -> None:
    turns = symmetries(mesh)
    assert len(turns) == size
    assert np.array_equal(turns[0], np.eye(3))
    assert np.allclose(np.linalg.det(turns), 1.0)
    assert is_group(turns)
    for turn in turns:
        moved = mesh.vertices @ turn.T
        assert np.linalg.norm(moved[:, None] - mesh.vertices[None], axis=2).min(axis=1).max() < 1e-4


def test_symmetries_are_limited() -> None:
    assert len(symmetries(shapes.prism(60, 0.05, 0.3))) == MAX_SYMMETRIES


def test_symmetries_do_not_depend_on_the_triangulation() -> None:
    fine = shapes.brick(0.1, 0.2, 0.3).trimesh.subdivide().subdivide()
    assert len(symmetries(Mesh.from_trimesh(fine))) == 4
    lopsided = shapes.brick(0.1, 0.1, 0.1).trimesh.subdivide(face_index=[0, 3, 7])
    assert len(symmetries(Mesh.from_trimesh(lopsided))) == 24


@pytest.mark.parametrize(
    "mesh", [shapes.l_shape(), shapes.prism(16, 0.02, 0.4, top=0.015), shapes.brick(0.1, 0.2, 0.3)]
)
@pytest.mark.parametrize("seed", range(4))
def test_a_turned_copy_is_found_exactly(mesh: Mesh, seed: int) -> None:
    turn = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    copy = mesh.transformed(SE3(turn, np.zeros(3)))
    found = rotations_onto(mesh, copy)
    assert len(found) == len(symmetries(mesh))
    # One of them is the turn itself, and every one of them lays shape onto shape.
    assert min(np.abs(found - turn).max(axis=(1, 2))) < 1e-5
    angles = Rotation.from_matrix(found).magnitude()
    assert (np.diff(angles) > -1e-5).all()


def test_a_mirror_image_is_another_shape() -> None:
    shape = shapes.l_shape()
    assert len(rotations_onto(shape, shapes.mirrored(shape))) == 0
    # A prism is its own mirror image.
    prism = shapes.prism(5, 0.02, 0.3)
    assert len(rotations_onto(prism, shapes.mirrored(prism))) == 10


@pytest.mark.parametrize(
    "other",
    [
        shapes.brick(0.1005, 0.2, 0.3),
        shapes.brick(0.1, 0.2, 0.31),
        shapes.prism(6, 0.1, 0.3),
        shapes.of_solid(
            shapes.block((-0.05, -0.1, -0.15), (0.05, 0.1, 0.15))
            - shapes.block((-0.01, -0.01, -0.01), (0.01, 0.01, 0.01))
        ),
    ],
)
def test_nearly_equal_parts_are_different(other: Mesh) -> None:
    box = shapes.brick(0.1, 0.2, 0.3)
    assert len(rotations_onto(box, other)) == 0
    assert len(rotations_onto(other, box)) == 0


@pytest.mark.parametrize(("off", "alike"), [(0.00005, True), (0.0003, False)])
def test_corners_on_an_edge_are_ignored_within_tolerance(off: float, alike: bool) -> None:
    box = shapes.brick(0.1, 0.2, 0.3)
    cut = box.trimesh.subdivide()
    vertices = np.array(cut.vertices)
    middle = np.flatnonzero(np.isclose(vertices, [0.05, 0.1, 0.0]).all(axis=1))
    vertices[middle] += [off, off, 0.0]
    bent = Mesh(vertices, np.array(cut.faces))
    assert len(rotations_onto(box, bent)) == len(rotations_onto(bent, box)) == (4 if alike else 0)


@pytest.mark.parametrize(("deep", "turns"), [(0.00005, 4), (0.0002, 1)])
def test_shallow_nicks_hide_no_symmetry(deep: float, turns: int) -> None:
    # A nick in one edge: its corners are the only ones at their distance from the centre.
    edge = shapes.block((0.05 - deep, 0.1 - deep, 0.1), (0.06, 0.11, 0.101))
    nicked = shapes.of_solid(shapes.block((-0.05, -0.1, -0.15), (0.05, 0.1, 0.15)) - edge)
    assert len(symmetries(nicked)) == turns


def test_degenerate_triangles_make_no_shapes_equal() -> None:
    # A thin board with rebated ends. Turned by half a degree its corners are 2 mm off.
    ends = shapes.block((-0.1, -0.001, -0.145), (0.1, 0.001, 0.145))
    board = shapes.of_solid(ends + shapes.block((-0.1, -0.00125, -0.14), (0.1, 0.00125, 0.14)))
    edges = board.faces[:, :2]
    middles = len(board.vertices) + np.arange(len(edges))
    with_lines = Mesh(
        np.concatenate([board.vertices, board.vertices[edges].mean(axis=1)]),
        np.concatenate([np.column_stack([edges, middles]), board.faces]),
    )
    assert len(symmetries(board)) == len(symmetries(with_lines)) == 4


def test_a_bore_through_a_board_counts() -> None:
    # Both its rims lie on faces that the turned board has, too.
    board = shapes.block((-0.2, -0.1, -0.006), (0.2, 0.1, 0.006))
    for x, y in ((-0.18, -0.08), (0.18, 0.08), (-0.18, 0.08), (0.18, -0.08)):
        board -= shapes.block((x - 0.002, y - 0.002, -0.006), (x + 0.002, y + 0.002, 0.003))
    bored = board - shapes.block((0.1, 0.05, -0.01), (0.103, 0.053, 0.01))
    assert len(symmetries(shapes.of_solid(board))) == 2
    assert len(symmetries(shapes.of_solid(bored))) == 1
    assert len(rotations_onto(shapes.of_solid(board), shapes.of_solid(bored))) == 0


def test_a_hole_to_the_middle_of_a_board_is_on_one_side() -> None:
    # Turned over, its bottom stays where it is and its rim lies on the other face.
    board = shapes.block((-0.2, -0.1, -0.006), (0.2, 0.1, 0.006))
    for x in (-0.1, 0.1):
        board -= shapes.block((x - 0.005, -0.005, 0.0), (x + 0.005, 0.005, 0.01))
    assert len(symmetries(shapes.of_solid(board))) == 2


def test_like_parts_share_a_mesh_where_there_is_room() -> None:
    # Two posts under a board; one is 0.05 mm thicker, which would close the gap to a third part beside it.
    def furniture(gap: float) -> Furniture:
        board = shapes.brick(0.4, 0.4, 0.02).transformed(SE3(np.eye(3), np.array([0.0, 0.0, 0.3102])))
        thick = shapes.brick(0.04005, 0.04, 0.6).transformed(SE3(np.eye(3), np.array([-0.1, 0.0, 0.0])))
        thin = shapes.brick(0.04, 0.04, 0.6).transformed(SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
        beside = shapes.brick(0.02, 0.1, 0.5).transformed(SE3(np.eye(3), np.array([0.13 + gap, 0.0, 0.0])))
        raw = [RawPart(n, m) for n, m in (("board", board), ("thick", thick), ("thin", thin), ("beside", beside))]
        return annotate("posts", raw, ORIGIN)

    for gap, shared in ((0.0002, True), (0.00004, False)):
        made = furniture(gap)
        assert made.class_of[1] == made.class_of[2]
        assert (made.parts[1].mesh is made.parts[2].mesh) == shared
        assert relative_error(made) < 1e-6


def bent_slat(sides: int, height: float = 0.02) -> Mesh:
    """A slat bent like an S, of many short pieces: the turn about z by half is its only symmetry."""
    along = np.linspace(-0.2, 0.2, sides + 1)
    bend = height * np.sin(along / 0.2 * np.pi) * (1 - (along / 0.2) ** 2)
    rings = [[(x, y + s * 0.006, t * 0.03) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
             for x, y in zip(along, bend, strict=True)]  # fmt: skip
    faces = [[0, 1, 2], [0, 2, 3]]
    for i in range(sides):
        for k in range(4):
            a, b = 4 * i + k, 4 * i + (k + 1) % 4
            faces += [[a, a + 4, b], [b, a + 4, b + 4]]
    last = 4 * sides
    faces += [[last, last + 2, last + 1], [last, last + 3, last + 2]]
    mesh = Mesh(np.array(rings).reshape(-1, 3), np.array(faces)[:, ::-1])
    assert mesh.is_solid
    return mesh


@pytest.mark.parametrize("sides", [8, 200])
def test_smooth_bends_count(sides: int) -> None:
    slat = bent_slat(sides)
    assert len(symmetries(slat)) == 2
    assert len(rotations_onto(slat, bent_slat(sides, 0.023))) == 0
