"""Trajectories of plans: read back from their files, within the limits, where the plan says, as long as physics."""

from __future__ import annotations

import csv
import io
import json
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from command_line import Run
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.robots.body import world_from_tips
from roboassembly.robots.description import JOINT_NAMES, robots_urdf
from roboassembly.robots.limits import FINGER_SPEED, LIMITS, magnitudes
from roboassembly.settings import SETTINGS, set_upright
from roboassembly.task.full.execution import execute
from roboassembly.task.full.failure import Stage
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.motion_record import decode_motions
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.trajectories.files import write_trajectory
from roboassembly.task.trajectories.tables import encode_csv, encode_json
from roboassembly.task.trajectories.trajectory import Trajectory, time_plan

RATE = 20.0
FULL = np.array([LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk])


@pytest.fixture(scope="module")
def plan(chair: Callable[..., Furniture]) -> FullPlan:
    return set_upright(SETTINGS["full"].solve(chair("three_legged", 24), seed=0).plan)


@pytest.fixture(scope="module")
def trajectory(plan: FullPlan) -> Trajectory:
    return time_plan(decode_motions(plan_file.encode(plan), "plan.json"), plan.furniture)


@pytest.fixture(scope="module")
def messages(trajectory: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[float, Any]]]:
    """Messages of the MCAP file by topic, each with its time."""
    pytest.importorskip("mcap_ros2")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path = tmp_path_factory.mktemp("mcap") / "trajectory.mcap"
    write_trajectory(trajectory, RATE, path, "mcap")
    out: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        attachment = next(reader.iter_attachments())
        assert (attachment.name, attachment.data.decode()) == ("robots.urdf", robots_urdf())
        for _, channel, message, decoded in reader.iter_decoded_messages():
            out[channel.topic].append((message.log_time * 1e-9 - 1.0, decoded))
    return out


def derivatives(q: np.ndarray, step: float) -> np.ndarray:
    """Largest shares of the limits of velocity, acceleration and jerk, by differences of samples."""
    return np.array([(magnitudes(np.diff(q, k, axis=0) / step**k) / FULL[k - 1]).max() for k in (1, 2, 3)])


def pose_of(message: Any) -> SE3:
    t, r = message.transform.translation, message.transform.rotation
    return SE3(pin.Quaternion(r.w, r.x, r.y, r.z).toRotationMatrix(), np.array([t.x, t.y, t.z]))


def final_poses(plan: FullPlan) -> tuple[SE3, ...]:
    return TaskState(tuple(plan.final_cell_state.groups())).part_poses


def test_joint_states_keep_limits_and_begin_and_end_as_planned(
    plan: FullPlan, messages: dict[str, list[tuple[float, Any]]], trajectory: Trajectory
) -> None:
    states = messages["/joint_states"]
    times = np.array([time for time, _ in states])
    assert times[0] == pytest.approx(0.0)
    assert times[-1] == pytest.approx(trajectory.seconds)
    assert np.allclose(np.diff(times)[:-1], 1.0 / RATE)
    names = states[0][1].name
    assert names == [prefix + joint for prefix in ("a_", "b_") for joint in JOINT_NAMES]
    stamp = states[20][1].header.stamp
    assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(2.0)
    q = np.array([message.position for _, message in states])
    v = np.array([message.velocity for _, message in states])
    for robot in (0, 1):
        own = slice(12 * robot, 12 * robot + 10)
        assert np.allclose(q[0, own], plan.initial.cell_state.robots[robot].at)
        assert np.allclose(q[-1, own], plan.final_cell_state.robots[robot].at)
        assert derivatives(q[:-1, own], 1.0 / RATE).max() <= 1.0
        # The positions between two samples are those that the velocities make: the platform's, which changes slowest.
        mean = 0.5 * (v[1:-1, own] + v[:-2, own])[:, :2]
        gap = np.abs((q[1:-1, own] - q[:-2, own])[:, :2] * RATE - mean)
        assert gap.max() < 0.25 * LIMITS.acceleration[0] / RATE + 1e-9
        fingers = slice(12 * robot + 10, 12 * robot + 12)
        assert np.abs(v[:, fingers]).max() <= FINGER_SPEED
        assert 0.02 < q[:, fingers].max() <= 0.04


def test_parts_end_where_the_plan_has_them_and_never_jump(
    plan: FullPlan, messages: dict[str, list[tuple[float, Any]]]
) -> None:
    names = {f"{plan.furniture.name}/{part.name}": i for i, part in enumerate(plan.furniture.parts)}
    poses = []
    for _, message in messages["/tf"]:
        there = {t.child_frame_id: t for t in message.transforms}
        assert all(there[name].header.frame_id == "world" for name in names)
        poses.append([pose_of(there[name]) for name in names])
    for pose, planned in zip(poses[-1], final_poses(plan), strict=True):
        assert np.allclose(pose.homogeneous, planned.homogeneous, atol=1e-9)
    for pose, planned in zip(poses[0], plan.initial.groups.part_poses, strict=True):
        assert np.allclose(pose.homogeneous, planned.homogeneous, atol=1e-9)
    places = np.array([[pose.translation for pose in row] for row in poses])
    assert np.linalg.norm(np.diff(places, axis=0), axis=2).max() < 0.3
    # All parts have moved, and at the end they are the furniture.
    assert np.linalg.norm(places[-1] - places[0], axis=1).min() > 0.1


