"""The segments by which two robots join what they hold: they meet, one brings its group in, and lets go of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, align_axis, turn_about_vertical
from roboassembly.planning.robot_path import Path, line, path_is_free
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.robots.kinematics import Poses
from roboassembly.robots.reach import nearness, reach
from roboassembly.task.full.cell_state import Configuration, Payload, Robot
from roboassembly.task.full.grips import Grip, Retract
from roboassembly.task.full.segments import GUESSES, TUCKED, LegError, Obstacle, SegmentPlanner
from roboassembly.task.rules.groups import Group, hull_points

_SPINS = 16
"""Turns about the way into a joint in which two groups may meet."""
_HEIGHTS = (0.45, 0.6, 0.75, 0.9)
"""Metres above the floor of the lowest point of two groups that meet."""
_MEETINGS = 6
"""Poses to meet in that are looked at, those that both arms reach best first."""
_PLACES_OF_B, _PLACES_OF_A = 3, 4
"""Ways to stand at a meeting that are tried."""
_BEYOND = (0.4, 0.15, 0.0)
"""Metres beyond the end of the way into a joint from which R_a comes, if it can: paths end where there is room."""


@dataclass(frozen=True, eq=False)
class MateStance:
    """How two robots stand when they join two groups."""

    world_from_furniture: SE3
    """Of the merged group."""
    a: Configuration
    b: Configuration
    out: Path
    """R_a's, out of the joint."""
    back: Path
    """Of R_a's empty hand, once both are joined."""


def mate_stances(
    planner: SegmentPlanner, grip_a: Grip, grip_b: Grip, u: Group, v: Group, ways: Sequence[Retract], merged: Group
) -> Iterator[MateStance]:
    """Ways to stand in which both hands, each with its group, have them joined, R_a comes straight out, and its empty
    hand straight back; first one in each pose of the joint, since what is wrong with one often is with its like.

    Args:
        segments: so far.
        grip_a: of u's group, in the merged group's frame.
        grip_b: of v's group, in the merged group's frame.
        u: in the merged group's frame.
        v: in the merged group's frame.
        ways: straight out of the joint.
        merged: both.
    """
    rest = replace(planner.state, placed=tuple(s for s in planner.state.placed if not _is_in(s.group, merged)))
    payload_a, payload_b = Payload(u, grip_a), Payload(v, grip_b)
    far = np.array([1e3, 0.0, 0.0, *TUCKED])
    absent = rest.with_robot(0, Robot(far, grip_a.closed, payload_a)).with_robot(
        1, Robot(far, grip_b.closed, payload_b)
    )
    world_a, world_b = planner.world(absent, 0), planner.world(absent, 1)
    letting_go = absent.with_robot(0, Robot(far, grip_a.open)).with_robot(
        1, Robot(far, grip_b.closed, Payload(merged, grip_b))
    )

    def of_pose(way: Retract, pose: SE3) -> Iterator[MateStance]:
        b = reach(pose * grip_b.furniture_from_tips, GUESSES, planner.rng).configurations
        a = reach(pose * grip_a.furniture_from_tips, GUESSES, planner.rng).configurations
        b, a = (q[w.free(q)] if len(q) else q for q, w in ((b, world_b), (a, world_a)))
        if not len(a) or not len(b):
            return
        # The farther R_b stands from where R_a would, the less they are in each other's way.
        apart = np.linalg.norm(b[:, None, :2] - a[None, :, :2], axis=2).mean(axis=1)
        for at_b in b[np.argsort(-apart)[:_PLACES_OF_B]]:
            world, empty = planner.world(absent.moved(1, at_b), 0), planner.world(letting_go.moved(1, at_b), 0)
            free = a[world.free(a)]
            order = np.argsort(-np.linalg.norm(free[:, :2] - at_b[:2], axis=1))
            for at_a in free[order[:_PLACES_OF_A]]:
                out = _way_out(world, at_a, pose.rotation @ way.direction, way.length)
                back = None if out is None else planner.back(empty, at_a)
                if out is not None and back is not None:
                    yield MateStance(pose, at_a, at_b, out, back)

    left = [of_pose(way, pose) for way, pose in _poses_to_meet(planner, grip_a, grip_b, ways, merged)]
    while left:
        for some in tuple(left):
            meeting = next(some, None)
            if meeting is None:
                left.remove(some)
            else:
                yield meeting


