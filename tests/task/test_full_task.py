"""The full step: two robots pick, mate, release and place; every segment checked by python-fcl."""

from __future__ import annotations

import weakref
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise, product
from multiprocessing import get_context

import numpy as np
import pytest

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, rotation_angle
from roboassembly.geometry.scene import Body, Shape
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_path import line
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.gripper import MAX_OPENING
from roboassembly.robots.kinematics import arm
from roboassembly.robots.reach import reach
from roboassembly.solvers.disassembly import partition_of
from roboassembly.solvers.full_search import solve_full
from roboassembly.solvers.options import grasping
from roboassembly.solvers.search import SearchLimits
from roboassembly.task.full.cell_state import Segment, world_cache
from roboassembly.task.full.failure import AFTER_MATING, PICKING, STRAIGHT, Failure, FullVerdict, Stage
from roboassembly.task.full.grips import Grip, MateGrasp
from roboassembly.task.full.pick import PickRequest, pick
from roboassembly.task.full.posts import Post
from roboassembly.task.full.segments import Planned, StepContext, child_seed, retreat_path
from roboassembly.task.full.step import pick_both
from roboassembly.task.full.task import FullOutcome, FullTask
from roboassembly.task.plans.full_plan import FullState
from shapes import GAP, RobotChecker, brick, furniture, pose

STAGES = [
    *[Stage.DRIVE_TO_GROUP, Stage.APPROACH, Stage.LIFT] * 2, *[Stage.DRIVE_TO_MATE] * 2, Stage.MATE, Stage.RELEASE,
    Stage.LEAVE, Stage.CARRY, Stage.SET_DOWN, Stage.RELEASE, Stage.LEAVE,
]  # fmt: skip


@pytest.fixture(scope="module")
def stool(chair) -> Furniture:
    return chair("stool", 0)


@pytest.fixture(scope="module")
def task(stool: Furniture) -> FullTask:
    return FullTask(stool)


@pytest.fixture(scope="module")
def start(task: FullTask) -> FullState:
    return task.initial_state(np.random.default_rng(0))


@pytest.fixture(scope="module")
def merged(task: FullTask, start: FullState) -> FullOutcome:
    """The first step of the stool that succeeds: a stretcher into a segment."""
    for action in grasping(task, start, start.groups, *stretcher_and_leg(task.furniture)):
        outcome = task.step(start, action, 3)
        if outcome.verdict is FullVerdict.MERGED:
            return outcome
    pytest.fail("no action merges")


def test_a_collision_model_is_freed_and_its_states_still_count(task: FullTask, start: FullState) -> None:
    tally = Tally()
    world = StepContext(task.furniture, start.cell, Budget(), world_cache(task.furniture)).world(
        start.cell_state, 0, tally
    )
    world.free(np.array([start.cell_state.robots[0].at, start.cell_state.robots[1].at]))
    there = weakref.ref(world)
    del world
    assert there() is None
    assert tally.states == 2


def test_a_grip_that_fits_the_joint_has_room_there(task: FullTask, start: FullState) -> None:
    state, told = start.groups, set[tuple[bool, bool]]()
    for c in task.furniture.connections:
        u, v = c.part_a, c.part_b
        merge = task.merge(state, (u, v, c.point_a, c.point_b))
        assert merge is not None
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        for robot, part in enumerate((u, v)):
            for held in task.free_grips(state, part).values():
                room = task.grip_has_room(u_group, v_group, merge, held, robot)
                fits = task.grip_fits(u_group, v_group, merge, held, robot)
                assert room or not fits
                told.add((room, fits))
    assert {(True, True), (False, False)} <= told


def stretcher_and_leg(stool: Furniture) -> tuple[frozenset[int], frozenset[int]]:
    c = next(c for c in stool.connections if {"stretcher", "leg"} <= _kinds(stool, c))
    return frozenset({c.part_a}), frozenset({c.part_b})


def _kinds(stool: Furniture, c) -> set[str]:
    names = (stool.parts[c.part_a].name, stool.parts[c.part_b].name)
    return {kind for kind in ("stretcher", "leg") if any(kind in n for n in names)}


def request_for(start: FullState, part: int, grip: Grip) -> tuple[PickRequest, Post]:
    """A request to pick the group of a part, and its post."""
    placed = next(s for s in start.cell_state.placed if part in s.group.parts)
    return PickRequest(placed.group, grip), placed.post


def context_of(task: FullTask, state: FullState) -> StepContext:
    return StepContext(task.furniture, state.cell, task.budget, world_cache(task.furniture))


