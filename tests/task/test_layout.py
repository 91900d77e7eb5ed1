"""How things lie on the ground: poses of rest, and room for everything."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.resting import stable_poses
from roboassembly.geometry.scene import Body, Shape
from roboassembly.simulation.settle import settle
from roboassembly.task.layout import GROUND_CLEARANCE, SPACING, free_spot, scatter_parts
from roboassembly.task.rules.groups import Circle, TaskState, footprint, group_footprint, hull_points

coordinate = st.floats(-1, 1).map(lambda x: round(x, 3))
circles = st.builds(
    lambda x, y, r: Circle(np.array([x, y]), r), coordinate, coordinate, st.floats(0.01, 0.5).map(lambda r: round(r, 3))
)


def room(spot: np.ndarray, radius: float, taken: list[Circle], spacing: float) -> float:
    return min((float(np.linalg.norm(spot - c.center)) - c.radius - radius - spacing for c in taken), default=np.inf)


@settings(max_examples=150, deadline=None)
@given(circles, st.lists(circles, max_size=7), st.sampled_from([0.0, 0.03]))
def test_free_spot_is_free_and_none_is_nearer(wanted: Circle, taken: list[Circle], spacing: float) -> None:
    spot = free_spot(wanted, taken, spacing)
    assert spot.shape == (2,)
    assert room(spot, wanted.radius, taken, spacing) > -1e-8
    away = float(np.linalg.norm(spot - wanted.center))
    # A dense search of the disc that would be nearer: rings of many points.
    angles = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    for share in np.linspace(0, 0.995, 40):
        ring = wanted.center + share * away * np.column_stack([np.cos(angles), np.sin(angles)])
        if taken:
            centers = np.array([c.center for c in taken])
            reach = np.array([c.radius for c in taken]) + wanted.radius + spacing
            gaps = (np.linalg.norm(ring[:, None] - centers[None], axis=2) - reach).min(axis=1)
            assert gaps.max() < 1e-9 or away < 1e-9


def test_free_spot_by_hand() -> None:
    here = Circle(np.zeros(2), 0.1)
    assert np.allclose(free_spot(here, []), [0, 0])
    assert np.allclose(free_spot(here, [Circle(np.array([1.0, 0]), 0.2)]), [0, 0])
    # Pushed straight away from one disc.
    assert np.allclose(free_spot(here, [Circle(np.array([0.1, 0]), 0.2)], spacing=0.0), [-0.2, 0])
    # Two discs left and right: out through the gap between their rims, 0.5 from both centres.
    walls = [Circle(np.array([-0.3, 0]), 0.4), Circle(np.array([0.3, 0]), 0.4)]
    assert np.allclose(np.abs(free_spot(here, walls, spacing=0.0)), [0, 0.4])
    # Exactly on a disc's centre: anywhere on its rim.
    spot = free_spot(here, [Circle(np.zeros(2), 0.3)], spacing=0.05)
    assert np.linalg.norm(spot) == pytest.approx(0.45)


def test_footprint_is_around_the_level_box() -> None:
    circle = footprint(np.array([[0.0, 0, 5], [3, 0, 1], [3, 4, -2]]))
    assert np.allclose(circle.center, [1.5, 2])
    assert circle.radius == pytest.approx(2.5)


def solid_angle(a: float, b: float, distance: float) -> float:
    """Of a rectangle a x b seen from `distance` before its middle."""
    return float(4 * np.arctan2(a * b, 2 * distance * np.sqrt(4 * distance**2 + a**2 + b**2)))


def test_a_box_rests_on_its_six_faces() -> None:
    sides = (0.1, 0.2, 0.3)
    rotations, likely = shapes.brick(*sides).resting_rotations
    assert likely.sum() == pytest.approx(1.0)
    down = np.array([r.T @ [0, 0, -1] for r in rotations])
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(rotations), 1.0)
    kept = likely > 1e-9
    assert kept.sum() == 6
    by_axis: dict[int, list[float]] = {0: [], 1: [], 2: []}
    for d, p in zip(down[kept], likely[kept], strict=True):
        axis = int(np.argmax(np.abs(d)))
        assert np.abs(d[axis]) == pytest.approx(1.0, abs=1e-6)
        by_axis[axis].append(float(p))
    # Dropped in a random orientation and without momentum, it ends on a face; opposite ones are as likely.
    assert all(p[0] == pytest.approx(p[1], rel=1e-6) for p in by_axis.values())
    # It tumbles from small faces to great ones, so that these are likelier than their solid angle.
    great = solid_angle(0.2, 0.3, 0.05) / (4 * np.pi)
    small = solid_angle(0.1, 0.2, 0.15) / (4 * np.pi)
    assert by_axis[0][0] >= great - 1e-6
    assert by_axis[2][0] <= small + 1e-6
    assert by_axis[0][0] > by_axis[1][0] > by_axis[2][0] > 0


def test_a_cube_rests_on_each_face_alike() -> None:
    _, likely = shapes.brick(0.1, 0.1, 0.1).resting_rotations
    assert np.allclose(np.sort(likely)[-6:], 1 / 6, atol=1e-6)


def test_a_hull_that_cannot_be_tumbled_is_with_its_corners_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    # Hulls of hundreds of corners that all but lie in a plane are not closed: nothing comes back.
    tries = []

    def first_fails(hull: trimesh.Trimesh, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tries.append(hull)
        return (np.empty((0, 3, 3)), np.empty(0)) if len(tries) == 1 else stable_poses(hull, center)

    monkeypatch.setattr("roboassembly.geometry.meshes.stable_poses", first_fails)
    rotations, likely = shapes.brick(0.1, 0.1, 0.1).resting_rotations
    assert len(tries) == 2
    assert np.allclose(np.sort(likely)[-6:], 1 / 6, atol=1e-3)
    assert np.allclose(np.abs(rotations[np.argsort(likely)[-6:], 2]).max(axis=1), 1.0, atol=1e-3)


@pytest.mark.parametrize(("family", "seed"), [("stool", 0), ("ladder", 1), ("pedestal", 0)])
def test_poses_of_rest_are_at_rest(chair, family: str, seed: int) -> None:
    """Put down so in the physics, parts stay: the likely poses at least."""
    furniture = chair(family, seed)
    for shape_class in furniture.classes:
        mesh = furniture.parts[shape_class.members[0]].mesh
        rotations, likely = mesh.resting_rotations
        best = rotations[int(np.argmax(likely))]
        low = float((mesh.hull_vertices @ best[2]).min())
        settled = settle(
            Body("part", (Shape(mesh, SE3.Identity()),), SE3(best, np.array([0, 0, 1e-4 - low])), True), 0.1
        )
        assert settled.poses[-1].rotation[2] @ best[2] > 0.99


def lowest(furniture: Furniture, state: TaskState) -> list[float]:
    return [
        float(
            (hull_points(furniture, g) @ g.world_from_furniture.rotation[2]).min()
            + g.world_from_furniture.translation[2]
        )
        for g in state.groups
    ]


@pytest.mark.parametrize("family", ["stool", "rocker", "pedestal"])
@pytest.mark.parametrize("seed", range(3))
def test_scattered_parts_lie_apart_on_the_ground(chair, family: str, seed: int) -> None:
    furniture = chair(family, 0)
    state = scatter_parts(furniture, np.random.default_rng(seed))
    assert [g.parts for g in state.groups] == [(p,) for p in range(len(furniture.parts))]
    assert all(g.slots == g.parts for g in state.groups)
    assert np.allclose(lowest(furniture, state), GROUND_CLEARANCE, atol=1e-7)
    rings = [group_footprint(furniture, g) for g in state.groups]
    for a, b in combinations(rings, 2):
        assert np.linalg.norm(a.center - b.center) >= a.radius + b.radius + SPACING - 1e-7
    for part, where in enumerate(state.part_poses):
        mesh = furniture.parts[part].mesh
        rotations, _ = mesh.resting_rotations
        # Up to a turn about the vertical it is one of the poses of rest.
        assert (rotations[:, 2] @ where.rotation[2]).max() > 1 - 1e-9
        assert np.allclose(where.rotation @ where.rotation.T, np.eye(3), atol=1e-9)


def test_scattering_is_decided_by_the_generator(table: Furniture) -> None:
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one, again, other = (scatter_parts(table, np.random.default_rng(s)).part_poses for s in (1, 1, 2))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert all(np.array_equal(a.homogeneous, b.homogeneous) for a, b in zip(one, again, strict=True))
    assert all(np.abs(a.translation - b.translation).max() > 1e-3 for a, b in zip(one, other, strict=True))


def test_scattering_draws_many_poses(table: Furniture) -> None:
    """All ways to lie and all directions come up."""
    rng = np.random.default_rng(0)
    poses = [scatter_parts(table, rng).part_poses[1] for _ in range(60)]
    flat = [p.rotation[2, 2] for p in poses]
    assert sum(abs(z) > 0.9 for z in flat) < 10  # a leg seldom stands
    yaw = np.array([np.arctan2(p.rotation[1, 2], p.rotation[0, 2]) for p in poses])
    assert len(np.unique(np.floor(yaw / (np.pi / 4)))) == 8
    where = np.array([p.translation[:2] for p in poses])
    assert (where.std(axis=0) > 0.1).all()
