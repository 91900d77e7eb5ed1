"""Paths for a mobile Franka: straight in joint space where that is free, else RRT-Connect; lines of the hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from ompl import base

from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.planning.rrt import box_around, exhaustion, run_rrt_connect, shortcut
from roboassembly.robots.body import DOF, world_from_tips
from roboassembly.robots.kinematics import arm
from roboassembly.robots.reach import in_mount

_LONGEST = 1.5
"""Of an extension of a tree; metres and radians together."""
_LINE_STEP = 0.02
"""Metres of a hand's straight line between two way-points, in joint space a little bent: by 0.1 mm at most."""
_LEAP = 0.5
"""Radians between two way-points of a line: more is another branch of solutions."""
_SHORTCUTS = 30
"""Pairs of way-points that are tried."""
Configuration = Float[np.ndarray, "10"]
"""`(x, y, angle)` of the platform and the seven joint angles of the arm [m, rad]."""
Path = tuple[Configuration, ...]


@dataclass(frozen=True)
class Floor:
    """Where platforms may drive: a square around the middle of the world."""

    half: float
    """Metres."""


def connect(
    world: RobotWorld, start: Configuration, goal: Configuration, floor: Floor, budget: Budget, seed: int
) -> Path | None:
    """Way-points from `start` to `goal`; None if either is not free or the budget ran out.

    `CLEARANCE` is kept all the way if both have it. The platform turns the short way round.
    """
    begun = time.perf_counter()
    goal = nearest_turn(goal, start)
    # OMPL would wait for another goal for ever.
    ends = np.array([start, goal])
    if not world.free(ends).all():
        return None
    clear = bool(world.clear(ends).all())
    if world.edge_is_free(start, goal, clear=clear):
        return start, goal
    space, state, read = number_space(start, goal, floor)
    found = run_rrt_connect(
        space,
        state(start),
        [state(goal)],
        lambda a, b: world.edge_is_free(read(a), read(b), clear=clear),
        lambda s: bool((world.clear if clear else world.free)(read(s)[None])[0]),
        exhaustion(lambda: world.states, budget, begun),
        seed,
        _LONGEST,
    )
    if found is None:
        return None
    return shortcut(
        [read(s) for s in found], lambda a, b: world.edge_is_free(a, b, clear=clear), seed, _SHORTCUTS
    )  # fmt: skip


def number_space(
    start: Configuration, goal: Configuration, floor: Floor
) -> tuple[Any, Callable[[Configuration], Any], Callable[[Any], Configuration]]:
    """OMPL's space of configurations, and how one becomes a state of it and comes back."""
    space = base.RealVectorStateSpace(DOF)
    low = np.concatenate([[-floor.half, -floor.half, min(start[2], goal[2]) - np.pi], arm().low])
    high = np.concatenate([[floor.half, floor.half, max(start[2], goal[2]) + np.pi], arm().high])
    space.setBounds(box_around(np.array([low, high]), [start, goal]))

    def state(q: Configuration) -> Any:
        made: Any = space.allocState()
        for axis in range(DOF):
            made[axis] = float(q[axis])
        return made

    def read(made: Any) -> Configuration:
        return np.array([made[axis] for axis in range(DOF)])

    return space, state, read


def nearest_turn(q: Configuration, to: Configuration) -> Configuration:
    """The same, with the platform's angle less than half a turn from another's."""
    out = np.array(q)
    out[2] = to[2] + (q[2] - to[2] + np.pi) % (2.0 * np.pi) - np.pi
    return out


def turned_on(path: Sequence[Configuration], before: Configuration) -> Path:
    """The same path with the platform's angle counted on from a configuration where it begins.

    All of it is shifted by the same whole turns: an edge of more than half a turn was planned the long way round.
    """
    shift = nearest_turn(path[0], before) - path[0]
    return tuple(q + shift for q in path)


def line(start: Configuration, offset: Float[np.ndarray, "3"], *, drive: bool = True) -> Path | None:
    """Way-points along which the hand goes straight, without turning; None if the arm cannot.

    The platform drives what is level of it, and the arm does the rest.

    Args:
        start: configuration at the beginning.
        offset: metres, world.
        drive: if not, the platform stands still.
    """
    length = float(np.linalg.norm(offset))
    if length < 1e-9:
        return (start,)
    level = np.array([*offset[:2], 0.0]) if drive else np.zeros(3)
    if np.linalg.norm(offset - level) < 1e-9 * length:
        return start, start + np.concatenate([offset[:2], np.zeros(DOF - 2)])
    tips = world_from_tips(start)
    count = max(1, int(np.ceil(length / _LINE_STEP)))
    way = [start]
    for i in range(1, count + 1):
        target = SE3(tips.rotation, tips.translation + offset * (i / count))
        place = start[:3] + level * [1.0, 1.0, 0.0] * (i / count)
        q, found = arm().solve(in_mount(place[None], target), way[-1][None, 3:])
        if not found[0] or np.abs(q[0] - way[-1][3:]).max() > _LEAP:
            return None
        way.append(np.concatenate([place, q[0]]))
    return tuple(way)


def path_is_free(world: RobotWorld, path: Sequence[Configuration]) -> bool:
    """Whether all edges are."""
    return all(world.edge_is_free(a, b) for a, b in pairwise(path))
