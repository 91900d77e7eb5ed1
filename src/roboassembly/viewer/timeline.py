"""From a plan to pictures in time: where every part is in each frame, and what it is doing.

A step is played in four beats:

1. *placing*: v's group goes from where it lies to its waiting pose. In the task this is a re-pose by a fixture, not a
   planned motion: it is drawn as one eased rigid motion with a small lift, and it is not checked for collision.
2. *moving*: u's group follows the planned path, slow over the last centimetres. Every way-point is a frame.
3. *settling*: the merged group comes to rest as the simulation says.
4. *pause*.

After the last step the finished piece moves to its feet, if the plan has that motion: *moving* and *settling* again.

Everything here is a pure function of the plan. Poses are `world_from_part`, metres; times are seconds.
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, from_quaternion, interpolate, rotation_angle, transform_points
from roboassembly.rendering.colors import Role
from roboassembly.task.plans.plan import SETTLING_INTERVAL, Plan, PlanStep, UprightResult

OVERTURE_SECONDS = 1.0
FINALE_SECONDS = 2.0
APPROACH_LENGTH = 0.10
"""Metres of path before mating that are played slowly."""

# Shares of `seconds_per_step`. A flight of 1 m takes FLIGHT_SHARE; shorter and longer ones go with the square root of
# their length, within FLIGHT_RANGE, so that a long one does not take forever.
PLACING_SHARE = 0.20
FLIGHT_SHARE = 0.32
FLIGHT_RANGE = (0.5, 1.3)
APPROACH_SHARE = 0.28
SETTLING_SHARE = 0.20
PAUSE_SHARE = 0.10

LARGEST_LIFT = 0.12
"""Metres that a group is raised at most while it is placed, beyond what keeps it off the ground."""
STILL_DISTANCE = 5e-4
"""Metres: a settling whose remaining motion is smaller than this is over."""


class Phase(enum.StrEnum):
    """Which beat of the film a frame belongs to."""

    OVERTURE = "overture"
    PLACING = "placing"
    MOVING = "moving"
    SETTLING = "settling"
    PAUSE = "pause"
    FINALE = "finale"


@dataclass(frozen=True, eq=False)
class Thing:
    """Something to be drawn."""

    name: str
    mesh: Mesh
    framed: bool = True
    """The camera keeps it in the picture."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture."""

    poses: tuple[SE3 | None, ...]
    """`world_from_mesh` of every thing; none of what is not to be seen. Framed things are always seen."""
    roles: tuple[Role, ...]
    step: int | None
    """Index into the plan's steps; none before the first and after the last, while the piece is set upright too."""
    phase: Phase
    caption: str
    key: bool = False
    """Tells best what its step is about; where none does, the one in the middle of its way."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """All frames, equally spaced in time; the first is at time zero."""

    name: str
    """Of the furniture."""
    things: tuple[Thing, ...]
    """Parts first; framed ones before those that are not."""
    frames: tuple[Frame, ...]
    frames_per_second: float

    @property
    def duration(self) -> float:
        """Seconds, the last frame's own time included."""
        return len(self.frames) / self.frames_per_second

    @cached_property
    def captions(self) -> tuple[tuple[float, str], ...]:
        """`(seconds, caption)` at every change of caption."""
        out: list[tuple[float, str]] = []
        for index, frame in enumerate(self.frames):
            if not out or out[-1][1] != frame.caption:
                out.append((index / self.frames_per_second, frame.caption))
        return tuple(out)

    @cached_property
    def box_corners(self) -> Float[np.ndarray, "frames things 8 3"]:
        """World corners of every framed thing's own bounding box, in metres."""
        framed = [thing for thing in self.things if thing.framed]
        poses = [[pose or SE3.Identity() for pose in frame.poses[: len(framed)]] for frame in self.frames]
        rotations = np.array([[pose.rotation for pose in row] for row in poses])
        translations = np.array([[pose.translation for pose in row] for row in poses])
        local = np.array([list(itertools.product(*thing.mesh.bounds.T)) for thing in framed])
        return np.einsum("fpij,pcj->fpci", rotations, local) + translations[:, :, None]


