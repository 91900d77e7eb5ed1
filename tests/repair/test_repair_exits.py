"""Repair keeps furniture assemblable: sockets are opened, congruent parts stay congruent, odd surfaces become solid."""

from __future__ import annotations

from itertools import combinations

import fcl
import manifold3d as m3
import numpy as np
import pytest
import trimesh

from roboassembly.errors import FurnitureError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Provenance, RawPart
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair import RepairLimits, repair
from roboassembly.repair.exits import Exits, blocking
from roboassembly.repair.proximity import Shell
from roboassembly.repair.solid import solidify
from roboassembly.repair.surface import Surface, components, patches, to_surface
from roboassembly.repair.wrap import wrap

GAP = 0.0002


def part(name, *meshes):
    mesh = trimesh.util.concatenate(meshes) if len(meshes) > 1 else meshes[0]
    return RawPart(name, Mesh(mesh.vertices, mesh.faces))


def block(size, centre):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return mesh


def fcl_object(mesh, shift=(0.0, 0.0, 0.0)):
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(mesh.vertices, mesh.faces)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform(np.asarray(shift, dtype=float)))


def collide(a, b, shift=(0.0, 0.0, 0.0)):
    one, two = fcl_object(a.mesh, shift), fcl_object(b.mesh)
    return bool(fcl.collide(one, two, fcl.CollisionRequest(), fcl.CollisionResult()))


def assert_clear(result):
    for a, b in combinations(result.parts, 2):
        assert not collide(a, b), f"{a.name} meets {b.name}"
        assert fcl.distance(fcl_object(a.mesh), fcl_object(b.mesh)) >= 0.5 * GAP - 1e-7
    assert all(p.mesh.is_solid for p in result.parts)


def captives(parts):
    shells = [Shell(Surface(p.mesh.vertices, p.mesh.faces)) for p in parts]
    graph = blocking(shells)
    everything = frozenset(range(len(parts)))
    return graph.captives(everything), Exits(shells, graph).captives(everything)


def hollow(inner, wall):
    outside = trimesh.creation.box([inner + 2 * wall] * 3)
    inside = trimesh.creation.box([inner] * 3)
    inside.invert()
    return trimesh.util.concatenate([outside, inside])


def box_with_a_keyhole():
    """A box around a cavity of 100 mm, walls of 10 mm, with a hole of 10 mm in its lid."""
    cavity = m3.Manifold.cube((0.1, 0.1, 0.1), True) + m3.Manifold.cylinder(0.1, 0.005)
    skin = to_surface(m3.Manifold.cube((0.12, 0.12, 0.12), True) - cavity)
    return RawPart("shell", Mesh(skin.vertices, skin.faces))


def test_an_enclosed_part_gets_an_opening():
    shell, core = box_with_a_keyhole(), part("core", block((0.0994, 0.0994, 0.0994), (0, 0, 0)))
    assert captives([shell, core]) == ([frozenset({0, 1})], [frozenset({0, 1})])
    result = repair([shell, core])
    assert_clear(result)
    assert captives(result.parts) == ([], [])
    trimmed = max(r.trimmed for r in result.report)
    assert trimmed == pytest.approx(0.0994**2 * 0.01 / (0.12**3 - 0.1**3), rel=0.05)
    assert any("opened so that 'core' can leave" in note for r in result.report for note in r.notes)


def test_parts_that_cannot_be_opened_are_named_in_the_refusal():
    shell, core = box_with_a_keyhole(), part("core", block((0.0994, 0.0994, 0.0994), (0, 0, 0)))
    with pytest.raises(FurnitureError, match=r"'shell', 'core' lock each other in place: .*`captive`"):
        repair([shell, core], limits=RepairLimits(trimmed=0.05))
    assert_clear(repair([shell, core], limits=RepairLimits(trimmed=0.05, captive=True)))


def test_seat_between_two_frames_can_be_put_in():
    # The frames are held apart by a seat whose ends, and by a rail whose ends, reach deep into both.
    frames = [part(f"frame {s}", block((0.04, 0.4, 0.4), (0.2 * s, 0, 0.2))) for s in (-1, 1)]
    seat = part("seat", block((0.39, 0.3, 0.03), (0, 0, 0.25)))
    rail = part("rail", trimesh.creation.cylinder(0.01, segment=[[-0.195, 0.05, 0.1], [0.195, 0.05, 0.1]]))
    result = repair([*frames, seat, rail])
    assert_clear(result)
    assert captives(result.parts) == ([], [])


