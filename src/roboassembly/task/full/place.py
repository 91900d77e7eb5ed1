"""The segments by which a robot sets what it holds on a post that rises for it, or on the floor, and leaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, align_axis, turn_about_vertical
from roboassembly.planning.robot_path import Path, line, path_is_free
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.task.full.cell import Post, free_places, on_post, open_grasps, reach_from
from roboassembly.task.full.cell_state import CellState, Configuration, PlacedGroup, Robot
from roboassembly.task.full.segments import LIFT, PLACE, LegError, Obstacle, SegmentPlanner
from roboassembly.task.layout import group_footprint
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Group

_OUTWARD = (1.0, 1.15, 1.3)
"""Where a merged group may stand: as far from the middle as a post of before, or farther by so much."""
_ROUNDS = 3
"""Times that each way to stand is tried, turned otherwise and elsewhere."""
_OF_ONE, _CARRIES = 3, 12
"""Ways to come to one way to stand, and to all of them, to which the planner looks for a path."""


@dataclass(frozen=True, eq=False)
class _Down:
    """A way to set a group down, `put_down` without the drive and what follows."""

    with_post: CellState
    after: CellState
    """The group on its post or on the floor, the hand open and not yet gone."""
    leaving: RobotWorld
    above: Path
    """Straight up from where the group stands."""
    back: Path


def set_down(planner: SegmentPlanner, wanted: Sequence[Float[np.ndarray, "2"]]) -> None:
    """R_b sets what it holds on a post that rises for it, and drives away.

    Args:
        segments: so far; those of this are added.
        wanted: places in the ring that are free.

    Raises:
        LegError: it cannot be.
    """
    robot = planner.state.robots[1]
    assert robot.payload is not None
    put_down(planner, 1, _places(planner, robot.payload.group, robot.at, wanted), PLACE)


def put_down(planner: SegmentPlanner, index: int, places: Iterable[PlacedGroup | Group], joints: slice) -> None:
    """A robot carries what it holds to one of several places, sets it down there and drives away.

    Args:
        segments: so far; those of this are added.
        index: of the robot.
        places: in the order in which they are tried: on a post that rises for it, or (a group) on the floor.
        joints: ways to stand are tried first that are near the robot's present configuration in these.

    Raises:
        LegError: it cannot be.
    """
    before = planner.reached
    robot = planner.state.robots[index]
    carrying = planner.world(planner.state, index)
    failed = LegError(Obstacle.NO_PATH, "set down")
    for down in islice(_ways_down(planner, index, places, joints), _CARRIES):
        path = planner.go(carrying, robot.at, down.above[-1])
        if path is None:
            continue
        planner.add("carry", index, path)
        planner.state = replace(planner.state, free_posts=down.with_post.free_posts)
        planner.add("set down", index, tuple(reversed(down.above)))
        planner.state = down.after.moved(index, planner.state.robots[index].at)
        planner.add("back off", index, down.back)
        try:
            planner.park(index, down.leaving, "leave")
        except LegError as no:
            failed = no
            planner.back_to(before)
        else:
            return
    raise failed


def _ways_down(
    planner: SegmentPlanner, index: int, places: Iterable[PlacedGroup | Group], joints: slice
) -> Iterator[_Down]:
    """Ways to set down what a robot holds, in the order of the places.

    Raises:
        LegError: there is none.
    """
    start, robot, other = planner.state, planner.state.robots[index], 1 - index
    grip = robot.payload
    assert grip is not None
    failed = LegError(Obstacle.NO_PLACEMENT, "set down", final=True)
    found = False
    for place in places:
        if isinstance(place, PlacedGroup):
            group, with_post = place.group, replace(start, free_posts=(*start.free_posts, place.post))
            there = replace(start, placed=(*start.placed, place))
        else:
            group, with_post = place, start
            there = replace(start, on_floor=(*start.on_floor, place))
        after = there.with_robot(index, Robot(robot.at, grip.grip.open))
        if not planner.world(after, other).free(after.robots[other].at[None])[0]:
            continue  # the other robot stands where the post would rise, or the group
        lowering, leaving = planner.world(with_post, index), planner.world(after, index)
        tips = group.world_from_furniture * grip.grip.furniture_from_tips
        ways = 0
        try:
            for at in planner.ways_to_stand(lowering, tips, robot.at, joints, "set down"):
                above = line(at, np.array([0.0, 0.0, LIFT]))
                if above is None or not path_is_free(lowering, above):
                    continue
                back = planner.back(leaving, at)
                if back is None:
                    continue
                found = True
                yield _Down(with_post, after, leaving, above, back)
                ways += 1
                if ways == _OF_ONE:
                    break
        except LegError as none:
            failed = LegError(none.why, none.segment, final=True)
        else:
            failed = LegError(Obstacle.NO_PATH, "set down", final=True)
    if not found:
        raise failed


def _places(
    planner: SegmentPlanner, merged: Group, near: Configuration, wanted: Sequence[Float[np.ndarray, "2"]]
) -> Iterator[PlacedGroup]:
    """Ways for the merged group to stand on a post, turned at random: each axis up once, and then again in another
    place, those of each round first that leave most grasps open; finished furniture upright if it can."""
    taken = [group_footprint(planner.furniture, s.group) for s in planner.state.placed]
    order = np.argsort([np.linalg.norm(p - near[:2]) for p in wanted])
    places = [wanted[o] * f for f in _OUTWARD for o in order]
    for round_ in range(_ROUNDS):
        found: list[tuple[float, Group, Post]] = []
        for w in planner.rng.permutation(len(UP_AXES)):
            turn = turn_about_vertical(planner.rng.uniform(-np.pi, np.pi)) @ align_axis(UP_AXES[w], UP_AXES[0])
            held = on_post(planner.furniture, merged.moved_to(SE3(turn, np.zeros(3))), np.zeros(2))
            if held is not None:
                upright = w == 0 and len(merged.parts) == len(planner.furniture.parts)
                found.append((float(upright) + open_grasps(planner.furniture, *held), *held))
        for _, group, stand in sorted(found, key=lambda item: -item[0]):
            fit = free_places(places, reach_from(planner.furniture, group, stand), taken)
            if not fit:
                continue
            shift = np.array([*fit[round_ % len(fit)], 0.0])
            moved = SE3(np.eye(3), shift) * group.world_from_furniture
            yield PlacedGroup(group.moved_to(moved), Post(stand.top + shift))
