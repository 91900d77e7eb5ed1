"""Tests of the ways of sub-assemblies out of each other."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import shapes
from roboassembly.audit.object_centric import audit_plan
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance
from roboassembly.generate import generate
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Scene
from roboassembly.solvers.blocking import BlockingGraphs
from roboassembly.solvers.disassembly import Disassembly
from roboassembly.solvers.exits import ExitPlanner
from roboassembly.solvers.options import upright
from roboassembly.solvers.search import solve
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.connections import UP_AXES, Rules
from shapes import Checker

CASE, FOOT, KEY = 0, 1, 2


def cased(opening: float) -> Furniture:
    """A key at one end of a channel in a case with a foot; at the other end, 0.1 m away, the channel opens upward.

    The key is 0.1 m wide, so that it leaves through a wider opening only [m].
    """
    c = shapes.GAP
    case = shapes.block((-0.1, -0.1, 0.0), (0.2, 0.1, 0.15))
    case -= shapes.block((-0.05 - c, -0.05 - c, 0.05 - c), (0.15 + c, 0.05 + c, 0.10 + c))
    case -= shapes.block((0.15 - opening - c, -0.05 - c, 0.05), (0.15 + c, 0.05 + c, 1.0))
    parts = {
        "case": shapes.of_solid(case),
        "foot": shapes.box((-0.1, -0.1, -0.1 - c), (0.2, 0.1, -c)),
        "key": shapes.box((-0.05, -0.05, 0.05), (0.05, 0.05, 0.10)),
    }
    return shapes.furniture("cased", parts)


def exits_of(furniture: Furniture) -> ExitPlanner:
    return ExitPlanner(Rules(furniture), BlockingGraphs(furniture), 0)


def parts(*of: int) -> frozenset[int]:
    return frozenset(of)


def test_a_way_around_a_corner_is_free() -> None:
    furniture = cased(0.12)
    exits = exits_of(furniture)
    assert exits.separable(parts(KEY), parts(CASE), 1_000)
    motions = exits.motions(parts(KEY), parts(CASE))
    assert np.allclose(motions[0].homogeneous, np.eye(4), atol=1e-9)
    key = shapes.mover(furniture.parts[KEY].mesh)
    still = shapes.still("case", furniture.parts[CASE].mesh, furniture.assembled[CASE])
    path = [motion * furniture.assembled[KEY] for motion in motions]
    assert not Checker(Scene((key, still), ground=False)).path_hits(path, 0.002)
    # The case is at most 0.3 m wide.
    assert np.linalg.norm(motions[-1].translation) > 0.3
    for motion, other in zip(motions, exits.motions(parts(CASE), parts(KEY)), strict=True):
        assert np.allclose((motion * other).homogeneous, np.eye(4), atol=1e-9)


def test_straight_exits_need_no_motions(table: Furniture) -> None:
    exits = exits_of(table)
    assert exits.separable(parts(1), parts(0), 1_000)
    assert exits.motions(parts(1), parts(0)) == ()


def test_what_holds_two_sub_assemblies_holds_larger_ones() -> None:
    exits = exits_of(cased(0.09))
    assert not exits.separable(parts(KEY), parts(CASE), 500)
    spent = exits.states
    assert spent > 0
    assert not exits.separable(parts(CASE, FOOT), parts(KEY), 500)
    assert not exits.separable(parts(KEY), parts(CASE), 400)
    assert exits.states == spent
    # With more states it may be possible after all.
    assert not exits.separable(parts(KEY), parts(CASE), 600)
    assert exits.states > spent


def test_a_way_out_of_the_touching_parts_is_tried_for_all() -> None:
    exits = exits_of(cased(0.12))
    assert exits.separable(parts(KEY), parts(CASE), 1_000)
    spent = exits.states
    assert exits.separable(parts(KEY), parts(CASE, FOOT), 1_000)
    assert exits.states - spent < spent
    assert exits.motions(parts(KEY), parts(CASE, FOOT)) == exits.motions(parts(KEY), parts(CASE))


@pytest.mark.parametrize("seed", range(3))
def test_search_around_a_corner_tries_no_hopeless_merge(seed: int) -> None:
    result = solve(cased(0.12), seed)
    assert result.plan.success
    assert result.backtracks == 0
    assert result.attempts <= 4
    assert audit_plan(result.plan).passed


def test_actions_left_out_end_in_the_ground(table: Furniture) -> None:
    task, disassembly = ObjectCentricTask(table), Disassembly(table, lambda: False)
    state = task.initial_state(np.random.default_rng(0))
    given = set(upright(disassembly, state, state, parts(1), parts(0), straight=False))
    ends = {(a[0], a[1]): (a[2], a[3]) for a in given}
    u, v = next(iter(ends))
    k, l = ends[u, v]  # noqa: E741
    left_out = {(*pair, w) for pair, w in product(((u, v, k, l), (v, u, l, k)), range(len(UP_AXES)))} - given
    assert left_out
    for action in left_out:
        assert task.step(state, action, 0).verdict is ObjectCentricVerdict.GOAL_IN_COLLISION


@pytest.mark.parametrize(("family", "seed"), [("lattice", 0), ("folding", 3), ("carcass", 3)])
def test_removable_sets_are_all_smallest_closed_ones(family: str, seed: int) -> None:
    """By hand: follow the arcs from each part; sets and complements are connected; small ones and upward ones first."""
    furniture = annotate(family, generate(family, seed), Provenance("test"), with_grasps=False)
    graphs, everything = BlockingGraphs(furniture), frozenset(range(len(furniture.parts)))
    expected: list[tuple[int, float, list[int]]] = []
    for d, arcs in zip(graphs.directions, graphs.arcs, strict=True):
        for part in everything:
            closed, stack = {part}, [part]
            while stack:
                new = arcs[stack.pop()] - closed
                closed |= new
                stack.extend(new)
            halves = (frozenset(closed), everything - closed)
            if halves[1] and all(len(furniture.connected_components(half)) == 1 for half in halves):
                expected.append((len(closed), -float(d[2].round(3)), sorted(closed)))
    wanted: list[frozenset[int]] = []
    for _, _, closed in sorted(expected):
        if not {frozenset(closed), everything - frozenset(closed)} & set(wanted):
            wanted.append(frozenset(closed))
    assert list(graphs.removable(everything, straight=False)) == wanted


def test_hints_of_motions_change_no_verdict(table: Furniture) -> None:
    """A wrong hint leads into the seat; the planner finds its own way."""
    task = ObjectCentricTask(table)
    state = task.initial_state(np.random.default_rng(0))
    wrong = (SE3.Identity(), SE3(np.eye(3), np.array([0.0, 0.0, 0.2])))
    for w in range(len(UP_AXES)):
        plain, hinted = (task.step(state, (1, 0, 0, 0, w), 0, None, motions) for motions in ((), wrong))
        assert plain.verdict is hinted.verdict
