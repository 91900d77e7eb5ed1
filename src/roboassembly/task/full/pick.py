"""The legs by which a robot takes a standing group: it drives to it, closes its hand and lifts it from its post."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from roboassembly.planning.robot_path import Path, line, path_is_free
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.robots.body import DOF
from roboassembly.task.full.cell_state import Configuration, Grip, Moment, Robot
from roboassembly.task.full.grips import Hold
from roboassembly.task.full.segments import ARM, LIFT, PLACE, TRIES, LegError, Legs, Obstacle
from roboassembly.task.rules.groups import Group

_DRAWS = 3
"""Times that ways to stand are looked for before there is none."""
_MAKING_WAY = 3
"""Times that the other robot drives elsewhere."""
_AWAY = np.array([1e3, *[0.0] * (DOF - 1)])
"""Where a robot is in nobody's way."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What a robot is to take."""

    group: Group
    hold: Hold
    name: str
    """Of the group, for the legs."""
    like: Configuration | None = None
    """Whose arm it would rather have as it takes it; if None, the nearer the platform is to where it was the better."""


@dataclass(eq=False)
class _Taking:
    """A robot takes a standing group."""

    before: Moment
    """Its hand open."""
    loaded: Moment
    """The group in its hand, the post still there."""
    world: RobotWorld
    """As it comes."""
    tries: Iterator[tuple[Path, Path]]
    """Straight back from the group, and straight up with it."""
    failed: str
    """The leg that the last try failed in."""


def fetch_both(legs: Legs, wanted: Sequence[Wanted]) -> None:
    """R_a takes one standing group, R_b another one, in the order that works.

    Args:
        legs: so far; those of this are added.
        wanted: R_a's, then R_b's.

    Raises:
        LegError: it cannot be.
    """
    before = legs.reached
    try:
        for robot in (0, 1):
            _fetch_past(legs, robot, wanted[robot])
    except LegError as no:
        legs.back_to(before)
        if no.final:
            raise
        try:
            for robot in (1, 0):
                _fetch_past(legs, robot, wanted[robot])
        except LegError:
            # Of two failures the one in the usual order is told.
            raise no from None


def _fetch_past(legs: Legs, robot: int, wanted: Wanted) -> None:
    """Take a standing group; if the other robot stands in the way, and holds nothing, it drives elsewhere.

    Raises:
        LegError: it cannot be.
    """
    before, other = legs.reached, 1 - robot
    for left in reversed(range(_MAKING_WAY + 1)):
        try:
            fetch(legs, robot, wanted)
        except LegError as no:
            legs.back_to(before)
            if left == 0 or legs.moment.robots[other].grip is not None:
                raise
            if not can_fetch(legs, robot, wanted):
                raise LegError(no.why, no.leg, final=True) from None
            legs.park(other, legs.world(legs.moment, other), "make way")
        else:
            return


def _index(legs: Legs, group: Group) -> int:
    """Of a group among those that stand."""
    return next(i for i, s in enumerate(legs.moment.standing) if s.group.parts == group.parts)


def fetch(legs: Legs, robot: int, wanted: Wanted) -> None:
    """Drive to a standing group, take it and lift it from its post, which sinks into the floor.

    Args:
        legs: so far; those of this are added.
        robot: 0 or 1.
        wanted: group.

    Raises:
        LegError: it cannot be.
    """
    taking = _taking(legs, robot, wanted)
    before, loaded, name = taking.before, taking.loaded, wanted.name
    for back, up in islice(taking.tries, TRIES):
        way = legs.go(taking.world, before.robots[robot].at, back[-1])
        if way is None:
            taking.failed = f"drive to {name}"
            continue
        legs.moment = before
        legs.add(f"drive to {name}", robot, way)
        legs.add(f"approach {name}", robot, tuple(reversed(back)))
        legs.moment = loaded.moved(robot, legs.moment.robots[robot].at)
        legs.add(f"lift {name}", robot, up)
        legs.moment = replace(legs.moment, posts=before.posts)
        return
    raise LegError(Obstacle.NO_PATH, taking.failed)


def can_fetch(legs: Legs, robot: int, wanted: Wanted) -> bool:
    """Whether a standing group can be taken and lifted, wherever the robot comes from and the other one is."""
    before, other = legs.moment, 1 - robot
    away = before.robots[other].at + _AWAY
    legs.moment = before.moved(other, away)
    try:
        return next(_taking(legs, robot, wanted).tries, None) is not None
    except LegError:
        return False
    finally:
        legs.moment = before


def _taking(legs: Legs, robot: int, wanted: Wanted) -> _Taking:
    """Ways to take a standing group and lift it, `fetch` without the drive.

    Raises:
        LegError: there is no way to stand (from the first of the tries).
    """
    hold, name, index = wanted.hold, wanted.name, _index(legs, wanted.group)
    before = legs.moment.with_robot(robot, replace(legs.moment.robots[robot], opening=hold.open, grip=None))
    group, stand = legs.moment.standing[index].group, legs.moment.standing[index].stand
    rest = tuple(s for i, s in enumerate(before.standing) if i != index)
    taken = Robot(before.robots[robot].at, hold.closed, Grip(group, hold))
    loaded = replace(before, standing=rest, posts=(*before.posts, stand)).with_robot(robot, taken)
    tips = group.world_from_furniture * hold.furniture_from_tips
    world, lifting = legs.world(before, robot), legs.world(loaded, robot)
    near = (before.robots[robot].at, PLACE) if wanted.like is None else (wanted.like, ARM)

    def tries() -> Iterator[tuple[Path, Path]]:
        for at in legs.ways_to_stand(world, tips, *near, f"grasp {name}", _DRAWS):
            back = legs.back(world, at)
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
