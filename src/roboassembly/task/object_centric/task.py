"""The object-centric task: v's group waits in a chosen pose, u's group comes along a path, they mate and settle.

Everything here is a pure function of state, action and seed; the environment and the solvers both call it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, align_axis
from roboassembly.geometry.scene import Scene
from roboassembly.planning.mating import MatingProblem, plan_mating
from roboassembly.planning.problem import Budget, PathResult
from roboassembly.planning.world import CollisionWorld
from roboassembly.task.layout import GROUND_CLEARANCE, free_spot, scatter_parts
from roboassembly.task.object_centric.settling import settle_group
from roboassembly.task.part_frames import PartFrames
from roboassembly.task.plans.plan import PlanStep
from roboassembly.task.rules.connections import OBJECT_CENTRIC_BRANCHES, UP_AXES, Rules
from roboassembly.task.rules.groups import (
    Circle,
    Group,
    TaskState,
    body,
    center_of_mass,
    footprint,
    group_footprint,
    hull_points,
)
from roboassembly.task.rules.pairs import Merge, PairRule
from roboassembly.task.setting import SettingName


class ObjectCentricVerdict(StrEnum):
    """Verdict on an object-centric step. Everything but `MERGED` ends the episode."""

    MERGED = "merged"
    NOT_AN_ACTION = "not_an_action"
    """A part or point does not exist, a point is not free, or both parts are in one group: masked out."""
    WRONG_PAIR = "wrong_pair"
    START_IN_COLLISION = "start_in_collision"
    GOAL_IN_COLLISION = "goal_in_collision"
    """U's group at its mating pose collides with the ground, v's group or another group."""
    UNREACHABLE = "unreachable"
    BUDGET_EXHAUSTED = "budget_exhausted"


@dataclass(frozen=True, eq=False)
class ObjectCentricOutcome:
    """Result of a step."""

    verdict: ObjectCentricVerdict
    state: TaskState
    """State after the step; the state before it unless merged."""
    step: PlanStep | None
    """Record of the step; None unless merged."""
    planning_steps: int
    planning_seconds: float
    failure: None = None
    """There are no robots that could fail."""


@dataclass(frozen=True, eq=False)
class Mating:
    """Right pair set up for planning: the moving group, the waiting group and all others."""

    merge: Merge
    u_group: Group
    v_group: Group
    """V's group at its waiting pose."""
    u_goal: Group
    """U's group at its mating pose."""
    merged: Group
    """Merged group before it settles."""
    others: tuple[Group, ...]


