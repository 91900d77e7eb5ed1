"""The object-centric step: every verdict from a case made for it, and what a merge leaves behind."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

import shapes
from roboassembly.furniture.model import PAPER_PARTS, PAPER_POINTS, Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Scene
from roboassembly.planning.problem import Budget
from roboassembly.task.layout import GROUND_CLEARANCE
from roboassembly.task.object_centric.task import ObjectCentricOutcome, ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.plans.plan import SETTLING_INTERVAL
from roboassembly.task.rules.connections import UP_AXES, lifted_directions
from roboassembly.task.rules.groups import (
    Group,
    TaskState,
    body,
    center_of_mass,
    group_footprint,
    group_in_place,
    hull_points,
)
from shapes import Checker, pose, turn

UP, DOWN = 0, 1


def lying(furniture: Furniture, places: dict[int, SE3]) -> TaskState:
    """Single parts at `world_from_part`."""
    groups = []
    for part in range(len(furniture.parts)):
        slot = furniture.assembled[part]
        groups.append(Group((part,), (part,), (slot,), places[part] * slot.inverse()))
    return TaskState(tuple(groups))


def apart(furniture: Furniture) -> TaskState:
    """Every part upright, as in the furniture, a metre from the next."""
    places = {}
    for part, slot in enumerate(furniture.assembled):
        low = (furniture.parts[part].mesh.hull_vertices @ slot.rotation[2]).min()
        places[part] = pose(part, 0, GROUND_CLEARANCE - low, slot.rotation)
    return lying(furniture, places)


def numbers(state: TaskState) -> np.ndarray:
    return np.array([p.homogeneous for p in state.part_poses])


def step(furniture: Furniture, state: TaskState, action: tuple[int, ...], **options: object) -> ObjectCentricOutcome:
    before, groups = numbers(state), state.groups
    outcome = ObjectCentricTask(furniture).step(state, action, 0, **options)  # pyright: ignore[reportArgumentType]
    # The old state is as it was, to the last bit.
    assert np.array_equal(numbers(state), before)
    assert state.groups is groups
    if outcome.verdict is ObjectCentricVerdict.MERGED:
        assert outcome.step is not None
        assert outcome.state is not state
    else:
        assert outcome.step is None
        assert outcome.state is state
    assert outcome.planning_steps >= 0
    assert (outcome.planning_steps > 0) == (
        outcome.verdict not in (ObjectCentricVerdict.NOT_AN_ACTION, ObjectCentricVerdict.WRONG_PAIR)
    )
    return outcome


@pytest.mark.parametrize(
    "action",
    [
        (0, 0, 0, 1, 0),
        (5, 0, 0, 0, 0),
        (0, 5, 0, 0, 0),
        (-1, 0, 0, 0, 0),
        (1, 0, 1, 0, 0),
        (1, 0, 0, 4, 0),
        (1, 0, -1, 0, 0),
        (1, 0, 0, -1, 0),
        (1, 0, 0, 0, 6),
        (1, 0, 0, 0, -1),
        (19, 18, 9, 9, 5),
    ],
)
def test_missing_parts_and_points_are_no_action(table: Furniture, action: tuple[int, ...]) -> None:
    assert step(table, apart(table), action).verdict is ObjectCentricVerdict.NOT_AN_ACTION


def test_occupied_points_and_joined_parts_are_no_action(table: Furniture) -> None:
    state = step(table, apart(table), (1, 0, 0, 0, DOWN)).state
    assert step(table, state, (1, 0, 0, 0, DOWN)).verdict is ObjectCentricVerdict.NOT_AN_ACTION  # one group already
    assert step(table, state, (0, 1, 1, 0, DOWN)).verdict is ObjectCentricVerdict.NOT_AN_ACTION
    assert step(table, state, (2, 0, 0, 0, DOWN)).verdict is ObjectCentricVerdict.NOT_AN_ACTION  # the corner is taken
    assert (
        step(table, state, (2, 1, 0, 0, DOWN)).verdict is ObjectCentricVerdict.NOT_AN_ACTION
    )  # the leg's end is taken
    assert step(table, state, (2, 0, 0, 1, DOWN)).verdict is ObjectCentricVerdict.MERGED


def test_wrong_pair(table: Furniture, stand: Furniture) -> None:
    assert step(table, apart(table), (1, 2, 0, 0, UP)).verdict is ObjectCentricVerdict.WRONG_PAIR
    wrong = [
        (u, v, k, l, w)
        for (u, v), k, l, w in product(((0, 1), (2, 3)), range(2), range(2), range(2))  # noqa: E741
    ]
    for action in wrong:
        assert step(stand, apart(stand), action).verdict is ObjectCentricVerdict.WRONG_PAIR


def test_a_leg_goes_under_a_seat_only_when_the_seat_lies_face_down(table: Furniture) -> None:
    state = apart(table)
    assert step(table, state, (1, 0, 0, 0, UP)).verdict is ObjectCentricVerdict.GOAL_IN_COLLISION
    assert step(table, state, (1, 0, 0, 0, DOWN)).verdict is ObjectCentricVerdict.MERGED
    # The seat onto a standing leg: there is room above.
    assert step(table, state, (0, 1, 0, 0, UP)).verdict is ObjectCentricVerdict.MERGED
    assert step(table, state, (0, 1, 0, 0, DOWN)).verdict is ObjectCentricVerdict.GOAL_IN_COLLISION


def test_every_up_axis_points_up(table: Furniture) -> None:
    """v's group waits with this axis of the furniture up, on the ground; what u may do about it is another matter."""
    task = ObjectCentricTask(table)
    start = task.initial_state(np.random.default_rng(3))
    for w, axis in enumerate(UP_AXES):
        mating = task.prepare(start, (1, 0, 0, 2, w))
        assert mating is not None
        assert np.allclose(mating.merged.world_from_furniture.rotation @ axis, [0, 0, 1], atol=1e-9)
        waiting = hull_points(table, mating.v_group)
        pose_v = mating.v_group.world_from_furniture
        assert (waiting @ pose_v.rotation[2]).min() + pose_v.translation[2] == pytest.approx(GROUND_CLEARANCE, abs=1e-7)
        merged = group_footprint(table, mating.merged)
        for other in (mating.u_group, *mating.others):
            circle = group_footprint(table, other)
            assert np.linalg.norm(circle.center - merged.center) > circle.radius + merged.radius


