"""Trajectory of a plan: where both robots, their fingers and all parts are at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Shape
from roboassembly.robots.body import DOF, world_from_tips
from roboassembly.robots.limits import FINGER_SPEED
from roboassembly.robots.timing import TICK, TimedPath, TimedStates
from roboassembly.task.full.failure import Stage
from roboassembly.task.full.timing import GRASP_SECONDS, RELEASE_SECONDS, rest_after, timed_motion
from roboassembly.task.plans.motion_record import MotionRecord, MotionSegment

_PEAK_SPEED = 1.875
"""Largest speed of a quintic from rest to rest over unit distance and time."""


@dataclass(frozen=True, eq=False)
class TimedSegment:
    """A segment and when it happens."""

    segment: MotionSegment
    start: float
    """Time at which it begins [s]."""
    motion: TimedPath

    @property
    def end(self) -> float:
        """Time at which the robot has reached the end of the path [s]."""
        return self.start + self.motion.seconds


@dataclass(frozen=True)
class HandMotion:
    """Motion of both fingers of a hand, quintic in time."""

    robot: int
    start: float
    """Time at which it begins [s]."""
    seconds: float
    before: float
    """Distance between the pads at the beginning [m]."""
    after: float
    """Distance between the pads at the end [m]."""

    @property
    def end(self) -> float:
        """Time at which it ends [s]."""
        return self.start + self.seconds


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Timed motions of a plan. Only one robot moves at a time."""

    record: MotionRecord
    segments: tuple[TimedSegment, ...]
    hand_motions: tuple[HandMotion, ...]
    openings: tuple[float, float]
    """Distances between the pads at first [m]."""
    seconds: float
    """Duration [s]."""

    def times(self, rate: float) -> Float[np.ndarray, "n"]:
        """Return times from 0 to the end, `rate` of them a second, the end included [s]."""
        count = int(np.floor(self.seconds * rate + 1e-9))
        times = np.arange(count + 1) / rate
        return times if self.seconds - times[-1] < 1e-9 else np.append(times, self.seconds)

    def robot(self, robot: int, times: Float[np.ndarray, "n"]) -> TimedStates:
        """Return the states of a robot at increasing times [s]."""
        at, n = self.record.robots[robot], len(times)
        states = TimedStates(np.tile(at, (n, 1)), np.zeros((n, DOF)), np.zeros((n, DOF)))
        for timed in self.segments:
            if timed.segment.robot == robot:
                rows = slice(int(np.searchsorted(times, timed.start)), n)
                moved = slice(rows.start, int(np.searchsorted(times, timed.end, side="right")))
                done = timed.motion.states(times[moved] - timed.start)
                states.position[rows] = timed.motion.end
                states.position[moved] = done.position
                states.velocity[moved], states.acceleration[moved] = done.velocity, done.acceleration
        return states

    def fingers(self, robot: int, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3 n"]:
        """Return position, velocity and acceleration of each finger of a hand at times [m, m/s, m/s²]."""
        out = np.zeros((3, len(times)))
        out[0] = 0.5 * self.openings[robot]
        for hand in self.hand_motions:
            if hand.robot == robot:
                way, s = 0.5 * (hand.after - hand.before), np.clip((times - hand.start) / hand.seconds, 0.0, 1.0)
                rows = times > hand.start
                share = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
                rate = 30.0 * s**2 * (1.0 - s) ** 2 / hand.seconds
                change = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / hand.seconds**2
                out[:, rows] = np.stack([0.5 * hand.before + way * share, way * rate, way * change])[:, rows]
        return out

    def parts(self, times: Float[np.ndarray, "n"]) -> list[list[SE3]]:
        """Return the pose of every part at increasing times [s], one row a time."""
        where, done = list(self.record.initial), 0
        out: list[list[SE3]] = []
        for time in times.tolist():
            while done < len(self.segments) and self.segments[done].end <= time + 1e-9:
                where = _carried(self.segments[done], self.segments[done].end, where)
                done += 1
            row = where
            if done < len(self.segments) and self.segments[done].start < time:
                row = _carried(self.segments[done], time, where)
            out.append(list(row))
        return out

    def segment_at(self, time: float) -> TimedSegment | None:
        """Return the segment that goes on at a time, or whose hand motion does; None after the last one."""
        started = [timed for timed in self.segments if timed.start <= time + 1e-9]
        return started[-1] if started and time < self.seconds - 1e-9 else None


def _carried(timed: TimedSegment, time: float, where: list[SE3]) -> list[SE3]:
    """Return the poses of all parts while, or after, a segment moves those in its robot's hand."""
    if not timed.segment.payload:
        return where
    tips = world_from_tips(timed.motion.states(np.array([time - timed.start])).position[0])
    moved = list(where)
    for part, pose in timed.segment.payload.items():
        moved[part] = tips * pose
    return moved


def time_plan(record: MotionRecord, furniture: Furniture) -> Trajectory:
    """Return the trajectory of a plan, timed as `--execution dynamic` carries it out.

    Args:
        record: motions of the plan.
        furniture: its furniture; the inertia of what a hand holds limits how quickly it moves.

    Raises:
        InputError: the furniture is not the plan's.
    """
    names = tuple(part.name for part in furniture.parts)
    if names != record.parts:
        raise InputError(f"the plan is for '{record.furniture}' with other parts than '{furniture.name}' has")
    openings = [next((s.opening for s in record.segments if s.robot == r), 0.0) for r in (0, 1)]
    return _Clock(record, furniture, openings).run()


class _Clock:
    def __init__(self, record: MotionRecord, furniture: Furniture, openings: list[float]) -> None:
        self.record, self.furniture, self.openings = record, furniture, openings
        self.first = (openings[0], openings[1])
        self.now = 0.0
        self.segments: list[TimedSegment] = []
        self.hand_motions: list[HandMotion] = []

    def run(self) -> Trajectory:
        for index, segment in enumerate(self.record.segments):
            # A hand gets ready for its group while it drives there.
            opening = self._move_hand(segment.robot, segment.opening, 0.0)
            motion = self._timed(segment)
            self.segments.append(TimedSegment(segment, self.now, motion))
            self.now = max(self.now + motion.seconds + rest_after(segment.stage), opening)
            if segment.stage is Stage.APPROACH:
                self.now = self._move_hand(segment.robot, self._next_opening(index, segment.robot), GRASP_SECONDS)
            elif segment.stage in (Stage.MATE, Stage.SET_DOWN):
                self.now = self._move_hand(segment.robot, self._next_opening(index, segment.robot), RELEASE_SECONDS)
        return Trajectory(self.record, tuple(self.segments), tuple(self.hand_motions), self.first, self.now)

    def _timed(self, segment: MotionSegment) -> TimedPath:
        payload = [Shape(self.furniture.parts[part].mesh, pose) for part, pose in sorted(segment.payload.items())]
        return timed_motion(segment.stage, tuple(segment.path), payload, self.record.density)

    def _next_opening(self, index: int, robot: int) -> float:
        later = (s.opening for s in self.record.segments[index + 1 :] if s.robot == robot)
        return next(later, self.openings[robot])

    def _move_hand(self, robot: int, opening: float, seconds: float) -> float:
        """Let a hand begin to open or close now, and return when it is done."""
        before, self.openings[robot] = self.openings[robot], opening
        way = 0.5 * abs(opening - before)
        if way < 1e-9:
            return self.now + seconds
        needed = max(seconds, _PEAK_SPEED * way / FINGER_SPEED)
        needed = TICK * int(np.ceil(needed / TICK - 1e-9))
        self.hand_motions.append(HandMotion(robot, self.now, needed, before, opening))
        return self.now + needed