class ObjectCentricTask:
    """Task of the object-centric setting for one piece of furniture."""

    setting: ClassVar[SettingName] = "object-centric"
    action_branches = OBJECT_CENTRIC_BRANCHES
    """Number of values of `w`, the component of an action after its pair."""

    def __init__(self, furniture: Furniture, budget: Budget | None = None) -> None:
        self.furniture = furniture
        self.budget = budget or Budget()
        self.rules = Rules(furniture)
        self.frames = PartFrames.aligned(furniture)
        """Frames in which parts are described; they say what `w` names."""
        self._footprints: WeakKeyDictionary[Group, Circle] = WeakKeyDictionary()

    def with_frames(self, frames: PartFrames) -> ObjectCentricTask:
        """Return the same task with parts described in other frames."""
        other = copy(self)
        other.frames = frames
        return other

    @property
    def pairs(self) -> PairRule:
        """Rule that judges whether a pair is right."""
        return self.rules.pairs

    def footprint(self, group: Group) -> Circle:
        """Return the circle that a group covers where it is. Results are cached: most groups stay as they are."""
        if group not in self._footprints:
            self._footprints[group] = group_footprint(self.furniture, group)
        return self._footprints[group]

    def check_furniture(self) -> None:
        """Accept the furniture: parts that move by themselves need no cell and no grasps."""

    def initial_state(self, rng: np.random.Generator) -> TaskState:
        """Return a state with every part alone, at random on the ground."""
        return scatter_parts(self.furniture, rng)

    def groups_of(self, state: TaskState) -> TaskState:
        """Return the groups of a state, which is the state itself."""
        return state

    def free_points(self, state: TaskState, max_parts: int = 0, max_points: int = 0) -> Bool[np.ndarray, "P K"]:
        """Return the mask of connection points that exist and touch nothing yet; see `Rules.free_points`."""
        return self.rules.free_points(state, max_parts, max_points)

    def exists(self, state: TaskState, action: tuple[int, ...]) -> bool:
        """Whether the action names free points of two parts in different groups."""
        *pair, w = action
        return 0 <= w < len(UP_AXES) and self.rules.pair_exists(state, *pair)

    def existing_actions(
        self, groups: TaskState, max_parts: int = 0, max_points: int = 0
    ) -> Bool[np.ndarray, "P P K K 6"]:
        """Return the mask of actions that exist with some groups, `(u, v, k, l, w)`; see `Rules.free_points`."""
        pairs = self.rules.existing_pairs(groups, max_parts, max_points)
        return np.repeat(pairs[..., None], len(UP_AXES), axis=-1)

    def step(
        self,
        state: TaskState,
        action: tuple[int, ...],
        seed: int,
        budget: Budget | None = None,
        exit_motions: Sequence[SE3] = (),
    ) -> ObjectCentricOutcome:
        """Carry out `(u, v, k, l, w)`.

        Args:
            state: unchanged.
            action: any integers; those that name no action get the verdict `NOT_AN_ACTION`.
            seed: of the planner.
            budget: of the planner, instead of the task's own.
            exit_motions: successive motions of u's group, in the furniture's frame, along which it may leave v's group;
                a hint to the planner.
        """
        if not self.exists(state, action):
            return ObjectCentricOutcome(ObjectCentricVerdict.NOT_AN_ACTION, state, None, 0, 0.0)
        mating = self.prepare(state, action)
        if mating is None:
            return ObjectCentricOutcome(ObjectCentricVerdict.WRONG_PAIR, state, None, 0, 0.0)
        result = self.plan(mating, seed, budget, exit_motions)
        if not result.solved:
            return ObjectCentricOutcome(
                ObjectCentricVerdict(result.status.value), state, None, result.states, result.seconds
            )
        return self._apply(state, action, mating, result)

    def prepare(self, state: TaskState, action: tuple[int, ...]) -> Mating | None:
        """Return the mating that an action asks for; None if the pair is wrong."""
        u, v, k, l, w = action  # noqa: E741
        u_group, v_group = state.groups[state.group_of[u]], state.groups[state.group_of[v]]
        merge = self.pairs.judge_in(state, u, k, v, l)
        if merge is None:
            return None
        others = state.others(u, v)
        obstacles = [self.footprint(g) for g in (u_group, *others)]
        world = self._waiting_pose(v_group, merge, self._up_axis(v_group, v, merge, w), obstacles)
        return Mating(
            merge,
            u_group,
            v_group.moved_to(world * merge.furniture_from_v),
            u_group.moved_to(world * merge.furniture_from_u),
            merge.merged.moved_to(world),
            others,
        )

    def _up_axis(self, v_group: Group, v: int, merge: Merge, w: int) -> Float[np.ndarray, "3"]:
        """Return the axis that `w` names, in the furniture's frame of the merged group."""
        if self.frames.name == "aligned":
            return UP_AXES[w]
        frame_of_v = v_group.furniture_from_part[v_group.parts.index(v)]
        return merge.furniture_from_v.rotation @ frame_of_v.rotation @ self.frames.up_axis(v, w)

    def _waiting_pose(self, v_group: Group, merge: Merge, up: Float[np.ndarray, "3"], obstacles: list[Circle]) -> SE3:
        """Return `world_from_furniture` of the merged group: v's group on the ground, axis `up` up, space for both."""
        now = v_group.world_from_furniture * merge.furniture_from_v.inverse()
        turn = align_axis(now.rotation @ up, np.array([0.0, 0.0, 1.0])) @ now.rotation
        own = hull_points(self.furniture, v_group)
        here = self.footprint(v_group).center
        v_turn = turn @ merge.furniture_from_v.rotation
        v_shift = turn @ merge.furniture_from_v.translation
        waiting = own @ v_turn.T + v_shift
        lift = GROUND_CLEARANCE - waiting[:, 2].min()
        whole = footprint(hull_points(self.furniture, merge.merged) @ turn.T)
        offset = footprint(waiting).center - whole.center
        spot = free_spot(Circle(here - offset, whole.radius), obstacles)
        return SE3(turn, np.array([*(spot - whole.center), lift]))

    def plan(
        self, mating: Mating, seed: int, budget: Budget | None = None, exit_motions: Sequence[SE3] = ()
    ) -> PathResult:
        """Plan the path of u's group, for the frame at its centre of mass; see `step`."""
        scene, axes, problem = self.planning_problem(mating)
        world = mating.merged.world_from_furniture
        out = tuple(world * motion * world.actInv(problem.goal) for motion in exit_motions)
        problem = replace(problem, exit=out)
        return plan_mating(CollisionWorld(scene, box_axes=axes), problem, budget or self.budget, seed)

    def planning_problem(self, mating: Mating) -> tuple[Scene, Float[np.ndarray, "3 3"], MatingProblem]:
        """Return what `plan` passes to the planner: the scene, the axes of bounding boxes, and the problem."""
        origin = center_of_mass(self.furniture, mating.u_group)
        mover = body(self.furniture, mating.u_group, "moving", origin=origin, moves=True)
        still = [body(self.furniture, mating.v_group, "waiting")]
        still += [body(self.furniture, g, f"other{i}") for i, g in enumerate(mating.others)]
        turn = mating.merged.world_from_furniture.rotation
        shift = SE3(np.eye(3), origin)
        problem = MatingProblem(
            start=mover.pose,
            goal=mating.u_goal.world_from_furniture * shift,
            partner="waiting",
            retreats=tuple(turn @ d for d in self.rules.retreats(mating.u_group, mating.v_group, mating.merged, turn)),
        )
        return Scene((mover, *still)), turn, problem

    def _apply(
        self, state: TaskState, action: tuple[int, ...], mating: Mating, result: PathResult
    ) -> ObjectCentricOutcome:
        others = [self.footprint(g) for g in mating.others]
        motions, rested = settle_group(self.furniture, mating.merged, others)
        after = TaskState((*mating.others, rested))
        still = {
            p: pose for g in (mating.v_group, *mating.others) for p, pose in zip(g.parts, g.part_poses(), strict=True)
        }
        origin = SE3(np.eye(3), center_of_mass(self.furniture, mating.u_group))
        step = PlanStep(
            action=action,
            moving={
                p: origin.actInv(pose)
                for p, pose in zip(mating.u_group.parts, mating.u_group.furniture_from_part, strict=True)
            },
            waiting=mating.v_group.parts,
            still=still,
            path=result.path,
            settling=motions,
            after=after.part_poses,
            planning_steps=result.states,
            planner=result.planner,
            planning_seconds=result.seconds,
        )
        return ObjectCentricOutcome(ObjectCentricVerdict.MERGED, after, step, result.states, result.seconds)