def test_start_in_collision(table: Furniture) -> None:
    state = apart(table)
    places = dict(enumerate(state.part_poses))
    places[2] = SE3(places[1].rotation, places[1].translation + np.array([0.02, 0, 0]))
    assert step(table, lying(table, places), (1, 0, 0, 0, DOWN)).verdict is ObjectCentricVerdict.START_IN_COLLISION
    places[2] = SE3(places[1].rotation, places[1].translation + np.array([0.2, 0, 0]))
    places[1] = SE3(places[1].rotation, places[1].translation - np.array([0, 0, 0.01]))
    assert step(table, lying(table, places), (1, 0, 0, 0, DOWN)).verdict is ObjectCentricVerdict.START_IN_COLLISION


def test_dead_end_is_not_merged(captive_slat: Furniture) -> None:
    """Both posts in the board, then the slat: its tenons are longer than the room between the posts."""
    furniture = captive_slat
    ends = {(c.part_a, c.part_b): (c.point_a, c.point_b) for c in furniture.connections}
    state = apart(furniture)
    for post in (1, 2):
        on_board, below = ends[0, post]
        outcome = step(furniture, state, (post, 0, below, on_board, UP))
        assert outcome.verdict is ObjectCentricVerdict.MERGED
        state = outcome.state
    mouth, tenon = ends[1, 3]
    for w in range(6):
        verdicts = {
            step(furniture, state, (3, 1, tenon, mouth, w)).verdict,
            step(furniture, state, (1, 3, mouth, tenon, w)).verdict,
        }
        assert ObjectCentricVerdict.MERGED not in verdicts
        assert verdicts <= {
            ObjectCentricVerdict.UNREACHABLE,
            ObjectCentricVerdict.BUDGET_EXHAUSTED,
            ObjectCentricVerdict.GOAL_IN_COLLISION,
        }
    assert ObjectCentricVerdict.UNREACHABLE in verdicts or ObjectCentricVerdict.BUDGET_EXHAUSTED in verdicts


