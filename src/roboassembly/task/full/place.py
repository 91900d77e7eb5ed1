"""Placing: a robot sets its payload on a post that rises for it, or on the floor, and leaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import SE3, align_axis, turn_about_vertical
from roboassembly.planning.robot_path import Path, line
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.task.full.cell import LANE
from roboassembly.task.full.cell_state import CellState, PlacedGroup, Robot
from roboassembly.task.full.failure import Failure, FullVerdict, Stage
from roboassembly.task.full.posts import best_stands, reach_from
from roboassembly.task.full.segments import (
    LIFT_HEIGHT,
    PLATFORM,
    Planned,
    StepContext,
    arm_configurations,
    child_seed,
    parking_path,
    retreat_path,
)
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.rules.groups import Circle, Group, group_footprint

_OUTWARD = (1.0, 1.15, 1.3)
"""Distances from the middle at which a merged group may stand, as multiples of that of an earlier post."""
_ROUNDS = 3
"""Times that each way to stand is tried, turned otherwise and elsewhere."""
_PER_PLACE, _CARRIES = 3, 12
"""Configurations above one place, and above all places, to which the planner looks for a path."""


@dataclass(frozen=True, eq=False)
class _Descent:
    """A way to set a group down, without the motions before and after it."""

    with_post: CellState
    """The post has risen; the group is in the hand."""
    released: CellState
    """The group stands; the hand is open and still around it."""
    leaving: RobotWorld
    """Collision model of the robot that leaves."""
    above: Path
    """Straight up from where the group stands; reversed it sets the group down."""
    back: Path
    """Straight path of the open hand away from the group."""


def place_on_post(
    context: StepContext, state: CellState, spots: Sequence[Float[np.ndarray, "2"]], seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan R_b to set its payload on a post that rises for it, and to drive away.

    Args:
        context: of the step.
        state: at the beginning.
        spots: places near which the post may rise [m].
        seed: of all draws.
    """
    payload = state.robots[1].payload
    assert payload is not None
    places = _posts_for(context, state, payload.group, spots, child_seed(seed, 0))
    return put_down(context, state, 1, places, PLATFORM, child_seed(seed, 1))


def put_down(
    context: StepContext,
    state: CellState,
    robot: int,
    places: Iterable[PlacedGroup | Group],
    entries: slice,
    seed: np.random.SeedSequence,
) -> Planned | Failure:
    """Plan a robot to carry its payload to one of several places, set it down there and drive away.

    Args:
        context: of the step.
        state: at the beginning.
        robot: 0 or 1.
        places: poses of the payload, in the order in which they are tried: on a post that rises, or on the floor.
        entries: entries of configurations; those are tried first that are near the present configuration in them.
        seed: of all draws.
    """
    tally = Tally()
    start = state.robots[robot].at
    carrying = context.world(state, robot, tally)
    failure = Failure(FullVerdict.NO_PLACEMENT, Stage.SET_DOWN, robot, final=True)
    carries = 0
    for descent in _descents(context, state, robot, places, entries, child_seed(seed, 0), tally):
        if isinstance(descent, Failure):
            failure = failure if carries else descent
            continue
        if not carries:
            failure = Failure(FullVerdict.NO_PATH, Stage.CARRY, robot)
        carries += 1
        path = context.connect(carrying, start, descent.above[-1][None], child_seed(seed, 1, carries))
        if path is not None:
            done = Planned(state).move(Stage.CARRY, robot, path)
            done = done.change(replace(done.state, free_posts=descent.with_post.free_posts))
            done = done.move(Stage.SET_DOWN, robot, tuple(reversed(descent.above)))
            done = done.change(descent.released.moved(robot, done.state.robots[robot].at))
            done = done.move(Stage.RELEASE, robot, descent.back)
            parked = parking_path(context, descent.leaving, done.state.robots[robot].at, child_seed(seed, 2, carries))
            if parked is not None:
                return replace(done.move(Stage.LEAVE, robot, parked), states=tally.states)
            failure = Failure(FullVerdict.NO_PATH, Stage.LEAVE, robot)
        if carries == _CARRIES:
            break
    return replace(failure, states=tally.states)