def dense(segment: Segment, step: float) -> list[np.ndarray]:
    """Configurations along a segment, `step` metres and radians apart."""
    out = [segment.path[0]]
    for a, b in pairwise(segment.path):
        moved = np.linalg.norm((b - a)[:2]) + np.abs(b - a)[2:].sum()
        count = max(1, int(np.ceil(moved / step)))
        out += [a + (b - a) * i / count for i in range(1, count + 1)]
    return out


def test_the_start_is_free(task: FullTask, start: FullState) -> None:
    for robot in (0, 1):
        own = start.cell_state.robots[robot]
        checker = RobotChecker(start.cell_state.around(task.furniture, robot), (), own.opening)
        assert not checker.hits(own.at)


def test_nonexistent_actions_and_wrong_pairs_cost_no_planning(
    task: FullTask, start: FullState, merged: FullOutcome
) -> None:
    assert merged.step is not None
    u, v, k, l, g_a, g_b = merged.step.action  # noqa: E741
    for action in ((u, u, k, l, g_a, g_b), (u, v, 9, l, g_a, g_b), (u, v, k, l, 8, g_b), (99, v, k, l, g_a, g_b)):
        outcome = task.step(start, action, 0)
        assert outcome.verdict is FullVerdict.NOT_AN_ACTION
        assert outcome.state is start
    segments = [i for i, p in enumerate(task.furniture.parts) if "leg" in p.name]
    outcome = task.step(start, (segments[0], segments[1], 0, 0, 0, 0), 0)
    assert outcome.verdict is FullVerdict.WRONG_PAIR
    assert (outcome.planning_steps, outcome.segments, outcome.step) == (0, (), None)
    # Joined points are not free any more.
    assert task.step(merged.state, merged.step.action, 0).verdict is FullVerdict.NOT_AN_ACTION


def test_stages_follow_each_other_as_in_the_paper(merged: FullOutcome) -> None:
    segments = merged.segments
    assert [segment.stage for segment in segments] == STAGES
    assert [segment.robot for segment in segments] == [
        0,
        0,
        0,
        1,
        1,
        1,
        segments[6].robot,
        segments[7].robot,
        0,
        0,
        0,
        1,
        1,
        1,
        1,
    ]
    for segment in segments:
        assert np.allclose(segment.path[0], segment.before.robots[segment.robot].at)
    for before, segment in pairwise(segments):
        for robot in (0, 1):
            assert np.array_equal(before.after.robots[robot].at, segment.before.robots[robot].at)


@pytest.mark.slow
def test_no_segment_touches_anything(task: FullTask, merged: FullOutcome) -> None:
    """Coarser ones are looked at in `test_evaluate.py`, a whole plan by the audit."""
    for segment in merged.segments:
        own = segment.before.robots[segment.robot]
        around = segment.before.around(task.furniture, segment.robot)
        checker = RobotChecker(around, own.payload_shapes(task.furniture), own.opening)
        hits = [q for q in dense(segment, 0.008) if checker.hits(q)]
        assert not hits, segment.name


def test_no_part_floats_or_jumps(task: FullTask, merged: FullOutcome) -> None:
    def poses(groups) -> dict[int, np.ndarray]:
        return {p: pose.homogeneous for g in groups for p, pose in zip(g.parts, g.part_poses(), strict=True)}

    n = len(task.furniture.parts)
    for before, segment in pairwise(merged.segments):
        there, here = poses(before.after.groups()), poses(segment.before.groups())
        assert sorted(here) == list(range(n))
        # Where a hand takes over or lets go, nothing moves but by rounding.
        assert all(np.allclose(there[p], here[p], atol=2e-6) for p in range(n)), segment.name
    final = merged.state
    assert len(final.cell_state.placed) == len(final.groups.groups) == n - 1
    for group, standing in zip(final.groups.groups, final.cell_state.placed, strict=True):
        assert group is standing.group
    assert final.cell_state.robots[0].payload is None
    assert final.cell_state.robots[1].payload is None


def test_mated_parts_are_where_the_furniture_has_them(task: FullTask, merged: FullOutcome) -> None:
    mate = next(segment for segment in merged.segments if segment.stage is Stage.MATE)
    where = {p: q for g in mate.after.groups() for p, q in zip(g.parts, g.part_poses(), strict=True)}
    joined = next(g for g in merged.state.groups.groups if len(g.parts) == 2)
    one, two = joined.parts
    wanted = joined.furniture_from_part[0].actInv(joined.furniture_from_part[1])
    got = where[one].actInv(where[two])
    assert np.linalg.norm(got.translation - wanted.translation) < 1e-5
    assert rotation_angle(got.rotation.T @ wanted.rotation) < 1e-5


