"""Path planning for a body from its resting pose to the pose at which it mates with another.

The planner works backward from the mating pose and tries cheap motions first: a straight retreat, perhaps a second one
across it, until the body can rise; then up above all obstacles, across, and down to the start. RRT-Connect searches
only if no such retreat exists.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import SE3, interpolate, shifted
from roboassembly.planning.problem import Budget, PathResult, PlanningStatus
from roboassembly.planning.rrt import rrt_connect, shortcut
from roboassembly.planning.world import CollisionWorld

UP = np.array([0.0, 0.0, 1.0])
SKY_CLEARANCE = 0.01
"""Distance between the highest still point and the lowest moving one while the body crosses [m]."""
_PARTIAL_RETREATS = (0.04, 0.12, 0.3)
"""Lengths of a first retreat before a second one, when the body cannot rise directly after leaving the joint [m]."""
_STEEP = 0.5
"""Sine of the elevation from which on a retreat may lead straight above all obstacles."""
_PROBE = 0.004
"""Smallest motion that counts as leaving the mating pose [m]."""
_WIGGLES = 60
"""Number of random small motions in the test whether a body can leave the mating pose."""
_SHORTCUTS = 40
"""Number of pairs of way-points that shortcutting tries."""


@dataclass(frozen=True, eq=False)
class MatingProblem:
    """Start, goal and retreat directions of a mating motion."""

    start: SE3
    """Resting pose `world_from_body`."""
    goal: SE3
    """Mating pose `world_from_body`."""
    partner: str
    """Name of the still body to mate with."""
    retreats: tuple[Float[np.ndarray, "3"], ...]
    """Unit vectors of the world along which the contacts at the goal separate, best first."""
    exit: tuple[SE3, ...] = ()
    """Poses from the goal outward along a way out of the partner that may be free; empty if none is known."""


def plan_mating(world: CollisionWorld, problem: MatingProblem, budget: Budget, seed: int) -> PathResult:
    """Plan the whole path, whose edges are free at the world's resolution."""
    begun, first_state = time.perf_counter(), world.states

    def result(status: PlanningStatus, path: Sequence[SE3] = (), planner: str = "retreat") -> PathResult:
        return PathResult(status, tuple(path), world.states - first_state, time.perf_counter() - begun, planner)

    if not world.is_free(problem.goal):
        return result(PlanningStatus.GOAL_IN_COLLISION)
    if not world.is_free(problem.start):
        return result(PlanningStatus.START_IN_COLLISION)
    sky = world.top + world.radius + SKY_CLEARANCE
    leave = _rise(world, problem.start, sky, [UP, *_around()], problem.partner)
    arrive = _rise(world, problem.goal, sky, distinct_directions(problem.retreats), problem.partner)
    if arrive is None:
        arrive = _rise_after(world, problem, sky)
    if leave is not None and arrive is not None and world.edge_is_free(leave[-1], arrive[-1]):
        return result(PlanningStatus.SOLVED, [*leave, *reversed(arrive)])
    if world.states - first_state >= budget.states:
        return result(PlanningStatus.BUDGET_EXHAUSTED)
    if arrive is None and not _can_move(world, problem.goal, problem.retreats, seed):
        return result(PlanningStatus.UNREACHABLE, planner="rrt-connect")
    remaining = Budget(max(0, budget.states - (world.states - first_state)), budget.seconds)
    begin = leave or [problem.start]
    footholds = [arrive] if arrive is not None else _footholds(world, problem.goal, problem.retreats)
    extent = world.radius + 0.1
    low = np.minimum(problem.goal.translation, begin[-1].translation) - extent
    high = np.maximum(problem.goal.translation, begin[-1].translation) + extent
    bounds = np.array([[low[0], low[1], 0.0], [high[0], high[1], max(sky, high[2])]])
    found = rrt_connect(world, begin[-1], [f[-1] for f in footholds], bounds, remaining, seed)
    if found is None:
        return result(PlanningStatus.BUDGET_EXHAUSTED, planner="rrt-connect")
    found = shortcut(found, world.edge_is_free, seed, _SHORTCUTS)
    arrival = min(footholds, key=lambda f: float(np.linalg.norm(pin.log6(f[-1].actInv(found[-1])).vector)))
    return result(PlanningStatus.SOLVED, [*begin[:-1], *found[:-1], *reversed(arrival)], "rrt-connect")


def _around() -> list[Float[np.ndarray, "3"]]:
    """Return eight horizontal unit vectors."""
    return [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.arange(8) * np.pi / 4]


