"""The full step: two mobile Frankas take two groups, join them, and set the whole on a post.

Everything here is a pure function of state, action and seed; the environment and the solvers both call it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from itertools import chain, islice
from typing import ClassVar

import numpy as np
from jaxtyping import Bool

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.task.full.cell import check_size, initial_layout
from roboassembly.task.full.cell_state import CellState, PlacedGroup, Robot, Segment
from roboassembly.task.full.grips import Grip, Retract, can_grip, can_release, grip_fits_group, grip_of, retracts
from roboassembly.task.full.mate import MateStance, join, mate_stances, release
from roboassembly.task.full.pick import PickRequest, can_pick, pick_both
from roboassembly.task.full.place import set_down
from roboassembly.task.full.segments import TUCKED, LegError, Obstacle, SegmentPlanner
from roboassembly.task.plans.full_plan import FullState, FullStep
from roboassembly.task.rules.connections import GRASPS, Rules
from roboassembly.task.rules.groups import Group, TaskState
from roboassembly.task.rules.pairs import Merge
from roboassembly.task.setting import SettingName

BUDGET = Budget(states=8_000)
"""Of each path."""
_MEETINGS = 6
"""Meetings that are driven to, and gone on from, before giving up."""
_GOES = 2
"""Times that it is planned from the start, all drawn anew: from some places nothing gets anywhere."""
_REMEMBERED = 20_000
"""Hands at groups."""
_APART = 0.6
"""Metres of each robot from the middle at the beginning."""


class FullVerdict(StrEnum):
    """How a step ended. Everything but `MERGED` ends the episode."""

    MERGED = "merged"
    NOT_AN_ACTION = "not_an_action"
    """A part, point or grasp that is not there, a point that is not free, or two parts of one group: masked out."""
    WRONG_PAIR = "wrong_pair"
    GRASP_BLOCKED = "grasp_blocked"
    """The hand cannot come to the part past the rest of its group."""
    JOINT_BLOCKED = "joint_blocked"
    """The groups or the hands are in each other's way at the joint, or on every straight way into it."""
    CANNOT_RELEASE = "cannot_release"
    """The hand of R_a, or of R_b once the other is gone, could not leave the merged group."""
    NO_ARM_SOLUTION = "no_arm_solution"
    NO_PATH = "no_path"
    NO_PLACEMENT = "no_placement"


@dataclass(frozen=True, eq=False)
class FullOutcome:
    """What a step led to."""

    verdict: FullVerdict
    segment: str
    """In which it failed; empty if it did not."""
    state: FullState
    """The new one; the old one unless merged."""
    step: FullStep | None
    """The record, if merged."""
    segments: tuple[Segment, ...]
    """As far as they were planned."""
    planning_steps: int
    planning_seconds: float


@dataclass(frozen=True, eq=False)
class MateGrasp:
    """A right pair and two grasps that pass all tests before any arm comes in."""

    merge: Merge
    u: Group
    """In its own frame."""
    v: Group
    grip_a: Grip
    """Of u's group, in its own frame."""
    grip_b: Grip
    retracts: tuple[Retract, ...]
    """Straight out of the joint."""

    @property
    def merged_grips(self) -> tuple[Grip, Grip]:
        """Both holds, in the merged group's frame."""
        return self.grip_a.moved(self.merge.furniture_from_u), self.grip_b.moved(self.merge.furniture_from_v)