def test_congruent_legs_stay_congruent():
    corners = [(x, y) for x in (-0.15, 0.15) for y in (-0.15, 0.15)]
    legs = [part(f"leg {k}", block((0.04, 0.04, 0.403), (x, y, 0.2015))) for k, (x, y) in enumerate(corners)]
    seat = part("seat", block((0.4, 0.4, 0.04), (0, 0, 0.42)))
    # A bracket too small to be trimmed itself takes a bite out of one leg.
    bracket = part("bracket", block((0.01, 0.01, 0.01), (-0.128, -0.15, 0.35)))
    result = repair([seat, *legs, bracket])
    assert_clear(result)
    volumes = [p.mesh.volume for p in result.parts[1:5]]
    assert np.ptp(volumes) < 1e-6 * volumes[0]
    furniture = annotate("stool", result.parts, Provenance("test", "", ""))
    assert max(len(c.members) for c in furniture.classes) == 4


def test_mirror_images_stay_different():
    left = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.06, 0], [0, 0, 0.03]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    right = left * [-1, 1, 1] - [0.0001, 0, 0]
    result = repair([RawPart("left", Mesh(left, faces)), RawPart("right", Mesh(right, faces[:, ::-1]))])
    assert_clear(result)
    assert not any("made like" in note for r in result.report for note in r.notes)


def test_sheet_with_a_hole_keeps_its_hole():
    ring = trimesh.creation.annulus(0.05, 0.1, 0.02)
    top = Mesh(ring.vertices, ring.faces[ring.face_normals[:, 2] > 0.9])
    solid = solidify("ring", top, 3000)
    assert solid.how == "sheet thickened"
    assert solid.body.volume() == pytest.approx(top.trimesh.area * 0.001, rel=1e-3)
    assert solid.shape_error <= 5e-4
    assert solid.body.genus() == 1


def test_a_filled_tube_reports_the_added_shape():
    tube = trimesh.creation.cylinder(0.03, height=0.2, sections=48)
    side = Mesh(tube.vertices, tube.faces[np.abs(tube.face_normals[:, 2]) < 0.5])
    solid = solidify("tube", side, 3000)
    assert solid.how == "holes filled"
    assert solid.shape_error < 1e-6
    assert 0.015 < solid.shape_added <= 0.03
    assert solid.body.volume() == pytest.approx(tube.volume, rel=1e-6)


def test_plates_with_a_common_edge_are_separated():
    one, two = block((0.1, 0.1, 0.1), (0, 0, 0)), block((0.1, 0.1, 0.1), (0.1, 0, 0.1))
    both = trimesh.util.concatenate([one, two])
    both.merge_vertices()
    surface = Surface(np.array(both.vertices), np.array(both.faces))
    assert len(components(surface)) == 1
    assert [piece.volume for piece in patches(surface)] == pytest.approx([1e-3, 1e-3])
    assert solidify("two", Mesh(surface.vertices, surface.faces), 3000).body.volume() == pytest.approx(2e-3, rel=1e-6)


def test_wrap_excludes_enclosed_space_that_is_not_inside():
    shell = hollow(0.02, 0.008)
    surface = Surface(np.array(shell.vertices), np.array(shell.faces))
    wound, _ = wrap(surface, surface)
    filled, _ = wrap(surface)
    assert wound.volume() == pytest.approx(0.036**3 - 0.02**3, rel=0.03)
    assert filled.volume() == pytest.approx(0.036**3, rel=0.03)


def test_triangles_are_bounded():
    ball = trimesh.creation.icosphere(5, 0.1)
    assert solidify("ball", Mesh(ball.vertices, ball.faces), 1000).body.num_tri() <= 1000


def tilted_prong(grow=0.0):
    """Return a slanted pin from the origin, 20 degrees off the vertical."""
    pin = m3.Manifold.cylinder(0.06, 0.008 + grow).translate((0.0, 0.0, -0.02)).rotate((0.0, 20.0, 0.0))
    return pin.trim_by_plane((0.0, 0.0, 1.0), -0.001)


def from_solid(name, body):
    skin = to_surface(body)
    return RawPart(name, Mesh(skin.vertices, skin.faces))