def _way_out(world: RobotWorld, at: Configuration, direction: Float[np.ndarray, "3"], length: float) -> Path | None:
    """R_a's straight way out of a joint, as far as there is any use in it; None if there is none of the length."""
    for beyond in _BEYOND:
        out = line(at, (length + beyond) * direction)
        if out is not None and path_is_free(world, out):
            return out
    return None


def _poses_to_meet(
    planner: SegmentPlanner, grip_a: Grip, grip_b: Grip, ways: Sequence[Retract], merged: Group
) -> Iterator[tuple[Retract, SE3]]:
    """Poses of the merged group, near the middle, with the way out level, those that suit both arms best first."""
    points = hull_points(planner.furniture, merged)
    some: list[tuple[Retract, SE3]] = []
    about = align_axis(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    for way in ways:
        level = align_axis(way.direction, np.array([1.0, 0.0, 0.0]))
        for spin in np.arange(_SPINS) * 2.0 * np.pi / _SPINS:
            turn = about @ turn_about_vertical(spin) @ about.T @ level
            turned = points @ turn.T
            low, high = turned.min(axis=0), turned.max(axis=0)
            for height in _HEIGHTS:
                shift = np.array([*(-0.5 * (low + high)[:2]), height - low[2]])
                some.append((way, SE3(turn, shift)))
    far = np.maximum(
        *(
            nearness(
                Poses(
                    np.array([p.rotation @ h.furniture_from_tips.rotation for _, p in some]),
                    np.array([p.act(h.furniture_from_tips.translation) for _, p in some]),
                )
            )
            for h in (grip_a, grip_b)
        )
    )
    for index in np.argsort(far, kind="stable")[:_MEETINGS]:
        way, pose = some[index]
        spot = 0.3 * planner.cell.radius * planner.rng.uniform(-1.0, 1.0, 2)
        drawn = SE3(turn_about_vertical(planner.rng.uniform(-np.pi, np.pi)), np.array([*spot, 0.0]))
        yield way, drawn * pose


def join(planner: SegmentPlanner, meeting: MateStance) -> None:
    """Drive both robots to a meeting and mate.

    Args:
        segments: so far; those of this are added.
        meeting: where.

    Raises:
        LegError: there is no way.
    """
    drives = ((1, meeting.b, "drive v"), (0, meeting.out[-1], "drive u"))
    before, failed = planner.reached, ""
    for order in (drives, drives[::-1]):
        for robot, goal, name in order:
            way = planner.go(planner.world(planner.state, robot), planner.state.robots[robot].at, goal)
            if way is None:
                failed = name
                break
            planner.add(name, robot, way)
        else:
            planner.add("mate", 0, tuple(reversed(meeting.out)))
            return
        planner.back_to(before)
    raise LegError(Obstacle.NO_PATH, failed)


def release(planner: SegmentPlanner, meeting: MateStance, merged: Group, grip_a: Grip, grip_b: Grip) -> None:
    """R_a opens its hand, backs off and drives away; R_b holds the merged group.

    Args:
        segments: so far; those of this are added.
        meeting: in which they were joined.
        merged: both groups.
        grip_a: of it.
        grip_b: of it.

    Raises:
        LegError: R_a cannot drive away.
    """
    a, b = planner.state.robots
    planner.state = planner.state.with_robot(1, replace(b, payload=Payload(merged, grip_b)))
    planner.state = planner.state.with_robot(0, Robot(a.at, grip_a.open))
    planner.add("back off from u", 0, meeting.back)
    planner.park(0, planner.world(planner.state, 0), "leave u")


def _is_in(group: Group, merged: Group) -> bool:
    return set(group.parts) <= set(merged.parts)
