"""Grasps by flanges, rims, sheets and bent sides, where flat sides of the whole part give fewer than two regions."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

import shapes
from hands import FclHand, check_region
from roboassembly.furniture import grasps
from roboassembly.furniture.grasps import find_grasps
from roboassembly.furniture.jaws import EvenJaw, UnevenJaw
from roboassembly.furniture.model import GraspRegion
from roboassembly.furniture.opposite_sides import Places, opposite_sides, within_reach
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.robots.gripper import HandAgainst


def even_regions(mesh: Mesh) -> list[GraspRegion]:
    """Return what the hand finds between flat sides, at some places where it is tried."""
    rays, hand = Rays(mesh), HandAgainst(mesh)
    jaw, places = EvenJaw(hand, ()), opposite_sides(mesh.trimesh, rays)
    places = places[within_reach(rays, places)]
    places = places[np.linspace(0, len(places.width) - 1, min(16, len(places.width))).astype(int)]
    directions, free = jaw.approaches(places)
    found = (jaw.closed_on(places[np.array([i])], directions[i], free[i]) for i in range(len(places.width)))
    return [region for region in found if region is not None]


def check_regions(mesh: Mesh) -> tuple[GraspRegion, ...]:
    """Check that only the uneven search holds a part, and that what it finds holds; return it."""
    assert even_regions(mesh) == []
    regions = find_grasps(mesh)
    assert regions
    for region in regions:
        check_region(mesh, region, FclHand(mesh), fan=5.0, uneven=True)
    return regions


def grooved(groove: float) -> Mesh:
    """Return a block of 200 x 200 x 300 mm with a groove 70 mm deep beside a flange of 18 mm, open upwards."""
    block = shapes.block((0.0, 0.0, 0.0), (0.2, 0.2, 0.3))
    solid = block - shapes.block((0.018, -1.0, 0.23), (0.018 + groove, 1.0, 1.0))
    mesh = shapes.of_solid(solid)
    return mesh.transformed(shapes.pose(*(-mesh.center_of_mass)))


def test_flange_beside_a_groove_is_pinched() -> None:
    """Pads of the fully open hand are 80/2 - 18/2 = 31 mm from the flange, in the block beyond the groove; those of a
    hand that opens 20 mm wider than the flange, and 2 mm more, are 11 mm from it."""
    mesh = grooved(0.03)
    low, high = mesh.bounds
    for region in check_regions(mesh):
        assert region.width == pytest.approx(0.018, abs=3e-4)
        assert np.abs(region.closing[0]) == pytest.approx(1.0, abs=1e-3)
        assert region.position[0] == pytest.approx(low[0] + 0.009, abs=3e-4)
        # In the flange, down to where the tips, 9.5 mm beyond the middle of the pads, meet the ground of the groove.
        assert high[2] - 0.07 + 0.009 < region.position[2] < high[2]


def test_groove_that_is_too_narrow_for_a_finger_is_no_grasp() -> None:
    """Pads 11 mm from the flange would be in the block."""
    assert find_grasps(grooved(0.0105)) == ()


def test_sheet_of_fibreboard_is_held_by_its_edges() -> None:
    mesh = shapes.brick(0.4, 0.3, 0.0006)
    for region in check_regions(mesh):
        assert region.width == pytest.approx(0.0006, abs=3e-4)
        assert np.abs(region.closing[2]) == pytest.approx(1.0)


def test_tray_is_held_across_its_hollow() -> None:
    """Two sheets of 2 mm, 30 mm apart outside, that only their ends connect: the rays from between them hit nothing."""
    outside, inside = shapes.block((-0.3, -0.015, -0.05), (0.3, 0.015, 0.05)), (0.298, 0.013, 1.0)
    mesh = shapes.of_solid(outside - shapes.block(tuple(-x for x in inside), inside))
    regions = find_grasps(mesh)
    assert len(regions) == 2
    for region in regions:
        check_region(mesh, region, FclHand(mesh), fan=5.0, uneven=True)
    assert any(r.width == pytest.approx(0.03, abs=3e-4) for r in regions)


def test_bent_stile_is_held_with_two_rims_in_its_hollow_side() -> None:
    """A quarter of a tube, 20 to 32 mm from its axis. A pad, 17.5 mm wide, rests on its rims in the hollow: its middle
    is 20 - sqrt(20² - 8.75²) = 2.0 mm above the side, and up to 3.5 mm if the hand is turned about the closing axis."""
    tube = manifold3d.Manifold.cylinder(0.16, 0.032, 0.032, 64, center=True)
    tube -= manifold3d.Manifold.cylinder(1.0, 0.020, 0.020, 64, center=True)
    quarter = shapes.of_solid(tube ^ shapes.block((0.0, 0.0, -1.0), (1.0, 1.0, 1.0)))
    mesh = quarter.transformed(shapes.pose(*(-quarter.center_of_mass)))
    axis = -quarter.center_of_mass[:2]
    bent = []
    for region in check_regions(mesh):
        out = region.position[:2] - axis
        out /= np.linalg.norm(out)
        if abs(region.closing[:2] @ out) > 0.9:
            bent.append(region)
            assert 0.012 + 0.0017 < region.width < 0.012 + 0.0035 + 5e-4
    assert bent


def test_a_finger_that_something_else_stops_does_not_hold() -> None:
    """A stem of 10 mm between two discs of 28 mm, 16 mm apart: pads, 18.5 mm long, stop at the discs."""
    stem = manifold3d.Manifold.cylinder(0.016, 0.005, 0.005, 32)
    disc = manifold3d.Manifold.cylinder(0.1, 0.014, 0.014, 32)
    mesh = shapes.of_solid(stem + disc.translate((0.0, 0.0, -0.1)) + disc.translate((0.0, 0.0, 0.016)))
    jaw = UnevenJaw(HandAgainst(mesh), (), Rays(mesh))
    middle, closing = np.array([[0.0, 0.0, 0.008]]), np.array([[1.0, 0.0, 0.0]])
    place = Places(middle, closing, np.array([0.01]), np.array([0.5]))
    directions, free = jaw.approaches(place)
    assert free[0].sum() >= 4
    assert jaw.closed_on(place, directions[0], free[0]) is None
    # Twice as far apart, they let the pads in.
    mesh = shapes.of_solid(
        manifold3d.Manifold.cylinder(0.032, 0.005, 0.005, 32) + disc.translate((0.0, 0.0, -0.1))
        + disc.translate((0.0, 0.0, 0.032))
    )  # fmt: skip
    jaw = UnevenJaw(HandAgainst(mesh), (), Rays(mesh))
    place = Places(np.array([[0.0, 0.0, 0.016]]), closing, np.array([0.01]), np.array([0.5]))
    directions, free = jaw.approaches(place)
    region = jaw.closed_on(place, directions[0], free[0])
    assert region is not None
    assert region.width == pytest.approx(0.01, abs=3e-4)


def test_parts_with_two_flat_grasps_are_not_searched_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*_: object) -> UnevenJaw:
        raise AssertionError("two regions are enough")

    monkeypatch.setattr(grasps, "UnevenJaw", search)
    assert len(find_grasps(shapes.brick(0.04, 0.04, 0.6))) == 2
    with pytest.raises(AssertionError, match="enough"):
        find_grasps(shapes.brick(0.5, 0.5, 0.12))
