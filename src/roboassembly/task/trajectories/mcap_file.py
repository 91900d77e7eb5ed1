"""Trajectories as MCAP, the recording format of ROS 2 and Foxglove.

    /robot_description   std_msgs/String                  URDF of both robots; also an attachment, `robots.urdf`
    /joint_states        sensor_msgs/JointState           all joints of both robots, at the rate of samples
    /a/joint_trajectory  trajectory_msgs/JointTrajectory  each motion of R_a when it begins; /b/ those of R_b
    /tf_static           tf2_msgs/TFMessage               links that do not move in their parents
    /tf                  tf2_msgs/TFMessage               the other links, and every part in `world`, at the rate

Times begin at `EPOCH`: ROS takes the time zero for none.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from roboassembly.errors import MissingExtraError
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.robots.description import JOINT_NAMES, PREFIXES, WORLD, described_joints, robots_urdf
from roboassembly.task.trajectories.ros_messages import (
    DEFINITIONS,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    STRING,
    TRANSFORMS,
)
from roboassembly.task.trajectories.tables import joint_states, sample_times
from roboassembly.task.trajectories.trajectory import TimedSegment, Trajectory

if TYPE_CHECKING:
    from mcap_ros2.writer import Writer

EPOCH = 1.0
"""Time stamp of the beginning [s]."""
_NANO = 1_000_000_000
EXTRA = "mcap"


def check_mcap() -> None:
    """Check that MCAP files can be written.

    Raises:
        MissingExtraError: the `mcap` extra is not installed.
    """
    try:
        for needed in ("mcap", "mcap_ros2"):
            importlib.import_module(needed)
    except ModuleNotFoundError as error:
        raise MissingExtraError(str(error.name), EXTRA) from None


def write_mcap(trajectory: Trajectory, rate: float, path: Path) -> None:
    """Write a trajectory as MCAP.

    Args:
        trajectory: to be written.
        rate: samples a second [Hz].
        path: of the file.

    Raises:
        MissingExtraError: the `mcap` extra is not installed.
        OSError: the file cannot be written.
    """
    check_mcap()
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        _write(_Recorder(writer), trajectory, rate)
        writer.finish()


class _Recorder:
    """Writes messages of known types at times of the trajectory."""

    def __init__(self, writer: Writer) -> None:
        self.writer = writer
        self._schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}

    def message(self, topic: str, kind: str, time: float, content: dict[str, Any]) -> None:
        stamp = _nanoseconds(time)
        self.writer.write_message(topic, self._schemas[kind], content, log_time=stamp, publish_time=stamp)


def _write(out: _Recorder, trajectory: Trajectory, rate: float) -> None:
    record, times, urdf = trajectory.record, trajectory.times(rate), robots_urdf()
    start = _nanoseconds(0.0)
    out.writer.add_attachment(start, start, "robots.urdf", "application/xml", urdf.encode())
    out.writer.add_metadata(
        "roboassembly",
        {
            "furniture": record.furniture, "seconds": f"{trajectory.seconds:.9g}", "rate": f"{rate:g}",
        },
    )  # fmt: skip
    out.message("/robot_description", STRING, 0.0, {"data": urdf})
    fixed = [j for j in described_joints() if j.kind == "fixed"]
    still = [_transform(0.0, j.parent, j.child, j.pose(0.0)) for j in fixed]
    out.message("/tf_static", TRANSFORMS, 0.0, {"transforms": still})
    states = [joint_states(trajectory, robot, times) for robot in (0, 1)]
    names = [prefix + name for prefix in PREFIXES for name in JOINT_NAMES]
    position, velocity = (np.concatenate([s[k] for s in states], axis=1) for k in (0, 1))
    parts = trajectory.parts(times)
    begins = iter([*trajectory.segments, None])
    following = next(begins)
    for i, time in enumerate(times.tolist()):
        while following is not None and following.start <= time + 1e-9:
            _write_motion(out, following, rate)
            following = next(begins)
        content = {
            "header": _header(time, ""), "name": names, "position": position[i].tolist(),
            "velocity": velocity[i].tolist(), "effort": [],
        }  # fmt: skip
        out.message("/joint_states", JOINT_STATE, time, content)
        transforms = [*_links(time, names, position[i]), *_parts(time, record.furniture, record.parts, parts[i])]
        out.message("/tf", TRANSFORMS, time, {"transforms": transforms})


def _write_motion(out: _Recorder, timed: TimedSegment, rate: float) -> None:
    prefix = PREFIXES[timed.segment.robot]
    times = sample_times(timed.motion.seconds, rate)
    states = timed.motion.states(times)
    points: list[dict[str, Any]] = [
        {
            "positions": states.position[i].tolist(), "velocities": states.velocity[i].tolist(),
            "accelerations": states.acceleration[i].tolist(), "effort": [], "time_from_start": _stamp(times[i]),
        }
        for i in range(len(times))
    ]  # fmt: skip
    content: dict[str, Any] = {
        "header": _header(timed.start, ""), "joint_names": [prefix + name for name in JOINT_NAMES[:-2]],
        "points": points,
    }  # fmt: skip
    out.message(f"/{prefix.rstrip('_')}/joint_trajectory", JOINT_TRAJECTORY, timed.start, content)


def _links(time: float, names: list[str], position: Float[np.ndarray, "24"]) -> Iterable[dict[str, Any]]:
    values = dict(zip(names, position.tolist(), strict=True))
    for joint in described_joints():
        if joint.kind != "fixed":
            yield _transform(time, joint.parent, joint.child, joint.pose(values[joint.name]))


def _parts(time: float, furniture: str, names: Iterable[str], poses: Iterable[SE3]) -> Iterable[dict[str, Any]]:
    for name, pose in zip(names, poses, strict=True):
        yield _transform(time, WORLD, f"{furniture}/{name}", pose)


def _transform(time: float, parent: str, child: str, pose: SE3) -> dict[str, Any]:
    x, y, z, qw, qx, qy, qz = pose_to_seven(pose)
    return {
        "header": _header(time, parent),
        "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
        },
    }  # fmt: skip


def _header(time: float, frame: str) -> dict[str, Any]:
    return {"stamp": _stamp(time + EPOCH), "frame_id": frame}


def _stamp(seconds: float) -> dict[str, int]:
    whole, rest = divmod(round(seconds * _NANO), _NANO)
    return {"sec": whole, "nanosec": rest}


def _nanoseconds(time: float) -> int:
    return round((time + EPOCH) * _NANO)