def _rise(
    world: CollisionWorld, pose: SE3, sky: float, directions: Sequence[Float[np.ndarray, "3"]], partner: str
) -> list[SE3] | None:
    """Return way-points from `pose` to the height `sky`: up, or along one or two directions and up; None if blocked."""
    blocked: list[tuple[Float[np.ndarray, "3"], float]] = []
    for d in directions:
        if d[2] > 1.0 - 1e-9:
            top = _at_sky(pose, sky)
            if world.edge_is_free(pose, top):
                return [pose, top]
            continue
        # The ground limits how far the body can sink.
        farthest = max(0.0, (world.lowest_point(pose) - 1e-4) / -d[2]) if d[2] < 0 else np.inf
        distance = min(world.distance_to_clear(pose, d, partner) + 0.005, farthest)
        if distance <= _PROBE:
            continue
        reached = distance * world.free_fraction(pose, shifted(pose, distance * d))
        if reached < distance:
            if reached > _PROBE:
                blocked.append((d, reached))
            continue
        aside = shifted(pose, distance * d)
        top = _at_sky(aside, sky)
        if world.edge_is_free(aside, top):
            return [pose, aside, top]
        # A body that has left the joint may still be below an obstacle.
        outside = shifted(pose, min(world.distance_to_clear(pose, d, partner, UP) + 0.005, farthest) * d)
        top = _at_sky(outside, sky)
        if world.edge_is_free(aside, outside) and world.edge_is_free(outside, top):
            return [pose, aside, outside, top]
        # Beside a slanted part, a body rises along the slant only.
        if d[2] > _STEEP:
            top = shifted(pose, (sky - pose.translation[2]) / d[2] * d)
            if world.edge_is_free(aside, top):
                return [pose, top]
        blocked.append((d, distance))
    for d, reached in blocked:
        for part in (*(p for p in _PARTIAL_RETREATS if p < reached), reached):
            aside = shifted(pose, part * d)
            for rest in _second_segments(world, aside, d, sky, partner):
                if all(world.edge_is_free(a, b) for a, b in zip([aside, *rest[:-1]], rest, strict=True)):
                    return [pose, aside, *rest]
    return None


def _rise_after(world: CollisionWorld, problem: MatingProblem, sky: float) -> list[SE3] | None:
    """Return way-points along the start of `problem.exit` and from there to the height `sky`; None if blocked."""
    for count in range(1, len(problem.exit)):
        if not world.edge_is_free(problem.exit[count - 1], problem.exit[count]):
            return None
        rise = _rise(world, problem.exit[count], sky, [UP, *problem.retreats], problem.partner)
        if rise is not None:
            return [*problem.exit[:count], *rise]
    return None


def _second_segments(
    world: CollisionWorld, pose: SE3, first: Float[np.ndarray, "3"], sky: float, partner: str
) -> Iterator[list[SE3]]:
    """Yield ways to the height `sky` after a first retreat: up, or across and up."""
    yield [_at_sky(pose, sky)]
    for d in _around():
        if abs(float(d @ first)) > 0.9:
            continue
        distance = world.distance_to_clear(pose, d, partner) + 0.005
        aside = shifted(pose, distance * d)
        yield [aside, _at_sky(aside, sky)]


def _at_sky(pose: SE3, sky: float) -> SE3:
    return SE3(pose.rotation, np.array([pose.translation[0], pose.translation[1], max(sky, pose.translation[2])]))


def _footholds(world: CollisionWorld, goal: SE3, retreats: Sequence[Float[np.ndarray, "3"]]) -> list[list[SE3]]:
    """Return paths from the mating pose to the goals of the search: itself and the free end of each retreat."""
    out = [[goal]]
    for d in retreats:
        end = shifted(goal, 0.3 * d)
        reached = world.free_fraction(goal, end)
        foothold = shifted(goal, (reached * 0.3 - _PROBE / 2) * d)
        # Equal goals would make OMPL's nearest-neighbour tree split without end.
        nearest = min(float(np.linalg.norm(foothold.translation - f[-1].translation)) for f in out)
        if reached * 0.3 > 2 * _PROBE and nearest > _PROBE:
            out.append([goal, foothold])
    return out


def _can_move(world: CollisionWorld, goal: SE3, retreats: Sequence[Float[np.ndarray, "3"]], seed: int) -> bool:
    """Return whether any of many small motions leads away from the goal; otherwise no tree can grow there."""
    rng = np.random.default_rng(seed)
    for d in retreats:
        if world.edge_is_free(goal, shifted(goal, _PROBE * d)):
            return True
    for _ in range(_WIGGLES):
        twist = rng.normal(size=6)
        twist[:3] *= _PROBE / np.linalg.norm(twist[:3])
        twist[3:] *= _PROBE / world.radius / np.linalg.norm(twist[3:])
        moved = goal * pin.exp6(twist)
        if world.first_collision(interpolate(goal, moved, np.array([0.5, 1.0]))) is None:
            return True
    return False