def test_locked_in_is_unreachable() -> None:
    c = shapes.GAP
    ring = shapes.block((-0.1, -0.1, 0), (0.1, 0.1, 0.04)) - shapes.block(
        (-0.02 - c, -0.02 - c, -1), (0.02 + c, 0.02 + c, 1)
    )
    bone = (
        shapes.block((-0.06, -0.05, 0.04 + c), (0.05, 0.05, 0.14))
        + shapes.block((-0.02, -0.02, -0.1), (0.02, 0.02, 0.1))
        + shapes.block((-0.05, -0.05, -0.1), (0.05, 0.05, -c))
    )
    furniture = shapes.furniture("bone", {"ring": shapes.of_solid(ring), "bone": shapes.of_solid(bone)})
    state = apart(furniture)
    verdicts = [step(furniture, state, (u, 1 - u, 0, 0, w)).verdict for u in (0, 1) for w in range(6)]
    assert ObjectCentricVerdict.UNREACHABLE in verdicts
    assert set(verdicts) <= {ObjectCentricVerdict.UNREACHABLE, ObjectCentricVerdict.GOAL_IN_COLLISION}


def test_budget_exhausted() -> None:
    furniture = shapes.interlocked()
    verdicts = {step(furniture, apart(furniture), (0, 1, 0, 0, w), budget=Budget(states=500)).verdict for w in range(6)}
    assert ObjectCentricVerdict.BUDGET_EXHAUSTED in verdicts
    assert ObjectCentricVerdict.MERGED not in verdicts


def test_the_tasks_own_budget_is_used() -> None:
    furniture = shapes.interlocked()
    state = apart(furniture)
    spent = [
        max(
            ObjectCentricTask(furniture, Budget(states=n)).step(state, (0, 1, 0, 0, w), 0).planning_steps
            for w in range(6)
        )
        for n in (0, 3_000)
    ]
    assert spent[0] < 3_000 <= spent[1] < 6_000


