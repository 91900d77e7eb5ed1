"""The workcell: parts on posts, reachable and apart; what it refuses."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import fcl
import numpy as np
import pytest

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.geometry.scene import Body
from roboassembly.task.full import cell, posts
from roboassembly.task.full.cell import BETWEEN_POSTS, LANE, PAYLOAD, check_size, initial_layout
from roboassembly.task.full.grips import ASTRAY, grip_of
from roboassembly.task.full.posts import LOWEST, on_post, on_two_posts, reach_from
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group
from shapes import GAP, block, brick, fcl_object, furniture, of_solid, pose


@pytest.fixture(scope="module")
def stool(chair) -> Furniture:
    return chair("stool", 0)


def alone(piece: Furniture, part: int, turn: np.ndarray) -> Group:
    slot = piece.assembled[part]
    return Group((part,), (part,), (slot,), SE3(turn, np.zeros(3)) * slot.inverse())


@pytest.mark.parametrize("seed", range(4))
def test_every_part_waits_on_a_post_of_its_own(stool: Furniture, seed: int) -> None:
    room, groups, stands = initial_layout(stool, np.random.default_rng(seed))
    assert [g.parts for g in groups] == [(i,) for i in range(len(stool.parts))]
    placed = []
    for group, stand in zip(groups, stands, strict=True):
        mesh, pose = stool.parts[group.parts[0]].mesh, group.part_poses()[0]
        points = mesh.vertices @ pose.rotation.T + pose.translation
        assert points[:, 2].min() == pytest.approx(LOWEST)
        assert np.linalg.norm(stand.top[:2]) == pytest.approx(room.radius)
        # Held near its centre of mass, which is the part's origin.
        assert np.linalg.norm(pose.translation[:2] - stand.top[:2]) < 0.18
        (post,) = stand.body("post").shapes
        placed.append((fcl_object(mesh, pose), fcl_object(post.mesh, SE3(np.eye(3), stand.top))))
    for thing, post in placed:
        gap = fcl.distance(thing, post, fcl.DistanceRequest(), fcl.DistanceResult())
        assert 0.5e-3 < gap < 1.5e-3
    for (a, stand_a, one), (b, stand_b, two) in combinations(zip(groups, stands, placed, strict=True), 2):
        apart = np.linalg.norm(stand_a.top - stand_b.top)
        assert apart > 0.9 * BETWEEN_POSTS
        assert apart > reach_from(stool, a, stand_a) + reach_from(stool, b, stand_b)
        for x in one:
            for y in two:
                assert not fcl.collide(x, y, fcl.CollisionRequest(), fcl.CollisionResult())


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(s, marks=pytest.mark.slow) for s in range(2, 6))])
def test_long_parts_are_spaced_apart(seed: int) -> None:
    """Four boards of a metre and four sticks: half as far as two boards need is what a board and a stick need."""
    sizes = {f"board{i}": (1.0, 0.1, 0.02) for i in range(4)} | {f"stick{i}": (0.1, 0.02, 0.02) for i in range(4)}
    high, solids = 0.0, {}
    for name, size in sizes.items():
        solids[name] = brick(*size).transformed(pose(z=high + 0.5 * size[2]))
        high += size[2] + GAP
    piece = furniture("pile", solids)
    _, groups, stands = initial_layout(piece, np.random.default_rng(seed))
    reach = [reach_from(piece, g, s) for g, s in zip(groups, stands, strict=True)]
    assert max(reach) > 0.4
    for i, j in combinations(range(len(reach)), 2):
        assert np.linalg.norm(stands[i].top - stands[j].top) > reach[i] + reach[j] + 0.8 * LANE


def test_the_layout_follows_the_generator(stool: Furniture) -> None:
    one, two, other = (initial_layout(stool, np.random.default_rng(s))[1] for s in (5, 5, 6))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.world_from_furniture.homogeneous, b.world_from_furniture.homogeneous)
    assert not np.allclose(one[0].world_from_furniture.translation, other[0].world_from_furniture.translation)


def test_the_density_keeps_the_whole_within_the_payload(stool: Furniture, table: Furniture) -> None:
    for piece in (stool, table):
        volume = sum(p.mesh.volume for p in piece.parts)
        density = check_size(piece) if all(p.grasps for p in piece.parts) else None
        if density is not None:
            assert density == pytest.approx(min(WOOD_DENSITY, PAYLOAD / volume))
            assert density * volume <= PAYLOAD + 1e-9


def test_furniture_that_does_not_suit_the_cell_is_refused(stool: Furniture, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = replace(stool, parts=(replace(stool.parts[0], grasps=()), *stool.parts[1:]))
    with pytest.raises(InputError, match=f"no hand can hold part '{stool.parts[0].name}'"):
        initial_layout(bare, np.random.default_rng(0))
    monkeypatch.setattr(cell, "LARGEST", 0.2)
    with pytest.raises(InputError, match=r"is 0\.\d+ m from corner to corner; the cell takes 0\.20 m"):
        initial_layout(stool, np.random.default_rng(0))


def test_a_cup_needs_something_above_it() -> None:
    frame = block((-0.25, -0.25, 0.0), (0.25, 0.25, 0.03)) - block((-0.2, -0.2, -0.1), (0.2, 0.2, 0.1))
    foot = block((-0.25, -0.25, 0.0305), (-0.2, -0.2, 0.1))
    piece = furniture("frame", {"frame": of_solid(frame), "foot": of_solid(foot)})
    # Lying it is a hole all around its centre; on edge there is a rail above its centre.
    assert on_post(piece, alone(piece, 0, np.eye(3)), np.zeros(2)) is None
    edge = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    found = on_post(piece, alone(piece, 0, edge), np.array([1.0, 2.0]))
    assert found is not None
    assert found[1].top == pytest.approx([1.0, 2.0, LOWEST - posts.CUP_GAP], abs=1e-9)


@pytest.fixture(scope="module")
def framed() -> Furniture:
    """A square frame, its rails 50 mm wide and 30 mm high, with a foot below one corner."""
    frame = block((-0.25, -0.25, 0.0), (0.25, 0.25, 0.03)) - block((-0.2, -0.2, -0.1), (0.2, 0.2, 0.1))
    foot = block((-0.25, -0.25, 0.0305), (-0.2, -0.2, 0.1))
    return furniture("frame", {"frame": of_solid(frame), "foot": of_solid(foot)})


def test_two_posts_hold_a_frame_on_opposite_sides(framed: Furniture) -> None:
    flat = alone(framed, 0, np.eye(3))
    assert on_post(framed, flat, np.zeros(2)) is None
    found = on_two_posts(framed, flat, np.array([1.0, 2.0]))
    assert found is not None
    group, post = found
    # The frame's middle is its centre of mass. Both cups end below rails, as far to one side of it as to the other.
    (mid,) = group.part_poses()
    assert mid.translation == pytest.approx([*post.middle, LOWEST + 0.015], abs=0.03)
    assert post.middle == pytest.approx([1.0, 2.0])
    tops = np.array([p.top for p in post.each])
    assert tops[:, 2] == pytest.approx(LOWEST - posts.CUP_GAP, abs=1e-9)
    for top in tops[:, :2] - mid.translation[:2]:
        assert 0.2 <= np.abs(top).max() <= 0.25
    first, second = tops[:, :2] - mid.translation[:2]
    # The centre of mass is no farther from the line between them than a cup's radius.
    assert abs(np.cross([*first, 0.0], [*second, 0.0])[2]) / np.linalg.norm(first - second) < posts.POST_RADIUS
    # Their shapes are where they are, wherever the pair goes.
    moved = post.moved(np.array([0.5, 0.0, 0.0])).body("posts")
    ends = [moved.pose.act(shape.body_from_mesh.translation) for shape in moved.shapes]
    assert np.allclose(ends, tops + np.array([0.5, 0.0, 0.0]))


def test_two_posts_are_a_last_resort(framed: Furniture) -> None:
    """If one post holds some way to stand, two hold none."""
    flat = alone(framed, 0, np.eye(3))
    edge = alone(framed, 0, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
    (pair,) = posts.best_stands(framed, [flat], [True])
    assert len(pair[1].each) == 2
    (one,) = posts.best_stands(framed, [flat, edge], [True, False])
    assert len(one[1].each) == 1


def test_the_ring_grows_with_large_furniture() -> None:
    """Two boards of 2.5 m: from corner to corner they are longer than 2.26 m, and the ring is as much wider."""
    high, solids = 0.0, {}
    for name in ("lower", "upper"):
        solids[name] = brick(2.5, 0.1, 0.02).transformed(pose(z=high + 0.01))
        high += 0.02 + GAP
    piece = furniture("pile", solids)
    across = np.sqrt(2.5**2 + 0.1**2 + (0.04 + GAP) ** 2)
    room, groups, _ = initial_layout(piece, np.random.default_rng(0))
    assert len(groups) == 2
    assert room.radius == pytest.approx(max(cell.SMALLEST_RING + across - cell.ROOMY, 0.0), abs=1e-6)
    assert room.floor > room.radius + 1.25


def test_the_cup_stays_away_from_the_hands(stool: Furniture) -> None:
    # A stretcher lies level; its grasps are on it, and the post ends where most of them are free.
    part = next(i for i, p in enumerate(stool.parts) if "stretcher" in p.name)
    _, groups, stands = initial_layout(stool, np.random.default_rng(0))
    assert posts.open_grasps(stool, groups[part], stands[part]) >= 0.5


def gap_between(one: Body, other: Body) -> float:
    """Return the distance between two bodies; 0 or less if they touch [m]."""
    gaps = [
        fcl.distance(*(fcl_object(s.mesh, b.pose * s.body_from_mesh) for b, s in ((one, a), (other, c))))
        for a in one.shapes
        for c in other.shapes
    ]
    return float(min(gaps))


@pytest.mark.parametrize("seed", range(3))
def test_hands_at_open_grasps_keep_clear_of_the_post(chair, seed: int) -> None:
    """A hand comes with a clearance of 1 mm; a grasp nearer to the post than that is none that the post leaves open.

    Nor is one from below, which the arm would have to come from beneath for.
    """
    piece = chair("panel", 4)
    task = FullTask(piece)
    for placed in task.initial_state(np.random.default_rng(seed)).cell_state.placed:
        clear: list[bool] = []
        for part in placed.group.parts:
            for grasp in range(4 * len(piece.parts[part].grasps)):
                grip = grip_of(piece, placed.group, part, grasp)
                assert grip is not None
                grip = grip.moved(placed.group.world_from_furniture)
                apart = gap_between(grip.hand(grip.open), placed.post.body("post")) >= ASTRAY
                clear.append(apart and grip.approach[2] < 0.6)
        assert posts.open_grasps(piece, placed.group, placed.post) <= np.mean(clear)


def test_groups_stand_in_the_order_of_their_open_grasps(stool: Furniture) -> None:
    turns = [align_axis(axis, UP_AXES[0]) for axis in UP_AXES]
    for part in range(len(stool.parts)):
        stands = [alone(stool, part, turn) for turn in turns]
        for upright in ([False] * 6, [False, False, True, False, False, False]):
            held = [(up, on_post(stool, stand, np.zeros(2))) for up, stand in zip(upright, stands, strict=True)]
            scores = [(up + posts.open_grasps(stool, *found), found[1].top) for up, found in held if found is not None]
            tops = [top for _, top in sorted(scores, key=lambda item: -item[0])]
            assert np.array_equal([post.top for _, post in posts.best_stands(stool, stands, upright)], tops)