def make_timeline(plan: Plan, *, frames_per_second: float = 30.0, seconds_per_step: float = 2.5) -> Timeline:
    """Lay a plan out in time. A plan that failed is laid out as far as it got.

    Raises:
        InputError: a rate or duration that is not a positive finite number.
    """
    check_rates(frames_per_second, seconds_per_step)
    director = Director(plan, frames_per_second, seconds_per_step)
    return Timeline(plan.furniture.name, director.things, tuple(director.frames()), frames_per_second)


def check_rates(frames_per_second: float, seconds_per_step: float) -> None:
    """Raise `InputError` unless both are positive finite numbers."""
    for name, value in (("frames_per_second", frames_per_second), ("seconds_per_step", seconds_per_step)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value}; a positive number would do")


def parts_of(furniture: Furniture) -> tuple[Thing, ...]:
    """The parts as things."""
    return tuple(Thing(f"parts/{i}_{p.name.replace('/', '_')}", p.mesh) for i, p in enumerate(furniture.parts))


def step_caption(plan: Plan, index: int) -> str:
    """For example `step 3 of 14: back_slat_1 onto post_left`."""
    step = plan.steps[index]
    what = onto(plan.furniture, step.action, len(step.moving), len(step.waiting))
    return f"step {index + 1} of {expected_steps(plan.furniture, len(plan.steps))}: {what}"


def onto(furniture: Furniture, action: tuple[int, ...], moving: int, waiting: int) -> str:
    """For example `back_slat_1 onto post_left (+3)`, from how many parts there are in both groups."""
    names = [
        furniture.parts[part].name + (f" (+{size - 1})" if size > 1 else "")
        for part, size in zip(action[:2], (moving, waiting), strict=True)
    ]
    return " onto ".join(names)


def expected_steps(furniture: Furniture, there: int) -> int:
    """Each step merges two groups, so that a whole assembly takes one step fewer than there are parts."""
    return max(there, len(furniture.parts) - 1)


def ending_caption(furniture: Furniture, steps: int, success: bool, upright: UprightResult[Any] | None) -> str:
    """How it came out."""
    if success:
        lying = ", not set upright" if upright is not None and not upright.success else ""
        return f"{furniture.name}: assembled in {steps} step{'s' if steps != 1 else ''}{lying}"
    return f"{furniture.name}: not assembled, stopped after {steps} of {expected_steps(furniture, steps)} steps"