@pytest.mark.parametrize("seed", range(3))
def test_state_after_a_merge(chair, seed: int) -> None:
    furniture = chair("stool", 0)
    task = ObjectCentricTask(furniture)
    state = task.initial_state(np.random.default_rng(seed))
    before = state.part_poses
    c = furniture.connections[0]
    for action in ((a, b, k, l, w) for (a, k, b, l) in ((c.part_a, c.point_a, c.part_b, c.point_b),) for w in range(6)):  # noqa: E741
        outcome = task.step(state, action, seed)
        if outcome.verdict is ObjectCentricVerdict.MERGED:
            break
    assert outcome.verdict is ObjectCentricVerdict.MERGED
    record, after = outcome.step, outcome.state
    assert record is not None
    u, v = action[:2]
    # Groups: all others as they were, and the new one.
    assert {g.parts for g in after.groups} == {tuple(sorted((u, v))), *((p,) for p in range(9) if p not in (u, v))}
    for part in range(9):
        if part not in (u, v):
            assert np.array_equal(after.part_poses[part].homogeneous, before[part].homogeneous)
            assert np.array_equal(record.still[part].homogeneous, before[part].homogeneous)
    assert np.array_equal(np.array([p.homogeneous for p in record.after]), numbers(after))
    # The two parts stand to each other exactly as in the furniture.
    merged = after.groups[after.group_of[u]]
    slots = dict(zip(merged.parts, merged.slots, strict=True))
    relative = after.part_poses[u].actInv(after.part_poses[v])
    expected = furniture.assembled[slots[u]].actInv(furniture.assembled[slots[v]])
    assert np.abs(relative.homogeneous - expected.homogeneous).max() < 1e-9 or slots != {u: u, v: v}
    # At rest on the ground.
    points = (
        hull_points(furniture, merged) @ merged.world_from_furniture.rotation[2]
        + merged.world_from_furniture.translation[2]
    )
    assert points.min() == pytest.approx(GROUND_CLEARANCE, abs=1e-7)
    # Apart from everything else.
    rings = [group_footprint(furniture, g) for g in after.groups]
    for a, b in combinations(rings, 2):
        assert np.linalg.norm(a.center - b.center) > a.radius + b.radius
    # The path leads from where u lay to where it mates, and hits nothing by another library's judgement.
    assert record.waiting == (v,)
    assert set(record.moving) == {u}
    assert set(record.still) == set(range(9)) - {u}
    start, end = (p * record.moving[u] for p in (record.path[0], record.path[-1]))
    assert np.allclose(start.homogeneous, before[u].homogeneous, atol=1e-9)
    assert np.allclose(
        (record.still[v].actInv(end)).homogeneous,
        after.part_poses[v].actInv(after.part_poses[u]).homogeneous,
        atol=1e-9,
    )
    moving = body(furniture, state.groups[u], "moving", origin=center_of_mass(furniture, state.groups[u]), moves=True)
    others = tuple(shapes.still(f"p{p}", furniture.parts[p].mesh, where) for p, where in record.still.items())
    assert not Checker(Scene((moving, *others))).path_hits(record.path, 0.001)
    # Settling begins at the mating pose and ends where the parts are now.
    assert np.allclose(record.settling[0].homogeneous, np.eye(4), atol=1e-9)
    for part, where in ((u, end), (v, record.still[v])):
        assert np.allclose((record.settling[-1] * where).homogeneous, after.part_poses[part].homogeneous, atol=1e-9)
    assert SETTLING_INTERVAL == 0.05
    assert record.action == action
    assert record.planning_steps == outcome.planning_steps


def test_a_group_moves_as_one(table: Furniture) -> None:
    """Two legs on the top, then the top with them onto a third."""
    state = apart(table)
    for leg in (1, 2):
        state = step(table, state, (leg, 0, 0, leg - 1, DOWN)).state
    outcome = step(table, state, (0, 3, 2, 0, UP))
    assert outcome.verdict is ObjectCentricVerdict.MERGED
    assert outcome.step is not None
    assert set(outcome.step.moving) == {0, 1, 2}
    origin = sum(table.parts[p].mesh.volume * outcome.step.moving[p].translation for p in (0, 1, 2))
    assert np.allclose(origin, 0, atol=1e-6)
    final = step(table, outcome.state, (4, 0, 0, 3, DOWN))
    assert final.verdict is ObjectCentricVerdict.MERGED
    assert final.state.complete
    assert ObjectCentricTask(table).free_points(final.state).sum() == 0


def test_steps_repeat_exactly(captive_slat: Furniture) -> None:
    furniture = captive_slat
    task, other = ObjectCentricTask(furniture), ObjectCentricTask(furniture)
    state = task.initial_state(np.random.default_rng(1))
    ends = {(c.part_a, c.part_b): (c.point_a, c.point_b) for c in furniture.connections}
    action = (3, 1, ends[1, 3][1], ends[1, 3][0], 0)
    outcomes = [t.step(state, action, 5) for t in (task, other, task)]
    for outcome in outcomes[1:]:
        assert outcome.verdict is outcomes[0].verdict
        assert outcome.planning_steps == outcomes[0].planning_steps
        assert np.array_equal(numbers(outcome.state), numbers(outcomes[0].state))
        if outcome.step is not None and outcomes[0].step is not None:
            assert all(np.array_equal(a.homogeneous, b.homogeneous)
                       for a, b in zip(outcome.step.path, outcomes[0].step.path, strict=True))  # fmt: skip


