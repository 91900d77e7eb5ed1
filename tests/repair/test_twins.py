"""Parts of nearly one shape can leave each other's sockets."""

from __future__ import annotations

import fcl
import manifold3d as m3
import numpy as np
import pytest

from roboassembly import repair as repairing
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Provenance, RawPart
from roboassembly.repair import RepairResult, repair
from shapes import block, of_solid

APART = 0.12
"""Distance between the two legs [m]."""
DEPTH = 0.025
"""Depth of the tenons in the top [m]."""


def key(height: float, along_y: bool, more: float = 0.0) -> m3.Manifold:
    """A key so far beyond the tenon, 11 to 15 mm up, with `more` room around it [m]."""
    low, high = np.array([0.0, -0.002, 0.011]) - more, np.array([0.01 + height, 0.002, 0.015]) + more
    made = block(low.tolist(), high.tolist())
    return made.rotate((0, 0, 90)) if along_y else made


def rod(radius: float, low: float, high: float) -> m3.Manifold:
    return m3.Manifold.cylinder(high - low, radius, radius, 48).translate((0, 0, low))


def table(height: float) -> tuple[RawPart, ...]:
    """A top with two legs in bayonet sockets, whose keys point along x and along y.

    Either leg has room in the other one's socket, in a ring around all keys. Only the leg's own key has a groove out of
    the ring.
    """
    gap = 0.0005
    top = block((-0.1, -0.1, 0), (0.22, 0.1, 0.04))
    legs: list[m3.Manifold] = []
    for x, along_y in ((0.0, False), (APART, True)):
        leg = block((-0.02, -0.015, -0.3), (0.02, 0.015, -gap)) + rod(0.01, -0.005, DEPTH) + key(height, along_y)
        groove = m3.Manifold.hull(key(height, along_y, gap) + key(height, along_y, gap).translate((0, 0, -0.02)))
        ring = rod(0.011 + height, 0.011 - gap, 0.015 + gap)
        socket = rod(0.01 + gap, -0.01, DEPTH + gap) + groove + ring
        top -= socket.translate((x, 0, 0))
        legs.append(leg.translate((x, 0, 0)))
    solids = {"top": top, "first": legs[0], "second": legs[1]}
    return tuple(RawPart(name, of_solid(solid)) for name, solid in solids.items())


def hits(part: RawPart, other: RawPart, shift: tuple[float, float, float]) -> bool:
    objects = [fcl.BVHModel(), fcl.BVHModel()]
    for model, mesh in zip(objects, (part.mesh, other.mesh), strict=True):
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
    moved = fcl.CollisionObject(objects[0], fcl.Transform(np.array(shift)))
    return bool(fcl.collide(moved, fcl.CollisionObject(objects[1]), fcl.CollisionRequest(), fcl.CollisionResult()))


def stuck(result: RepairResult) -> list[str]:
    """Names of the legs that cannot be drawn out of the other one's socket."""
    top, first, second = result.parts
    ways = ((first, APART), (second, -APART))
    return [leg.name for leg, x in ways if any(hits(leg, top, (x, 0, -z)) for z in np.arange(0.0, 0.03, 0.001))]


def classes(result: RepairResult) -> list[tuple[int, ...]]:
    furniture = annotate("table", result.parts, Provenance("test"), with_grasps=False, with_near_shapes=True)
    return [c.members for c in furniture.classes]


def test_legs_that_differ_in_a_key_leave_both_sockets() -> None:
    result = repair(table(0.002))
    assert stuck(result) == []
    assert classes(result) == [(0,), (1, 2)]
    report = {part.name: part for part in result.report}
    assert report["top"].notes[-2:] == (
        "opened for 'second' in the place of 'first'", "opened for 'first' in the place of 'second'"
    )  # fmt: skip
    assert [report[name].trimmed for name in ("first", "second")] == [0.0, 0.0]
    # The sockets still hold their legs on all sides, down to the last millimetre.
    top, first, second = result.parts
    for own in (first, second):
        for drawn in (0.0, DEPTH - 0.001):
            for side in ((0.0015, 0), (-0.0015, 0), (0, 0.0015), (0, -0.0015)):
                assert hits(own, top, (*side, -drawn))


def test_without_openings_each_leg_is_stuck_in_the_other_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repairing, "open_for_twins", lambda *_: False)
    result = repair(table(0.002))
    assert stuck(result) == ["first", "second"]
    # They count as interchangeable all the same, because both have room.
    assert classes(result) == [(0,), (1, 2)]


def test_sockets_are_not_opened_for_other_shapes() -> None:
    """Keys of 6 mm, which differ by more than marks do, make two different legs."""
    result = repair(table(0.006))
    assert stuck(result) == ["first", "second"]
    assert classes(result) == [(0,), (1,), (2,)]