@dataclass(frozen=True)
class Director:
    """Makes frames of a plan, all or those of one step."""

    plan: Plan
    fps: float
    seconds: float
    """About how long a step lasts."""

    @property
    def things(self) -> tuple[Thing, ...]:
        """What the frames show."""
        return parts_of(self.plan.furniture)

    def opening(self) -> Frame:
        """Before the first step."""
        idle = (Role.IDLE,) * len(self.plan.initial)
        text = f"{self.plan.furniture.name}: {len(self.plan.initial)} parts"
        return Frame(self.plan.initial, idle, None, Phase.OVERTURE, text)

    def frames(self) -> Iterator[Frame]:
        """All of them."""
        plan = self.plan
        idle = (Role.IDLE,) * len(plan.initial)
        steps = len(plan.steps)
        yield from itertools.repeat(self.opening(), self._count(OVERTURE_SECONDS))
        for index in range(steps):
            yield from self.step(index)
        yield from self.upright()
        ending = ending_caption(plan.furniture, steps, plan.success, plan.upright)
        last = Frame(plan.final_poses, idle, None, Phase.FINALE, ending)
        yield from itertools.repeat(last, self._count(FINALE_SECONDS))

    def upright(self) -> Iterator[Frame]:
        """Those of the motion that sets the finished piece on its feet; none if there is none."""
        motion = None if self.plan.upright is None else self.plan.upright.motion
        if motion is None:
            return
        caption, n = f"{self.plan.furniture.name}: set upright", len(motion.after)

        def frame(world_from_piece: SE3, phase: Phase) -> Frame:
            poses = tuple(world_from_piece * motion.moving[p] for p in range(n))
            return Frame(poses, (Role.MOVING,) * n, None, phase, caption)

        yield from (frame(pose, Phase.MOVING) for pose in self._path(motion.path, motion.moving))
        let_go = {p: motion.path[-1] * pose for p, pose in motion.moving.items()}
        for by in self._settling(motion.settling, let_go):
            yield frame(by * motion.path[-1], Phase.SETTLING)
        rest = Frame(motion.after, (Role.IDLE,) * n, None, Phase.PAUSE, caption)
        yield from itertools.repeat(rest, self._count(PAUSE_SHARE * self.seconds))

    def _count(self, seconds: float) -> int:
        return max(1, round(seconds * self.fps))

    def step(self, index: int) -> Iterator[Frame]:
        """Those of one step."""
        step = self.plan.steps[index]
        before = self.plan.steps[index - 1].after if index else self.plan.initial
        caption = step_caption(self.plan, index)
        n = len(before)
        roles = tuple(
            Role.MOVING if p in step.moving else Role.WAITING if p in step.waiting else Role.IDLE for p in range(n)
        )

        def frame(poses: Iterable[SE3], phase: Phase) -> Frame:
            return Frame(tuple(poses), roles, index, phase, caption)

        start = tuple(step.path[0] * step.moving[p] if p in step.moving else step.still[p] for p in range(n))
        for poses in self._placing(before, start, step):
            yield frame(poses, Phase.PLACING)
        for world_from_group in self._path(step.path, step.moving):
            poses = [world_from_group * step.moving[p] if p in step.moving else start[p] for p in range(n)]
            yield frame(poses, Phase.MOVING)
        mated = tuple(step.path[-1] * step.moving[p] if p in step.moving else start[p] for p in range(n))
        merged = {*step.moving, *step.waiting}
        for motion in self._settling(step.settling, {p: mated[p] for p in merged}):
            yield frame((motion * mated[p] if p in merged else mated[p] for p in range(n)), Phase.SETTLING)
        rest = Frame(step.after, (Role.IDLE,) * n, index, Phase.PAUSE, caption)
        yield from itertools.repeat(rest, self._count(PAUSE_SHARE * self.seconds))

    def _placing(self, before: Sequence[SE3], start: Sequence[SE3], step: PlanStep) -> Iterator[list[SE3]]:
        """V's group, as one rigid body, from where it lies to where it waits; the last frame is `start` itself.

        The other parts should already be at `start`. Where one is not (a record from elsewhere), it goes there alone.
        """
        groups = [sorted(step.waiting), *([p] for p in range(len(before)) if p not in step.waiting)]
        moves = [self._reposing(group, before, start) for group in groups if not _all_close(group, before, start)]
        if not moves:
            return
        count = self._count(PLACING_SHARE * self.seconds)
        for k in range(1, count):
            poses = list(before)
            for move in moves:
                fraction = k / count
                for part, pose in move(fraction * fraction * (3.0 - 2.0 * fraction)):
                    poses[part] = pose
            yield poses
        yield list(start)

    def _reposing(self, group: list[int], before: Sequence[SE3], start: Sequence[SE3]):
        parts = self.plan.furniture.parts
        cloud = np.concatenate([transform_points(before[p], parts[p].mesh.vertices) for p in group])
        center = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
        cloud = cloud - center
        here = SE3(np.eye(3), center)
        there = start[group[0]] * before[group[0]].inverse() * here
        floor = min(cloud[:, 2].min() + center[2], transform_points(there, cloud)[:, 2].min())
        lift = min(LARGEST_LIFT, 0.5 * path_length([here, there], float(np.linalg.norm(cloud, axis=1).max())))

        def at(fraction: float) -> Iterator[tuple[int, SE3]]:
            pose = _between(here, there, fraction)
            lowest = transform_points(pose, cloud)[:, 2].min()
            raised = max(0.0, floor + lift * float(np.sin(np.pi * fraction)) - lowest)
            motion = SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, raised])) * here.inverse()
            return ((p, motion * before[p]) for p in group)

        return at

    def _path(self, path: Sequence[SE3], moving: Mapping[int, SE3]) -> Iterator[SE3]:
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
        flight = FLIGHT_SHARE * self.seconds * float(np.clip(np.sqrt(total), *FLIGHT_RANGE))
        distance_at = speed_profile(total, flight, APPROACH_SHARE * self.seconds)
        # Way-points fall between the regular times; each edge is stretched a little so that they become frames.
        grid = np.linspace(0.0, flight + APPROACH_SHARE * self.seconds, 2001)
        reached = np.concatenate([[0.0], np.cumsum(lengths)])
        times = np.interp(reached, distance_at(grid), grid)
        for index, (a, b) in enumerate(edges):
            if lengths[index] == 0.0:
                continue
            count = self._count(times[index + 1] - times[index])
            inner = np.linspace(times[index], times[index + 1], count + 1)[1:-1]
            fractions = np.clip((distance_at(inner) - reached[index]) / lengths[index], 0.0, 1.0)
            yield from _along(a, b, fractions)
            yield b

    def _settling(self, settling: Sequence[SE3], let_go: Mapping[int, SE3]) -> Iterator[SE3]:
        """Motions of the world, up to but without the last, after which all is at rest.

        Args:
            settling: as recorded.
            let_go: where the parts that settle are at first.
        """
        parts = self.plan.furniture.parts
        points = np.concatenate([transform_points(pose, parts[p].mesh.bounds) for p, pose in let_go.items()])
        placed = np.array([transform_points(motion, points) for motion in settling])
        if len(placed) == 0:
            return
        far = np.linalg.norm(placed - placed[-1], axis=2).max(axis=1) > STILL_DISTANCE
        last = int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0
        count = round(min(last * SETTLING_INTERVAL, SETTLING_SHARE * self.seconds) * self.fps)
        for k in range(1, count):
            index, fraction = divmod(last * k / count, 1.0)
            yield _between(settling[int(index)], settling[min(int(index) + 1, last)], fraction)


