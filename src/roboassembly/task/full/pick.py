"""The segments by which a robot takes a standing group: it drives to it, closes its hand and lifts it from its post."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from roboassembly.planning.robot_path import Path, line, path_is_free
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.robots.body import DOF
from roboassembly.task.full.cell_state import CellState, Configuration, Payload, Robot
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.segments import ARM, LIFT, PLACE, TRIES, LegError, Obstacle, SegmentPlanner
from roboassembly.task.rules.groups import Group

_DRAWS = 3
"""Times that ways to stand are looked for before there is none."""
_MAKING_WAY = 3
"""Times that the other robot drives elsewhere."""
_AWAY = np.array([1e3, *[0.0] * (DOF - 1)])
"""Where a robot is in nobody's way."""


@dataclass(frozen=True, eq=False)
class PickRequest:
    """What a robot is to take."""

    group: Group
    grip: Grip
    name: str
    """Of the group, for the segments."""
    like: Configuration | None = None
    """Whose arm it would rather have as it takes it; if None, the nearer the platform is to where it was the better."""


@dataclass(eq=False)
class _Taking:
    """A robot takes a standing group."""

    before: CellState
    """Its hand open."""
    loaded: CellState
    """The group in its hand, the post still there."""
    world: RobotWorld
    """As it comes."""
    tries: Iterator[tuple[Path, Path]]
    """Straight back from the group, and straight up with it."""
    failed: str
    """The segment that the last try failed in."""


def pick_both(planner: SegmentPlanner, wanted: Sequence[PickRequest]) -> None:
    """R_a takes one standing group, R_b another one, in the order that works.

    Args:
        segments: so far; those of this are added.
        wanted: R_a's, then R_b's.

    Raises:
        LegError: it cannot be.
    """
    before = planner.reached
    try:
        for robot in (0, 1):
            _pick_past(planner, robot, wanted[robot])
    except LegError as no:
        planner.back_to(before)
        if no.final:
            raise
        try:
            for robot in (1, 0):
                _pick_past(planner, robot, wanted[robot])
        except LegError:
            # Of two failures the one in the usual order is told.
            raise no from None


def _pick_past(planner: SegmentPlanner, robot: int, wanted: PickRequest) -> None:
    """Take a standing group; if the other robot stands in the way, and holds nothing, it drives elsewhere.

    Raises:
        LegError: it cannot be.
    """
    before, other = planner.reached, 1 - robot
    for left in reversed(range(_MAKING_WAY + 1)):
        try:
            pick(planner, robot, wanted)
        except LegError as no:
            planner.back_to(before)
            if left == 0 or planner.state.robots[other].payload is not None:
                raise
            if not can_pick(planner, robot, wanted):
                raise LegError(no.why, no.segment, final=True) from None
            planner.park(other, planner.world(planner.state, other), "make way")
        else:
            return


def _index(planner: SegmentPlanner, group: Group) -> int:
    """Of a group among those that stand."""
    return next(i for i, s in enumerate(planner.state.placed) if s.group.parts == group.parts)


def pick(planner: SegmentPlanner, robot: int, wanted: PickRequest) -> None:
    """Drive to a standing group, take it and lift it from its post, which sinks into the floor.

    Args:
        segments: so far; those of this are added.
        robot: 0 or 1.
        wanted: group.

    Raises:
        LegError: it cannot be.
    """
    taking = _taking(planner, robot, wanted)
    before, loaded, name = taking.before, taking.loaded, wanted.name
    for back, up in islice(taking.tries, TRIES):
        way = planner.go(taking.world, before.robots[robot].at, back[-1])
        if way is None:
            taking.failed = f"drive to {name}"
            continue
        planner.state = before
        planner.add(f"drive to {name}", robot, way)
        planner.add(f"approach {name}", robot, tuple(reversed(back)))
        planner.state = loaded.moved(robot, planner.state.robots[robot].at)
        planner.add(f"lift {name}", robot, up)
        planner.state = replace(planner.state, free_posts=before.free_posts)
        return
    raise LegError(Obstacle.NO_PATH, taking.failed)


def can_pick(planner: SegmentPlanner, robot: int, wanted: PickRequest) -> bool:
    """Whether a standing group can be taken and lifted, wherever the robot comes from and the other one is."""
    before, other = planner.state, 1 - robot
    away = before.robots[other].at + _AWAY
    planner.state = before.moved(other, away)
    try:
        return next(_taking(planner, robot, wanted).tries, None) is not None
    except LegError:
        return False
    finally:
        planner.state = before


def _taking(planner: SegmentPlanner, robot: int, wanted: PickRequest) -> _Taking:
    """Ways to take a standing group and lift it, `fetch` without the drive.

    Raises:
        LegError: there is no way to stand (from the first of the tries).
    """
    grip, name, index = wanted.grip, wanted.name, _index(planner, wanted.group)
    before = planner.state.with_robot(robot, replace(planner.state.robots[robot], opening=grip.open, payload=None))
    group, stand = planner.state.placed[index].group, planner.state.placed[index].post
    rest = tuple(s for i, s in enumerate(before.placed) if i != index)
    taken = Robot(before.robots[robot].at, grip.closed, Payload(group, grip))
    loaded = replace(before, placed=rest, free_posts=(*before.free_posts, stand)).with_robot(robot, taken)
    tips = group.world_from_furniture * grip.furniture_from_tips
    world, lifting = planner.world(before, robot), planner.world(loaded, robot)
    near = (before.robots[robot].at, PLACE) if wanted.like is None else (wanted.like, ARM)

    def tries() -> Iterator[tuple[Path, Path]]:
        for at in planner.ways_to_stand(world, tips, *near, f"grasp {name}", _DRAWS):
            back = planner.back(world, at)
            if back is None:
                taking.failed = f"approach {name}"
                continue
            up = line(at, np.array([0.0, 0.0, LIFT]))
            if up is None or not path_is_free(lifting, up):
                taking.failed = f"lift {name}"
                continue
            yield back, up

    taking = _Taking(before, loaded, world, tries(), f"grasp {name}")
    return taking
