"""After the last merge, with robots: one of them takes the finished piece from its post and sets it on its feet.

The hand is chosen as for a merge: grasps that the rest of the piece leaves free, those first that an arm reaches easily
both at the post and on the floor. The legs are those of a merge, too: take, lift, carry, set down, back off, leave.
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
from roboassembly.task.full.grips import Hold
from roboassembly.task.full.pick import Wanted, can_fetch, fetch
from roboassembly.task.full.place import put_down
from roboassembly.task.full.segments import ARM, LegError, Legs
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


def upright_legs(plan: FullPlan) -> UprightResult[FullUprightMotion]:
    """How a robot sets the assembled piece on its feet on the floor. What is drawn depends on the plan's seed only.

    Args:
        plan: of a whole assembly, without its last motion.
    """
    begun = time.perf_counter()
    rng = np.random.default_rng([plan.seed, zlib.crc32(b"set upright")])
    legs = Legs(plan.furniture, plan.initial.cell, plan.final_moment, BUDGET, rng)
    reason = _planned(legs)
    motion = None if reason else FullUprightMotion(tuple(legs.legs))
    return UprightResult(not reason, reason, motion, legs.states, time.perf_counter() - begun)


def _planned(legs: Legs) -> str:
    """Plan all legs; why it cannot be, empty if it can."""
    furniture, start = legs.furniture, legs.reached
    group = legs.moment.standing[0].group
    where = dict(zip(group.parts, group.part_poses(), strict=True))
    stance = stance_of(furniture, [where[p] for p in range(len(where))])
    if stance is None:
        return NOT_ASSEMBLED
    if stance.reason:
        return stance.reason
    attempts, failed = 0, "no hand reaches it both on its post and on the floor"
    for hold, robot in _hands(legs, group, _turned(furniture, group, stance, np.zeros(2))):
        if attempts == _ATTEMPTS or legs.states > _STATES:
            break
        wanted = Wanted(group, hold, "piece")
        if not can_fetch(legs, robot, wanted):
            continue
        attempts += 1
        try:
            fetch(legs, robot, wanted)
            put_down(legs, robot, _on_floor(legs, group, stance), ARM)
        except LegError as no:
            failed = f"the robots found no way: {no}"
            legs.back_to(start)
        else:
            return ""
    return f"{failed} ({attempts} grasps tried)"


def _turned(furniture: Furniture, group: Group, stance: Stance, place: Float[np.ndarray, "2"]) -> Group:
    """The group as it stands on its feet, its centre of mass above a place of the floor."""
    # The stance is told in a frame of the furniture that may be another than the group's own, if it is symmetric.
    other_from_group = stance.group.world_from_furniture.actInv(group.world_from_furniture)
    return standing_at(furniture, group, stance.rotation @ other_from_group.rotation, place)


def _hands(legs: Legs, group: Group, goal: Group) -> Iterator[tuple[Hold, int]]:
    """Grasps of the piece and the robot that takes it, the most promising first; the nearer robot before the other."""
    task = FullTask(legs.furniture)
    holds = [h for part in group.parts for g in range(GRASPS) if (h := task.taken(group, part, g)) is not None]
    if not holds:
        return
    far = np.maximum(*(_far(holds, g.world_from_furniture) for g in (group, goal)))
    center = center_of_mass(legs.furniture, group)
    lever = [float(np.linalg.norm(h.furniture_from_tips.translation - center)) for h in holds]
    post = legs.moment.standing[0].stand.top[:2]
    robots = sorted((0, 1), key=lambda r: float(np.linalg.norm(legs.moment.robots[r].at[:2] - post)))
    for index in np.argsort(far + _LEVER * np.array(lever), kind="stable"):
        for robot in robots:
            yield holds[index], robot


def _far(holds: list[Hold], pose: SE3) -> Float[np.ndarray, "n"]:
    """How far each hand is from what an arm reaches in many ways, with the piece at a pose."""
    tips = [pose * hold.furniture_from_tips for hold in holds]
    return nearness(Poses(np.array([t.rotation for t in tips]), np.array([t.translation for t in tips])))


def _on_floor(legs: Legs, group: Group, stance: Stance) -> Iterator[Group]:
    """Where the piece may stand: in the middle of the cell, then elsewhere, turned about the vertical at random."""
    for k in range(_SPOTS):
        place = legs.rng.uniform(-_SPREAD, _SPREAD, 2) * legs.cell.radius * (k > 0)
        turn = turn_about_vertical(legs.rng.uniform(-np.pi, np.pi) * (k > 0))
        yield _turned(legs.furniture, group, replace(stance, rotation=turn @ stance.rotation), place)
