"""Last motion of a full plan: a robot picks the finished piece from its post and sets it on its feet on the floor.

The grips are chosen as for a merge: those that the rest of the piece leaves free, and first those that an arm reaches
easily both at the post and on the floor. The stages are those of a step: pick, carry, set down, release, leave.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, rotations_and_translations, turn_about_vertical
from roboassembly.planning.robot_world import Tally
from roboassembly.robots.kinematics import Poses
from roboassembly.robots.reach import nearness
from roboassembly.task.full.cell_state import CellState, world_cache
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.pick import PickRequest, can_pick, pick
from roboassembly.task.full.place import put_down
from roboassembly.task.full.segments import ARM, Planned, StepContext, child_seed
from roboassembly.task.full.task import BUDGET, FullTask
from roboassembly.task.object_centric.stance import NOT_ASSEMBLED, Stance, stance_of, standing_at
from roboassembly.task.plans.full_plan import FullPlan, FullUprightMotion
from roboassembly.task.plans.plan import UprightResult
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, center_of_mass

_STATES = 400_000
"""Configurations that are tested before the planner gives up."""
_ATTEMPTS = 16
"""Grips that are planned with, of those that pass the cheap tests."""
_SPOTS = 5
"""Places on the floor that are tried with each grip."""
_SPOT_RANGE = 0.5
"""Share of the ring's radius within which these places lie, but for the first one, the middle of the cell."""
_LEVER = 0.05
"""Weight of a grip's distance from the centre of mass against its distance from easy reach."""


def plan_full_upright(plan: FullPlan) -> UprightResult[FullUprightMotion]:
    """Plan how a robot sets the assembled piece on its feet on the floor. The draws depend on the plan's seed only.

    Args:
        plan: of a whole assembly, without its last motion.
    """
    begun = time.perf_counter()
    context = StepContext(plan.furniture, plan.initial.cell, BUDGET, world_cache(plan.furniture))
    state = plan.final_cell_state
    seed = np.random.SeedSequence([plan.seed, zlib.crc32(b"set upright")])

    def result(reason: str, done: Planned | None, states: int) -> UprightResult[FullUprightMotion]:
        motion = None if done is None else FullUprightMotion(done.segments)
        return UprightResult(not reason, reason, motion, states, time.perf_counter() - begun)

    group = state.placed[0].group
    where = dict(zip(group.parts, group.part_poses(), strict=True))
    stance = stance_of(plan.furniture, [where[p] for p in range(len(where))])
    if stance is None or stance.reason:
        return result(NOT_ASSEMBLED if stance is None else stance.reason, None, 0)
    attempts, spent, tally = 0, 0, Tally()
    reason = "no hand reaches it both on its post and on the floor"
    for index, (grip, robot) in enumerate(_grips(context, state, group, stance)):
        if attempts >= _ATTEMPTS or spent + tally.states > _STATES:
            break
        request, drawn = PickRequest(group, grip), child_seed(seed, index)
        if not can_pick(context, state, robot, request, child_seed(drawn, 0), tally):
            continue
        attempts += 1
        done = pick(context, state, robot, request, child_seed(drawn, 1))
        if isinstance(done, Planned):
            places = _on_floor(context, group, stance, child_seed(drawn, 2))
            done = done.then(put_down(context, done.state, robot, places, ARM, child_seed(drawn, 3)))
        spent += done.states
        if isinstance(done, Planned):
            return result("", done, spent + tally.states)
        reason = f"the robots found no way: {done.stage_text}: {done.kind}"
    return result(f"{reason} ({attempts} grasps tried)", None, spent + tally.states)


def _turned(furniture: Furniture, group: Group, stance: Stance, place: Float[np.ndarray, "2"]) -> Group:
    """Return the group as it stands on its feet, its centre of mass above a place of the floor."""
    # If the furniture is symmetric, the stance's frame may differ from the group's.
    other_from_group = stance.group.world_from_furniture.actInv(group.world_from_furniture)
    return standing_at(furniture, group, stance.rotation @ other_from_group.rotation, place)


def _grips(context: StepContext, state: CellState, group: Group, stance: Stance) -> Iterator[tuple[Grip, int]]:
    """Yield grips on the piece and the robot that picks it: the most promising grip first, the nearer robot first."""
    task = FullTask(context.furniture)
    free = (task.free_grip(group, part, grasp) for part in group.parts for grasp in range(GRASPS))
    grips = [grip for grip in free if grip is not None]
    if not grips:
        return
    goal = _turned(context.furniture, group, stance, np.zeros(2))
    far = np.maximum(*(_difficulty(grips, pose) for pose in (group.world_from_furniture, goal.world_from_furniture)))
    center = center_of_mass(context.furniture, group)
    lever = [float(np.linalg.norm(grip.furniture_from_tips.translation - center)) for grip in grips]
    post = state.placed[0].post.middle
    robots = sorted((0, 1), key=lambda robot: float(np.linalg.norm(state.robots[robot].at[:2] - post)))
    for index in np.argsort(far + _LEVER * np.array(lever), kind="stable"):
        for robot in robots:
            yield grips[index], robot


def _difficulty(grips: list[Grip], pose: SE3) -> Float[np.ndarray, "n"]:
    """Return how far each hand is from what an arm reaches in many ways, with the piece at a pose."""
    tips = [pose * grip.furniture_from_tips for grip in grips]
    return nearness(Poses(*rotations_and_translations(tips)))


def _on_floor(context: StepContext, group: Group, stance: Stance, seed: np.random.SeedSequence) -> Iterator[Group]:
    """Yield poses of the piece on the floor: in the middle of the cell, then elsewhere, turned at random."""
    rng = np.random.default_rng(seed)
    for k in range(_SPOTS):
        place = rng.uniform(-_SPOT_RANGE, _SPOT_RANGE, 2) * context.cell.radius * (k > 0)
        turn = turn_about_vertical(rng.uniform(-np.pi, np.pi) * (k > 0))
        yield _turned(context.furniture, group, replace(stance, rotation=turn @ stance.rotation), place)