def test_approach_lift_mate_and_release_are_straight_lines(merged: FullOutcome) -> None:
    for segment in merged.segments:
        if segment.stage in STRAIGHT - {Stage.SET_DOWN}:
            tips = [world_from_tips(q) for q in segment.path]
            start, end = tips[0].translation, tips[-1].translation
            along = (end - start) / np.linalg.norm(end - start)
            off = np.array([t.translation - start for t in tips])
            assert np.abs(off - np.outer(off @ along, along)).max() < 1e-5, segment.name
            assert max(rotation_angle(t.rotation.T @ tips[0].rotation) for t in tips) < 1e-5, segment.name
            if segment.stage is Stage.LIFT:
                assert along == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)


def test_the_same_seed_gives_the_same_plan(task: FullTask, start: FullState, merged: FullOutcome) -> None:
    assert merged.step is not None
    again = task.step(start, merged.step.action, 3)
    assert again.planning_steps == merged.planning_steps
    for a, b in zip(again.segments, merged.segments, strict=True):
        assert (a.stage, a.robot) == (b.stage, b.robot)
        assert all(np.array_equal(p, q) for p, q in zip(a.path, b.path, strict=True))


def test_a_blocked_grasp_fails_before_anything_moves(task: FullTask, merged: FullOutcome) -> None:
    state = merged.state
    joined = next(g for g in state.groups.groups if len(g.parts) == 2)
    for u in joined.parts:
        free = set(task.free_grips(state.groups, u))
        for c in task.furniture.connections:
            if (
                u == c.part_a
                and c.part_b not in joined.parts
                and task.exists(state, (u, c.part_b, c.point_a, c.point_b, 0, 0))
            ):
                for g in set(range(8)) - free:
                    outcome = task.step(state, (u, c.part_b, c.point_a, c.point_b, g, 0), 0)
                    assert outcome.failure == Failure(FullVerdict.GRASP_BLOCKED, Stage.GRASP, 0)
                    assert outcome.state is state
                    assert outcome.segments == ()


def test_without_a_budget_there_is_no_path(task: FullTask, start: FullState, merged: FullOutcome) -> None:
    assert merged.step is not None

    def searches(outcome: FullOutcome) -> bool:
        """Whether some path has corners, which straight edges have not."""
        lengths = [len(segment.path) for segment in outcome.segments if segment.stage not in STRAIGHT]
        return max(lengths, default=2) > 2

    seed = next(seed for seed in range(20) if searches(task.step(start, merged.step.action, seed)))
    outcome = task.step(start, merged.step.action, seed, Budget(states=1))
    # Straight edges need no search, so it may get some way.
    assert outcome.verdict in (FullVerdict.NO_PATH, FullVerdict.MERGED)
    assert not searches(outcome)


def test_a_budget_limits_the_ways_to_mate_that_are_tried(
    task: FullTask, start: FullState, merged: FullOutcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert merged.step is not None
    tried = list[object]()

    def fails(*args: object) -> Failure:
        tried.append(args)
        return Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_MATE)

    monkeypatch.setattr("roboassembly.task.full.step.drive_and_mate", fails)
    for most in (1, 2, 8):
        tried.clear()
        outcome = task.step(start, merged.step.action, 3, Budget(8_000, stances=most))
        assert outcome.verdict is FullVerdict.NO_PATH
        assert len(tried) == most


@pytest.mark.slow
def test_a_robot_that_stands_in_the_way_drives_elsewhere(task: FullTask, start: FullState, merged: FullOutcome) -> None:
    assert merged.step is not None
    action = merged.step.action
    held = task.free_grips(start.groups, action[0])[action[4]]
    request, stand = request_for(start, action[0], held)
    post = stand.top[:2]

    def without_r_b_moving(state: FullState) -> bool:
        planned = pick(context_of(task, state), state.cell_state, 0, request, np.random.SeedSequence(0))
        return isinstance(planned, Planned)

    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    for far, angle, facing in product((0.4, 0.35, 0.3, 0.25), angles, angles):
        place = post + far * np.array([np.cos(angle), np.sin(angle)])
        at = np.concatenate([place, [facing], start.cell_state.robots[1].at[3:]])
        state = replace(start, cell_state=start.cell_state.moved(1, at))
        if state.cell_state.world(task.furniture, 1).free(at[None])[0] and not without_r_b_moving(state):
            break
    else:
        pytest.fail("R_b is nowhere in the way")
    assert task.can_pick(state, action[0], held, 0, 0), "that is for the other robot to see to"
    outcome = task.step(state, action, 0)
    assert outcome.verdict is FullVerdict.MERGED
    assert [segment.robot for segment in outcome.segments if segment.stage is Stage.MAKE_WAY] == [1]
    for segment in outcome.segments[:4]:
        own = segment.before.robots[segment.robot]
        checker = RobotChecker(
            segment.before.around(task.furniture, segment.robot), own.payload_shapes(task.furniture), own.opening
        )
        assert not [q for q in dense(segment, 0.08) if checker.hits(q)], segment.name


