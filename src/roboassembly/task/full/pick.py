"""Picking: a robot drives to a group on its post, grips it and lifts it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from roboassembly.planning.robot_path import Configuration, Path, line
from roboassembly.planning.robot_world import RobotWorld, Tally
from roboassembly.robots.body import DOF
from roboassembly.task.full.cell_state import CellState, Payload, Robot
from roboassembly.task.full.failure import Failure, FullVerdict, Stage
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.segments import (
    ARM,
    LIFT_HEIGHT,
    PLATFORM,
    Planned,
    StepContext,
    arm_configurations,
    child_seed,
    retreat_path,
)
from roboassembly.task.rules.groups import Group

_DRAWS = 3
"""Draws of configurations before there is none."""
_DRIVES = 12
"""Configurations at the grasp to which the planner looks for a path."""
_AWAY = np.array([1e3, *[0.0] * (DOF - 1)])
"""Offset of a configuration that is in nobody's way."""


@dataclass(frozen=True, eq=False)
class PickRequest:
    """Group that a robot is to pick, and the grip for it."""

    group: Group
    """Group on a post."""
    grip: Grip
    preferred: Configuration | None = None
    """Configuration whose arm joints are preferred at the grasp; None to prefer the shortest drive."""


@dataclass(frozen=True, eq=False)
class _PickOption:
    """One configuration at the grasp, with the straight motions from it."""

    back: Path
    """Straight back from the group; reversed it is the approach."""
    lift: Path


@dataclass(frozen=True, eq=False)
class _PickStates:
    """States around the moment at which the hand closes."""

    open: CellState
    """The hand is open, the group on its post."""
    closed: CellState
    """The group is in the hand, its post still up."""


def pick(
    context: StepContext, state: CellState, robot: int, request: PickRequest, seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan to drive to a group, grip it and lift it off its post, which sinks into the floor.

    Args:
        context: of the step.
        state: at the beginning; the robot's hand is empty.
        robot: 0 or 1.
        request: what to pick, and how.
        seed: of all draws.
    """
    tally = Tally()
    states = _pick_states(state, robot, request)
    world = context.world(states.open, robot, tally)
    failure = Failure(FullVerdict.NO_ARM_SOLUTION, Stage.GRASP, robot)
    drives = 0
    for option in _pick_options(context, states, world, robot, request, child_seed(seed, 0), tally):
        if isinstance(option, Failure):
            failure = option
            continue
        path = context.connect(world, state.robots[robot].at, option.back[-1][None], child_seed(seed, 1, drives))
        drives += 1
        if path is not None:
            there = Planned(states.open).move(Stage.DRIVE_TO_GROUP, robot, path)
            there = there.move(Stage.APPROACH, robot, tuple(reversed(option.back)))
            lifted = there.change(states.closed.moved(robot, there.state.robots[robot].at))
            lifted = lifted.move(Stage.LIFT, robot, option.lift)
            done = lifted.change(replace(lifted.state, free_posts=state.free_posts))
            return replace(done, states=tally.states)
        failure = Failure(FullVerdict.NO_PATH, Stage.DRIVE_TO_GROUP, robot)
        if drives == _DRIVES:
            break
    return replace(failure, states=tally.states)


def can_pick(
    context: StepContext,
    state: CellState,
    robot: int,
    request: PickRequest,
    seed: np.random.SeedSequence,
    tally: Tally,
) -> bool:
    """Whether a group can be gripped and lifted, wherever the robot comes from and the other robot stands.

    Args:
        context: of the step.
        state: unchanged.
        robot: 0 or 1.
        request: what to pick, and how.
        seed: of all draws.
        tally: counts the tested configurations.
    """
    other = 1 - robot
    cleared = state.moved(other, state.robots[other].at + _AWAY)
    states = _pick_states(cleared, robot, request)
    world = context.world(states.open, robot, tally)
    options = _pick_options(context, states, world, robot, request, seed, tally)
    return any(isinstance(option, _PickOption) for option in options)


def _pick_states(state: CellState, robot: int, request: PickRequest) -> _PickStates:
    index = next(i for i, placed in enumerate(state.placed) if placed.group.parts == request.group.parts)
    picked, rest = state.placed[index], (*state.placed[:index], *state.placed[index + 1 :])
    at = state.robots[robot].at
    opened = state.with_robot(robot, Robot(at, request.grip.open))
    closed = replace(opened, placed=rest, free_posts=(*opened.free_posts, picked.post))
    payload = Payload(picked.group, request.grip)
    return _PickStates(opened, closed.with_robot(robot, Robot(at, request.grip.closed, payload)))


def _pick_options(
    context: StepContext,
    states: _PickStates,
    world: RobotWorld,
    robot: int,
    request: PickRequest,
    seed: np.random.SeedSequence,
    tally: Tally,
) -> Iterator[_PickOption | Failure]:
    """Yield ways to grip the group and lift it, and why others fail."""
    lifting = context.world(states.closed, robot, tally)
    near, entries = states.open.robots[robot].at, PLATFORM
    if request.preferred is not None:
        near, entries = request.preferred, ARM
    tips = request.group.world_from_furniture * request.grip.furniture_from_tips
    for at in arm_configurations(world, tips, near, entries, seed, _DRAWS):
        back = retreat_path(world, at)
        if back is None:
            yield Failure(FullVerdict.NO_PATH, Stage.APPROACH, robot)
            continue
        up = line(at, np.array([0.0, 0.0, LIFT_HEIGHT]))
        if up is None or not lifting.path_is_free(up):
            yield Failure(FullVerdict.NO_PATH, Stage.LIFT, robot)
            continue
        yield _PickOption(back, up)
