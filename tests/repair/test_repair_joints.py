"""Repair preserves joints: tenons, dowels, housings and wedges keep their depth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import fcl
import manifold3d as m3
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import RawPart
from roboassembly.repair import RepairLimits, repair
from shapes import block, of_solid

SIDE = 0.0015
"""Sideways shift of a tongue that tests whether the socket still holds it [m]."""


@dataclass(frozen=True)
class Joint:
    """Tongue in a socket, with its known figures."""

    parts: tuple[RawPart, ...]
    tongue: int
    socket: int
    out: Sequence[float]
    """Direction in which the tongue leaves."""
    depth: float
    """Depth of the tongue in the socket [m]."""
    across: Sequence[Sequence[float]]
    """Directions in which the socket holds the tongue."""


def joint(solids: dict[str, m3.Manifold], tongue: str, socket: str, out, depth: float, across) -> Joint:
    names = list(solids)
    parts = tuple(RawPart(name, of_solid(solid)) for name, solid in solids.items())
    return Joint(parts, names.index(tongue), names.index(socket), out, depth, across)


def rod(radius: float, low: float, high: float) -> m3.Manifold:
    return m3.Manifold.cylinder(high - low, radius, radius, 24).translate((0, 0, low))


def mortise_and_tenon(blind: bool, clearance: float) -> Joint:
    c, depth = clearance, 0.025
    plate, deep = (0.04, depth + c) if blind else (depth, depth + 0.01)
    hole = block((-0.015 - c, -0.01 - c, -0.01), (0.015 + c, 0.01 + c, deep))
    leg = block((-0.02, -0.02, -0.4), (0.02, 0.02, 0)) + block((-0.015, -0.01, -0.005), (0.015, 0.01, depth))
    seat = block((-0.2, -0.2, 0), (0.2, 0.2, plate)) - hole
    return joint({"seat": seat, "leg": leg}, "leg", "seat", (0, 0, -1), depth, [(1, 0, 0), (0, 1, 0)])


def round_tenon(blind: bool, clearance: float) -> Joint:
    c, depth = clearance, 0.025
    plate, deep = (0.04, depth + c) if blind else (depth, depth + 0.01)
    seat = block((-0.2, -0.2, 0), (0.2, 0.2, plate)) - rod(0.01 + c, -0.01, deep)
    leg = rod(0.02, -0.4, 0) + rod(0.01, -0.005, depth)
    return joint({"seat": seat, "leg": leg}, "leg", "seat", (0, 0, -1), depth, [(1, 0, 0), (0, 1, 0)])


def dowel(blind: bool, clearance: float) -> Joint:
    c, depth = clearance, 0.02
    top = block((-0.1, -0.03, 0), (0.1, 0.03, 0.06)) - rod(0.004 + c, -0.01, depth + c)
    low = block((-0.1, -0.03, -0.07), (0.1, 0.03, 0)) - rod(0.004 + c, -(depth + c) if blind else -0.08, 0.01)
    pin = rod(0.004, -depth if blind else -0.07, depth)
    return joint({"top": top, "low": low, "pin": pin}, "pin", "top", (0, 0, -1), depth, [(1, 0, 0), (0, 1, 0)])


def dado(blind: bool, clearance: float) -> Joint:
    c, depth = clearance, 0.008
    wide, half = (0.1 + c, 0.1) if blind else (0.2, 0.15)
    side = block((-0.02, -0.15, -0.3), (0, 0.15, 0.3)) - block((-depth - c, -wide, -0.01 - c), (0.01, wide, 0.01 + c))
    shelf = block((0, -0.15, -0.01), (0.4, 0.15, 0.01)) + block((-depth, -half, -0.01), (0.005, half, 0.01))
    across = [(0, 0, 1), (0, 1, 0)] if blind else [(0, 0, 1)]
    return joint({"side": side, "shelf": shelf}, "shelf", "side", (1, 0, 0), depth, across)


def wedge(blind: bool, clearance: float) -> Joint:
    """A rail's tenon passes through a post; a wedge through the tenon holds it there, or ends in it."""
    c, low = clearance, -0.012 if blind else -0.05

    def tapered(y: float, bottom: float, front: float, more: float) -> m3.Manifold:
        ends = [(front, bottom), (0.03 + 0.009 + more, bottom), (front, 0.05), (0.03 + 0.012 + more, 0.05)]
        return m3.Manifold.hull_points(np.array([[x, s * y, z] for x, z in ends for s in (-1, 1)]))

    post = block((0, -0.03, -0.3), (0.03, 0.03, 0.3)) - block((-0.01, -0.01 - c, -0.02 - c), (0.04, 0.01 + c, 0.02 + c))
    tenon = block((-0.4, -0.02, -0.03), (0, 0.02, 0.03)) + block((-0.005, -0.01, -0.02), (0.055, 0.01, 0.02))
    rail = tenon - tapered(0.004 + c, low - c if blind else low, 0.028, c)
    solids = {"post": post, "rail": rail, "wedge": tapered(0.004, low, 0.03, 0)}
    return joint(solids, "wedge", "rail", (0, 0, 1), 0.02 - low, [(0, 1, 0)])