def _descents(
    context: StepContext,
    state: CellState,
    robot: int,
    places: Iterable[PlacedGroup | Group],
    entries: slice,
    seed: np.random.SeedSequence,
    tally: Tally,
) -> Iterator[_Descent | Failure]:
    """Yield ways to set down what a robot holds, in the order of the places, and why others fail."""
    start, other = state.robots[robot].at, 1 - robot
    payload = state.robots[robot].payload
    assert payload is not None
    for index, place in enumerate(places):
        if isinstance(place, PlacedGroup):
            group, with_post = place.group, replace(state, free_posts=(*state.free_posts, place.post))
            there = replace(state, placed=(*state.placed, place))
        else:
            group, with_post = place, state
            there = replace(state, on_floor=(*state.on_floor, place))
        released = there.with_robot(robot, Robot(start, payload.grip.open))
        if not context.world(released, other, tally).free(released.robots[other].at[None])[0]:
            continue  # the other robot stands where the post or the group would be
        lowering, leaving = context.world(with_post, robot, tally), context.world(released, robot, tally)
        tips = group.world_from_furniture * payload.grip.furniture_from_tips
        found, reached = 0, False
        for at in arm_configurations(lowering, tips, start, entries, child_seed(seed, index)):
            reached = True
            above = line(at, np.array([0.0, 0.0, LIFT_HEIGHT]))
            if above is None or not lowering.path_is_free(above):
                continue
            back = retreat_path(leaving, at)
            if back is None:
                continue
            yield _Descent(with_post, released, leaving, above, back)
            found += 1
            if found == _PER_PLACE:
                break
        if not found:
            kind = FullVerdict.NO_PATH if reached else FullVerdict.NO_ARM_SOLUTION
            yield Failure(kind, Stage.SET_DOWN, robot, final=True)


def _posts_for(
    context: StepContext,
    state: CellState,
    merged: Group,
    spots: Sequence[Float[np.ndarray, "2"]],
    seed: np.random.SeedSequence,
) -> Iterator[PlacedGroup]:
    """Yield ways for the merged group to stand on a post, turned at random about the vertical.

    Each axis is up once in each round. Those come first that leave most grasps open; finished furniture stands upright
    if it can.
    """
    furniture, rng = context.furniture, np.random.default_rng(seed)
    occupied = [group_footprint(furniture, placed.group) for placed in state.placed]
    near = state.robots[1].at[:2]
    order: list[int] = np.argsort([float(np.linalg.norm(spot - near)) for spot in spots]).tolist()
    places = [spots[i] * factor for factor in _OUTWARD for i in order]
    for round_ in range(_ROUNDS):
        turns = [
            (w, turn_about_vertical(rng.uniform(-np.pi, np.pi)) @ align_axis(UP_AXES[w], UP_AXES[0]))
            for w in rng.permutation(len(UP_AXES)).tolist()
        ]
        stands = [merged.moved_to(SE3(turn, np.zeros(3))) for _, turn in turns]
        upright = [w == 0 and len(merged.parts) == len(furniture.parts) for w, _ in turns]
        for group, post in best_stands(furniture, stands, upright):
            fit = _free_places(places, reach_from(furniture, group, post), occupied)
            if not fit:
                continue
            shift = np.array([*fit[round_ % len(fit)], 0.0])
            moved = SE3(np.eye(3), shift) * group.world_from_furniture
            yield PlacedGroup(group.moved_to(moved), post.moved(shift))


def _free_places(
    places: Sequence[Float[np.ndarray, "2"]], radius: float, occupied: Sequence[Circle]
) -> list[Float[np.ndarray, "2"]]:
    """Return the places where a circle keeps clear of all occupied ones."""
    return [
        place
        for place in places
        if all(np.linalg.norm(place - c.center) > radius + c.radius + 0.5 * LANE for c in occupied)
    ]