def path_length(path: Iterable[SE3], radius: float) -> float:
    """Metres: translation plus rotation times `radius` (of the farthest point from the frame's origin), summed."""
    total = 0.0
    for a, b in itertools.pairwise(path):
        total += float(np.linalg.norm(b.translation - a.translation))
        turn = rotation_angle(a.rotation.T @ b.rotation)
        total += radius * turn if turn > 1e-9 else 0.0
    return total


def speed_profile(length: float, flight: float, approach: float):
    """Distance in metres as a function of time: a flight, then a slow approach over the last `APPROACH_LENGTH`.

    Two cubic pieces, at rest at both ends, with the same speed where they meet. `flight` and `approach` are seconds.
    """
    last = min(APPROACH_LENGTH, 0.5 * length)
    first = length - last
    # At most 1.5 times the mean speed of the approach, so that it only ever slows down; below three times the mean
    # of the flight, so that the flight never overshoots.
    speed = min(1.5 * last / approach, 2.0 * first / flight)

    def at(time: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        time = np.asarray(time, dtype=float)
        s = np.clip(time / flight, 0.0, 1.0)
        out = first * s * s * (3.0 - 2.0 * s) + speed * flight * s * s * (s - 1.0)
        r = np.clip((time - flight) / approach, 0.0, 1.0)
        slow = last * r * r * (3.0 - 2.0 * r) + speed * approach * r * (1.0 - r) ** 2
        return np.maximum.accumulate(out + slow) if time.ndim else out + slow

    return at


def _along(a: SE3, b: SE3, fractions: Float[np.ndarray, "n"]) -> Iterator[SE3]:
    for x, y, z, qx, qy, qz, qw in interpolate(a, b, fractions).T:
        yield from_quaternion((x, y, z), (qw, qx, qy, qz))


def _between(a: SE3, b: SE3, fraction: float) -> SE3:
    return next(_along(a, b, np.array([fraction])))


def _all_close(group: Iterable[int], a: Sequence[SE3], b: Sequence[SE3]) -> bool:
    return all(np.allclose(a[p].homogeneous, b[p].homogeneous, rtol=0.0, atol=1e-6) for p in group)