def slanted_joint():
    """A leg whose slanted pin sits in a slanted hole of the seat, and a wedge on the seat whose face leans as much."""
    seat = m3.Manifold.cube((0.4, 0.2, 0.02), True).translate((0.0, 0.0, 0.0101)) - tilted_prong(0.0003)
    leg = m3.Manifold.cube((0.03, 0.03, 0.3), True).translate((0.0, 0.0, -0.1501)) + (
        tilted_prong().trim_by_plane((0.0, 0.0, -1.0), -0.015)
    )
    stop = m3.Manifold.cube((0.05, 0.05, 0.05), True).rotate((0.0, 20.0, 0.0)).translate((0.15, 0.0, 0.08))
    sits = m3.Manifold.cube((0.05, 0.05, 0.05), True).rotate((0.0, 20.0, 0.0))
    along = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])
    block_on_top = sits.translate(tuple(np.array([0.15, 0.0, 0.08]) + 0.0503 * along))
    foot = m3.Manifold.cube((0.05, 0.05, 0.06), True).translate((0.15, 0.0, 0.0503))
    return [
        from_solid("seat", seat + stop + foot),
        from_solid("leg", leg),
        from_solid("block", block_on_top),
    ]


def test_directions_are_natural_only_to_the_parts_that_define_them():
    parts = slanted_joint()
    graph = blocking([Shell(Surface(p.mesh.vertices, p.mesh.faces)) for p in parts])
    along = np.array([-np.sin(np.radians(20.0)), 0.0, -np.cos(np.radians(20.0))])
    slanted = int(np.argmax(graph.directions @ along))
    assert graph.directions[slanted] @ along > 0.9999
    seat, leg, on_top = (frozenset({k}) for k in range(3))
    assert graph.is_natural(slanted, on_top, seat)
    assert not graph.is_natural(slanted, leg, seat | on_top)
    assert all(graph.is_natural(index, leg, seat) for index in range(6))


def test_a_joint_opens_in_a_natural_direction():
    parts = slanted_joint()
    ways = [(0, 0, -1), (-np.sin(np.radians(20.0)), 0, -np.cos(np.radians(20.0)))]

    def comes_out(pieces, way):
        steps = np.arange(0.0, 0.1, 0.002)[:, None] * np.array(way)
        return not any(collide(pieces[1], pieces[0], step) for step in steps)

    # As made the leg comes out along the slant only, which is the normal of a contact that has nothing to do with it.
    assert [comes_out(parts, way) for way in ways] == [False, True]
    result = repair(parts)
    assert_clear(result)
    assert comes_out(result.parts, ways[0])
    assert any("opened so that" in note for r in result.report for note in r.notes)
    assert max(r.trimmed for r in result.report) < 0.01


def test_legs_and_seat_share_an_overlap_too_large_for_either():
    # Every leg would lose 22 % if cut flush, and the seat 22 % to the four sockets; 20 % is allowed.
    seat = part("seat", block((0.24, 0.24, 0.1), (0, 0, 0.362)))
    corners = [(x, y) for x in (-0.07, 0.07) for y in (-0.07, 0.07)]
    legs = [part(f"leg {k}", block((0.06, 0.06, 0.4), (x, y, 0.2))) for k, (x, y) in enumerate(corners)]
    result = repair([seat, *legs])
    assert_clear(result)
    assert all(r.trimmed <= 0.2 for r in result.report)
    assert any("cut short where it sat too deep" in note for r in result.report for note in r.notes)
    assert captives(result.parts) == ([], [])
    # What is lost is what is missing once faces are set back by 0.15 mm, and nothing has moved.
    for before, after, report in zip([seat, *legs], result.parts, result.report, strict=True):
        size = np.ptp(before.mesh.bounds, axis=0) - 0.0003
        assert after.mesh.volume == pytest.approx((1.0 - report.trimmed) * np.prod(size), rel=1e-4)
        assert report.displacement == 0.0


def test_the_first_refusal_is_reported():
    one, two = part("one", block((0.1, 0.1, 0.1), (0, 0, 0))), part("two", block((0.1, 0.1, 0.1), (0.03, 0, 0)))
    with pytest.raises(FurnitureError, match=r"would lose 7\d\.\d% of its volume to clear"):
        repair([one, two])


@pytest.mark.slow
def test_fine_solids_are_simplified():
    ball = trimesh.creation.icosphere(6, 0.2)
    dented = ball.vertices * (1.0 + 0.004 * np.sin(40.0 * ball.vertices[:, :1]))
    solid = solidify("ball", Mesh(dented, ball.faces), 2400)
    assert solid.body.num_tri() <= 2 * 2400
    assert solid.shape_error <= 0.0015
    assert solid.body.volume() == pytest.approx(Mesh(dented, ball.faces).volume, rel=0.01)
