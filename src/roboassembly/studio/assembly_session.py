"""Assembly of one piece by hand, by a policy or by the search. It knows no browser."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32

from roboassembly.envs.assembly import COMPLETION_REWARD, MERGE_REWARD
from roboassembly.envs.observation import Observer
from roboassembly.errors import InputError
from roboassembly.furniture.annotate import add_grasps
from roboassembly.furniture.model import Furniture, GraspRegion
from roboassembly.settings import SETTINGS, set_upright
from roboassembly.solvers.forward import SearchProgress, Watch, planner_seed
from roboassembly.solvers.guide import Guide
from roboassembly.task.full.failure import Failure
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan, UprightResult
from roboassembly.task.plans.plan_file import Script
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName

_PLANNER = threading.Lock()
"""Lock of the planner: OMPL has one stream of random numbers per process, so sessions plan one after another."""
MERGED = "merged"

_ACTION_WITH_POSE, _ACTION_WITH_GRASPS = 5, 6
"""Numbers of an action `(u, v, k, l, w)`, and of `(u, v, k, l, g_a, g_b)`."""


@dataclass(frozen=True)
class Attempt:
    """Result of one action."""

    action: tuple[int, ...]
    verdict: str
    """`ObjectCentricVerdict` or `FullVerdict`."""
    stage: str
    """Robot and stage that failed, in words; empty if none did."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float

    @property
    def merged(self) -> bool:
        """Whether the action merged two groups."""
        return self.verdict == MERGED


