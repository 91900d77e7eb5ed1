"""The full step: which attempts are made, and in which order. Stages are in `pick`, `mate` and `place`.

1. Find stances in which the groups can mate; if there is none, nothing else is tried.
2. Pick both groups. R_a picks first; if that fails, R_b does. An empty robot in the way drives elsewhere.
3. Drive to the first stance, mate, release, and place the merged group.
4. If 3 fails, pick both groups again, with the arms as the next stance has them, and repeat 3 there.
5. If no stance leads to the end, start again with other draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, islice

import numpy as np
from jaxtyping import Float

from roboassembly.planning.robot_world import Tally
from roboassembly.task.full.cell_state import CellState
from roboassembly.task.full.failure import Failure, FullVerdict, Stage
from roboassembly.task.full.grips import MateGrasp
from roboassembly.task.full.mate import MateStance, drive_and_mate, mate_stances, release
from roboassembly.task.full.pick import PickRequest, can_pick, pick
from roboassembly.task.full.place import place_on_post
from roboassembly.task.full.segments import Planned, StepContext, child_seed, parking_path

_RESTARTS = 2
"""Times that a step is planned from its beginning, with other draws."""
_STANCES = 6
"""Stances that are driven to before the step starts again."""
_MAKE_WAY = 3
"""Times that the other robot drives elsewhere."""


def plan_step(
    context: StepContext, state: CellState, grasp: MateGrasp, seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan a whole step: pick both groups, mate them, release, and set the merged group on a post.

    Args:
        context: of the step.
        state: at the beginning; both hands are empty.
        grasp: both groups, their grips and their joint.
        seed: of all draws.
    """
    requests = PickRequest(grasp.u, grasp.grip_a), PickRequest(grasp.v, grasp.grip_b)
    failure, spent = Failure(FullVerdict.NO_ARM_SOLUTION, Stage.MATE), 0
    most = context.budget.stances or _RESTARTS * _STANCES
    for restart in range(-(-most // _STANCES)):
        drawn, tally = child_seed(seed, restart), Tally()
        stances = mate_stances(context, state, grasp, child_seed(drawn, 0), tally)
        first = next(stances, None)
        if first is None:
            return replace(failure, states=spent + tally.states)
        picked = pick_both(context, state, requests, child_seed(drawn, 1))
        if isinstance(picked, Failure):
            return replace(picked, states=spent + tally.states + picked.states)
        for attempt, stance in enumerate(islice(chain([first], stances), min(_STANCES, most - restart * _STANCES))):
            if attempt:
                # With a long payload an arm does not get from any posture to any other.
                arms = stance.out[-1], stance.b
                liked = [replace(request, preferred=arm) for request, arm in zip(requests, arms, strict=True)]
                picked = pick_both(context, state, liked, child_seed(drawn, 2, attempt))
            result = picked
            if isinstance(picked, Planned):
                result = _mate_and_place(context, state, picked, stance, grasp, child_seed(drawn, 3, attempt))
            if isinstance(result, Planned):
                return replace(result, states=spent + tally.states + result.states)
            failure, spent = result, spent + result.states
            if failure.final:
                return replace(failure, states=spent + tally.states)
        spent += tally.states
    return replace(failure, states=spent)


def pick_both(
    context: StepContext, state: CellState, requests: Sequence[PickRequest], seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan R_a to pick one group and R_b another one: R_a first, and if that fails, R_b first.

    Args:
        context: of the step.
        state: at the beginning; both hands are empty.
        requests: R_a's and R_b's.
        seed: of all draws.

    Returns:
        What was planned, or the failure of the usual order.
    """
    usual = _pick_in_order(context, state, requests, (0, 1), child_seed(seed, 0))
    if isinstance(usual, Planned) or usual.final:
        return usual
    swapped = _pick_in_order(context, state, requests, (1, 0), child_seed(seed, 1))
    total = usual.states + swapped.states
    return replace(swapped if isinstance(swapped, Planned) else usual, states=total)


def _pick_in_order(
    context: StepContext,
    state: CellState,
    requests: Sequence[PickRequest],
    order: tuple[int, int],
    seed: np.random.SeedSequence,
) -> Planned | Failure:
    done: Planned | Failure = Planned(state)
    for robot in order:
        if isinstance(done, Failure):
            break
        done = done.then(_pick_past_other(context, done.state, robot, requests[robot], child_seed(seed, robot)))
    return done


def _pick_past_other(
    context: StepContext, state: CellState, robot: int, request: PickRequest, seed: np.random.SeedSequence
) -> Planned | Failure:
    """Plan to pick a group; if that fails, the other robot drives elsewhere first, unless it holds something."""
    other, before, spent = 1 - robot, Planned(state), 0
    for attempt in range(_MAKE_WAY + 1):
        picked = before.then(pick(context, before.state, robot, request, child_seed(seed, 0, attempt)))
        spent += picked.states
        if isinstance(picked, Planned) or attempt == _MAKE_WAY or state.robots[other].payload is not None:
            return replace(picked, states=spent)
        tally = Tally()
        if not can_pick(context, state, robot, request, child_seed(seed, 1, attempt), tally):
            return replace(picked, final=True, states=spent + tally.states)
        world = context.world(state, other, tally)
        path = parking_path(context, world, state.robots[other].at, child_seed(seed, 2, attempt))
        if path is None:
            return Failure(FullVerdict.NO_PATH, Stage.MAKE_WAY, other, states=spent + tally.states)
        before = replace(Planned(state).move(Stage.MAKE_WAY, other, path), states=tally.states)
    raise AssertionError("the last attempt returns")


def _mate_and_place(
    context: StepContext,
    start: CellState,
    picked: Planned,
    stance: MateStance,
    grasp: MateGrasp,
    seed: np.random.SeedSequence,
) -> Planned | Failure:
    """Plan everything from the moment on at which both groups are in the hands."""
    spots: list[Float[np.ndarray, "2"]] = [placed.post.middle for placed in start.placed]
    done = picked.then(drive_and_mate(context, picked.state, stance, child_seed(seed, 0)))
    if isinstance(done, Planned):
        done = done.then(release(context, done.state, stance, grasp, child_seed(seed, 1)))
    if isinstance(done, Planned):
        done = done.then(place_on_post(context, done.state, spots, child_seed(seed, 2)))
    return done
