"""Trajectories as text: CSV with one row a time, JSON with one object a motion."""

from __future__ import annotations

import csv
import io
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import pose_to_seven
from roboassembly.robots.description import JOINT_NAMES, PREFIXES
from roboassembly.robots.limits import FINGER_SPEED, JOINT_TORQUES, LIMITS, MOTION_SHARE
from roboassembly.robots.timing import TimedStates
from roboassembly.task.trajectories.trajectory import TimedSegment, Trajectory

FORMAT, VERSION = "roboassembly.trajectory", 1
_DIGITS = 12
"""Digits of numbers in files: differences of third order need them."""


def joint_states(trajectory: Trajectory, robot: int, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3 n 12"]:
    """Return positions, velocities and accelerations of all joints of a robot, fingers included, as `JOINT_NAMES`."""
    states, fingers = trajectory.robot(robot, times), trajectory.fingers(robot, times)
    rows = (states.position, states.velocity, states.acceleration)
    return np.stack(
        [np.hstack([row, finger[:, None], finger[:, None]]) for row, finger in zip(rows, fingers, strict=True)]
    )


def encode_csv(trajectory: Trajectory, rate: float) -> bytes:
    """Return a table: time, what goes on, and positions, velocities and accelerations of all joints of both robots.

    Args:
        trajectory: to be written.
        rate: rows a second [Hz].
    """
    times = trajectory.times(rate)
    blocks = [joint_states(trajectory, robot, times) for robot in (0, 1)]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    suffixes = ("", ".velocity", ".acceleration")
    writer.writerow(["time", "segment", *(p + j + s for p in PREFIXES for s in suffixes for j in JOINT_NAMES)])
    rows = np.concatenate([block.transpose(1, 0, 2).reshape(len(times), -1) for block in blocks], axis=1)
    for time, row in zip(times.tolist(), rows.tolist(), strict=True):
        timed = trajectory.segment_at(time)
        name = "" if timed is None else timed.segment.name
        writer.writerow([f"{time:.{_DIGITS}g}", name, *(f"{x:.{_DIGITS}g}" for x in row)])
    return out.getvalue().encode()


def encode_json(trajectory: Trajectory, rate: float) -> bytes:
    """Return an object with the limits, all motions of robots and hands with their samples, and where parts end.

    Args:
        trajectory: to be written.
        rate: samples a second within each motion [Hz].
    """
    record = trajectory.record
    document = {
        "format": FORMAT,
        "version": VERSION,
        "furniture": record.furniture,
        "parts": list(record.parts),
        "seconds": round(trajectory.seconds, _DIGITS),
        "rate": rate,
        "joints": list(JOINT_NAMES[:-2]),
        "limits": limits_table(),
        "robots": [q.tolist() for q in record.robots],
        "openings": list(trajectory.openings),
        "motions": [_motion(timed, rate) for timed in trajectory.segments],
        "hands": [
            {"robot": h.robot, "start": h.start, "seconds": h.seconds, "before": h.before, "after": h.after}
            for h in trajectory.hand_motions
        ],
        "initial": [pose_to_seven(pose) for pose in record.initial],
        "final": [pose_to_seven(pose) for pose in trajectory.parts(np.array([trajectory.seconds]))[0]],
    }
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def limits_table() -> dict[str, Any]:
    """Return the limits that all motions keep: first the platform's speed and turning, then the joints."""
    return {
        "velocity": list(LIMITS.velocity),
        "acceleration": list(LIMITS.acceleration),
        "jerk": list(LIMITS.jerk),
        "torque_of_motion": [MOTION_SHARE * torque for torque in JOINT_TORQUES],
        "tip_speed": LIMITS.tip_speed,
        "finger_speed": FINGER_SPEED,
    }


def _motion(timed: TimedSegment, rate: float) -> dict[str, Any]:
    segment, seconds = timed.segment, timed.motion.seconds
    times = sample_times(seconds, rate)
    states: TimedStates = timed.motion.states(times)
    return {
        "robot": segment.robot,
        "stage": segment.stage.value,
        "start": round(timed.start, _DIGITS),
        "seconds": round(seconds, _DIGITS),
        "payload": [{"part": part, "pose": pose_to_seven(pose)} for part, pose in sorted(segment.payload.items())],
        "times": times.round(_DIGITS).tolist(),
        "positions": states.position.round(_DIGITS).tolist(),
        "velocities": states.velocity.round(_DIGITS).tolist(),
        "accelerations": states.acceleration.round(_DIGITS).tolist(),
    }


def sample_times(seconds: float, rate: float) -> Float[np.ndarray, "n"]:
    """Return times from 0 to a duration, both included [s]."""
    times = np.arange(int(np.floor(seconds * rate + 1e-9)) + 1) / rate
    return times if seconds - times[-1] < 1e-9 else np.append(times, seconds)
