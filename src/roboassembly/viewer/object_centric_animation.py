"""Frames of a plan of the object-centric setting.

A step has four phases:

1. *placing*: v's group moves from where it lies to its waiting pose. In the task a fixture turns the group over; that
   motion is not planned. The film shows one eased rigid motion with a small lift, which is not checked for collision.
2. *moving*: u's group follows the planned path and slows down over the last centimetres. Each way-point is a frame.
3. *settling*: the merged group comes to rest as simulated.
4. *pause*.

Fasteners that go in after a step follow it; all of one kind at once, although the plan has them one after the other.

If the plan sets the finished piece on its feet, that motion follows the last step: *moving* and *settling* again.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from roboassembly.geometry.poses import SE3, shifted, transform_points
from roboassembly.rendering.colors import Role
from roboassembly.task.plans.plan import SETTLING_INTERVAL, Plan, PlanStep, UprightMotion
from roboassembly.viewer.captions import ending_caption, held_caption, step_caption
from roboassembly.viewer.fastener_frames import fastener_objects, insertion_frames, with_fasteners
from roboassembly.viewer.motion_timing import ease, interpolated, path_length, pose_between, speed_profile
from roboassembly.viewer.timeline import Frame, Phase, SceneObject, part_objects

# Shares of the seconds per step. FLIGHT_SHARE is for a flight of 1 m. Other flights scale with the square root of
# their length, by a factor within FLIGHT_RANGE, so that a long flight does not take too long.
PLACING_SHARE = 0.20
FLIGHT_SHARE = 0.32
FLIGHT_RANGE = (0.5, 1.3)
APPROACH_SHARE = 0.28
SETTLING_SHARE = 0.20
PAUSE_SHARE = 0.10
INSERTION_SHARE = 0.45

LARGEST_LIFT = 0.12
"""Largest lift [m] of a group while it is placed, beyond what keeps it off the ground."""
STILL_DISTANCE = 5e-4
"""Remaining motion [m] below which a settling is over."""

GroupMotion = Callable[[float], Iterator[tuple[int, SE3]]]
"""Pose of each part of a group as a function of the eased fraction of the motion."""


@dataclass(frozen=True)
class PlanAnimator:
    """Makes the frames of an object-centric plan, step by step."""

    plan: Plan
    frames_per_second: float
    seconds_per_step: float
    """Approximate duration of a step [s]."""

    @property
    def objects(self) -> tuple[SceneObject, ...]:
        """Objects that the frames show: the parts, then the fasteners."""
        return (*part_objects(self.plan.furniture), *fastener_objects(self.plan))

    def path_points(self, index: int) -> Float32[np.ndarray, "n 3"]:
        """Return the path of the moving group's centre of mass in a step [m]."""
        return np.array([pose.translation for pose in self.plan.steps[index].path], np.float32)

    def opening(self) -> Frame:
        """Return the frame before the first step."""
        text = f"{self.plan.furniture.name}: {len(self.plan.initial)} parts"
        return with_fasteners(self.plan, self._resting(self.plan.initial, None, Phase.OVERTURE, text), -2)

    def ending(self) -> Frame:
        """Return the frame after the last step."""
        plan = self.plan
        text = ending_caption(plan.furniture, len(plan.steps), plan.success, plan.upright)
        return with_fasteners(plan, self._resting(plan.final_poses, None, Phase.FINALE, text), len(plan.steps))

    def step(self, index: int) -> Iterator[Frame]:
        """Yield the frames of one step and of the fasteners after it; with the first step, also of those before it."""
        if index == 0:
            yield from insertion_frames(
                self.plan, -1, self._resting(self.plan.initial, 0, Phase.INSERTING, ""), self._pace
            )
        yield from (with_fasteners(self.plan, frame, index - 1) for frame in self._merge(index))
        rest = self._resting(self.plan.steps[index].after, index, Phase.INSERTING, "")
        yield from insertion_frames(self.plan, index, rest, self._pace)

    @property
    def _pace(self) -> int:
        """Number of frames in which a fastener goes in."""
        return self._count(INSERTION_SHARE * self.seconds_per_step)

    def _merge(self, index: int) -> Iterator[Frame]:
        """Yield the frames of one merge, without fasteners."""
        step = self.plan.steps[index]
        before = self.plan.steps[index - 1].after if index else self.plan.initial
        sizes = len(step.moving), len(step.waiting)
        caption = step_caption(self.plan.furniture, index, len(self.plan.steps), step.action, sizes)
        caption += held_caption(self.plan, index)
        n = len(before)
        roles = tuple(
            Role.MOVING if p in step.moving else Role.WAITING if p in step.waiting else Role.IDLE for p in range(n)
        )

        def frame(poses: Iterable[SE3], phase: Phase) -> Frame:
            return Frame(tuple(poses), roles, index, phase, caption)

        start = tuple(step.path[0] * step.moving[p] if p in step.moving else step.still[p] for p in range(n))
        for poses in self._placing(before, start, step):
            yield frame(poses, Phase.PLACING)
        for world_from_group in self._along_path(step.path, step.moving):
            poses = [world_from_group * step.moving[p] if p in step.moving else start[p] for p in range(n)]
            yield frame(poses, Phase.MOVING)
        mated = tuple(step.path[-1] * step.moving[p] if p in step.moving else start[p] for p in range(n))
        merged = {*step.moving, *step.waiting}
        for motion in self._settling(step.settling, {p: mated[p] for p in merged}):
            yield frame((motion * mated[p] if p in merged else mated[p] for p in range(n)), Phase.SETTLING)
        yield from self._pause(self._resting(step.after, index, Phase.PAUSE, caption))

    def upright(self) -> Iterator[Frame]:
        """Yield the frames of the motion that sets the finished piece on its feet; none without such a motion."""
        motion = None if self.plan.upright is None else self.plan.upright.motion
        if motion is None:
            return
        for shown in self._upright_frames(motion):
            yield with_fasteners(self.plan, shown, len(self.plan.steps) - 1)
        rest = self._resting(motion.after, None, Phase.INSERTING, "")
        yield from insertion_frames(self.plan, len(self.plan.steps), rest, self._pace)

    def _upright_frames(self, motion: UprightMotion) -> Iterator[Frame]:
        caption, n = f"{self.plan.furniture.name}: set upright", len(motion.after)

        def frame(world_from_piece: SE3, phase: Phase) -> Frame:
            poses = tuple(world_from_piece * motion.moving[p] for p in range(n))
            return Frame(poses, (Role.MOVING,) * n, None, phase, caption)

        yield from (frame(pose, Phase.MOVING) for pose in self._along_path(motion.path, motion.moving))
        released = {p: motion.path[-1] * pose for p, pose in motion.moving.items()}
        for by in self._settling(motion.settling, released):
            yield frame(by * motion.path[-1], Phase.SETTLING)
        yield from self._pause(self._resting(motion.after, None, Phase.PAUSE, caption))

    def _resting(self, poses: tuple[SE3, ...], step: int | None, phase: Phase, caption: str) -> Frame:
        return Frame(poses, (Role.IDLE,) * len(poses), step, phase, caption)

    def _pause(self, frame: Frame) -> Iterator[Frame]:
        return itertools.repeat(frame, self._count(PAUSE_SHARE * self.seconds_per_step))

    def _count(self, seconds: float) -> int:
        return max(1, round(seconds * self.frames_per_second))

    def _placing(self, before: Sequence[SE3], start: Sequence[SE3], step: PlanStep) -> Iterator[list[SE3]]:
        """Yield poses of all parts while v's group moves to its waiting pose; the last ones equal `start`.

        The other parts usually are at `start` already. In a record from another program a part may not be; it then
        moves there on its own.
        """
        groups = [sorted(step.waiting), *([p] for p in range(len(before)) if p not in step.waiting)]
        motions = [self._placing_motion(group, before, start) for group in groups if not _same(group, before, start)]
        if not motions:
            return
        count = self._count(PLACING_SHARE * self.seconds_per_step)
        for k in range(1, count):
            poses = list(before)
            for motion in motions:
                for part, pose in motion(ease(k / count)):
                    poses[part] = pose
            yield poses
        yield list(start)

    def _placing_motion(self, group: list[int], before: Sequence[SE3], start: Sequence[SE3]) -> GroupMotion:
        """Return the motion of a group, as one rigid body, which is lifted so that it stays off the ground."""
        parts = self.plan.furniture.parts
        cloud = np.concatenate([transform_points(before[p], parts[p].mesh.vertices) for p in group])
        center = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
        cloud = cloud - center
        here = SE3(np.eye(3), center)
        there = start[group[0]] * before[group[0]].inverse() * here
        floor = min(cloud[:, 2].min() + center[2], transform_points(there, cloud)[:, 2].min())
        lift = min(LARGEST_LIFT, 0.5 * path_length([here, there], float(np.linalg.norm(cloud, axis=1).max())))

        def at(fraction: float) -> Iterator[tuple[int, SE3]]:
            pose = pose_between(here, there, fraction)
            lowest = transform_points(pose, cloud)[:, 2].min()
            raised = max(0.0, floor + lift * float(np.sin(np.pi * fraction)) - lowest)
            motion = shifted(pose, np.array([0.0, 0.0, raised])) * here.inverse()
            return ((p, motion * before[p]) for p in group)

        return at

    def _along_path(self, path: Sequence[SE3], moving: Mapping[int, SE3]) -> Iterator[SE3]:
        """Yield the poses of a group along its path, every way-point among them.

        Args:
            path: `world_from_group` way-points.
            moving: `group_from_part` of each part.
        """
        parts = self.plan.furniture.parts
        radius = max(
            float(np.linalg.norm(transform_points(pose, parts[p].mesh.vertices), axis=1).max())
            for p, pose in moving.items()
        )
        yield path[0]
        edges = list(itertools.pairwise(path))
        lengths = np.array([path_length(edge, radius) for edge in edges])
        total = float(lengths.sum())
        if total == 0.0:
            return
        flight = FLIGHT_SHARE * self.seconds_per_step * float(np.clip(np.sqrt(total), *FLIGHT_RANGE))
        approach = APPROACH_SHARE * self.seconds_per_step
        distance_at = speed_profile(total, flight, approach)
        # Way-points fall between the regular times. Each edge is stretched a little so that its ends become frames.
        grid = np.linspace(0.0, flight + approach, 2001)
        reached = np.concatenate([[0.0], np.cumsum(lengths)])
        times = np.interp(reached, distance_at(grid), grid)
        for index, (a, b) in enumerate(edges):
            if lengths[index] == 0.0:
                continue
            count = self._count(times[index + 1] - times[index])
            inner = np.linspace(float(times[index]), float(times[index + 1]), count + 1)[1:-1]
            fractions = np.clip((distance_at(inner) - reached[index]) / lengths[index], 0.0, 1.0)
            yield from interpolated(a, b, fractions)
            yield b

    def _settling(self, settling: Sequence[SE3], released: Mapping[int, SE3]) -> Iterator[SE3]:
        """Yield the motions of the world that bring released parts to rest, without the last one.

        Args:
            settling: recorded motions, one every `SETTLING_INTERVAL` seconds.
            released: world pose of each part when the settling begins.
        """
        parts = self.plan.furniture.parts
        points = np.concatenate([transform_points(pose, parts[p].mesh.bounds) for p, pose in released.items()])
        placed = np.array([transform_points(motion, points) for motion in settling])
        if len(placed) == 0:
            return
        far = np.linalg.norm(placed - placed[-1], axis=2).max(axis=1) > STILL_DISTANCE
        last = int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0
        seconds = min(last * SETTLING_INTERVAL, SETTLING_SHARE * self.seconds_per_step)
        count = round(seconds * self.frames_per_second)
        for k in range(1, count):
            index, fraction = divmod(last * k / count, 1.0)
            yield pose_between(settling[int(index)], settling[min(int(index) + 1, last)], fraction)


def _same(group: Iterable[int], a: Sequence[SE3], b: Sequence[SE3]) -> bool:
    return all(np.allclose(a[p].homogeneous, b[p].homogeneous, rtol=0.0, atol=1e-6) for p in group)
