"""Time parametrization of paths: the quickest motions within limits of velocity, acceleration, jerk and torque.

A robot follows its path exactly: it was tested for collisions, and a rounded corner was not. So the robot comes to rest
wherever the path bends. Between two rests, the position along the path is one number, and Ruckig's profile of it is
the quickest within limits (Berscheid and Kröger 2021, "Jerk-limited Real-time Trajectory Generation with Arbitrary
Target States"). All is computed here; Ruckig's service on the network, for several way-points at once, is not used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pinocchio as pin
import ruckig
from jaxtyping import Float
from scipy.interpolate import CubicSpline, PPoly

from roboassembly.robots.body import DOF, tip_positions
from roboassembly.robots.dynamics import motion_forces
from roboassembly.robots.kinematics import JOINTS
from roboassembly.robots.limits import (
    DRIVE,
    JOINT_TORQUES,
    JOINT_VELOCITIES,
    LIMITS,
    MOTION_SHARE,
    TURN,
    MotionLimits,
    magnitudes,
)

TICK = 0.002
"""Time step of which all durations are multiples [s]."""
_BEND = 0.98
"""Cosine between two edges above which a robot does not stop at the way-point between them."""
_SAMPLES = 32
"""Points between two way-points at which limits are checked."""
_MARGIN = 1.0 - 1e-4
"""Share of the limits that a motion uses, so that rounding keeps them."""
_BETWEEN = 1.01
"""Factor on what samples of a motion show, for what lies between them."""
_INSTANT = 1e-12
"""Duration below which a section of a profile is none [s]."""
_SAME = 1e-9
"""Time at full speed below which two way-points are one [s]."""


@dataclass(frozen=True, eq=False)
class TimedStates:
    """States of a robot at several times."""

    position: Float[np.ndarray, "n 10"]
    """Configurations [m, rad]."""
    velocity: Float[np.ndarray, "n 10"]
    acceleration: Float[np.ndarray, "n 10"]


class TimedPath:
    """Motion along a path, at rest at both ends and wherever the path bends.

    Args:
        path: way-points.
        limits: limits that the motion keeps.
        payload: inertia of what the hand holds, in the frame of the finger tips; None if it is empty.
    """

    def __init__(
        self,
        path: Sequence[Float[np.ndarray, "10"]],
        limits: MotionLimits = LIMITS,
        payload: pin.Inertia | None = None,
    ) -> None:
        self._payload = payload
        self.start, self.end = np.array(path[0], dtype=float), np.array(path[-1], dtype=float)
        self.stretches = tuple(_Stretch(points, limits, payload) for points in _straight_runs(path))
        """Motions from rest to rest."""

    @cached_property
    def seconds(self) -> float:
        """Duration, a multiple of `TICK` [s]."""
        return float(sum(stretch.seconds for stretch in self.stretches))

    def states(self, times: Float[np.ndarray, "n"]) -> TimedStates:
        """Return states at times since the beginning [s]; the robot is at rest before and after."""
        out = TimedStates(
            np.tile(self.start, (len(times), 1)), np.zeros((len(times), DOF)), np.zeros((len(times), DOF))
        )
        begun = 0.0
        for stretch in self.stretches:
            rows = times > begun
            states = stretch.states(times[rows] - begun)
            out.position[rows], out.velocity[rows] = states.position, states.velocity
            out.acceleration[rows] = states.acceleration
            begun += stretch.seconds
        return out

    def forces(self, states: TimedStates) -> Float[np.ndarray, "n 10"]:
        """Return the forces and torques that the motion takes in some of its states, without weight [N, N·m]."""
        return motion_forces(states.position, states.velocity, states.acceleration, self._payload)

    def ticks(self) -> TimedStates:
        """Return the states at every tick after the beginning, the last one at the end."""
        return self.states(np.arange(1, round(self.seconds / TICK) + 1) * TICK)


class _Stretch:
    """Motion from rest to rest through points that lie almost in line."""

    def __init__(self, points: Float[np.ndarray, "k 10"], limits: MotionLimits, payload: pin.Inertia | None) -> None:
        most = _MARGIN * np.array([limits.velocity, limits.acceleration, limits.jerk])
        steps = (magnitudes(np.diff(points, axis=0)) / most[0]).max(axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        # A smooth curve through the points, so that velocities do not jump from edge to edge; a line through two.
        self._curve = CubicSpline(length, points)
        at: Float[np.ndarray, "m"] = np.linspace(0.0, float(length[-1]), 1 + _SAMPLES * len(steps))
        slope = np.maximum(magnitudes(self._curve(at, 1)).max(axis=0), 1e-12)
        along = (most / slope).min(axis=1)
        if limits.tip_speed is not None:
            moved = np.linalg.norm(np.diff(tip_positions(self._curve(at)), axis=0), axis=1).max()
            along[0] = min(along[0], limits.tip_speed * float(at[1]) / max(float(moved), 1e-12))
        self._profile = _profile(float(length[-1]), along)
        # A motion that takes k times as long has 1/k of the velocities, 1/k² of the accelerations and torques, 1/k³ of
        # the jerks. On a curve, speed means acceleration, and only here is it known how much.
        times: Float[np.ndarray, "m"] = np.linspace(0.0, self.seconds, 2 * len(at))
        position, *derivatives = self._derivatives(times)
        over = [
            (magnitudes(d) / row).max() ** (1.0 / k)
            for k, (d, row) in enumerate(zip(derivatives, most, strict=True), 1)
        ]
        torques = motion_forces(position, derivatives[0], derivatives[1], payload)[:, DOF - JOINTS :]
        over.append(math.sqrt((np.abs(torques) / (MOTION_SHARE * np.array(JOINT_TORQUES))).max()))
        slower = max(over) * _BETWEEN
        # Along a line, the first profile keeps all limits but that of torque.
        if slower > 1.0 and (len(points) > 2 or over[-1] > 1.0):
            self._profile = _profile(float(length[-1]), along / slower ** np.array([1.0, 2.0, 3.0]))

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return TICK * round(float(self._profile.x[-1]) / TICK)

    def states(self, times: Float[np.ndarray, "n"]) -> TimedStates:
        """Return states at times since the beginning of the stretch [s]."""
        return TimedStates(*self._derivatives(np.minimum(times, self._profile.x[-1]))[:3])

    def _derivatives(self, times: Float[np.ndarray, "n"]) -> list[Float[np.ndarray, "n 10"]]:
        """Return configurations and their first three derivatives at times."""
        s, rate, change, jerk = (self._profile(times, k)[:, None] for k in range(4))
        place, first, second, third = (self._curve(s[:, 0], k) for k in range(4))
        return [
            place,
            first * rate,
            first * change + second * rate**2,
            first * jerk + 3.0 * second * rate * change + third * rate**3,
        ]


def _profile(length: float, limits: Float[np.ndarray, "3"]) -> PPoly:
    """Return the quickest motion of one number from rest at 0 to rest at `length`, as a function of time."""
    given = ruckig.InputParameter(1)
    given.current_position, given.target_position = [0.0], [length]
    given.current_velocity, given.target_velocity = [0.0], [0.0]
    given.current_acceleration, given.target_acceleration = [0.0], [0.0]
    given.max_velocity, given.max_acceleration, given.max_jerk = ([float(x)] for x in limits)
    given.duration_discretization = ruckig.DurationDiscretization.Discrete
    found = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1, TICK).calculate(given, found)
    assert result is ruckig.Result.Working, result
    # Numbers, not Ruckig's object: nanobind complains about objects that live when Python ends.
    profile = found.profiles[0][0]
    keep = np.array(profile.t) > _INSTANT
    cubes = np.array([profile.j, profile.a[:-1], profile.v[:-1], profile.p[:-1]])[:, keep]
    return PPoly(cubes / np.array([[6.0], [2.0], [1.0], [1.0]]), np.r_[0.0, np.cumsum(np.array(profile.t)[keep])])


def _straight_runs(path: Sequence[Float[np.ndarray, "10"]]) -> Iterator[Float[np.ndarray, "k 10"]]:
    """Yield the longest runs of way-points without a bend between them; points that repeat are left out."""
    scale = np.array([DRIVE[0], DRIVE[0], TURN[0], *JOINT_VELOCITIES])
    points = [np.array(path[0], dtype=float)]
    for point in path[1:]:
        if np.abs((point - points[-1]) / scale).max() > _SAME:
            points.append(np.array(point, dtype=float))
    edges = np.diff(np.array(points), axis=0) / scale
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    bends = [k for k in range(1, len(edges)) if edges[k - 1] @ edges[k] <= _BEND]
    for first, last in pairwise([0, *bends, len(edges)]):
        if last > first:
            yield np.array(points[first : last + 1])
