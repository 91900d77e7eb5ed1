"""Remedies that start where repair would refuse: hand-made double surfaces and volumes, panels, and thin wires."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import manifold3d as m3
import numpy as np
import pytest

import roboassembly.repair
from roboassembly.errors import FurnitureError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Provenance, RawPart
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair import GAP, RepairLimits, RepairResult, repair
from roboassembly.solvers.search import solve
from shapes import block, box, fcl_object, least_distance, of_solid, pose

ALONE = pose()


def with_triangles(mesh: Mesh, corners: Sequence[Sequence[Sequence[float]]]) -> Mesh:
    """A mesh with more triangles, given by their corners."""
    points = np.array(corners, dtype=float).reshape(-1, 3)
    faces = len(mesh.vertices) + np.arange(len(points)).reshape(-1, 3)
    return Mesh(np.concatenate([mesh.vertices, points]), np.concatenate([mesh.faces, faces]))


def refusal(parts: Sequence[RawPart], monkeypatch: pytest.MonkeyPatch, limits: RepairLimits | None = None) -> str:
    """The error of repair without remedies."""
    with monkeypatch.context() as patch:
        patch.setattr(roboassembly.repair, "REMEDIES", ())
        with pytest.raises(FurnitureError) as error:
            repair(parts, limits=limits)
    return str(error.value)


def clearance(result: RepairResult) -> float:
    """Between all parts, by python-fcl; 0 if some penetrate."""
    placed = [fcl_object(part.mesh, ALONE) for part in result.parts]
    return least_distance(placed)


def test_what_is_not_refused_gets_no_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("a remedy was tried")

    monkeypatch.setattr(roboassembly.repair, "REMEDIES", (forbidden,))
    parts = [RawPart("board", box((0, 0, 0), (0.4, 0.2, 0.02))), RawPart("post", box((0, 0, 0.0), (0.04, 0.04, 0.4)))]
    assert len(repair(parts).parts) == 2


def board_and_post(sheet: bool) -> list[RawPart]:
    """A board of two pieces that sits 20 mm deep in a post; the post also has the face between the two, as a sheet."""
    near, far = box((0.02, 0.0, 0.0), (0.3, 0.2, 0.02)), box((0.3, 0.0, 0.0), (0.4, 0.2, 0.02))
    board = with_triangles(near, far.vertices[far.faces].tolist())
    post = box((0.0, -0.02, -0.2), (0.04, 0.22, 0.3))
    if sheet:
        a, b, c, d = (0.3, 0.05, 0.0), (0.3, 0.11, 0.0), (0.3, 0.11, 0.02), (0.3, 0.05, 0.02)
        post = with_triangles(post, [[a, b, c], [a, c, d]])
    return [RawPart("board", board), RawPart("post", post)]


def test_a_doubled_surface_is_left_to_one_part(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = board_and_post(sheet=True)
    # The sheet would become a plate of 1 mm inside the board, and go when the post gets its socket. With it the post
    # reaches to 0.3005 m, without it to 0.04 m.
    assert "part 'post' would become 260.5 mm smaller" in refusal(parts, monkeypatch)
    result = repair(parts)
    plain = repair(board_and_post(sheet=False))
    for part, other in zip(result.parts, plain.parts, strict=True):
        assert np.allclose(part.mesh.bounds, other.mesh.bounds, atol=1e-6)
        assert part.mesh.volume == pytest.approx(other.mesh.volume, rel=1e-6)
    assert "12 cm² of sheets and fins dropped that lie on other parts" in result.report[1].notes
    assert result.report[0].notes == plain.report[0].notes
    assert clearance(result) == pytest.approx(GAP, rel=0.3)


def test_a_fin_of_a_side_that_the_other_part_lacks_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    # A shelf without its right side, which touches a rail of 40 mm. One triangle of the rail's open side went to the
    # shelf: it stands 10 mm above it.
    shelf = box((0.0, 0.0, 0.0), (0.4, 0.3, 0.02))
    right = (shelf.vertices[shelf.faces][:, :, 0] > 0.399).all(axis=1)
    open_shelf = Mesh(shelf.vertices, shelf.faces[~right])
    fin = [[(0.4, 0.0, 0.02), (0.4, 0.3, 0.02), (0.4, 0.3, 0.03)]]
    rail = box((0.4, 0.0, -0.01), (0.42, 0.3, 0.03))
    left = (rail.vertices[rail.faces][:, :, 0] < 0.401).all(axis=1)
    parts = [RawPart("shelf", with_triangles(open_shelf, fin)), RawPart("rail", Mesh(rail.vertices, rail.faces[~left]))]
    assert "part 'shelf' would become 10.3 mm smaller" in refusal(parts, monkeypatch)
    result = repair(parts)
    assert np.allclose(result.parts[0].mesh.bounds, [[0, 0, 0], [0.4, 0.3, 0.02]], atol=1.5 * GAP)
    assert result.parts[0].mesh.volume == pytest.approx(0.3997 * 0.2997 * 0.0197, rel=2e-3)
    assert "15 cm² of sheets and fins dropped that lie on other parts" in result.report[0].notes


SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))


def star() -> list[RawPart]:
    """A column of 60 x 60 x 200 mm that also has its four arms, of 30 x 30 x 300 mm, inside the legs of 32 x 32 mm."""
    column = block((-0.03, -0.03, 0.0), (0.03, 0.03, 0.2))
    legs: dict[str, m3.Manifold] = {}
    for number, (x, y) in enumerate(SIDES):
        for half, target in ((0.015, None), (0.016, f"leg{number}")):
            low = np.array([0.03, -half, 0.05 - half])
            arm = m3.Manifold.cube((0.3, 2 * half, 2 * half)).translate(tuple(low))
            arm = arm.rotate((0.0, 0.0, float(np.degrees(np.arctan2(y, x)))))
            if target is None:
                column += arm
            else:
                legs[target] = arm
    return [RawPart("column", of_solid(column)), *(RawPart(name, of_solid(leg)) for name, leg in legs.items())]


def test_a_doubled_volume_goes_to_the_part_whose_rest_would_be_a_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = star()
    # Each arm is 15 % of the column with its arms (7.2e-4 + 4 x 2.7e-4 m³), and 88 % of its leg.
    assert parts[0].mesh.volume == pytest.approx(1.8e-3)
    assert "of its volume to clear" in refusal(parts, monkeypatch)
    result = repair(parts)
    column, *legs = result.parts
    assert np.allclose(column.mesh.bounds, [[-0.03, -0.03, 0.0], [0.03, 0.03, 0.2]], atol=2 * GAP)
    assert column.mesh.volume == pytest.approx(7.2e-4, rel=0.01)
    for leg in legs:
        assert leg.mesh.volume == pytest.approx(0.3 * 0.032**2, rel=0.01)
    # What the column lost the legs have: the finished piece has its volume but for the gaps.
    whole = 7.2e-4 + 4 * 0.3 * 0.032**2
    assert sum(part.mesh.volume for part in result.parts) == pytest.approx(whole, rel=0.01)
    note = "60% of its volume left to 'leg0', 'leg1', 'leg2', 'leg3', which had it, too"
    assert note in result.report[0].notes
    # The report has the change of size, in the smallest box, which lies across: its sides are the sums of the arms'
    # reach and half width, and the column's diagonal.
    assert result.report[0].size_change == pytest.approx(0.06 * 2**0.5 - (0.33 + 0.015) * 2**0.5, abs=0.002)
    assert clearance(result) >= 0.5 * GAP
    assert solve(annotate("star", result.parts, Provenance("test")), seed=0).plan.success


def test_misplaced_parts_are_no_doubled_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two cubes of 100 mm, 50 mm apart: half of either is in the other, with its end up to 50 mm below the surface.
    parts = [RawPart(name, box((x, 0, 0), (x + 0.1, 0.1, 0.1))) for name, x in (("one", 0.0), ("other", 0.05))]
    without = refusal(parts, monkeypatch)
    with pytest.raises(FurnitureError) as error:
        repair(parts)
    assert str(error.value) == without


def panels(other: bool) -> list[RawPart]:
    """Two panels of 300 x 200 x 3 mm on a block, 2 mm in each other; with `other`, a block also lies on top."""
    parts = {
        "block": box((0.0, 0.0, -0.05), (0.3, 0.2, 0.0)),
        "lower": box((0.0, 0.0, 0.0), (0.3, 0.2, 0.003)),
        "upper": box((0.0, 0.0, 0.001), (0.3, 0.2, 0.004)),
    }
    if other:
        parts["top"] = box((0.0, 0.0, 0.004), (0.3, 0.2, 0.05))
    return [RawPart(name, mesh) for name, mesh in parts.items()]


def test_a_panel_moves_out_of_another_part(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = panels(other=False)
    assert "of its volume to clear" in refusal(parts, monkeypatch)
    result = repair(parts)
    # The upper one goes up by the 2 mm of the overlap and the gap; downward, the lower one would run into the block.
    # Then all faces are set back by 0.15 mm.
    assert result.report[1].shift == (0.0, 0.0, 0.0)
    assert result.report[2].shift == pytest.approx((0.0, 0.0, 0.002 + GAP), abs=1e-5)
    assert result.parts[2].mesh.bounds[:, 2] == pytest.approx([0.00335, 0.00605], abs=1e-5)
    assert result.parts[2].mesh.volume == pytest.approx(0.2997 * 0.1997 * 0.0027, rel=1e-3)
    assert "moved 2.2 mm across its faces, out of 'lower'" in result.report[2].notes
    assert clearance(result) == pytest.approx(1.5 * GAP, rel=0.05)


def test_a_panel_does_not_move_where_it_would_overlap_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = panels(other=True)
    without = refusal(parts, monkeypatch)
    with pytest.raises(FurnitureError) as error:
        repair(parts)
    # The reason is that of the first refusal.
    assert str(error.value) == without


@pytest.mark.slow
def test_thin_wires_keep_their_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    # A frame with 20 round bars of 1.2 mm, bent like a wave. With 800 triangles it could only be wrapped, 1.1 mm off.
    frame = block((0.0, 0.0, 0.0), (0.3, 0.3, 0.02)) - block((0.02, 0.02, -0.01), (0.28, 0.28, 0.03))
    for number in range(20):
        x = 0.03 + 0.0125 * number
        steps = np.linspace(0.01, 0.29, 15)
        spots = [(x + 0.004 * np.sin(40.0 * y), y, 0.01) for y in steps.tolist()]
        balls = [m3.Manifold.sphere(0.0006, 8).translate(spot) for spot in spots]
        bars = [m3.Manifold.batch_hull([a, b]) for a, b in itertools.pairwise(balls)]
        frame += m3.Manifold.batch_boolean(bars, m3.OpType.Add)
    parts = [RawPart("frame", of_solid(frame)), RawPart("block", box((0.0, 0.0, -0.05), (0.3, 0.3, 0.0)))]
    limits = RepairLimits(faces=1000, shape_error=0.0008)
    assert "(limit `shape_error`)" in refusal(parts, monkeypatch, limits)
    result = repair(parts, limits=limits)
    assert result.report[0].shape_error < 0.0005
    assert result.report[0].how == "as delivered"
    # All faces are set back by 0.15 mm.
    assert result.parts[0].mesh.volume == pytest.approx(frame.volume() - 0.00015 * frame.surface_area(), rel=0.02)
