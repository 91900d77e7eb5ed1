"""Orders for people: the same merges, each checked by the planner and by the audit, the smaller half moving."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plans import plan_digest
from roboassembly.audit.object_centric import audit_plan
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.manual.arrangement import ArrangedPlan, ManualError, arrange, building_order
from roboassembly.manual.exits import Handling
from roboassembly.manual.merge_tree import Halves, equalised, tree_of
from roboassembly.solvers.search import solve
from shapes import GAP, block, box, furniture, interlocked, of_solid


def arranged(piece: Furniture, seed: int = 0) -> ArrangedPlan:
    plan = solve(piece, seed).plan
    assert plan.success
    return arrange(piece, tree_of(piece, [s.action for s in plan.steps]), seed)


def set_of(*parts: int) -> frozenset[int]:
    return frozenset(parts)


def two_frames() -> Furniture:
    """A board on two equal frames of two posts and a rail: 0 board; 1, 2 and 3 one frame; 4, 5 and 6 the other."""
    parts = {"board": box((-0.4, -0.2, 0.3 + GAP), (0.4, 0.2, 0.33 + GAP))}
    for side, x in (("left", -0.3), ("right", 0.3)):
        for end, y in (("front", -0.15), ("back", 0.15)):
            parts[f"{side}_{end}"] = box((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.3))
        parts[f"{side}_rail"] = box((x - 0.015, -0.13 + GAP, 0.1), (x + 0.015, 0.13 - GAP, 0.14))
    return furniture("two frames", parts)


@pytest.mark.parametrize(
    ("family", "seed"),
    [
        ("shelf_open", 0),
        ("bench", 2),
        *(pytest.param(*piece, marks=pytest.mark.slow) for piece in (("ladder", 0), ("stool", 4))),
    ],
)
def test_an_arrangement_joins_everything_and_passes_the_audit(chair, family: str, seed: int) -> None:
    piece = chair(family, seed)
    result = arranged(piece)
    parts = len(piece.parts)
    assert len(result.merges) == len(result.trees.tree) == parts - 1
    assert {m.choice.halves.merged for m in result.merges} == set(result.trees.tree)
    assert set_of(*range(parts)) in result.trees.tree
    # The checker of python-fcl finds every step of the new order free, too.
    assert audit_plan(result.plan).passed
    for merge in result.merges:
        halves = merge.choice.halves
        assert result.trees.tree[halves.merged] in (halves, halves.swapped)
        assert frozenset(merge.step.moving) == halves.moving
        assert frozenset(merge.step.waiting) == halves.waiting


@pytest.mark.slow
def test_the_same_plan_gives_the_same_arrangement(chair) -> None:
    assert plan_digest(arranged(chair("ladder", 0)).plan) == plan_digest(arranged(chair("ladder", 0)).plan)


def test_legs_come_from_above_onto_a_top_that_lies_upside_down(table: Furniture) -> None:
    result = arranged(table)
    for merge in result.merges:
        assert 0 in merge.choice.halves.waiting
        assert len(merge.choice.halves.moving) == 1
        assert merge.choice.up == 1  # the furniture's z axis points down
        out = merge.way[1].translation
        assert out / np.linalg.norm(out) == pytest.approx([0, 0, -1], abs=1e-6)


def test_equal_frames_are_built_alike_and_directly_after_each_other() -> None:
    piece = two_frames()
    names = [p.name for p in piece.parts]
    board, lf, lb, lr, rf, rb, rr = (
        names.index(n)
        for n in ("board", "left_front", "left_back", "left_rail", "right_front", "right_back", "right_rail")
    )
    left, right = set_of(lf, lb, lr), set_of(rf, rb, rr)
    tree = [
        Halves(set_of(lr), set_of(lf)),
        Halves(set_of(lb), set_of(lf, lr)),
        Halves(left, set_of(board)),
        # The other one from its other end.
        Halves(set_of(rf), set_of(rr)),
        Halves(set_of(rb), set_of(rf, rr)),
        Halves(right, left | {board}),
    ]
    same = equalised(piece, {h.merged: h for h in tree})
    assert same.equals(left) == [left, right] or same.equals(left) == [right, left]
    assert len(same.tree) == 6
    # The order of the first one, carried over.
    first, other = same.equals(left)
    made, copied = same.tree[first], same.tree[other]
    assert (len(made.moving), len(made.waiting)) == (len(copied.moving), len(copied.waiting))
    order = building_order(same)
    assert order.index(other) == order.index(first) + 1
    result = arrange(piece, {h.merged: h for h in tree}, 0)
    assert audit_plan(result.plan).passed


def test_a_tree_of_a_plan_speaks_of_slots(chair) -> None:
    piece = chair("ladder", 0)
    plan = solve(piece, 0).plan
    tree = tree_of(piece, [s.action for s in plan.steps])
    assert len(tree) == len(plan.steps)
    for merged, halves in tree.items():
        assert halves.moving | halves.waiting == merged
        assert not halves.moving & halves.waiting
        assert any(piece.neighbours[p] & halves.waiting for p in halves.moving)


@pytest.mark.parametrize("wrong", [(0, 0, 0, 0, 0), (0, 1, 99, 0, 0), (77, 1, 0, 0, 0)])
def test_actions_that_name_nothing_are_refused(table: Furniture, wrong: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="step 0: action"):
        tree_of(table, [wrong])


def test_an_unfinished_plan_is_refused(table: Furniture) -> None:
    plan = solve(table, 0).plan
    with pytest.raises(InputError, match="ends with 3 separate groups"):
        tree_of(table, [s.action for s in plan.steps[:2]])


def test_parts_that_cannot_come_together_have_no_manual() -> None:
    piece = interlocked()
    with pytest.raises(ManualError, match="'two' and 'one'"):
        arrange(piece, {set_of(0, 1): Halves(set_of(0), set_of(1))}, 0)


def test_a_brick_stands_until_its_center_is_over_its_edge() -> None:
    piece = furniture(
        "bricks", {"low": box((0, 0, 0), (0.1, 0.3, 0.2)), "high": box((0, 0, 0.2 + GAP), (0.1, 0.3, 0.4))}
    )
    handling = Handling(piece, 0)
    # 0.1 m wide and 0.2 m high: it falls when tilted by atan(0.05 / 0.1).
    assert handling.tipping(set_of(0), 0) == pytest.approx(np.arctan2(0.05, 0.1), abs=1e-6)
    assert handling.tipping(set_of(0), 4) == pytest.approx(np.arctan2(0.05, 0.15), abs=1e-6)
    assert handling.stands(set_of(0, 1), 0)


def test_a_pin_does_not_stand_and_a_leaning_frame_lies() -> None:
    pin = block((-0.01, -0.01, 0.0), (0.01, 0.01, 0.5))
    lean = of_solid(block((0.1, -0.1, 0.0), (0.14, 0.1, 0.5)).rotate((0.0, 8.0, 0.0)))
    piece = furniture(
        "odd", {"pin": of_solid(pin), "lean": lean, "bridge": box((0.01 + GAP, -0.01, 0.0), (0.1, 0.01, 0.02))}
    )
    handling = Handling(piece, 0)
    index = [p.name for p in piece.parts].index
    assert not handling.stands(set_of(index("pin")), 0)
    # Turned by 8 degrees it rests flat on its broad side, not on an edge.
    assert handling.stands(set_of(index("lean")), 2)


def test_the_half_with_the_larger_hull_waits() -> None:
    # A frame waits for a rod that is longer than it is.
    frame = block((0, 0, 0), (0.8, 0.4, 0.05)) - block((0.05, 0.05, -1), (0.75, 0.35, 1))
    parts = {"frame": of_solid(frame), "rod": box((0.02, 0.01, 0.05 + GAP), (0.03, 0.02, 1.0))}
    piece = furniture("rod and frame", parts)
    handling = Handling(piece, 0)
    index = [p.name for p in piece.parts].index
    rod, whole = set_of(index("rod")), set_of(index("frame"))
    assert handling.size(rod) == pytest.approx(2 * 0.01**2 + 4 * 0.01 * (0.95 - GAP), rel=1e-4)
    assert handling.size(whole) == pytest.approx(2 * (0.8 * 0.4 + 0.8 * 0.05 + 0.4 * 0.05), rel=1e-4)
    for halves in (Halves(rod, whole), Halves(whole, rod)):
        (merge,) = arrange(piece, {rod | whole: halves}, 0).merges
        assert merge.choice.halves.moving == rod


def test_directions_out_of_a_pocket(captive_slat: Furniture) -> None:
    handling = Handling(captive_slat, 0)
    slat, left = (next(i for i, p in enumerate(captive_slat.parts) if p.name == n) for n in ("slat", "left"))
    out = handling.directions(Halves(set_of(slat), set_of(left)))
    assert [d.tolist() for d in out] == [[1.0, 0.0, 0.0]]
    assert handling.directions(Halves(set_of(left), set_of(slat))).tolist() == [[-1.0, 0.0, 0.0]]


def test_a_dead_end_of_the_plan_is_not_entered(captive_slat: Furniture) -> None:
    result = arranged(captive_slat)
    order = [m.choice.halves for m in result.merges]
    slat, board = (next(i for i, p in enumerate(captive_slat.parts) if p.name == n) for n in ("slat", "board"))
    # The slat joins both posts before these stand in the board.
    last = order[-1]
    assert {frozenset(last.moving), frozenset(last.waiting)} >= {set_of(board)} or slat in last.merged
    assert audit_plan(result.plan).passed
    assert not audit_plan(replace(result.plan, initial=(SE3.Identity(), *result.plan.initial[1:]))).passed
