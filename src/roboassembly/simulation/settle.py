"""Settling of a body: it falls, rocks and comes to rest on the ground."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from roboassembly.geometry.poses import SE3, from_quaternion
from roboassembly.geometry.scene import Body, Scene
from roboassembly.simulation.model import TIME_STEP, compile_scene, rotation_to_quaternion

MAX_SECONDS = 4.0
"""Simulated time after which a body counts as settled in any case [s]."""
_STILL_SPEED = 0.01
"""Speed of the farthest point below which a body is still [m/s]."""
_STILL_CHECKS = 3
"""Number of successive still samples after which a body is at rest."""


@dataclass(frozen=True, eq=False)
class SettledMotion:
    """Motion of a body that comes to rest."""

    poses: tuple[SE3, ...]
    """Pose `world_from_body` at every sample, the first as given, the last at rest."""
    seconds: float
    """Simulated time until rest [s]."""
    at_rest: bool
    """Whether the body was at rest before `MAX_SECONDS`."""


def settle(body: Body, interval: float) -> SettledMotion:
    """Drop `body` onto the ground, alone, and sample its pose every `interval` seconds of simulated time."""
    model = compile_scene(Scene((body,)))
    data = mujoco.MjData(model)
    radius = max(float(np.linalg.norm(s.body_from_mesh.translation)) + s.mesh.radius for s in body.shapes)
    steps = max(1, round(interval / TIME_STEP))
    poses, quiet = [body.pose], 0
    while data.time < MAX_SECONDS and quiet < _STILL_CHECKS:
        mujoco.mj_step(model, data, nstep=steps)
        poses.append(from_quaternion(data.qpos[:3], data.qpos[3:7]))
        speed = float(np.linalg.norm(data.qvel[:3]) + radius * np.linalg.norm(data.qvel[3:6]))
        quiet = quiet + 1 if speed < _STILL_SPEED else 0
    return SettledMotion(tuple(poses), float(data.time), quiet >= _STILL_CHECKS)


def release(body: Body, starts: Sequence[SE3], seconds: float) -> Iterator[SE3]:
    """Release `body` above the ground, alone, at each of several poses; yield its pose after a simulated time [s]."""
    model = compile_scene(Scene((body,)))
    for start in starts:
        data = mujoco.MjData(model)
        data.qpos[:3], data.qpos[3:7] = start.translation, rotation_to_quaternion(start.rotation)
        mujoco.mj_step(model, data, nstep=round(seconds / TIME_STEP))
        yield from_quaternion(data.qpos[:3], data.qpos[3:7])
