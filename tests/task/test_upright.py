"""After the last merge the finished piece is set upright on its feet: planned, checked, recorded and shown."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import shapes
from roboassembly.audit.full import RobotViolationKind, audit_full_plan
from roboassembly.audit.object_centric import ViolationKind, audit_plan
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, pose_from_seven, transform_points
from roboassembly.learning.policy import guide_of
from roboassembly.learning.registry import load_policy
from roboassembly.settings import set_upright
from roboassembly.solvers.search import solve
from roboassembly.studio.assembly_session import AssemblySession
from roboassembly.studio.messages import upright_message
from roboassembly.task.full.cell import Cell
from roboassembly.task.full.cell_state import CellState, PlacedGroup, Robot
from roboassembly.task.full.execution import ExecutionVerdict, execute_upright
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.posts import on_post
from roboassembly.task.full.segments import TUCKED
from roboassembly.task.object_centric.settling import settle_group
from roboassembly.task.object_centric.stance import stance_of, standing_at
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.full_plan import FullPlan, FullState, FullUprightMotion
from roboassembly.task.plans.plan import Plan, UprightMotion
from roboassembly.task.rules.groups import Group, TaskState
from roboassembly.viewer.playback import make_timeline
from roboassembly.viewer.timeline import Phase, Role

pytest.importorskip("fcl")

ON_ITS_SIDE = shapes.pose(rotation=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])).rotation


def whole(furniture: Furniture) -> Group:
    parts = tuple(range(len(furniture.parts)))
    return Group(parts, parts, furniture.assembled, SE3.Identity())


def finished(furniture: Furniture, rotation: np.ndarray) -> Plan:
    """All merges done, the piece at rest where it fell when it was let go turned like this."""
    _, rested = settle_group(furniture, standing_at(furniture, whole(furniture), rotation))
    return Plan(furniture, rested.part_poses(), (), True, 0)


def heights(furniture: Furniture, poses: tuple[SE3, ...]) -> np.ndarray:
    points = [transform_points(pose, part.mesh.vertices) for part, pose in zip(furniture.parts, poses, strict=True)]
    return np.concatenate(points)[:, 2]


def tilt_in_degrees(furniture: Furniture, poses: tuple[SE3, ...]) -> float:
    """Between the furniture's z axis and the vertical, for parts in their own slots."""
    frame = poses[0] * furniture.assembled[0].inverse()
    return float(np.rad2deg(np.arccos(np.clip(frame.rotation[2, 2], -1.0, 1.0))))


def motion_of(plan: Plan) -> UprightMotion:
    assert plan.upright is not None
    assert plan.upright.motion is not None
    return plan.upright.motion


@pytest.mark.parametrize(
    "family",
    [
        "stool",
        "table_apron",
        "shelf_open",
        "three_legged",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ladder", "bench", "windsor", "pedestal")),
    ],
)
def test_any_resting_piece_ends_on_its_feet(chair, family: str) -> None:
    furniture = chair(family, 0)
    moved = 0
    for seed in range(4):
        plan = set_upright(finished(furniture, shapes.random_pose(np.random.default_rng(seed), 0.0).rotation))
        assert plan.upright is not None
        assert (plan.upright.success, plan.upright.reason) == (True, "")
        assert tilt_in_degrees(furniture, plan.final_poses) < 2.0
        assert 0.0 <= heights(furniture, plan.final_poses).min() < 0.002
        report = audit_plan(plan)
        assert report.passed, report.summary()
        if plan.upright.motion is not None:
            moved += 1
            assert plan.upright.planning_steps > 0
            assert report.states > 100
    assert moved > 0


def test_a_rocking_chair_ends_on_its_rockers(chair) -> None:
    """It leans by some degrees, as rocking chairs do."""
    furniture = chair("rocker", 3)
    plan = set_upright(finished(furniture, ON_ITS_SIDE))
    assert motion_of(plan)
    assert tilt_in_degrees(furniture, plan.initial) > 45.0
    assert 2.0 < tilt_in_degrees(furniture, plan.final_poses) < 8.0
    assert audit_plan(plan).passed


def test_a_piece_that_stands_already_is_left_alone(chair) -> None:
    plan = set_upright(finished(chair("ladder", 0), np.eye(3)))
    assert plan.upright is not None
    assert (plan.upright.success, plan.upright.motion, plan.upright.planning_steps) == (True, None, 0)
    assert plan.final_poses == plan.initial


def overhanging() -> Furniture:
    """A beam far out on one side of a small foot."""
    return shapes.furniture("overhang", {
        "foot": shapes.box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.4)),
        "beam": shapes.box((-0.05, -0.05, 0.4 + shapes.GAP), (0.6, 0.05, 0.45)),
    })  # fmt: skip


