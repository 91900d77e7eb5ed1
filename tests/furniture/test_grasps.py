"""Grasps: shapes with known answers, and every region of generated furniture checked again by other means."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterator

import manifold3d
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import shapes
from hands import FclHand, check_region
from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import furniture_hash
from roboassembly.envs.observation import Observer
from roboassembly.errors import MissingRobotError
from roboassembly.furniture import storage
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.grasps import find_grasps
from roboassembly.furniture.model import Furniture, GraspRegion, Provenance, RawPart
from roboassembly.furniture.opposite_sides import MAX_WIDTH
from roboassembly.generate import CHAIRS, FAMILIES
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, rotations_from_euler
from roboassembly.robots import gripper
from roboassembly.robots.gripper import MAX_OPENING, HandAgainst, hand_bodies, hand_pose, panda_folder

SEEDS = [0, pytest.param(3, marks=pytest.mark.slow)]


def distinct(furniture: Furniture) -> Iterator[tuple[Mesh, tuple[GraspRegion, ...]]]:
    for shape_class in furniture.classes:
        part = furniture.parts[shape_class.members[0]]
        yield part.mesh, part.grasps


def test_square_bar_is_held_at_its_centre() -> None:
    one, two = find_grasps(shapes.brick(0.04, 0.04, 0.6))
    assert one.width == pytest.approx(0.04, abs=1e-6)
    assert two.width == pytest.approx(0.04, abs=1e-6)
    assert np.abs(one.position).max() < 1e-6
    assert abs(two.position[2]) == pytest.approx(0.15, abs=0.02)
    for region in (one, two):
        assert np.abs(region.closing).max() == pytest.approx(1.0)
        assert abs(region.closing[2]) < 1e-9
        # From the two free sides, and along the bar only from its ends, which are too far.
        assert np.abs(region.approaches[:, 2]).max() < 0.99


@pytest.mark.parametrize("edge", [0.0765, 0.1])
def test_cube_wider_than_the_jaw_cannot_be_held(edge: float) -> None:
    assert find_grasps(shapes.brick(edge, edge, edge)) == ()


def test_cube_just_within_the_jaw_can_be_held() -> None:
    assert [r.width for r in find_grasps(shapes.brick(0.07, 0.07, 0.07))] == pytest.approx([0.07, 0.07])
    assert MAX_WIDTH < 0.0765


def test_board_is_held_at_opposite_edges_from_outside() -> None:
    one, two = find_grasps(shapes.brick(0.5, 0.5, 0.03))
    for region in (one, two):
        assert region.width == pytest.approx(0.03, abs=1e-6)
        assert abs(region.closing[2]) == pytest.approx(1.0)
        out = region.position * (np.abs(region.position) > 0.25 - gripper.PALM_DEPTH)
        assert np.linalg.norm(out) > 0
        # The hand comes towards the board's middle.
        assert (region.approaches @ out < 0).all()
    assert one.position @ two.position < 0


def test_upholstered_seat_cannot_be_held() -> None:
    assert find_grasps(shapes.brick(0.5, 0.5, 0.12)) == ()


def test_sphere_is_held_along_two_axes() -> None:
    ball = Mesh.from_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=0.025))
    one, two = find_grasps(ball)
    for region in (one, two):
        assert region.width == pytest.approx(0.05, abs=1e-3)
        assert np.linalg.norm(region.position) < 2e-3
    assert np.degrees(np.arccos(abs(one.closing @ two.closing))) >= 45.0 - 1e-6


def test_tube_is_held_across_its_hollow() -> None:
    outer, inner = (manifold3d.Manifold.cylinder(0.3, r, r, 64, center=True) for r in (0.03, 0.025))
    for region in find_grasps(shapes.of_solid(outer - inner)):
        assert region.width == pytest.approx(0.06, abs=1e-3)
        assert np.abs(region.position[:2]).max() < 2e-3
    assert len(find_grasps(shapes.of_solid(outer - inner))) == 2


def test_wedge_slips() -> None:
    # A long triangular prism: its sides lean by 60°, its ends are 30 cm apart.
    assert find_grasps(shapes.prism(3, 0.04, 0.3)) == ()


def test_sides_that_lean_little_are_held_along_their_mean() -> None:
    tapered = shapes.prism(4, 0.025, 0.4, top=0.035)
    regions = find_grasps(tapered)
    assert len(regions) == 2
    checker = FclHand(tapered)
    for region in regions:
        check_region(tapered, region, checker)
        assert abs(region.closing[2]) < 0.02


def test_turned_shape_has_as_many_grasps() -> None:
    rng = np.random.default_rng(3)
    for edges in ((0.04, 0.06, 0.4), (0.4, 0.3, 0.02), (0.05, 0.05, 0.05)):
        turn = SE3(Rotation.random(random_state=rng).as_matrix(), np.zeros(3))
        mesh = shapes.brick(*edges).transformed(turn)
        regions = find_grasps(mesh)
        assert len(regions) == 2
        checker = FclHand(mesh)
        for region in regions:
            check_region(mesh, region, checker)


def left_free(around: Mesh, region: GraspRegion) -> np.ndarray:
    n = len(region.approaches)
    places = (np.tile(region.position, (n, 1)), np.tile(region.closing, (n, 1)), region.approaches)
    return ~HandAgainst(around).touches(*places, MAX_OPENING, coming=True)


def test_regions_are_where_the_furniture_has_room_for_a_hand() -> None:
    rod = shapes.brick(0.02, 0.7, 0.02)
    collar = shapes.of_solid(
        shapes.block((-0.04, -0.22, -0.04), (0.04, 0.22, 0.04))
        - shapes.block((-0.011, -1.0, -0.011), (0.011, 1.0, 0.011))
    )
    assert not any(left_free(collar, region).any() for region in find_grasps(rod))
    one, two = find_grasps(rod, [collar])
    assert np.linalg.norm(one.position) < 0.05
    assert left_free(collar, two).any()
    assert abs(two.position[1]) > 0.22


def test_directions_free_in_the_furniture_come_first() -> None:
    rod, wall = shapes.brick(0.02, 0.3, 0.02), shapes.box((-0.3, -0.3, 0.011), (0.3, 0.3, 0.05))
    for region in find_grasps(rod, [wall]):
        if abs(region.closing[0]) > 0.9:
            # From below and level; never more than the rest from above, through the wall.
            assert region.approaches[0, 2] > -0.3
            assert left_free(wall, region)[0]


def test_same_mesh_same_grasps_whatever_the_global_seed() -> None:
    def numbers(seed: int) -> list[bytes]:
        np.random.seed(seed)  # noqa: NPY002
        mesh = shapes.l_shape(0.3)
        return [np.concatenate([r.position, r.closing, *r.approaches, [r.width]]).tobytes() for r in find_grasps(mesh)]

    assert numbers(0) == numbers(1) != []


def test_regions_are_ranked_by_distance_to_the_centre_of_mass(chair) -> None:
    for mesh, regions in distinct(chair("ladder", 3)):
        assert len(regions) == 2, mesh.bounds
        assert np.linalg.norm(regions[0].position) <= np.linalg.norm(regions[1].position)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_region_holds_by_an_independent_checker(chair, family: str, seed: int) -> None:
    for mesh, regions in distinct(chair(family, seed)):
        checker = FclHand(mesh)
        for region in regions:
            check_region(mesh, region, checker)


@pytest.mark.parametrize("seed", SEEDS)
def test_nearly_all_parts_of_generated_chairs_have_two_regions(chair, seed: int) -> None:
    held = [len(part.grasps) == 2 for family in CHAIRS for part in chair(family, seed).parts]
    assert np.mean(held) >= 0.95


def test_equal_parts_share_grasps(chair) -> None:
    furniture = chair("ladder", 3)
    for shape_class in furniture.classes:
        assert len({id(furniture.parts[m].grasps) for m in shape_class.members}) == 1


@pytest.fixture(scope="module")
def cushioned() -> Furniture:
    """A block that no hand can hold, on a bar that any can."""
    raw = [
        RawPart("cushion", shapes.box((-0.25, -0.25, 0.0405), (0.25, 0.25, 0.16))),
        RawPart("bar", shapes.box((-0.02, -0.2, 0.0), (0.02, 0.2, 0.04))),
    ]
    return annotate("cushioned", raw, Provenance("test"))


def test_furniture_without_grasps_is_the_same_in_all_else(chair) -> None:
    whole, bare = chair("windsor", 0), catalogue.make("windsor", 0, with_grasps=False)
    assert not any(p.grasps for p in bare.parts)
    assert all(p.grasps for p in whole.parts)
    assert furniture_hash(bare) == furniture_hash(whole)
    for a, b in zip(bare.parts, whole.parts, strict=True):
        assert [p.frame.homogeneous.tolist() for p in a.points] == [p.frame.homogeneous.tolist() for p in b.points]
    assert bare.connections == whole.connections


def test_parts_that_no_hand_can_hold_are_named(cushioned: Furniture, chair) -> None:
    assert cushioned.unholdable == ("cushion",)
    assert chair("ladder", 3).unholdable == ()


def test_grasps_are_saved_and_loaded(cushioned: Furniture, tmp_path) -> None:
    loaded = storage.load(storage.save(cushioned, tmp_path / "piece"))
    assert loaded.unholdable == ("cushion",)
    for ours, theirs in zip(cushioned.parts[1].grasps, loaded.parts[1].grasps, strict=True):
        for field in ("position", "closing", "approaches", "width"):
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))


def test_observation_holds_the_frame_of_the_hand(cushioned: Furniture) -> None:
    rows = Observer(cushioned, 20, 10, 16)._grasps
    assert rows.shape == (20, 2, 4, 6)
    assert not rows[0].any()
    assert not rows[2:].any()
    for four, region in zip(rows[1], cushioned.parts[1].grasps, strict=True):
        for row, approach in zip(four, region.approaches, strict=True):
            tips = hand_pose(region.position, region.closing, approach)
            np.testing.assert_allclose(row[:3], tips.translation, atol=1e-6)
            np.testing.assert_allclose(rotations_from_euler(row[3:].astype(float)), tips.rotation, atol=1e-6)


def test_hand_has_the_size_of_the_real_one() -> None:
    for opening in (0.0, 0.03, MAX_OPENING):
        palm, left, right = (mesh.transformed(pose).bounds for mesh, pose in hand_bodies(opening))
        # The finger's own mesh stands out of the pad by 0.1 mm.
        assert left[0, 1] - right[1, 1] == pytest.approx(opening, abs=3e-4)
        assert left[1, 2] == pytest.approx(0.0095, abs=1e-3)
        assert palm[1, 2] == pytest.approx(-gripper.PALM_DEPTH, abs=1e-4)
        assert palm[1, 1] - palm[0, 1] == pytest.approx(0.204, abs=2e-3)


def test_whole_approach_is_tested() -> None:
    # A thin plate 70 mm behind the finger tips: free where the hand ends, in the way of its coming only for a slit.
    plate = shapes.box((-0.2, -0.2, 0.05), (0.2, 0.2, 0.0501))
    hand = HandAgainst(plate)
    where = {"positions": np.zeros((1, 3)), "closing": np.eye(3)[[1]], "approach": np.eye(3)[[2]], "opening": 0.04}
    # The hand comes along +z from below and stops short of the plate ...
    assert not hand.touches(**where)[0]
    assert not hand.touches(**where, coming=True)[0]
    # ... or from above, through it.
    from_above = where | {"approach": -np.eye(3)[[2]], "positions": np.array([[0.0, 0.0, -0.09]])}
    assert not hand.touches(**(from_above | {"positions": np.array([[0.0, 0.0, -0.1]])}))[0]
    assert hand.touches(**(from_above | {"positions": np.array([[0.0, 0.0, -0.1]])}), coming=True)[0]


def test_missing_wheel_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    def nowhere(name: str):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", nowhere)
    with pytest.raises(MissingRobotError, match=r"'example-robot-data' is not installed; .*pip install"):
        panda_folder()

    class Empty:
        def locate_file(self, path: str):
            return tmp_path / path

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Empty())
    with pytest.raises(MissingRobotError, match=str(tmp_path)):
        panda_folder()