def test_groups_are_picked_with_the_preferred_arm(
    task: FullTask, start: FullState, merged: FullOutcome
) -> None:  # fmt: skip
    assert merged.step is not None
    u, v, _, _, g_a, g_b = merged.step.action
    requests = [request_for(start, part, task.free_grips(start.groups, part)[g])[0] for part, g in ((u, g_a), (v, g_b))]

    def arms(preferred: list[np.ndarray | None]) -> list[np.ndarray]:
        liked = [replace(request, preferred=q) for request, q in zip(requests, preferred, strict=True)]
        planned = pick_both(context_of(task, start), start.cell_state, liked, np.random.SeedSequence(0))
        assert isinstance(planned, Planned)
        return [robot.at for robot in planned.state.robots]

    usual = arms([None, None])
    like: list[np.ndarray | None] = []
    for w, q in zip(requests, usual, strict=True):
        tips = w.group.world_from_furniture * w.grip.furniture_from_tips
        others = reach(tips, 64, np.random.default_rng(1))
        like.append(others[np.argmax(np.linalg.norm((others - q)[:, 3:], axis=1))])
    for before, after, wished in zip(usual, arms(like), like, strict=True):
        assert wished is not None
        far, near = (float(np.linalg.norm((q - wished)[3:])) for q in (before, after))
        assert near < 0.9 * far


def test_a_hand_backs_off_less_where_something_is_behind_it(task: FullTask, merged: FullOutcome) -> None:
    segment = next(s for s in merged.segments if s.stage is Stage.RELEASE and s.robot == 0)
    at = segment.path[0]
    out = -world_from_tips(at).rotation[:, 2]

    def backs_off(far: float) -> float | None:
        """How far, with a small block that far behind the finger tips."""
        place = world_from_tips(at).translation + far * out
        block = Body("block", (Shape(brick(0.01, 0.01, 0.01), SE3.Identity()),), SE3(np.eye(3), place), False)
        way = retreat_path(RobotWorld([block], segment.before.robots[0].opening), at)
        if way is None:
            return None
        return float(np.linalg.norm(world_from_tips(way[-1]).translation - world_from_tips(at).translation))

    assert backs_off(1.0) == pytest.approx(0.10, abs=1e-3)
    found = {backs_off(far) for far in np.arange(0.1, 0.6, 0.01)}
    assert {None if d is None else round(d, 2) for d in found} == {None, 0.05, 0.10}


def test_a_hand_backs_off_less_where_the_arm_does_not_reach_farther() -> None:
    rng, world = np.random.default_rng(0), RobotWorld([], MAX_OPENING)
    found = 0
    for _ in range(2_000):
        at = np.concatenate([np.zeros(3), rng.uniform(arm().low, arm().high)])
        back = -world_from_tips(at).rotation[:, 2]
        if not world.free(at[None]).all() or any(line(at, 0.10 * back, drive=d) for d in (True, False)):
            continue
        way = retreat_path(world, at)
        if way is not None:
            moved = world_from_tips(way[-1]).translation - world_from_tips(at).translation
            assert np.allclose(moved, 0.05 * back, atol=1e-3)
            found += 1
        if found == 3:
            break
    assert found == 3


def test_options_pass_the_cheap_tests_and_name_the_split(task: FullTask, start: FullState) -> None:
    leaving, staying = stretcher_and_leg(task.furniture)
    assert {leaving, staying} <= partition_of(start.groups)
    options = list(grasping(task, start, start.groups, leaving, staying))
    assert options
    for action in options:
        assert task.exists(start, action)
        assert {action[0], action[1]} == {*leaving, *staying}
        assert isinstance(task.mate_grasp(start.groups, action), MateGrasp)


@pytest.mark.slow
def test_the_search_assembles_a_stool_with_two_robots(stool: Furniture) -> None:
    result = solve_full(stool, 0)
    assert result.plan.success, result.reason
    assert len(result.plan.steps) == len(stool.parts) - 1
    for step in result.plan.steps:
        end = step.segments[-1].after
        free = [end.world(stool, robot).free(end.robots[robot].at[None])[0] for robot in (0, 1)]
        assert all(free), "a post rose where a robot stands"
    again = solve_full(stool, 0)
    assert [s.action for s in again.plan.steps] == [s.action for s in result.plan.steps]
    gone = solve_full(stool, 0, limits=SearchLimits(attempts=2))
    assert not gone.plan.success
    assert "limits reached after 2 merges tried" in gone.reason