@dataclass(eq=False)
class AssemblySession:
    """Assembly of one piece in one setting, with undo.

    Args:
        furniture: furniture to assemble.
        setting: setting of the task.
        seed: seed of the initial state and of the planner; 0 or more.

    Raises:
        InputError: the seed is negative, or the furniture does not suit the workcell.
    """

    furniture: Furniture
    setting: SettingName = "object-centric"
    seed: int = 0
    planning_steps: int = field(default=0, init=False)
    """Configurations tested for collision so far."""
    failures: int = field(default=0, init=False)
    """Number of failed actions."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative; it must be 0 or more")
        self.task: Any = SETTINGS[self.setting].make_task(self.furniture)
        self._states: list[Any] = [self.task.initial_state(np.random.default_rng(self.seed))]
        self._steps: list[Any] = []
        self.upright: UprightResult[Any] | None = None
        """Result of setting the finished piece upright; None while it is not finished."""
        self._observer = Observer(self.furniture, *self.furniture.padding, 1)

    @cached_property
    def furniture_with_grasps(self) -> Furniture:
        """The furniture with grasps; they are computed if it has none."""
        return self.furniture if any(p.grasps for p in self.furniture.parts) else add_grasps(self.furniture)

    def furniture_with(self, *, grasps: bool) -> Furniture:
        """Return the furniture, with grasps if they are asked for."""
        return self.furniture_with_grasps if grasps else self.furniture

    @property
    def state(self) -> Any:
        """Current state of the task: `TaskState`, or `FullState` in the full setting."""
        return self._states[-1]

    @property
    def task_state(self) -> TaskState:
        """Groups of the current state."""
        return self.task.groups_of(self.state)

    @property
    def merges(self) -> int:
        """Number of merges in the current state."""
        return len(self._steps)

    @property
    def actions(self) -> list[tuple[int, ...]]:
        """Actions of all steps."""
        return [step.action for step in self._steps]

    @property
    def reward(self) -> float:
        """Reward that the environment gives for these merges."""
        return self.merges * MERGE_REWARD + self.task_state.complete * COMPLETION_REWARD

    def points(self) -> Float32[np.ndarray, "P K 9"]:
        """Return position [m], normal and tangent of each connection point in its part's frame."""
        return self._observer.observe(self.task_state)["connection_points"]

    def free_points(self) -> Bool[np.ndarray, "P K"]:
        """Return which connection points are not connected yet."""
        return self.task.rules.free_points(self.task_state, *self.furniture.padding)

    def choices(self) -> tuple[tuple[str, int], ...]:
        """Return the name and the number of values of each component of an action after `(u, v, k, l)`."""
        return tuple(zip(SETTINGS[self.setting].choices, self.task.action_branches, strict=True))

    def attempt(self, action: tuple[int, ...]) -> Attempt:
        """Carry out an action; it becomes the newest step if it merges."""
        with _PLANNER:
            outcome = self.task.step(self.state, action, planner_seed(self.seed, action))
        self.planning_steps += outcome.planning_steps
        if outcome.step is not None:
            self._steps.append(outcome.step)
            self._states.append(outcome.state)
            self._set_upright()
        else:
            self.failures += 1
        failure: Failure | None = outcome.failure
        stage = "" if failure is None else failure.stage_text
        return Attempt(action, str(outcome.verdict), stage, outcome.planning_steps, outcome.planning_seconds)

    def up_while_waiting(self, action: tuple[int, ...]) -> Float[np.ndarray, "3"] | None:
        """Return the direction that points up while v's group waits, in v's frame.

        Args:
            action: `(u, v, k, l, w)`.

        Returns:
            The direction; None if the action does not join parts of this furniture, or in the full setting.
        """
        if len(action) != _ACTION_WITH_POSE:
            return None
        exists = self.task.exists(self.state, action)
        mating = self.task.prepare(self.state, action) if exists else None
        if mating is None:
            return None
        pose = mating.v_group.part_poses()[mating.v_group.parts.index(action[1])]
        return pose.rotation.T @ np.array([0.0, 0.0, 1.0])

    def grasps_of(self, action: tuple[int, ...]) -> list[tuple[int, GraspRegion, int]]:
        """Return part, grasp region and index of the approach of each hand of an action; empty without robots."""
        if len(action) != _ACTION_WITH_GRASPS:
            return []
        u, v, _, _, g_a, g_b = action
        parts = self.furniture.parts
        chosen = ((u, *divmod(g_a, 4)), (v, *divmod(g_b, 4)))
        return [(p, parts[p].grasps[region], side) for p, region, side in chosen if region < len(parts[p].grasps)]

    def make_manual(self) -> tuple[bytes, str]:
        """Return a manual for people, as PDF and as HTML.

        Raises:
            InputError: the furniture is not assembled yet.
            ManualError: the planner finds no order for people.
        """
        from roboassembly.manual.document import pages_of, title_of
        from roboassembly.manual.make import make_manual
        from roboassembly.manual.writers import html, pdf

        if not self.task_state.complete:
            raise InputError("a manual needs the finished piece; assemble the furniture first")
        with _PLANNER:
            manual = make_manual(self.furniture, self.actions, self.seed)
        pages, title = pages_of(manual, SETTINGS[self.setting].on_manuals), title_of(manual)
        return pdf(pages, title), html(pages, title)

    def check(self, script: Script) -> None:
        """Check that a plan is for this furniture and this setting.

        Raises:
            InputError: the plan is for other parts or for the other setting.
        """
        parts = tuple(p.name for p in self.furniture.parts)
        if script.parts != parts:
            raise InputError(f"the plan is for '{script.furniture}', whose parts differ from those of this furniture")
        if script.setting != self.setting:
            raise InputError(
                f"the plan is for the setting '{script.setting}', not '{self.setting}'; open the furniture in that one"
            )

    def repeat(self, script: Script, watch: Watch) -> str:
        """Carry out the actions of a plan from the current state; each step is planned and checked again.

        Args:
            script: plan for the same furniture and setting.
            watch: see `search`.

        Returns:
            The reason of an early end; empty if all actions were carried out.

        Raises:
            InputError: the plan is for other parts or for the other setting.
        """
        self.check(script)
        before = self.planning_steps
        for index, action in enumerate(script.actions):
            if not watch(SearchProgress(index, index, self.planning_steps - before)):
                return "stopped"
            attempt = self.attempt(action)
            if not attempt.merged:
                return f"step {index + 1} of the plan ended as {attempt.verdict} this time"
        return ""

    def undo(self) -> bool:
        """Remove the newest step, and the motion that set the piece upright; returns False if there is no step."""
        if not self._steps:
            return False
        self._steps.pop()
        self._states.pop()
        self.upright = None
        return True

    def search(self, guide: Guide[Any] | None, watch: Watch) -> str:
        """Search for the remaining steps from the current state, and carry them out.

        Args:
            guide: suggests actions; plain search if None.
            watch: called with the progress before each attempted merge; the search stops if it returns False.

        Returns:
            The reason of the failure; empty if the furniture was assembled.
        """

        def watch_unlocked(progress: SearchProgress) -> bool:
            # Other sessions may plan between two merges.
            _PLANNER.release()
            go_on = watch(progress)
            _PLANNER.acquire()
            return go_on

        with _PLANNER:
            setting = SETTINGS[self.setting]
            result = setting.solve_from(self.task, self.state, self.seed, setting.limits, guide, watch_unlocked)
        self.planning_steps += result.planning_steps
        if result.plan.success:
            self._steps += result.plan.steps
            self._states += result.states
            self._set_upright()
        return result.reason

    def _set_upright(self) -> None:
        """Plan the motion that sets the piece on its feet, if it is complete."""
        if self.task_state.complete:
            with _PLANNER:
                self.upright = set_upright(self.plan()).upright

    def suggestion(self, guide: Guide[Any]) -> tuple[int, ...] | None:
        """Return the action that a policy prefers; None if it suggests none."""
        suggestions = guide(self.task, self.state)
        return suggestions[0].action if suggestions else None

    def plan(self) -> Plan | FullPlan:
        """Return the record of all steps, and of the motion that set the piece upright."""
        steps, complete = tuple(self._steps), self.task_state.complete
        make_plan = SETTINGS[self.setting].make_plan
        return make_plan(self.furniture, self._states[0], steps, complete, self.seed, self.upright)
