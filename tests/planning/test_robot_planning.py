"""One mobile Franka among still things: exact checks against python-fcl, certified edges, paths and lines."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from itertools import islice, pairwise

import fcl
import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.geometry.poses import SE3, rotation_angle
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import Floor, connect, line, turned_on
from roboassembly.planning.robot_shapes import CLEARANCE, Arrangement, RobotShapes, WorldCache
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.robots.body import DOF, placed, world_from_tips
from roboassembly.robots.kinematics import arm
from shapes import RobotChecker, brick, fcl_object, pose, still

OPENING = 0.03
FOLDED = np.array([0.0, -1.2, 0.0, -2.6, 0.0, 2.0, 0.785])


@pytest.fixture(scope="module")
def around() -> list[Body]:
    """Half of a chair's parts, hanging around."""
    furniture = catalogue.make("ladder", 0)
    n = len(furniture.parts) // 2
    return [
        still(f"part{i}", p.mesh, SE3(a.rotation, np.array([1.3 * (i % 3), 1.3 * (i // 3), 0.8])))
        for i, (p, a) in enumerate(zip(furniture.parts[n:], furniture.assembled[n:], strict=True))
    ]


RACKET = (Shape(brick(0.6, 0.028, 0.03), pose(z=0.01)), Shape(brick(0.3, 0.3, 0.02), pose(z=0.06)))
"""A bar between the pads, a plate in front of it."""
EITHER = [pytest.param((), id="empty", marks=pytest.mark.slow), pytest.param(RACKET, id="loaded")]
"""What the hand holds; with a load there is all to check that there is without, and more."""


def drawn(rng: np.random.Generator, n: int) -> np.ndarray:
    place = np.concatenate([rng.uniform(-0.5, 3.0, (n, 2)), rng.uniform(-np.pi, np.pi, (n, 1))], axis=1)
    return np.concatenate([place, rng.uniform(arm().low, arm().high, (n, 7))], axis=1)


@pytest.mark.parametrize("held", EITHER)
def test_free_configurations_agree_with_fcl(around: list[Body], held: tuple[Shape, ...]) -> None:
    rng = np.random.default_rng(0)
    q = drawn(rng, 150)
    world, empty = RobotWorld(around, OPENING, held), RobotWorld([], OPENING, held)
    checker = RobotChecker(around, held, OPENING)
    free, alone = world.free(q), empty.free(q)
    assert world.states == len(q)
    assert not (free & ~alone).any()
    hits = np.array([checker.hits(c) for c in q])
    # What the robot does to itself aside, both say the same.
    assert (~free & alone == hits & alone).all()
    assert 5 < (hits & alone).sum() < 145


def test_the_last_world_takes_its_shapes_along(around: list[Body]) -> None:
    """A search makes thousands of worlds with some megabytes each: Python's search for cycles comes too late."""
    world = RobotWorld(around, OPENING, RACKET)
    world.free(drawn(np.random.default_rng(0), 5))
    kept = [weakref.ref(o) for o in gc.get_referents(world) if isinstance(o, Arrangement)]
    kept += [weakref.ref(o) for a in kept for o in gc.get_referents(a()) if isinstance(o, RobotShapes)]
    assert len(kept) > 1
    gc.disable()
    try:
        del world
        assert all(reference() is None for reference in kept)
    finally:
        gc.enable()


def test_worlds_that_share_shapes_answer_as_on_their_own(around: list[Body]) -> None:
    """Other places, grips, loads and openings, less around, something that the cache has not, and back again."""
    q, cache = drawn(np.random.default_rng(6), 80), WorldCache(RACKET, [s for b in around for s in b.shapes])
    elsewhere = [replace(b, pose=pose(x=0.4, z=-0.2) * b.pose) for b in around]
    turned = tuple(replace(s, body_from_mesh=pose(z=-0.02) * s.body_from_mesh) for s in RACKET)
    cases = [
        (around, OPENING, RACKET), (elsewhere, OPENING, RACKET), (around, OPENING, ()), (around, 0.07, turned),
        (around[1:], OPENING, RACKET[1:]), ([*around, still("new", brick(1.0, 0.5, 2.0), SE3.Identity())], OPENING, ()),
        (around, OPENING, RACKET),
    ]  # fmt: skip
    shared = [RobotWorld(*case, cache=cache) for case in cases]
    alone = [RobotWorld(*case) for case in cases]
    edges = [(q[i], q[i] + 0.1 * (q[i + 1] - q[i])) for i in range(0, 60, 2)]
    frees = [world.free(q) for world in shared]
    assert len({free.tobytes() for free in frees}) == len(cases) - 1
    for one, other, free in zip(shared, alone, frees, strict=True):
        assert (free == other.free(q)).all()
        assert (one.free(q, clearance=CLEARANCE) == other.free(q, clearance=CLEARANCE)).all()
        assert [one.edge_is_free(*e) for e in edges] == [other.edge_is_free(*e) for e in edges]


def test_free_configurations_come_in_their_order_and_only_as_many_as_are_asked_for(around: list[Body]) -> None:
    q, world = drawn(np.random.default_rng(7), 64), RobotWorld(around, OPENING)
    free = q[RobotWorld(around, OPENING).free(q)]
    assert np.array_equal(np.array(list(islice(world.each_free(q), 2))), free[:2])
    assert world.states < len(q)
    assert np.array_equal(np.array(list(world.each_free(q))), free)


def test_path_angles_continue_from_the_robot() -> None:
    angles = np.array([0.2, 3.6, 7.0, 4.0])
    path = [np.eye(10)[2] * a for a in angles]
    for turns in (-3, 0, 2):
        before = np.eye(10)[2] * (0.2 + 2.0 * np.pi * turns)
        moved = np.array(turned_on(path, before))
        assert np.allclose(moved[0], before)
        assert np.allclose(np.diff(moved[:, 2]), np.diff(angles))


def test_the_robot_may_not_fold_into_itself() -> None:
    world, rng = RobotWorld([], OPENING), np.random.default_rng(4)
    assert world.free(np.array([[0.0, 0.0, 0.0, *FOLDED]])).all()
    q = np.concatenate([np.zeros((300, 3)), rng.uniform(arm().low, arm().high, (300, 7))], axis=1)
    low, high = ("platform", "link0", "link1"), ("link5", "link6", "palm", "left_finger", "right_finger")
    hits = 0
    where = {link.name: fcl_object(link.mesh, at) for link, at in placed(q[0], OPENING)}
    for free, c in zip(world.free(q), q, strict=True):
        for link, at in placed(c, OPENING):
            where[link.name].setTransform(fcl.Transform(at.rotation, at.translation))
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        folded = any(fcl.collide(where[a], where[b], request, result) for a in low for b in high)
        hits += folded
        assert not (free and folded)
    assert hits > 5


@pytest.mark.parametrize("held", EITHER)
def test_certified_edges_are_free_all_along(around: list[Body], held: tuple[Shape, ...]) -> None:
    rng = np.random.default_rng(1)
    world, dense = RobotWorld(around, OPENING, held), RobotWorld(around, OPENING, held)
    q = drawn(rng, 600)
    q = q[world.free(q)]
    told = []
    for a, b in pairwise(q[:80]):
        b = a + (b - a) * rng.uniform(0.02, 0.3)
        before = world.states
        told.append(world.edge_is_free(a, b))
        spent = world.states - before
        # 3 mm of the farthest point: the platform's way, and each joint's turn by at most 1.8 m.
        count = int(np.ceil((np.linalg.norm((b - a)[:2]) + 1.8 * np.abs(b - a)[2:].sum()) / 0.003))
        assert told[-1] == dense.free(a + np.outer(np.linspace(0.0, 1.0, count + 1), b - a)).all()
        assert spent < count or not told[-1]
    assert 10 < sum(told) < 70


def test_clearance_is_a_margin_that_is_kept() -> None:
    wall = still("wall", brick(0.02, 4.0, 2.0), pose(x=1.0, z=1.0))
    world = RobotWorld([wall], OPENING)
    q = np.array([0.0, 0.0, np.pi, *FOLDED])
    # The platform is turned away from the wall: its corner is 0.29 m behind its middle.
    near, far = q.copy(), q.copy()
    near[0], far[0] = 0.99 - 0.29 - 0.5 * CLEARANCE, 0.99 - 0.29 - 1.5 * CLEARANCE
    both = np.array([near, far])
    assert world.free(both).all()
    assert world.free(both, clearance=CLEARANCE).tolist() == [False, True]
    # Along the wall, as near as that.
    assert [world.edge_is_free(c, c + np.eye(10)[1], clearance=kept) for c in both for kept in (0.0, CLEARANCE)] == [
        True, False, True, True,
    ]  # fmt: skip


def test_path_around_an_obstacle_is_free(around: list[Body]) -> None:
    held = RACKET
    start, goal = np.array([-1.5, -1.5, 0.0, *FOLDED]), np.array([3.5, 3.5, 2.0, *FOLDED])
    ways = []
    for _ in range(2):
        world = RobotWorld(around, OPENING, held)
        assert world.free(np.array([start, goal])).all()
        ways.append(connect(world, start, goal[None], Floor(5.0), Budget(20_000), 7))
    path = ways[0]
    assert path is not None
    assert ways[1] is not None
    assert all(np.array_equal(a, b) for a, b in zip(path, ways[1], strict=True))
    assert np.array_equal(path[0], start)
    assert np.allclose(path[-1], goal)
    checker = RobotChecker(around, held, OPENING)
    states = [a + f * (b - a) for a, b in pairwise(path) for f in np.linspace(0.0, 1.0, 25)]
    assert not any(checker.hits(q) for q in states)
    assert world.free(np.array(states), clearance=CLEARANCE).all()
    assert max(np.abs(q[:2]).max() for q in states) <= 5.0


def test_of_several_goals_the_first_on_a_straight_path_is_reached() -> None:
    wall = [still("wall", brick(0.1, 4.0, 1.5), pose(x=2.0, z=0.75))]
    world = RobotWorld(wall, OPENING)
    start, inside, behind, beside, far = np.array([[x, y, 0.0, *FOLDED] for x, y in [
        (0.0, 0.0), (2.0, 0.0), (4.0, 0.0), (0.0, 1.0), (0.0, 3.0),
    ]])  # fmt: skip
    found = connect(world, start, np.array([inside, behind, beside, far]), Floor(6.0), Budget(20_000), 0)
    assert found is not None
    assert np.array_equal(found, [start, beside])
    around = connect(world, start, np.array([inside, behind]), Floor(6.0), Budget(20_000), 0)
    assert around is not None
    assert len(around) > 2
    assert np.allclose(around[-1], behind)
    assert connect(world, start, inside[None], Floor(6.0), Budget(20_000), 0) is None


def test_a_spent_budget_gives_no_path() -> None:
    pen = [still(f"wall{i}", brick(4.0, 0.05, 1.5), w) for i, w in enumerate(_walls())]
    world = RobotWorld(pen, OPENING)
    start, goal = np.array([0.0, 0.0, 0.0, *FOLDED]), np.array([5.0, 0.0, 0.0, *FOLDED])
    assert world.free(np.array([start, goal])).all()
    assert connect(world, start, goal[None], Floor(8.0), Budget(1_500), 0) is None
    assert world.states < 5_000


def _walls() -> list[SE3]:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [pose(y=2.0, z=0.75), pose(y=-2.0, z=0.75), pose(2.0, 0.0, 0.75, quarter), pose(-2.0, 0.0, 0.75, quarter)]


@pytest.mark.parametrize("drive", [True, False])
def test_the_hand_goes_straight_and_does_not_turn(drive: bool) -> None:
    start = np.array([0.3, -0.2, 0.8, 0.1, -0.5, 0.2, -2.2, 0.1, 1.9, 0.6])
    offset = np.array([0.06, 0.04, 0.08])
    way = line(start, offset, drive=drive)
    assert way is not None
    from_, along = world_from_tips(start), offset / np.linalg.norm(offset)
    for a, b in pairwise(way):
        for f in np.linspace(0.0, 1.0, 9):
            tips = world_from_tips(a + f * (b - a))
            off = tips.translation - from_.translation
            assert np.linalg.norm(off - along * (off @ along)) < 2e-4
            assert rotation_angle(tips.rotation.T @ from_.rotation) < 1e-3
    assert world_from_tips(way[-1]).translation == pytest.approx(from_.translation + offset, abs=1e-6)
    moved = np.linalg.norm(way[-1][:2] - start[:2])
    assert moved == pytest.approx(np.hypot(0.06, 0.04) if drive else 0.0)


def test_level_lines_are_driven_and_unreachable_ones_refused() -> None:
    start = np.array([0.0, 0.0, 0.0, *FOLDED])
    driven = line(start, np.array([1.0, -2.0, 0.0]))
    assert driven is not None
    assert len(driven) == 2
    assert np.array_equal(driven[1] - driven[0], [1.0, -2.0, *np.zeros(DOF - 2)])
    assert line(start, np.array([0.0, 0.0, 2.0])) is None
    assert line(start, np.zeros(3)) == (start,)


def test_a_line_into_a_wall_is_not_free() -> None:
    wall = still("wall", brick(0.02, 4.0, 2.0), pose(x=1.5, z=1.0))
    world = RobotWorld([wall], OPENING)
    start = np.array([0.0, 0.0, 0.0, *FOLDED])
    short, long = (line(start, np.array([x, 0.0, 0.0])) for x in (0.2, 1.5))
    assert short is not None
    assert long is not None
    assert world.path_is_free(short)
    assert not world.path_is_free(long)