def balancing() -> Furniture:
    """A plate on an upturned pyramid: upright it stays, until something touches it."""
    point, plate = shapes.prism(4, 0.004, 0.3, 0.06), shapes.prism(8, 0.2, 0.02)
    on_point = 0.3 + shapes.GAP - plate.bounds[0][2]
    return shapes.furniture(
        "balance",
        {
            "point": point.transformed(shapes.pose(z=-point.bounds[0][2])),
            "plate": plate.transformed(shapes.pose(z=on_point)),
        },
    )


def test_piece_that_would_tip_over_stays_and_the_plan_names_the_reason() -> None:
    plan = set_upright(finished(overhanging(), ON_ITS_SIDE))
    assert plan.upright is not None
    assert (plan.upright.success, plan.upright.motion) == (False, None)
    assert "tips over" in plan.upright.reason
    assert plan.final_poses == plan.initial
    assert make_timeline(plan, 10.0, None).frames[-1].caption.endswith("not set upright")
    assert json.loads(plan_file.encode(plan))["upright"]["motion"] is None
    assert upright_message(plan.upright).startswith(" It is not set upright: it does not stay upright")


def test_a_piece_that_only_balances_does_not_stand() -> None:
    furniture = balancing()
    stance = stance_of(furniture, furniture.assembled)
    assert stance is not None
    _, let_be = settle_group(furniture, standing_at(furniture, whole(furniture), np.eye(3)))
    assert tilt_in_degrees(furniture, let_be.part_poses()) < 2.0, "unnudged it stays, or this tests nothing"
    assert stance.reason


def test_parts_that_are_not_the_furniture_are_not_set_upright(chair) -> None:
    plan = finished(chair("stool", 0), ON_ITS_SIDE)
    moved = (SE3(plan.initial[0].rotation, plan.initial[0].translation + 0.1), *plan.initial[1:])
    upright = set_upright(replace(plan, initial=moved)).upright
    assert upright is not None
    assert not upright.success
    assert "not where the furniture has them" in upright.reason
    unfinished = replace(plan, success=False)
    assert set_upright(unfinished) is unfinished


# The audit


@cache
def _stool_set_upright(furniture: Furniture) -> Plan:
    return set_upright(finished(furniture, ON_ITS_SIDE))


def with_motion(plan: Plan, **changed: object) -> Plan:
    assert plan.upright is not None
    return replace(plan, upright=replace(plan.upright, motion=replace(motion_of(plan), **changed)))


def shifted(pose: SE3, z: float) -> SE3:
    return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, z]))


def test_the_audit_catches_a_path_through_the_ground(chair) -> None:
    plan = _stool_set_upright(chair("stool", 0))
    assert audit_plan(plan).passed
    start, _, _, goal = motion_of(plan).path
    report = audit_plan(with_motion(plan, path=(start, goal)))  # turned without being lifted
    assert set(report.counts) == {ViolationKind.PATH_GROUND}
    assert report.first[0].step == len(plan.steps)
    below = audit_plan(with_motion(plan, path=(start, shifted(start, -0.05), goal)))
    assert below.counts[ViolationKind.PATH_GROUND] > 0


def test_audit_finds_wrong_starts_and_non_rigid_motions(chair) -> None:
    plan = _stool_set_upright(chair("stool", 0))
    path = motion_of(plan).path
    jump = audit_plan(with_motion(plan, path=(shifted(path[0], 0.1), *path[1:])))
    assert jump.counts[ViolationKind.DISCONTINUITY] == len(plan.initial)
    first, *rest = motion_of(plan).after
    bent = audit_plan(with_motion(plan, after=(shifted(first, 0.1), *rest)))
    assert bent.counts[ViolationKind.NOT_RIGID] > 0
    lost = audit_plan(with_motion(plan, moving=dict(list(motion_of(plan).moving.items())[1:])))
    assert set(lost.counts) == {ViolationKind.MISSING_PART}


def test_the_audit_catches_a_piece_that_does_not_stand(chair) -> None:
    plan = _stool_set_upright(chair("stool", 0))
    assert plan.upright is not None
    lying = audit_plan(replace(plan, upright=replace(plan.upright, motion=None)))
    assert set(lying.counts) == {ViolationKind.NOT_UPRIGHT}
    after = tuple(shifted(pose, 0.2) for pose in motion_of(plan).after)
    hanging = audit_plan(with_motion(plan, after=after))
    assert set(hanging.counts) == {ViolationKind.NOT_UPRIGHT}
    furniture = overhanging()
    falling = set_upright(finished(furniture, np.eye(3)))
    assert falling.upright is not None
    up = standing_at(furniture, whole(furniture), np.eye(3)).part_poses()
    said = audit_plan(replace(falling, initial=up, upright=replace(falling.upright, success=True)))
    assert set(said.counts) == {ViolationKind.NOT_UPRIGHT}