class FullTask:
    """The rules of the full setting for one piece of furniture."""

    setting: ClassVar[SettingName] = "full"
    action_branches = (GRASPS, GRASPS)
    """Choices that an action has after its pair: `g_a` and `g_b`."""

    def __init__(self, furniture: Furniture, budget: Budget | None = None) -> None:
        self.furniture = furniture
        self.budget = budget or BUDGET
        self.rules = Rules(furniture)
        self._grips: dict[tuple[int, int, tuple[int, ...], bytes], Grip | None] = {}

    def initial_state(self, rng: np.random.Generator) -> FullState:
        """All parts on posts, both robots in the middle of the ring.

        Raises:
            InputError: the furniture does not suit the cell, or hands cannot join a part to any other.
        """
        self.check_graspable()
        cell, groups, stands = initial_layout(self.furniture, rng)
        a, b = (Robot(np.array([_APART * side, 0.0, rng.uniform(-np.pi, np.pi), *TUCKED]), 0.0) for side in (-1.0, 1.0))
        standing = tuple(PlacedGroup(g, s) for g, s in zip(groups, stands, strict=True))
        return FullState(TaskState(groups), CellState(standing, (a, b)), cell)

    def check_graspable(self) -> None:
        """Refuse furniture that two robots cannot assemble, whatever else they do.

        Raises:
            InputError: it is too large for the cell, no hand can hold a part, or hands cannot join it to any other.
        """
        check_size(self.furniture)
        if self.unjoinable is not None:
            raise InputError(
                f"{self.furniture.name}: no hand can hold part '{self.furniture.parts[self.unjoinable].name}' where it "
                "is joined to another part; two opposite sides must stay free there"
            )

    @cached_property
    def unjoinable(self) -> int | None:
        """A part that two hands cannot join to any of its neighbours, even with nothing else around; None if there is
        none. With more around it they cannot either, so that nobody needs to try."""
        alone = tuple(Group((i,), (i,), (pose,), SE3.Identity()) for i, pose in enumerate(self.furniture.assembled))
        joined: set[int] = set()
        for c in self.furniture.connections:
            if {c.part_a, c.part_b} <= joined:
                continue
            a, b = (c.part_a, c.point_a), (c.part_b, c.point_b)
            if self._hands_join(alone, a, b) or self._hands_join(alone, b, a):
                joined |= {c.part_a, c.part_b}
        return next((p for p in range(len(alone)) if p not in joined), None)

    def _hands_join(self, alone: Sequence[Group], a: _End, b: _End) -> bool:
        (u, k), (v, m) = a, b
        merge = self.rules.pairs.judge(alone[u], alone[v], u, k, v, m)
        if merge is None:
            return False
        # In an order that tries unlike grasps early.
        for index in np.random.default_rng(0).permutation(GRASPS**2).tolist():
            grip_a, grip_b = self.free_grip(alone[u], u, index // GRASPS), self.free_grip(alone[v], v, index % GRASPS)
            if grip_a is None or grip_b is None:
                continue
            if isinstance(self.check_grips(alone[u], alone[v], merge, grip_a, grip_b), MateGrasp):
                return True
        return False

    def exists(self, state: FullState, action: tuple[int, ...]) -> bool:
        """Whether the action names free points of two parts in different groups, and grasps that these parts have."""
        u, v, k, l, g_a, g_b = action  # noqa: E741
        if not self.rules.pair_exists(state.groups, u, v, k, l):
            return False
        return all(0 <= g < 4 * len(self.furniture.parts[p].grasps) for p, g in ((u, g_a), (v, g_b)))

    def existing_actions(
        self, state: FullState, max_parts: int = MAX_PARTS, max_points: int = MAX_POINTS
    ) -> Bool[np.ndarray, "P P K K 8 8"]:
        """Return the mask of actions that exist in a state, indexed by `(u, v, k, l, g_a, g_b)`."""
        pairs = self.rules.existing_pairs(state.groups, max_parts, max_points)
        grasps = np.zeros((max_parts, GRASPS), bool)
        for index, part in enumerate(self.furniture.parts):
            grasps[index, : 4 * len(part.grasps)] = True
        both = grasps[:, None, :, None] & grasps[None, :, None, :]
        return pairs[..., None, None] & both[:, :, None, None]

    def groups_of(self, state: FullState) -> TaskState:
        """The groups of a state."""
        return state.groups

    def free_grips(self, state: TaskState, part: int) -> dict[int, Grip]:
        """Grasps of a part that the rest of its group leaves free, and how the hand holds it then."""
        group = state.groups[state.group_of[part]]
        grips = [(g, self.free_grip(group, part, g)) for g in range(GRASPS)]
        return {g: held for g, held in grips if held is not None}

    def free_grip(self, group: Group, part: int, grasp: int) -> Grip | None:
        """How a hand takes a part; None if the part has no such grasp or the rest of its group is in the way."""
        # Groups are looked at again and again while others change, and this depends on nothing else.
        key = (part, grasp, group.parts, b"".join(p.homogeneous.tobytes() for p in group.furniture_from_part))
        if key not in self._grips:
            if len(self._grips) >= _REMEMBERED:
                self._grips.clear()
            held = grip_of(self.furniture, group, part, grasp)
            self._grips[key] = held if held is not None and can_grip(self.furniture, group, held) else None
        return self._grips[key]

    def merge(self, state: TaskState, pair: tuple[int, int, int, int]) -> Merge | None:
        """What the pair `(u, v, k, l)` makes; None if it is wrong."""
        u, v, k, l = pair  # noqa: E741
        return self.rules.pairs.judge(state.groups[state.group_of[u]], state.groups[state.group_of[v]], u, k, v, l)

    def step(self, state: FullState, action: tuple[int, ...], seed: int, budget: Budget | None = None) -> FullOutcome:
        """Carry out `(u, v, k, l, g_a, g_b)`: R_a takes u by grasp `g_a`, R_b takes v by grasp `g_b`.

        Args:
            state: unchanged.
            action: any integers; those that name no action get the verdict `NOT_AN_ACTION`.
            seed: of all that is drawn.
            budget: of each path, instead of the task's own.
        """
        begun = time.perf_counter()
        planner = self._planner(state, seed, budget)

        def failed(verdict: FullVerdict, segment: str) -> FullOutcome:
            seconds = time.perf_counter() - begun
            return FullOutcome(verdict, segment, state, None, tuple(planner.segments), planner.states, seconds)

        if not self.exists(state, action):
            return failed(FullVerdict.NOT_AN_ACTION, "")
        joint = self.mate_grasp(state.groups, action)
        if isinstance(joint, Refusal):
            return failed(joint.verdict, joint.segment)
        try:
            after = self._carry_out(planner, state, joint)
        except LegError as no:
            return failed(FullVerdict(no.why.value), no.segment)
        seconds = time.perf_counter() - begun
        step = FullStep(action, tuple(planner.segments), planner.states, seconds)
        return FullOutcome(FullVerdict.MERGED, "", after, step, step.segments, step.planning_steps, seconds)

    def mate_grasp(self, state: TaskState, action: tuple[int, ...]) -> MateGrasp | Refusal:
        """The cheap tests of an action that exists: pair, hands at their grasps, both at the joint."""
        u, v, k, l, g_a, g_b = action  # noqa: E741
        one, two = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = self.merge(state, (u, v, k, l))
        if merge is None:
            return Refusal(FullVerdict.WRONG_PAIR, "")
        grip_a = self.free_grip(one, u, g_a)
        if grip_a is None:
            return Refusal(FullVerdict.GRASP_BLOCKED, "grasp u")
        grip_b = self.free_grip(two, v, g_b)
        if grip_b is None:
            return Refusal(FullVerdict.GRASP_BLOCKED, "grasp v")
        return self.check_grips(one, two, merge, grip_a, grip_b)

    def can_pick(self, state: FullState, part: int, held: Grip, robot: int, seed: int) -> bool:
        """Whether a robot can take the group of a part and lift it from its post, wherever it comes from.

        Args:
            state: unchanged.
            part: that is held.
            held: how, of `free_holds`.
            robot: 0 or 1.
            seed: of what is drawn.
        """
        group = next(s.group for s in state.cell_state.placed if part in s.group.parts)
        return can_pick(self._planner(state, seed), robot, PickRequest(group, held, ""))

    def can_mate(self, state: FullState, joint: MateGrasp, seed: int) -> bool:
        """Whether both arms reach the joint in some pose of it, and R_a comes straight out."""
        return next(_meetings(self._planner(state, seed), joint), None) is not None

    def _planner(self, state: FullState, seed: int, budget: Budget | None = None) -> SegmentPlanner:
        rng = np.random.default_rng(seed)
        return SegmentPlanner(self.furniture, state.cell, state.cell_state, budget or self.budget, rng)

    def grip_has_room(self, one: Group, two: Group, merge: Merge, held: Grip, robot: int) -> bool:
        """Whether one hand meets nothing of the group that it does not hold, where both are joined: the part of
        `fits_alone` that costs least. Arguments as there."""
        own, other, placed = merge.furniture_from_u, merge.furniture_from_v, two
        if robot == 1:
            own, other, placed = other, own, one
        return grip_fits_group(self.furniture, placed.moved_to(other), held.moved(own))

    def separates(self, one: Group, two: Group, merge: Merge) -> bool:
        """Whether two groups come straight out of their joint as long as no hand holds them. Arguments as of
        `fits_alone`."""
        return next(self._ways(one, two, merge, None, None), None) is not None

    def grip_fits(self, one: Group, two: Group, merge: Merge, held: Grip, robot: int) -> bool:
        """Whether one hand suits a joint as long as the other is not there: what `fitted` needs of each.

        Args:
            one: u's group.
            two: v's group.
            merge: of them.
            held: how the hand holds its group.
            robot: 0 if it is R_a's and holds u's group, else 1.
        """
        hands = (held, None) if robot == 0 else (None, held)
        if next(self._ways(one, two, merge, *hands), None) is None:
            return False
        merged_from_own = merge.furniture_from_u if robot == 0 else merge.furniture_from_v
        return can_release(self.furniture, merge.merged, held.moved(merged_from_own))

    def _ways(
        self, one: Group, two: Group, merge: Merge, grip_a: Grip | None, grip_b: Grip | None
    ) -> Iterator[Retract]:
        u_placed, v_placed = one.moved_to(merge.furniture_from_u), two.moved_to(merge.furniture_from_v)
        directions = distinct_directions(self.rules.retreats(one, two, merge.merged, np.eye(3)))
        return retracts(self.furniture, u_placed, v_placed, grip_a, grip_b, directions)

    def check_grips(self, one: Group, two: Group, merge: Merge, grip_a: Grip, grip_b: Grip) -> MateGrasp | Refusal:
        """Of the cheap tests those at the joint, for a right pair and hands that can take their groups."""
        ways = sorted(self._ways(one, two, merge, grip_a, grip_b), key=lambda way: -way.usable_length)
        if not ways:
            return Refusal(FullVerdict.JOINT_BLOCKED, "mate")
        in_b = grip_b.moved(merge.furniture_from_v)
        if not can_release(
            self.furniture, merge.merged, grip_a.moved(merge.furniture_from_u), in_b.hand(grip_b.closed)
        ):
            return Refusal(FullVerdict.CANNOT_RELEASE, "back off from u")
        if not can_release(self.furniture, merge.merged, in_b):
            return Refusal(FullVerdict.CANNOT_RELEASE, "back off")
        return MateGrasp(merge, one, two, grip_a, grip_b, tuple(ways))

    def _carry_out(self, planner: SegmentPlanner, state: FullState, joint: MateGrasp) -> FullState:
        places = [s.post.top[:2] for s in state.cell_state.placed]
        wanted = PickRequest(joint.u, joint.grip_a, "u"), PickRequest(joint.v, joint.grip_b, "v")
        start = planner.reached
        failed = LegError(Obstacle.NO_ARM_SOLUTION, "mate")
        for _ in range(_GOES):
            planner.back_to(start)
            some = _meetings(planner, joint)
            # Whether they can meet at all is found out before anything moves.
            first = next(some, None)
            if first is None:
                break
            pick_both(planner, wanted)
            for meeting in islice(chain([first], some), _MEETINGS):
                try:
                    if meeting is not first:
                        # With something long in its hand an arm does not get from any posture to any other: they take
                        # them again, with the arms rather as they will be.
                        planner.back_to(start)
                        arms = meeting.out[-1], meeting.b
                        pick_both(planner, [replace(w, like=arm) for w, arm in zip(wanted, arms, strict=True)])
                    join(planner, meeting)
                    release(planner, meeting, joint.merge.merged, *joint.merged_grips)
                    set_down(planner, places)
                    groups = TaskState(tuple(s.group for s in planner.state.placed))
                    return FullState(groups, planner.state, state.cell)
                except LegError as no:
                    # From here R_a does not get away, or R_b, from elsewhere they may.
                    failed = no
                    if no.final:
                        raise
        raise failed


@dataclass(frozen=True)
class Refusal:
    """What an action fails by before any arm comes in."""

    verdict: FullVerdict
    segment: str


_End = tuple[int, int]
"""Part and point."""


def _meetings(planner: SegmentPlanner, joint: MateGrasp) -> Iterator[MateStance]:
    """Of both groups at the joint."""
    merge = joint.merge
    u, v = _reframed(joint.u, merge.furniture_from_u), _reframed(joint.v, merge.furniture_from_v)
    return mate_stances(planner, *joint.merged_grips, u, v, joint.retracts, merge.merged)


def _reframed(group: Group, by: SE3) -> Group:
    """The same group told in the frame of the merged one."""
    return replace(group, furniture_from_part=tuple(by * p for p in group.furniture_from_part))