def test_each_motion_is_a_joint_trajectory(
    messages: dict[str, list[tuple[float, Any]]], trajectory: Trajectory
) -> None:
    sent = sorted([*messages["/a/joint_trajectory"], *messages["/b/joint_trajectory"]], key=lambda m: m[0])
    assert len(sent) == len(trajectory.segments)
    for (time, message), timed in zip(sent, trajectory.segments, strict=True):
        assert time == pytest.approx(timed.start)
        prefix = "ab"[timed.segment.robot]
        assert message.joint_names[0] == f"{prefix}_x"
        first, last = message.points[0], message.points[-1]
        assert np.allclose(first.positions, timed.segment.path[0])
        assert np.allclose(last.positions, timed.segment.path[-1])
        assert np.abs(last.velocities).max() < 1e-6
        since = last.time_from_start
        assert since.sec + 1e-9 * since.nanosec == pytest.approx(timed.motion.seconds)


def test_the_robots_description_has_the_planners_kinematics(messages: dict[str, list[tuple[float, Any]]]) -> None:
    model = pin.buildModelFromXML(messages["/robot_description"][0][1].data)
    data = model.createData()
    _, states = messages["/joint_states"][400]
    q = pin.neutral(model)
    for name, value in zip(states.name, states.position, strict=True):
        joint = model.joints[model.getJointId(name)]
        # Joints that turn without end have cosine and sine.
        q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
    pin.framesForwardKinematics(model, data, q)
    # The frames of /tf and /tf_static, from link to link.
    links = {t.child_frame_id: t for t in messages["/tf_static"][0][1].transforms}
    links |= {t.child_frame_id: t for t in messages["/tf"][400][1].transforms}
    for robot, prefix in enumerate("ab"):
        configuration = np.array(states.position[12 * robot : 12 * robot + 10])
        planned = world_from_tips(configuration).homogeneous
        frame = f"{prefix}_panda_hand_tcp"
        assert np.allclose(data.oMf[model.getFrameId(frame)].homogeneous, planned, atol=1e-9)
        pose = SE3.Identity()
        while frame != "world":
            pose, frame = pose_of(links[frame]) * pose, links[frame].header.frame_id
        assert np.allclose(pose.homogeneous, planned, atol=1e-9)


def test_csv_samples_of_every_tick_keep_all_limits(plan: FullPlan, trajectory: Trajectory) -> None:
    record = trajectory.record
    first = replace(record, segments=record.segments[: len(plan.steps[0].segments)])
    trajectory = time_plan(first, plan.furniture)
    rows = list(csv.reader(io.StringIO(encode_csv(trajectory, 500.0).decode())))
    head = rows[0]
    assert head[:3] == ["time", "segment", "a_x"]
    names = {row[1] for row in rows[1:]}
    assert {"R_a: approach", "R_a: mate", "R_b: carry"} <= names
    numbers = np.array([[float(x) for x in [row[0], *row[2:]]] for row in rows[1:]])
    times = numbers[:, 0]
    assert np.allclose(np.diff(times), 0.002)
    for prefix in ("a_", "b_"):
        q, v, a = (
            numbers[:, [head.index(prefix + joint + kind) - 1 for joint in JOINT_NAMES[:10]]]
            for kind in ("", ".velocity", ".acceleration")
        )
        shares = derivatives(q, 0.002)
        assert shares.max() <= 1.0 + 1e-4
        assert shares.max() > 0.95
        assert (magnitudes(v) / FULL[0]).max() <= 1.0
        assert (magnitudes(a) / FULL[1]).max() <= 1.0


def test_json_has_every_motion_and_the_limits(plan: FullPlan, trajectory: Trajectory) -> None:
    content = json.loads(encode_json(trajectory, 20.0))
    assert content["format"] == "roboassembly.trajectory"
    assert content["limits"]["velocity"] == [1.2, 2.5, 2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]
    assert len(content["motions"]) == sum(len(s.segments) for s in plan.steps) + len(plan.final_segments)
    at = [np.array(q) for q in content["robots"]]
    end = 0.0
    for motion in content["motions"]:
        assert motion["start"] >= end - 1e-9
        end = motion["start"] + motion["seconds"]
        assert np.allclose(motion["positions"][0], at[motion["robot"]], atol=1e-8)
        at[motion["robot"]] = np.array(motion["positions"][-1])
        assert motion["times"][-1] == pytest.approx(motion["seconds"])
    assert content["seconds"] >= end
    for row, planned in zip(content["final"], final_poses(plan), strict=True):
        assert np.allclose(row[:3], planned.translation, atol=1e-9)