def test_a_part_that_hands_can_never_join_is_refused(task: FullTask) -> None:
    """A cushion on a seat: whatever holds it has a finger between the two."""
    assert task.unjoinable is None
    lower, upper = brick(0.4, 0.3, 0.02), brick(0.3, 0.2, 0.05).transformed(pose(z=0.035 + GAP))
    hopeless = FullTask(furniture("pad on a board", {"board": lower, "pad": upper}))
    assert all(part.grasps for part in hopeless.furniture.parts)
    with pytest.raises(InputError, match=r"no hand can hold part '(pad|board)' where it is joined to another part"):
        hopeless.initial_state(np.random.default_rng(0))
    # A pad that stands out over the edge can be held there.
    over = upper.transformed(pose(x=0.15))
    assert FullTask(furniture("pad over an edge", {"board": lower, "pad": over})).unjoinable is None


def test_a_query_between_steps_changes_nothing(task: FullTask, start: FullState, merged: FullOutcome) -> None:
    assert merged.step is not None
    action = merged.step.action
    grasp = task.mate_grasp(start.groups, action)
    assert isinstance(grasp, MateGrasp)
    for seed in (3, 4):
        assert task.can_mate(start, grasp, seed)
        assert task.can_pick(start, action[0], grasp.grip_a, 0, seed)
        assert task.can_pick(start, action[1], grasp.grip_b, 1, seed)
    again = task.step(start, action, 3)
    assert paths_of(again) == paths_of(merged)
    assert again.planning_steps == merged.planning_steps


def test_another_process_plans_the_same(stool: Furniture, merged: FullOutcome) -> None:
    assert merged.step is not None
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        paths, states = pool.submit(planned_elsewhere, stool, merged.step.action).result()
    assert (paths, states) == (paths_of(merged), merged.planning_steps)


def paths_of(outcome: FullOutcome) -> list[tuple[str, list[list[float]]]]:
    return [(segment.name, [q.tolist() for q in segment.path]) for segment in outcome.segments]


def planned_elsewhere(stool: Furniture, action: tuple[int, ...]) -> tuple[list[tuple[str, list[list[float]]]], int]:
    task = FullTask(stool)
    outcome = task.step(task.initial_state(np.random.default_rng(0)), action, 3)
    return paths_of(outcome), outcome.planning_steps


def test_a_stage_can_be_planned_by_itself(task: FullTask, start: FullState, merged: FullOutcome) -> None:
    """A pick changes nothing, does not depend on other stages, and counts its own states."""
    assert merged.step is not None
    request, _ = request_for(
        start, merged.step.action[0], task.free_grips(start.groups, merged.step.action[0])[merged.step.action[4]]
    )
    planned = [
        pick(context_of(task, start), start.cell_state, 0, request, np.random.SeedSequence(seed)) for seed in (1, 2, 1)
    ]
    stages = [Stage.DRIVE_TO_GROUP, Stage.APPROACH, Stage.LIFT]
    for one in planned:
        assert isinstance(one, Planned)
        assert [segment.stage for segment in one.segments] == stages
        assert one.states > 0
        assert one.state.robots[0].payload is not None
        assert start.cell_state.robots[0].payload is None
    first, other, again = (np.concatenate(one.segments[0].path) for one in planned if isinstance(one, Planned))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_attempt_is_drawn_by_its_own_key() -> None:
    seed = np.random.SeedSequence(5)
    keys = [(), (0,), (1,), (0, 1), (1, 0)]
    words = [tuple(child_seed(seed, *key).generate_state(2).tolist()) for key in keys]
    assert len(set(words)) == len(keys)
    assert child_seed(child_seed(seed, 0), 1).generate_state(1) == child_seed(seed, 0, 1).generate_state(1)
    assert seed.n_children_spawned == 0


def test_failures_name_stage_and_robot_in_one_place() -> None:
    failure = Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_GROUP, 1, final=True, states=7)
    assert failure == Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_GROUP, 1)
    assert failure.stage_text == "R_b: drive to group"
    assert Failure(FullVerdict.NO_ARM_SOLUTION, Stage.MATE).stage_text == "mate"
    assert Failure(FullVerdict.WRONG_PAIR).stage_text == ""
    assert not PICKING & AFTER_MATING
