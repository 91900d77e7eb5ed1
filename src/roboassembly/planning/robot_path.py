"""Paths for a mobile Franka: straight in joint space if free, else RRT-Connect; straight lines of the hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from ompl import base

from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_shapes import CLEARANCE, Configurations
from roboassembly.planning.robot_world import RobotWorld
from roboassembly.planning.rrt import box_around, exhaustion, run_rrt_connect, shortcut
from roboassembly.robots.body import DOF, world_from_tips
from roboassembly.robots.kinematics import Poses, arm
from roboassembly.robots.reach import in_mount

_LONGEST = 1.5
"""Largest extension of a tree, in the norm of configurations [m, rad]."""
_LINE_STEP = 0.025
"""Distance between way-points of a straight line of the hand [m]; between them it mostly deviates by less than 0.2
mm."""
_LEAP = 0.5
"""Largest joint motion between way-points of a line; more indicates another branch of solutions [rad]."""
_SHORTCUTS = 30
"""Number of pairs of way-points that shortcutting tries."""
Configuration = Float[np.ndarray, "10"]
"""`(x, y, angle)` of the platform and the seven joint angles of the arm [m, rad]."""
Path = tuple[Configuration, ...]


@dataclass(frozen=True)
class Floor:
    """Square around the world's origin in which platforms may drive."""

    half: float
    """Half the side [m]."""


def connect(
    world: RobotWorld, start: Configuration, goals: Configurations, floor: Floor, budget: Budget, seed: int
) -> Path | None:
    """Return way-points from `start` to a goal; None if there is no free goal or the budget is exhausted.

    A goal on a straight path is preferred, the first such goal. `CLEARANCE` is kept along the path if both ends have
    it. The platform turns by less than half a turn.

    Args:
        world: collision model.
        start: first configuration.
        goals: possible last configurations.
        floor: where the platform may drive.
        budget: limit of the search.
        seed: of the search.
    """
    begun = time.perf_counter()
    goals = np.array([nearest_turn(goal, start) for goal in goals])
    # OMPL would wait without end for other goals.
    free = world.free(np.array([start, *goals]))
    goals = goals[free[1:]]
    if not free[0] or not len(goals):
        return None
    wide = world.free(np.array([start, *goals]), clearance=CLEARANCE)
    clearance = CLEARANCE if wide[0] and wide[1:].any() else 0.0
    goals = goals[wide[1:]] if clearance else goals
    for goal in goals:
        if world.edge_is_free(start, goal, clearance=clearance):
            return start, goal
    space, state, read = configuration_space(start, goals, floor)
    found = run_rrt_connect(
        space,
        state(start),
        [state(goal) for goal in goals],
        lambda a, b: world.edge_is_free(read(a), read(b), clearance=clearance),
        lambda s: bool(world.free(read(s)[None], clearance=clearance)[0]),
        exhaustion(lambda: world.states, budget, begun),
        seed,
        _LONGEST,
    )
    if found is None:
        return None
    return shortcut(
        [read(s) for s in found], lambda a, b: world.edge_is_free(a, b, clearance=clearance), seed, _SHORTCUTS
    )  # fmt: skip


def configuration_space(
    start: Configuration, goals: Configurations, floor: Floor
) -> tuple[Any, Callable[[Configuration], Any], Callable[[Any], Configuration]]:
    """Return OMPL's space of configurations and conversions from configurations to states and back."""
    space = base.RealVectorStateSpace(DOF)
    ends = np.array([start, *goals])
    low = np.concatenate([[-floor.half, -floor.half, ends[:, 2].min() - np.pi], arm().low])
    high = np.concatenate([[floor.half, floor.half, ends[:, 2].max() + np.pi], arm().high])
    space.setBounds(box_around(np.array([low, high]), list(ends)))

    def state(q: Configuration) -> Any:
        made: Any = space.allocState()
        for axis in range(DOF):
            made[axis] = float(q[axis])
        return made

    def read(made: Any) -> Configuration:
        return np.array([made[axis] for axis in range(DOF)])

    return space, state, read


def nearest_turn(q: Configuration, to: Configuration) -> Configuration:
    """Return a configuration with the platform's angle shifted to within half a turn of another's."""
    out = np.array(q)
    out[2] = to[2] + (q[2] - to[2] + np.pi) % (2.0 * np.pi) - np.pi
    return out


def turned_on(path: Sequence[Configuration], before: Configuration) -> Path:
    """Return a path with the platform's angle continuous from a configuration before it.

    The whole path is shifted by the same number of turns, since an edge may have more than half a turn.
    """
    shift = nearest_turn(path[0], before) - path[0]
    return tuple(q + shift for q in path)


def line(start: Configuration, offset: Float[np.ndarray, "3"], *, drive: bool = True) -> Path | None:
    """Return way-points of a straight motion of the hand without rotation; None if out of the arm's reach.

    The platform drives the horizontal part and the arm moves the rest.

    Args:
        start: initial configuration.
        offset: displacement in the world's axes [m].
        drive: whether the platform drives.
    """
    length = float(np.linalg.norm(offset))
    if length < 1e-9:
        return (start,)
    level = np.array([*offset[:2], 0.0]) if drive else np.zeros(3)
    if np.linalg.norm(offset - level) < 1e-9 * length:
        return start, start + np.concatenate([offset[:2], np.zeros(DOF - 2)])
    tips = world_from_tips(start)
    fractions = np.linspace(0.0, 1.0, max(1, int(np.ceil(length / _LINE_STEP))) + 1)[1:, None]
    place = start[:3] + fractions * np.array([*level[:2], 0.0])
    targets = in_mount(place, Poses(tips.rotation[None], tips.translation + fractions * offset))
    # All way-points at once, from the first configuration.
    arms, found = arm().solve(targets, np.tile(start[3:], (len(place), 1)))
    path = np.vstack([start, np.concatenate([place, arms], axis=1)])
    leaps = np.abs(np.diff(path[:, 3:], axis=0)).max() > _LEAP
    return None if leaps or not found.all() else tuple(path)