# The record


def test_a_plan_that_was_searched_ends_upright_in_the_file_and_in_the_pictures(chair) -> None:
    guide = guide_of(load_policy("relational"))
    result = solve(chair("ladder", 0), 0, guide=guide)
    assert result.plan.upright is None
    assert tilt_in_degrees(result.plan.furniture, result.plan.final_poses) > 45.0
    plan = set_upright(result.plan)
    assert plan.steps == result.plan.steps
    assert set_upright(plan) is plan
    assert plan_file.encode(plan) == plan_file.encode(set_upright(result.plan))

    told = json.loads(plan_file.encode(plan))
    assert (told["version"], told["upright"]["success"], told["upright"]["reason"]) == (3, True, "")
    motion = told["upright"]["motion"]
    start = pose_from_seven(motion["path"][0])
    for placed in motion["moving"]:
        left = pose_from_seven(told["steps"][-1]["after"][placed["part"]])
        here = start * pose_from_seven(placed["pose"])
        assert np.allclose(here.homogeneous, left.homogeneous, atol=1e-6)
    poses = tuple(pose_from_seven(p) for p in motion["after"])
    assert heights(plan.furniture, poses).min() == pytest.approx(0.001, abs=1e-6)

    timeline = make_timeline(plan, 12.0, None)
    last = timeline.frames[-1]
    assert last.phase is Phase.FINALE
    for shown, pose in zip(last.poses, plan.final_poses, strict=True):
        assert shown is not None
        assert np.allclose(shown.homogeneous, pose.homogeneous, atol=1e-12)
    played = [frame for frame in timeline.frames if frame.caption == "ladder-0: set upright"]
    assert len(played) > 10
    assert set(played[0].roles) == {Role.MOVING}
    lows = [heights(plan.furniture, tuple(p for p in frame.poses if p is not None)).min() for frame in played]
    assert min(lows) > -1e-3, "never in the ground"
    assert max(lows) > 0.01, "lifted"


def test_files_of_the_version_before_are_read_and_of_a_later_one_refused(chair) -> None:
    told = json.loads(plan_file.encode(set_upright(finished(chair("stool", 0), ON_ITS_SIDE))))
    script = plan_file.decode(json.dumps(told).encode(), "plan.json")
    del told["upright"]
    assert plan_file.decode(json.dumps(told | {"version": 1}).encode(), "plan.json") == script
    with pytest.raises(InputError, match=r"version 4; this program reads .* versions 1, 2, 3: `roboassembly assemble`"):
        plan_file.decode(json.dumps(told | {"version": 4}).encode(), "plan.json")


# The studio


def test_the_studio_sets_a_finished_piece_upright_and_undo_takes_that_back(chair) -> None:
    session = AssemblySession(chair("stool", 0), seed=1)
    assert session.search(guide_of(load_policy("relational")), lambda _: True) == ""
    assert session.upright is not None
    assert session.upright.success
    plan = session.plan()
    assert isinstance(plan, Plan)
    assert tilt_in_degrees(session.furniture, plan.final_poses) < 2.0
    assert upright_message(session.upright) == " It stands on its feet."
    last = plan.steps[-1].action
    assert session.undo()
    assert session.upright is None
    assert session.plan().upright is None
    assert session.attempt(last).merged
    assert plan_file.encode(session.plan()) == plan_file.encode(plan)


# Two robots


@cache
def _full(furniture: Furniture, lying: bool) -> FullPlan:
    """A finished piece on its post, both robots beside it; as after the last merge."""
    turned = whole(furniture).moved_to(SE3(ON_ITS_SIDE if lying else np.eye(3), np.zeros(3)))
    held = on_post(furniture, turned, np.array([1.6, 0.0]))
    assert held is not None
    robots = tuple(Robot(np.array([x, -0.8, 0.0, *TUCKED]), 0.0) for x in (-0.6, 0.6))
    state = CellState((PlacedGroup(*held),), (robots[0], robots[1]))
    initial = FullState(TaskState((held[0],)), state, Cell(1.6, 400.0))
    return set_upright(FullPlan(furniture, initial, (), True, 0))