KINDS: list[Callable[[bool, float], Joint]] = [mortise_and_tenon, round_tenon, dowel, dado, wedge]


def fcl_object(part: RawPart, shift: np.ndarray) -> fcl.CollisionObject:
    model = fcl.BVHModel()
    model.beginModel(len(part.mesh.vertices), len(part.mesh.faces))
    model.addSubModel(part.mesh.vertices, part.mesh.faces)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform(shift))


def hits(part: RawPart, other: RawPart, shift: np.ndarray) -> bool:
    objects = fcl_object(part, shift), fcl_object(other, np.zeros(3))
    return bool(fcl.collide(*objects, fcl.CollisionRequest(), fcl.CollisionResult()))


def held(made: Joint, parts: Sequence[RawPart], drawn: float) -> bool:
    """Return whether the socket holds the tongue on all sides after it moves out by a distance [m]."""
    tongue, socket = parts[made.tongue], parts[made.socket]
    at = drawn * np.array(made.out, dtype=float)
    sides = [sign * SIDE * np.array(way, dtype=float) for way in made.across for sign in (1, -1)]
    return all(hits(tongue, socket, at + side) for side in sides)


def assert_joint_is_kept(made: Joint) -> None:
    result = repair(made.parts)
    assert not hits(result.parts[made.tongue], result.parts[made.socket], np.zeros(3))
    # Held a millimetre before its tip leaves the socket, as far as it was delivered.
    for drawn in (0.0, 0.5 * made.depth, made.depth - 0.001):
        assert held(made, result.parts, drawn), f"loose after {drawn * 1e3:.1f} of {made.depth * 1e3:.1f} mm"
    assert not held(made, result.parts, made.depth + 0.001)
    # And it can be drawn out.
    way = np.array(made.out, dtype=float)
    for drawn in np.arange(0.0, made.depth + 0.01, 0.001):
        assert not hits(result.parts[made.tongue], result.parts[made.socket], drawn * way)
    for before, after, done in zip(made.parts, result.parts, result.report, strict=True):
        change = np.ptp(after.mesh.vertices, axis=0) - np.ptp(before.mesh.vertices, axis=0)
        assert np.abs(change).max() < 0.001
        assert abs(done.size_change) < 0.001
        assert done.depth_losses == ()


@pytest.mark.parametrize("blind", [True, False], ids=["blind", "through"])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize(
    "clearance",
    [
        pytest.param(0.0, id="touching"),
        pytest.param(0.00005, id="tight", marks=pytest.mark.slow),
        pytest.param(-0.0005, id="overlapping"),
    ],
)
def test_joint_keeps_its_depth(kind, blind, clearance):
    assert_joint_is_kept(kind(blind, clearance))


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(st.sampled_from(KINDS), st.booleans(), st.floats(-0.0005, 0.0003))
def test_any_joint_keeps_its_depth(kind, blind, clearance):
    assert_joint_is_kept(kind(blind, clearance))


def test_a_leg_deep_in_a_solid_seat_gets_a_socket():
    seat, leg = block((-0.2, -0.2, 0), (0.2, 0.2, 0.04)), block((-0.015, -0.01, -0.4), (0.015, 0.01, 0.025))
    made = joint({"seat": seat, "leg": leg}, "leg", "seat", (0, 0, -1), 0.025, [(1, 0, 0), (0, 1, 0)])
    assert_joint_is_kept(made)


def stacked(overlap: float) -> list[RawPart]:
    """Return two overlapping blocks with the same footprint: one of them must become shorter."""
    low, high = block((0, 0, 0), (0.1, 0.1, 0.3)), block((0, 0, 0.3 - overlap), (0.1, 0.1, 0.5))
    return [RawPart("low", of_solid(low)), RawPart("high", of_solid(high))]


def test_a_part_that_becomes_smaller_is_named():
    low, high = repair(stacked(0.003)).report
    assert low.size_change == pytest.approx(-0.0032, abs=2e-5)
    assert low.changes[0] == "3.2 mm smaller than delivered"
    # Faces are set back by 0.15 mm; then low loses 2.9 mm.
    assert high.size_change == pytest.approx(-0.0003, abs=1e-6)
    assert high.changes == ("sits 2.9 mm less deep in 'low'",)


def test_faces_stay_where_moving_them_would_be_refused():
    # Two blocks that just touch: set back, both are 0.3 mm smaller all round; cut, only one is, by 0.2 mm.
    result = repair(stacked(0.0), limits=RepairLimits(shortening=0.00025))
    assert sorted(done.size_change for done in result.report) == pytest.approx([-0.0002, 0.0], abs=2e-5)


def test_a_part_that_becomes_too_small_is_refused():
    with pytest.raises(FurnitureError, match=r"part '(low|high)' would .* 7\.9 mm .*`shortening`.*--allow-shortening"):
        repair(stacked(0.008))
    result = repair(stacked(0.008), limits=RepairLimits(shortening=float("inf")))
    assert min(done.size_change for done in result.report) == pytest.approx(-0.0082, abs=2e-5)
