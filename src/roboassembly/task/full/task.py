"""The full task: two mobile Frankas pick two groups, mate them, and set the merged group on a post.

Everything here is a pure function of state, action and seed; the environment and the solvers both call it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import ClassVar

import numpy as np
from jaxtyping import Bool

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.mating import distinct_directions
from roboassembly.geometry.poses import SE3
from roboassembly.planning.problem import Budget
from roboassembly.planning.robot_shapes import WorldCache
from roboassembly.planning.robot_world import Tally
from roboassembly.task.full.cell import check_size, initial_layout
from roboassembly.task.full.cell_state import CellState, PlacedGroup, Robot, Segment, world_cache
from roboassembly.task.full.failure import Failure, FullVerdict, Stage
from roboassembly.task.full.grips import (
    Grip,
    MateGrasp,
    Retract,
    can_grip,
    can_release,
    grip_fits_group,
    grip_of,
    retracts,
)
from roboassembly.task.full.mate import mate_stances
from roboassembly.task.full.pick import PickRequest, can_pick
from roboassembly.task.full.segments import TUCKED, Planned, StepContext
from roboassembly.task.full.step import plan_step
from roboassembly.task.part_frames import PartFrames
from roboassembly.task.plans.full_plan import FullState, FullStep
from roboassembly.task.rules.connections import FULL_BRANCHES, GRASPS, Rules
from roboassembly.task.rules.groups import Group, TaskState
from roboassembly.task.rules.pairs import Merge
from roboassembly.task.setting import SettingName

BUDGET = Budget(states=8_000)
"""Limit of each path."""
_CACHED_GRIPS = 20_000
_FROM_MIDDLE = 0.6
"""Distance of each robot from the middle of the cell at the beginning [m]."""
_End = tuple[int, int]
"""Part and point."""


@dataclass(frozen=True, eq=False)
class FullOutcome:
    """Result of a step."""

    failure: Failure | None
    """None if the groups were merged."""
    state: FullState
    """State after the step; the state before it unless merged."""
    step: FullStep | None
    """Record of the step; None unless merged."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float

    @property
    def verdict(self) -> FullVerdict:
        """Verdict on the step."""
        return FullVerdict.MERGED if self.failure is None else self.failure.kind

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Motion segments of the step; empty unless merged."""
        return () if self.step is None else self.step.segments


def initial_robots(rng: np.random.Generator) -> tuple[Robot, Robot]:
    """Return both robots in the middle of the ring, arms folded, turned at random."""
    a, b = (
        Robot(np.array([_FROM_MIDDLE * side, 0.0, rng.uniform(-np.pi, np.pi), *TUCKED]), 0.0) for side in (-1.0, 1.0)
    )
    return a, b


class FullTask:
    """The rules of the full setting for one piece of furniture."""

    setting: ClassVar[SettingName] = "full"
    action_branches = FULL_BRANCHES
    """Choices that an action has after its pair: `g_a` and `g_b`."""

    def __init__(self, furniture: Furniture, budget: Budget | None = None) -> None:
        self.furniture = furniture
        self.budget = budget or BUDGET
        self.rules = Rules(furniture)
        self._grips: dict[tuple[int, int, tuple[int, ...], bytes], Grip | None] = {}

    @cached_property
    def _worlds(self) -> WorldCache:
        return world_cache(self.furniture)

    def initial_state(self, rng: np.random.Generator) -> FullState:
        """All parts on posts, both robots in the middle of the ring.

        Raises:
            InputError: the furniture does not suit the cell, or hands cannot join a part to any other.
        """
        self.check_furniture()
        cell, groups, posts = initial_layout(self.furniture, rng)
        placed = tuple(PlacedGroup(group, post) for group, post in zip(groups, posts, strict=True))
        return FullState(TaskState(groups), CellState(placed, initial_robots(rng)), cell)

    def with_frames(self, frames: PartFrames) -> FullTask:
        """Return the task itself: no component of its actions names an axis."""
        return self

    def check_furniture(self) -> None:
        """Check that two robots can assemble the furniture at all.

        Raises:
            InputError: the furniture is too large for the cell, or no grippers can join one of its parts to another.
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
            if self.grips_failure(alone[u], alone[v], merge, grip_a, grip_b) is None:
                return True
        return False

    def exists(self, state: FullState, action: tuple[int, ...]) -> bool:
        """Whether the action names free points of two parts in different groups, and grasps that these parts have."""
        u, v, k, l, g_a, g_b = action  # noqa: E741
        if not self.rules.pair_exists(state.groups, u, v, k, l):
            return False
        return all(0 <= g < 4 * len(self.furniture.parts[p].grasps) for p, g in ((u, g_a), (v, g_b)))

    def existing_actions(
        self, groups: TaskState, max_parts: int = 0, max_points: int = 0
    ) -> Bool[np.ndarray, "P P K K 8 8"]:
        """Return the mask of actions that exist with some groups, `(u, v, k, l, g_a, g_b)`; see `Rules.free_points`."""
        pairs = self.rules.existing_pairs(groups, max_parts, max_points)
        grasps = np.zeros((len(pairs), GRASPS), bool)
        for index, part in enumerate(self.furniture.parts):
            grasps[index, : 4 * len(part.grasps)] = True
        both = grasps[:, None, :, None] & grasps[None, :, None, :]
        return pairs[..., None, None] & both[:, :, None, None]

    def groups_of(self, state: FullState) -> TaskState:
        """The groups of a state."""
        return state.groups

    def free_grips(self, state: TaskState, part: int) -> dict[int, Grip]:
        """Return the grips on a part that the rest of its group leaves free, by grasp."""
        group = state.groups[state.group_of[part]]
        grips = {grasp: self.free_grip(group, part, grasp) for grasp in range(GRASPS)}
        return {grasp: grip for grasp, grip in grips.items() if grip is not None}

    def free_grip(self, group: Group, part: int, grasp: int) -> Grip | None:
        """Return a grip on a part; None if the part has no such grasp or the rest of its group blocks it."""
        # Groups are looked at again and again while others change, and this depends on nothing else.
        key = (part, grasp, group.parts, b"".join(p.homogeneous.tobytes() for p in group.furniture_from_part))
        if key not in self._grips:
            if len(self._grips) >= _CACHED_GRIPS:
                self._grips.clear()
            grip = grip_of(self.furniture, group, part, grasp)
            self._grips[key] = grip if grip is not None and can_grip(self.furniture, group, grip) else None
        return self._grips[key]

    def merge(self, state: TaskState, pair: tuple[int, int, int, int]) -> Merge | None:
        """Return what the pair `(u, v, k, l)` makes; None if it is wrong."""
        u, v, k, l = pair  # noqa: E741
        return self.rules.pairs.judge_in(state, u, k, v, l)

    def step(self, state: FullState, action: tuple[int, ...], seed: int, budget: Budget | None = None) -> FullOutcome:
        """Carry out `(u, v, k, l, g_a, g_b)`: R_a picks u by grasp `g_a`, R_b picks v by grasp `g_b`, and they mate.

        Args:
            state: unchanged.
            action: any integers; those that name no action get the verdict `NOT_AN_ACTION`.
            seed: of all draws.
            budget: limit of each path, instead of the task's own.
        """
        begun = time.perf_counter()
        grasp = self.mate_grasp(state.groups, action) if self.exists(state, action) else _NO_ACTION
        result = grasp
        if isinstance(grasp, MateGrasp):
            result = plan_step(self._context(state, budget), state.cell_state, grasp, np.random.SeedSequence(seed))
        seconds = time.perf_counter() - begun
        if isinstance(result, Failure):
            return FullOutcome(result, state, None, result.states, seconds)
        assert isinstance(result, Planned)
        after = FullState(TaskState(tuple(p.group for p in result.state.placed)), result.state, state.cell)
        step = FullStep(action, result.segments, result.states, seconds)
        return FullOutcome(None, after, step, result.states, seconds)

    def mate_grasp(self, state: TaskState, action: tuple[int, ...]) -> MateGrasp | Failure:
        """Test an action that exists before any arm comes in: the pair, both grips, and both hands at the joint."""
        gripped = self._gripped(state, action)
        return gripped if isinstance(gripped, Failure) else self.check_grips(*gripped)

    def hands_merge(self, state: TaskState, action: tuple[int, ...]) -> Merge | Failure:
        """Return what an action makes of two groups, or the failure of `mate_grasp`; quicker, see `grips_failure`."""
        gripped = self._gripped(state, action)
        if isinstance(gripped, Failure):
            return gripped
        failure = self.grips_failure(*gripped)
        return gripped[2] if failure is None else failure

    def _gripped(self, state: TaskState, action: tuple[int, ...]) -> tuple[Group, Group, Merge, Grip, Grip] | Failure:
        """Return the groups of u and of v, what the pair makes of them, and both grips."""
        u, v, k, l, g_a, g_b = action  # noqa: E741
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = self.merge(state, (u, v, k, l))
        if merge is None:
            return Failure(FullVerdict.WRONG_PAIR)
        grip_a = self.free_grip(u_group, u, g_a)
        if grip_a is None:
            return Failure(FullVerdict.GRASP_BLOCKED, Stage.GRASP, 0)
        grip_b = self.free_grip(v_group, v, g_b)
        if grip_b is None:
            return Failure(FullVerdict.GRASP_BLOCKED, Stage.GRASP, 1)
        return u_group, v_group, merge, grip_a, grip_b

    def check_grips(
        self, u_group: Group, v_group: Group, merge: Merge, grip_a: Grip, grip_b: Grip
    ) -> MateGrasp | Failure:
        """Test both hands at the joint of a right pair, for grips that their groups leave free."""
        ways_out = self._ways_out(u_group, v_group, merge, grip_a, grip_b)
        if isinstance(ways_out, Failure):
            return ways_out
        longest_first = tuple(sorted(ways_out, key=lambda r: -r.usable_length))
        return MateGrasp(merge, u_group, v_group, grip_a, grip_b, longest_first)

    def grips_failure(self, u_group: Group, v_group: Group, merge: Merge, grip_a: Grip, grip_b: Grip) -> Failure | None:
        """Return the failure of `check_grips`; None if it succeeds. Looks for one way out of the joint, not for all."""
        ways_out = self._ways_out(u_group, v_group, merge, grip_a, grip_b)
        return ways_out if isinstance(ways_out, Failure) else None

    def _ways_out(
        self, u_group: Group, v_group: Group, merge: Merge, grip_a: Grip, grip_b: Grip
    ) -> Iterator[Retract] | Failure:
        """Return the ways out of a joint, all but the first still to be looked for."""
        ways_out = self._retracts(u_group, v_group, merge, grip_a, grip_b)
        first = next(ways_out, None)
        if first is None:
            return Failure(FullVerdict.JOINT_BLOCKED, Stage.MATE)
        in_a, in_b = grip_a.moved(merge.furniture_from_u), grip_b.moved(merge.furniture_from_v)
        if not can_release(self.furniture, merge.merged, in_a, in_b.hand(grip_b.closed)):
            return Failure(FullVerdict.CANNOT_RELEASE, Stage.RELEASE, 0)
        if not can_release(self.furniture, merge.merged, in_b):
            return Failure(FullVerdict.CANNOT_RELEASE, Stage.RELEASE, 1)
        return chain((first,), ways_out)

    def grip_has_room(self, u_group: Group, v_group: Group, merge: Merge, grip: Grip, robot: int) -> bool:
        """Whether one hand touches nothing of the other hand's group at the joint: the cheapest part of `grip_fits`.

        Arguments as of `grip_fits`.
        """
        own, other, group = merge.furniture_from_u, merge.furniture_from_v, v_group
        if robot == 1:
            own, other, group = other, own, u_group
        return grip_fits_group(self.furniture, group.moved_to(other), grip.moved(own))

    def grip_fits(self, u_group: Group, v_group: Group, merge: Merge, grip: Grip, robot: int) -> bool:
        """Whether one hand suits a joint as long as the other hand is not there: what `check_grips` needs of each.

        Args:
            u_group: group of u.
            v_group: group of v.
            merge: of both.
            grip: of the hand on its group.
            robot: 0 if it is R_a's and holds u's group, else 1.
        """
        grips = (grip, None) if robot == 0 else (None, grip)
        if next(self._retracts(u_group, v_group, merge, *grips), None) is None:
            return False
        merged_from_own = merge.furniture_from_u if robot == 0 else merge.furniture_from_v
        return can_release(self.furniture, merge.merged, grip.moved(merged_from_own))

    def separates(self, u_group: Group, v_group: Group, merge: Merge) -> bool:
        """Whether two groups come straight out of their joint as long as no hand holds them."""
        return next(self._retracts(u_group, v_group, merge, None, None), None) is not None

    def can_pick(self, state: FullState, part: int, grip: Grip, robot: int, seed: int) -> bool:
        """Whether a robot can pick the group of a part, wherever it comes from.

        Args:
            state: unchanged.
            part: part that the hand holds.
            grip: one of `free_grips`.
            robot: 0 or 1.
            seed: of all draws.
        """
        group = next(p.group for p in state.cell_state.placed if part in p.group.parts)
        request, drawn = PickRequest(group, grip), np.random.SeedSequence(seed)
        return can_pick(self._context(state), state.cell_state, robot, request, drawn, Tally())

    def can_mate(self, state: FullState, grasp: MateGrasp, seed: int) -> bool:
        """Whether both arms reach the joint in some pose of it, and R_a comes straight out."""
        stances = mate_stances(
            self._context(state), state.cell_state, grasp, np.random.SeedSequence(seed), Tally()
        )  # fmt: skip
        return next(stances, None) is not None

    def _context(self, state: FullState, budget: Budget | None = None) -> StepContext:
        return StepContext(self.furniture, state.cell, budget or self.budget, self._worlds)

    def _retracts(
        self, u_group: Group, v_group: Group, merge: Merge, grip_a: Grip | None, grip_b: Grip | None
    ) -> Iterator[Retract]:
        u_placed, v_placed = u_group.moved_to(merge.furniture_from_u), v_group.moved_to(merge.furniture_from_v)
        directions = distinct_directions(self.rules.retreats(u_group, v_group, merge.merged, np.eye(3)))
        return retracts(self.furniture, u_placed, v_placed, grip_a, grip_b, directions)


_NO_ACTION = Failure(FullVerdict.NOT_AN_ACTION)
