"""Which parts of nearly one shape are interchangeable: by hand-made marks, tenons and cuts, judged by python-fcl."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import fcl
import manifold3d as m3
import numpy as np
import pytest

from roboassembly.audit.object_centric import audit_plan
from roboassembly.furniture import storage
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.exchange import LEAST_CLEARANCE
from roboassembly.furniture.model import NEAR, Furniture, Provenance, RawPart
from roboassembly.furniture.near_shapes import NearShape
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.solvers.search import solve
from roboassembly.task.rules.groups import Group
from roboassembly.task.rules.pairs import PairRule
from shapes import LEGS, block, box, brick, fcl_object, l_shape, least_distance, of_solid, pose, turn

CLEARANCE = 0.0002
"""Distance between the parts, as repair leaves it [m]."""


def furniture(solids: dict[str, m3.Manifold], *, near: bool = True, grasps: bool = False) -> Furniture:
    raw = [RawPart(name, of_solid(solid)) for name, solid in solids.items()]
    return annotate("made", raw, Provenance("test"), with_grasps=grasps, with_near_shapes=near)


def classes(made: Furniture) -> set[tuple[int, ...]]:
    return {c.members for c in made.classes}


def marked_table() -> dict[str, m3.Manifold]:
    """A top on four legs of 40 x 40 x 400 mm; each has its number engraved, so many squares of 6 mm, 1 mm deep."""
    solids = {"top": block((-0.3, -0.2, 0.4 + CLEARANCE), (0.3, 0.2, 0.43))}
    for number, (x, y) in enumerate(LEGS):
        leg = block((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.4))
        for square in range(number + 1):
            low = 0.1 + 0.01 * square
            leg -= block((x - 0.003, y + 0.019, low), (x + 0.003, y + 0.021, low + 0.006))
        solids[f"leg{number}"] = leg
    return solids


def clearances(made: Furniture, meshes: list[Mesh]) -> float:
    """Least distance of the parts in their slots with other meshes, by python-fcl; 0 if some penetrate."""
    placed = [fcl_object(mesh, slot) for mesh, slot in zip(meshes, made.assembled, strict=True)]
    return least_distance(placed)


def test_legs_that_differ_by_marks_are_one_class() -> None:
    solids = marked_table()
    assert classes(furniture(solids, near=False)) == {(0,), (1,), (2,), (3,), (4,)}
    made = furniture(solids)
    assert classes(made) == {(0,), (1, 2, 3, 4)}
    # Each keeps its own mesh: 40 x 40 x 400 mm less its squares of 36 mm³.
    for number in range(4):
        assert made.parts[1 + number].mesh.volume == pytest.approx(6.4e-4 - (number + 1) * 3.6e-8, abs=2e-9)
        assert np.allclose(made.parts[1 + number].mesh.bounds, made.parts[1].mesh.bounds, atol=1e-5)
        placed = made.parts[1 + number].mesh.transformed(made.assembled[1 + number])
        x, y = LEGS[number]
        assert np.allclose(placed.bounds, [[x - 0.02, y - 0.02, 0.0], [x + 0.02, y + 0.02, 0.4]], atol=1e-6)
    for order in permutations(range(1, 5)):
        meshes = [made.parts[0].mesh, *(made.parts[p].mesh for p in order)]
        assert clearances(made, meshes) == pytest.approx(CLEARANCE, abs=1e-5)


def test_a_marked_leg_goes_to_every_corner_and_is_itself_there() -> None:
    made = furniture(marked_table())
    rule = PairRule(made)
    top = Group((0,), (0,), (made.assembled[0],), SE3.Identity())
    ends = {c.part_b: (c.point_a, c.point_b) for c in made.connections}
    for leg, corner in product(range(1, 5), range(1, 5)):
        own = Group((leg,), (leg,), (made.assembled[leg],), SE3.Identity())
        merge = rule.judge(own, top, leg, ends[leg][1], 0, ends[corner][0])
        assert merge is not None
        placed = [
            fcl_object(made.parts[p].mesh, f) for p, f in zip((0, leg), merge.merged.furniture_from_part, strict=True)
        ]
        assert not fcl.collide(*placed, fcl.CollisionRequest(), fcl.CollisionResult())
        gap = fcl.distance(*placed, fcl.DistanceRequest(), fcl.DistanceResult())
        assert gap == pytest.approx(CLEARANCE, abs=1e-5)


def test_the_planner_assembles_exchanged_parts_and_the_audit_agrees() -> None:
    made = furniture(marked_table())
    meshes = [made.parts[p].mesh for p in (0, 2, 1, 4, 3)]
    exchanged = replace(made, parts=tuple(replace(p, mesh=m) for p, m in zip(made.parts, meshes, strict=True)))
    plan = solve(exchanged, seed=0).plan
    assert plan.success
    assert audit_plan(plan).passed


@pytest.mark.parametrize(("wider", "same"), [(0.0, True), (0.00005, True), (0.0002, False), (0.001, False)])
def test_a_thicker_tenon_does_not_fit_a_narrower_socket(wider: float, same: bool) -> None:
    # Tenons of 20 mm, 0.2 mm of clearance around them; the second tenon and socket are wider on every side. The wider
    # tenon in the other socket keeps 0.2 mm less that.
    top = block((-0.3, -0.1, 0.4 + CLEARANCE), (0.3, 0.1, 0.44))
    solids = {"top": top}
    for name, x, more in (("one", -0.2, 0.0), ("other", 0.2, wider)):
        half = 0.01 + more
        socket = half + CLEARANCE
        solids["top"] -= block((x - socket, -socket, 0.39), (x + socket, socket, 0.42 + CLEARANCE))
        leg = block((x - 0.02, -0.02, 0.0), (x + 0.02, 0.02, 0.4))
        solids[name] = leg + block((x - half, -half, 0.39), (x + half, half, 0.42))
        # Marks of two sizes, 0.5 mm deep, make them unequal in any case.
        solids[name] -= block((x - 0.003, 0.0195, 0.1), (x + 0.003, 0.03, 0.11 if name == "one" else 0.12))
    made = furniture(solids)
    assert ((1, 2) in classes(made)) == same


def shelf(lip: bool) -> dict[str, m3.Manifold]:
    """A board of 400 x 100 x 20 mm between two posts; repair cut a strip of 2.5 mm off one lower edge of its end.

    With a lip, the post beside the cut reaches into it.
    """
    board = block((-0.2, -0.05, 0.0), (0.2, 0.05, 0.02)) - block((0.19, -0.06, -0.01), (0.21, 0.06, 0.0025))
    posts = {
        name: block((low, -0.02, -0.3), (low + 0.04, 0.02, 0.3))
        for name, low in (("left", -0.24 - CLEARANCE), ("right", 0.2 + CLEARANCE))
    }
    if lip:
        posts["right"] += block((0.192, -0.02, -0.03), (0.22, 0.02, 0.0025 - CLEARANCE))
    return {"board": board, **posts}


def test_a_board_may_be_turned_if_only_the_cut_of_repair_says_no() -> None:
    rigid, free, barred = (
        furniture(shelf(lip), near=near) for lip, near in ((False, False), (False, True), (True, True))
    )
    # Without the cut it has four symmetries: the identity and half a turn about each axis. The cut leaves one about x
    # or none; the turns about y and z bring the cut to the other post, which has no lip.
    assert len(rigid.classes[rigid.class_of[0]].symmetries) == 1
    assert len(free.classes[free.class_of[0]].symmetries) == 4
    assert len(barred.classes[barred.class_of[0]].symmetries) == 1
    board = free.parts[0]
    for rotation in free.classes[free.class_of[0]].symmetries:
        turned = board.mesh.transformed(SE3(rotation, np.zeros(3)))
        assert clearances(free, [turned, *(p.mesh for p in free.parts[1:])]) == pytest.approx(CLEARANCE, abs=2e-5)


def test_the_frame_lies_in_the_middle_of_the_turns() -> None:
    made = furniture(shelf(False))
    # The board's centre of mass is off the middle, which is at height 10 mm.
    assert np.allclose(made.assembled[0].translation, [0.0, 0.0, 0.01], atol=1e-4)
    cut = 0.01 * 0.1 * 0.0025
    whole = 0.4 * 0.1 * 0.02
    off = -cut * 0.195 / (whole - cut)
    assert made.parts[0].center_of_mass[0] == pytest.approx(off, abs=1e-4)


def test_the_best_fit_is_moved_where_neighbours_need_it() -> None:
    # Posts of 40 and 40.4 mm, each 0.2 mm beside a stop at x = 0. With equal middles, the thicker one in the place of
    # the thinner one would touch the stop. A notch at the top leaves them no symmetry.
    base = block((-0.1, -0.1, -0.02), (0.1, 0.6, -CLEARANCE))
    solids = {"base": base}
    for name, y, width in (("thin", 0.0, 0.04), ("thick", 0.4, 0.0404)):
        solids[name] = block((CLEARANCE, y, 0.0), (CLEARANCE + width, y + 0.05, 0.3))
        solids[name] -= block((0.02, y - 0.01, 0.2), (0.06, y + 0.01, 0.4))
        solids[f"stop {name}"] = block((-0.03 - 0.01 * (y > 0), y, 0.0), (0.0, y + 0.05, 0.1))
    made = furniture(solids)
    assert (1, 3) in classes(made)
    meshes = [p.mesh for p in made.parts]
    meshes[1], meshes[3] = meshes[3], meshes[1]
    assert clearances(made, meshes) > LEAST_CLEARANCE - 1e-6


def test_nearly_equal_parts_that_would_penetrate_are_no_class() -> None:
    # The posts are equal up to 0.04 mm on either side, so that their shapes count as congruent, but each stands 0.04 mm
    # from walls on both sides.
    def made(near: bool) -> Furniture:
        solids = {"base": block((-0.3, -0.1, -0.02), (0.3, 0.1, -CLEARANCE))}
        for name, x, width in (("thick", -0.1, 0.04008), ("thin", 0.1, 0.04)):
            solids[name] = block((x - width / 2, -0.02, 0.0), (x + width / 2, 0.02, 0.3))
            walls = width / 2 + 0.00004
            solids[f"{name} walls"] = block((x - walls - 0.02, -0.05, 0.0), (x + walls + 0.02, 0.05, 0.25)) - block(
                (x - walls, -0.06, -0.01), (x + walls, 0.06, 0.26)
            )
            solids[f"{name} walls"] += block(
                (x - walls - 0.02, -0.05, 0.0), (x + walls + 0.02, -0.045 - 0.001 * (x > 0), 0.25)
            )
        return furniture(solids, near=near)

    assert (1, 3) in classes(made(False))
    assert (1, 3) not in classes(made(True))


def test_nearly_equal_parts_have_grasps_of_their_own() -> None:
    # Legs of 40 and 41 mm: the hand closes on either to its own width.
    solids = {"top": block((-0.3, -0.2, 0.4 + CLEARANCE), (0.3, 0.2, 0.43))}
    for name, x, width in (("thin", -0.2, 0.04), ("thick", 0.2, 0.041)):
        solids[name] = block((x - width / 2, -width / 2, 0.0), (x + width / 2, width / 2, 0.4))
    made = furniture(solids, grasps=True)
    assert (1, 2) in classes(made)
    for part, width in ((1, 0.04), (2, 0.041)):
        assert [g.width for g in made.parts[part].grasps] == pytest.approx([width] * 2, abs=1e-5)


def test_storage_keeps_nearly_equal_parts(tmp_path: Path) -> None:
    made = furniture(marked_table())
    loaded = storage.load(storage.save(made, tmp_path / "made"))
    assert classes(loaded) == classes(made)
    for part, other in zip(made.parts, loaded.parts, strict=True):
        assert part.mesh.content_hash == other.mesh.content_hash


def test_motions_onto_a_nearly_equal_shape() -> None:
    bar = NearShape(brick(0.3, 0.05, 0.02))
    # A cuboid has four rotations onto itself, and no more onto one that is 2 mm longer, here moved and turned.
    where = pose(0.4, 0.1, 0.2, turn((1, 2, 3), 0.7))
    longer = NearShape(brick(0.302, 0.05, 0.02).transformed(where))
    motions = bar.motions_onto(longer)
    rotations = [where.rotation.T @ motion.rotation for motion in motions]
    assert {tuple(np.round(np.diag(r)).astype(int).tolist()) for r in rotations} == {
        (1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)
    }  # fmt: skip
    for motion in motions:
        assert np.allclose(motion.translation, where.translation, atol=2e-4)
        assert np.allclose(np.abs(where.rotation.T @ motion.rotation), np.eye(3), atol=0.02)
    # 8 mm longer, every end is 4 mm off.
    assert not bar.motions_onto(NearShape(brick(0.308, 0.05, 0.02)))
    assert all(
        np.allclose(m.homogeneous, np.eye(4), atol=1e-3)
        for m in NearShape(l_shape()).motions_onto(NearShape(l_shape()))
    )
    assert NEAR == 0.003
    # Of a small part, 3 mm would be another shape: 5 % of its longest side counts.
    assert NearShape(box((0, 0, 0), (0.02, 0.01, 0.005))).limit == pytest.approx(0.001)
