"""After the last merge, with robots: one of them takes the finished piece from its post and sets it on its feet.

The hand is chosen as for a merge: grasps that the rest of the piece leaves free, those first that an arm reaches easily
both at the post and on the floor. The segments are those of a merge, too: take, lift, carry, set down, back off, leave.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, turn_about_vertical
from roboassembly.robots.kinematics import Poses
from roboassembly.robots.reach import nearness
from roboassembly.task.full.grips import Grip
from roboassembly.task.full.pick import PickRequest, can_pick, pick
from roboassembly.task.full.place import put_down
from roboassembly.task.full.segments import ARM, LegError, SegmentPlanner
from roboassembly.task.full.task import BUDGET, FullTask
from roboassembly.task.object_centric.stance import NOT_ASSEMBLED, Stance, stance_of, standing_at
from roboassembly.task.plans.full_plan import FullPlan, FullUprightMotion
from roboassembly.task.plans.plan import UprightResult
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, center_of_mass

_STATES = 400_000
"""Configurations that may be tested before there is no way."""
_ATTEMPTS = 16
"""Grasps that are planned with, of those that pass the cheap tests."""
_SPOTS = 5
"""Places on the floor that are tried with each."""
_SPREAD = 0.5
"""Share of the ring's radius within which these places lie, but for the first one, the middle of the cell."""
_LEVER = 0.05
"""How much farther from easy reach counts a grasp a metre farther from the centre of mass."""


def plan_upright(plan: FullPlan) -> UprightResult[FullUprightMotion]:
    """How a robot sets the assembled piece on its feet on the floor. What is drawn depends on the plan's seed only.

    Args:
        plan: of a whole assembly, without its last motion.
    """
    begun = time.perf_counter()
    rng = np.random.default_rng([plan.seed, zlib.crc32(b"set upright")])
    planner = SegmentPlanner(plan.furniture, plan.initial.cell, plan.final_cell_state, BUDGET, rng)
    reason = _planned(planner)
    motion = None if reason else FullUprightMotion(tuple(planner.segments))
    return UprightResult(not reason, reason, motion, planner.states, time.perf_counter() - begun)


def _planned(planner: SegmentPlanner) -> str:
    """Plan all segments; why it cannot be, empty if it can."""
    furniture, start = planner.furniture, planner.reached
    group = planner.state.placed[0].group
    where = dict(zip(group.parts, group.part_poses(), strict=True))
    stance = stance_of(furniture, [where[p] for p in range(len(where))])
    if stance is None:
        return NOT_ASSEMBLED
    if stance.reason:
        return stance.reason
    attempts, failed = 0, "no hand reaches it both on its post and on the floor"
    for grip, robot in _hands(planner, group, _turned(furniture, group, stance, np.zeros(2))):
        if attempts == _ATTEMPTS or planner.states > _STATES:
            break
        wanted = PickRequest(group, grip, "piece")
        if not can_pick(planner, robot, wanted):
            continue
        attempts += 1
        try:
            pick(planner, robot, wanted)
            put_down(planner, robot, _on_floor(planner, group, stance), ARM)
        except LegError as no:
            failed = f"the robots found no way: {no}"
            planner.back_to(start)
        else:
            return ""
    return f"{failed} ({attempts} grasps tried)"


def _turned(furniture: Furniture, group: Group, stance: Stance, place: Float[np.ndarray, "2"]) -> Group:
    """The group as it stands on its feet, its centre of mass above a place of the floor."""
    # The stance is told in a frame of the furniture that may be another than the group's own, if it is symmetric.
    other_from_group = stance.group.world_from_furniture.actInv(group.world_from_furniture)
    return standing_at(furniture, group, stance.rotation @ other_from_group.rotation, place)


def _hands(planner: SegmentPlanner, group: Group, goal: Group) -> Iterator[tuple[Grip, int]]:
    """Grasps of the piece and the robot that takes it, the most promising first; the nearer robot before the other."""
    task = FullTask(planner.furniture)
    grips = [h for part in group.parts for g in range(GRASPS) if (h := task.free_grip(group, part, g)) is not None]
    if not grips:
        return
    far = np.maximum(*(_far(grips, g.world_from_furniture) for g in (group, goal)))
    center = center_of_mass(planner.furniture, group)
    lever = [float(np.linalg.norm(h.furniture_from_tips.translation - center)) for h in grips]
    post = planner.state.placed[0].post.top[:2]
    robots = sorted((0, 1), key=lambda r: float(np.linalg.norm(planner.state.robots[r].at[:2] - post)))
    for index in np.argsort(far + _LEVER * np.array(lever), kind="stable"):
        for robot in robots:
            yield grips[index], robot


def _far(grips: list[Grip], pose: SE3) -> Float[np.ndarray, "n"]:
    """How far each hand is from what an arm reaches in many ways, with the piece at a pose."""
    tips = [pose * grip.furniture_from_tips for grip in grips]
    return nearness(Poses(np.array([t.rotation for t in tips]), np.array([t.translation for t in tips])))


def _on_floor(planner: SegmentPlanner, group: Group, stance: Stance) -> Iterator[Group]:
    """Where the piece may stand: in the middle of the cell, then elsewhere, turned about the vertical at random."""
    for k in range(_SPOTS):
        place = planner.rng.uniform(-_SPREAD, _SPREAD, 2) * planner.cell.radius * (k > 0)
        turn = turn_about_vertical(planner.rng.uniform(-np.pi, np.pi) * (k > 0))
        yield _turned(planner.furniture, group, replace(stance, rotation=turn @ stance.rotation), place)