def test_free_points_and_exists_agree(stand: Furniture) -> None:
    task = ObjectCentricTask(stand)
    state = apart(stand)
    assert task.free_points(state).shape == (len(stand.parts), stand.most_points)
    padded = task.free_points(state, PAPER_PARTS, PAPER_POINTS)
    assert padded.shape == (PAPER_PARTS, PAPER_POINTS)
    assert padded.sum() == task.free_points(state).sum()
    assert task.free_points(state).sum() == 8
    ends = {(c.part_a, c.part_b): (c.point_a, c.point_b) for c in stand.connections}
    outcome = task.step(state, (2, 1, ends[1, 2][1], ends[1, 2][0], UP), 0)
    assert outcome.verdict is ObjectCentricVerdict.MERGED
    after = outcome.state
    free = task.free_points(after)
    assert free.sum() == 6
    for u, v, k, l in product(range(4), range(4), range(2), range(2)):  # noqa: E741
        expected = bool(free[u, k] and free[v, l] and after.group_of[u] != after.group_of[v])
        assert task.exists(after, (u, v, k, l, 0)) == expected


def test_the_nearest_free_place(table: Furniture) -> None:
    """v's group is put down where it lies if there is room."""
    state = apart(table)
    places = dict(enumerate(state.part_poses))
    places[0] = pose(0, 50, 0.1, turn((0, 0, 1), 0.3))
    outcome = step(table, lying(table, places), (1, 0, 0, 0, DOWN))
    assert outcome.step is not None
    assert np.allclose(outcome.step.still[0].translation[:2], [0, 50], atol=1e-6)
    assert outcome.step.still[0].translation[2] == pytest.approx(0.015 + GROUND_CLEARANCE, abs=1e-6)


def test_long_axis(table: Furniture) -> None:
    assert abs(table.parts[1].mesh.long_axis @ table.assembled[1].rotation.T @ [0, 0, 1]) == pytest.approx(1, abs=1e-6)


def test_what_slides_along_contacts_may_be_lifted_off_them() -> None:
    x, y, z = np.eye(3)
    flat = np.array(lifted_directions(x, np.array([z, z])))
    np.testing.assert_allclose(flat[:, 2] / flat[:, 0], [0.03, 0.06])
    np.testing.assert_allclose(np.linalg.norm(flat, axis=1), 1.0)
    assert not flat[:, 1].any()
    # In a corner it leaves both faces; in a groove, against a stop and straight off a face there is nothing to lift.
    corner = np.array(lifted_directions(x, np.array([y, z])))
    np.testing.assert_allclose(corner[:, 1], corner[:, 2])
    assert (corner[:, 1] > 0).all()
    assert lifted_directions(x, np.array([z, -z])) == []
    assert lifted_directions(x, np.array([z, -x])) == []
    assert lifted_directions(z, np.array([z])) == []


def test_retreats_of_a_leg_lead_off_the_seat(table: Furniture) -> None:
    task = ObjectCentricTask(table)
    seat, leg, both = (group_in_place(table, parts) for parts in ({0}, {1}, {0, 1}))
    directions = np.array(task.rules.retreats(leg, seat, both, np.eye(3)))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    # The leg hangs from the seat: it leaves downward, to the sides, and to the sides while it sinks.
    sides = directions[np.abs(directions[:, 2]) < 0.1]
    sinks = (-sides[:, 2] / np.linalg.norm(sides[:, :2], axis=1)).round(6)
    assert set(sinks.tolist()) == {0.0, 0.03, 0.06}