def test_hands_close_once_they_are_there_and_open_once_the_group_stands(trajectory: Trajectory) -> None:
    for timed in trajectory.segments:
        if timed.segment.stage is Stage.APPROACH:
            hand = next(h for h in trajectory.hand_motions if h.robot == timed.segment.robot and h.start > timed.start)
            assert hand.start >= timed.end
            assert hand.after < hand.before
        if timed.segment.stage is Stage.LIFT:
            width = 2.0 * trajectory.fingers(timed.segment.robot, np.array([timed.start, timed.end]))[0]
            assert np.allclose(width, timed.segment.opening)


def test_a_trajectory_lasts_as_long_as_physics_takes(plan: FullPlan, trajectory: Trajectory) -> None:
    step = plan.steps[0]
    done = execute(plan.furniture, plan.initial.cell.density, step)
    assert done.success
    following = trajectory.segments[len(step.segments)]
    # Hands that open farther than a tenth of a second allows need longer here; in physics they are open at once.
    assert following.start == pytest.approx(done.seconds, abs=0.2)


BROKEN: list[tuple[str, Callable[[dict[str, Any]], object], str]] = [
    ("not finite", lambda p: p["steps"][0]["segments"][0]["path"][0].__setitem__(3, None), "Expected `float`"),
    ("nine numbers", lambda p: p["steps"][0]["segments"][0]["path"][0].pop(), "expected configurations of 10 numbers"),
    ("beyond the joint", lambda p: p["steps"][0]["segments"][0]["path"][-1].__setitem__(6, 1.0), "joint 4 at 1.0000"),
    ("a leap", lambda p: p["steps"][0]["segments"][1]["path"][0].__setitem__(0, 9.0), "does not begin where R_"),
    ("no third robot", lambda p: p["steps"][0]["segments"][0].__setitem__("robot", 2), "robot 2; expected 0 or 1"),
    ("no such part", lambda p: p["steps"][0]["segments"][2]["payload"][0].__setitem__("part", 99), "expected parts 0"),
    ("bad pose", lambda p: p["initial"][0].__setitem__(3, 7.0), "expected (x, y, z, qw, qx, qy, qz)"),
    ("no density", lambda p: p.__setitem__("density", 0.0), "density 0.0"),
    ("one robot", lambda p: p["robots"].pop(), "1 robots; expected 2"),
    ("unknown stage", lambda p: p["steps"][0]["segments"][0].__setitem__("stage", "fly"), "Invalid enum value 'fly'"),
    ("objects only", lambda p: p.__setitem__("setting", "object-centric"), "expected"),
]


@pytest.mark.parametrize(("change", "message"), [row[1:] for row in BROKEN], ids=[row[0] for row in BROKEN])
def test_broken_plans_are_refused_in_one_line(
    plan: FullPlan, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    document = json.loads(plan_file.encode(plan))
    change(document)
    with pytest.raises(InputError) as error:
        decode_motions(json.dumps(document).encode(), "broken.json")
    assert message in str(error.value)
    assert "broken.json" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plan_of_other_furniture_is_refused(plan: FullPlan, chair: Callable[..., Furniture]) -> None:
    with pytest.raises(InputError, match="with other parts"):
        time_plan(decode_motions(plan_file.encode(plan), "plan.json"), chair("stool", 0))


def test_the_command_writes_what_it_says(plan: FullPlan, tmp_path: Path, run: Run) -> None:
    (tmp_path / "plan.json").write_bytes(plan_file.encode(plan))
    storage.save(plan.furniture, tmp_path / "furniture")
    arguments = ["export", "trajectory", str(tmp_path / "plan.json"), "--out", str(tmp_path / "out")]
    status, out, _ = run(*arguments, "--format", "csv", "--rate", "10", "--json")
    assert status == 0
    result = json.loads(out)
    path = Path(result["outputs"]["csv"])
    rows = path.read_text().splitlines()
    assert len(rows) == pytest.approx(result["seconds"] * 10, abs=3)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    for more, message in (
        (["--format", "csv"], "exists already"),
        (["--format", "json", "--rate", "0"], "--rate 0: expected 1 to 1000"),
        (["--format", "json", "--rate", "nan"], "--rate nan"),
    ):
        status, _, err = run(*arguments, *more)
        assert status == 2
        assert message in err
        assert len(err.strip().splitlines()) == 1
    status, _, err = run("export", "mjcf", "stool", "--format", "csv", "--out", str(tmp_path / "m"))
    assert status == 2
    assert "--format is for trajectories" in err