@pytest.mark.parametrize("lying", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_robot_sets_the_piece_on_its_feet_on_the_floor(chair, lying: bool) -> None:
    furniture = chair("stool", 0)
    plan = _full(furniture, lying)
    assert plan.upright is not None
    assert (plan.upright.success, plan.upright.reason) == (True, "")
    stages = [segment.stage for segment in plan.final_segments]
    assert stages[-7:] == [
        Stage.DRIVE_TO_GROUP, Stage.APPROACH, Stage.LIFT, Stage.CARRY, Stage.SET_DOWN, Stage.RELEASE, Stage.LEAVE,
    ]  # fmt: skip
    end = plan.final_cell_state
    assert (end.placed, end.free_posts) == ((), ())
    assert [robot.payload for robot in end.robots] == [None, None]
    poses = end.on_floor[0].part_poses()
    assert tilt_in_degrees(furniture, poses) < 2.0
    assert heights(furniture, poses).min() == pytest.approx(0.001, abs=1e-6)
    report = audit_full_plan(plan)
    assert report.passed, report.summary()
    assert report.segments == len(stages)
    told = json.loads(plan_file.encode(plan))["upright"]
    assert [segment["stage"] for segment in told["motion"]["segments"]] == stages
    last = make_timeline(plan, 10.0, None).frames[-1]
    for shown, pose in zip(last.poses, poses, strict=False):
        assert shown is not None
        assert np.allclose(shown.homogeneous, pose.homogeneous, atol=1e-9)


def test_the_same_plan_gives_the_same_segments(chair) -> None:
    plan = _full(chair("stool", 0), False)
    assert plan_file.encode(set_upright(replace(plan, upright=None))) == plan_file.encode(plan)


def test_the_audit_catches_a_piece_that_a_robot_put_through_the_floor_or_left_hanging(chair) -> None:
    plan = _full(chair("stool", 0), False)
    assert plan.upright is not None

    def with_segments(segments: tuple) -> FullPlan:
        return replace(plan, upright=replace(plan.upright, motion=FullUprightMotion(segments)))

    hanging = audit_full_plan(with_segments(plan.final_segments[:3]), 0.1)
    assert set(hanging.counts) == {RobotViolationKind.NOT_UPRIGHT}
    moments = [segment.before for segment in plan.final_segments]
    sunk = moments[-1].on_floor[0]
    sunk = sunk.moved_to(shifted(sunk.world_from_furniture, -0.05))
    segments = tuple(replace(segment, before=replace(segment.before, on_floor=(sunk,) * len(segment.before.on_floor)))
                 for segment in plan.final_segments)  # fmt: skip
    assert {RobotViolationKind.NOT_UPRIGHT, RobotViolationKind.JUMP} <= set(
        audit_full_plan(with_segments(segments), 0.1).counts
    )


def test_robot_reports_why_a_piece_stays_on_its_post(chair) -> None:
    """It would tip over, or no hand can hold it."""
    tipping = _full(overhanging(), False).upright
    assert tipping is not None
    assert (tipping.success, tipping.motion) == (False, None)
    assert "tips over" in tipping.reason
    plan = _full(chair("stool", 0), False)
    bare = replace(plan.furniture, parts=tuple(replace(part, grasps=()) for part in plan.furniture.parts))
    left = set_upright(replace(plan, furniture=bare, upright=None))
    assert left.upright is not None
    assert left.success
    assert left.upright.reason == "no hand reaches it both on its post and on the floor (0 grasps tried)"
    assert left.final_cell_state.placed == plan.initial.cell_state.placed
    assert make_timeline(left, 10.0, None).frames[-1].caption.endswith("not set upright")


def test_it_is_carried_out_in_physics_and_a_dropped_piece_is_reported(chair) -> None:
    plan = _full(chair("stool", 0), False)
    done = execute_upright(plan)
    assert done is not None
    assert (done.ending, done.segment) == (ExecutionVerdict.DONE, "")
    assert 0.0 < done.tracking < 0.005
    assert done.pad_force > 5.0
    assert execute_upright(plan) == done
    assert execute_upright(replace(plan, upright=None)) is None

    # Let go above the post from which it was lifted, it falls.
    lifted = next(segment for segment in plan.final_segments if segment.stage is Stage.CARRY).path[0]
    segments = plan.final_segments[:-4] + tuple(
        replace(segment, path=(lifted, lifted)) for segment in plan.final_segments[-4:]
    )
    assert plan.upright is not None
    dropped = execute_upright(replace(plan, upright=replace(plan.upright, motion=FullUprightMotion(segments))))
    assert dropped is not None
    assert (dropped.ending, dropped.success) == (ExecutionVerdict.NOT_STANDING, False)
    assert dropped.segment.endswith("leave")
