"""One visitor's work: a piece of furniture, what has been joined so far, what is tried next. Knows no browser."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from roboassembly.envs.assembly import COMPLETION_REWARD, MERGE_REWARD
from roboassembly.envs.observation import Observer
from roboassembly.errors import InputError
from roboassembly.furniture.annotate import add_grasps
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.solvers.forward import SearchLimits, SearchProgress, Watch, planner_seed
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.search import FULL_LIMITS, solve_from, solve_full_from
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.object_centric.upright import set_upright
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan, UprightResult
from roboassembly.task.plans.plan_file import Script
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName

_PLANNER = threading.Lock()
"""OMPL's random numbers are one stream for the whole process, so that visitors plan one after another."""
MERGED = "merged"


@dataclass(frozen=True)
class Tried:
    """What an action came to."""

    action: tuple[int, ...]
    verdict: str
    """`ObjectCentricVerdict` or `FullVerdict`."""
    leg: str
    """In which robots failed; empty if they did not, or there are none."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float

    @property
    def merged(self) -> bool:
        """Whether it worked."""
        return self.verdict == MERGED


@dataclass(eq=False)
class Session:
    """An assembly by hand, by a policy or by the search, in turns.

    Args:
        furniture: what is assembled.
        setting: what moves the parts.
        seed: of how all lies at first, and of the planner; 0 or more.

    Raises:
        InputError: a negative seed, or furniture that does not suit the workcell.
    """

    furniture: Furniture
    setting: SettingName = "object-centric"
    seed: int = 0
    planning_steps: int = field(default=0, init=False)
    """Configurations tested for collision by all that was tried."""
    failures: int = field(default=0, init=False)
    """Actions that did not work."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is negative; 0 or more would do")
        self.task: Any = (FullTask if self.setting == "full" else ObjectCentricTask)(self.furniture)
        self._states: list[Any] = [self.task.initial_state(np.random.default_rng(self.seed))]
        self._steps: list[Any] = []
        self.upright: UprightResult[Any] | None = None
        """How the finished piece ends; None as long as it is not finished."""
        self._observer = Observer(self.furniture, MAX_PARTS, MAX_POINTS, 1)

    @cached_property
    def held(self) -> Furniture:
        """The furniture with its grasps, which may have been left out."""
        return self.furniture if any(p.grasps for p in self.furniture.parts) else add_grasps(self.furniture)

    @property
    def state(self) -> Any:
        """The present one, in the task's own terms."""
        return self._states[-1]

    @property
    def joined(self) -> TaskState:
        """Groups of the present state."""
        return self.task.groups_of(self.state)

    @property
    def merges(self) -> int:
        """That worked and were not taken back."""
        return len(self._steps)

    @property
    def reward(self) -> float:
        """What the environment would have given for them."""
        return self.merges * MERGE_REWARD + self.joined.complete * COMPLETION_REWARD

    def points(self) -> Float32[np.ndarray, "20 10 9"]:
        """Position, normal and tangent of all connection points in their parts' frames, as the observation has them."""
        return self._observer.observe(self.joined)["connection_points"]

    def free(self) -> Bool[np.ndarray, "20 10"]:
        """Which connection points touch nothing yet."""
        return self.task.rules.free_points(self.joined)

    def choices(self) -> tuple[tuple[str, int], ...]:
        """What an action has after `(u, v, k, l)`: the name of each and how many there are at most."""
        names = ("g_a", "g_b") if self.setting == "full" else ("w",)
        return tuple(zip(names, self.task.action_branches, strict=True))

    def attempt(self, action: tuple[int, ...]) -> Tried:
        """Carry out an action; if it works, it is the newest step."""
        with _PLANNER:
            outcome = self.task.step(self.state, action, planner_seed(self.seed, action))
        self.planning_steps += outcome.planning_steps
        if outcome.step is not None:
            self._steps.append(outcome.step)
            self._states.append(outcome.state)
            self._set_upright()
        else:
            self.failures += 1
        leg = getattr(outcome, "leg", "")
        return Tried(action, str(outcome.verdict), leg, outcome.planning_steps, outcome.planning_seconds)

    def check(self, script: Script) -> None:
        """Whether a plan is of this furniture in this setting.

        Raises:
            InputError: it is a plan of other parts, or of the other setting.
        """
        parts = tuple(p.name for p in self.furniture.parts)
        if script.parts != parts:
            raise InputError(f"the plan is of '{script.furniture}', whose parts are others than those shown")
        if script.setting != self.setting:
            raise InputError(f"the plan is of setting '{script.setting}'; open the furniture in that one")

    def repeat(self, script: Script, watch: Watch) -> str:
        """Do a plan again from here, each step planned and checked anew.

        Args:
            script: of a plan of the same furniture in the same setting.
            watch: as of `search`.

        Returns:
            Why it ended early; empty if it did not.

        Raises:
            InputError: it is a plan of other parts, or of the other setting.
        """
        self.check(script)
        before = self.planning_steps
        for index, action in enumerate(script.actions):
            if not watch(SearchProgress(index, index, self.planning_steps - before)):
                return "stopped"
            tried = self.attempt(action)
            if not tried.merged:
                return f"step {index + 1} of the plan ended as {tried.verdict} this time"
        return ""

    def undo(self) -> bool:
        """Take the newest step back, and the motion that followed it if it was the last; False if there is none."""
        if not self._steps:
            return False
        self._steps.pop()
        self._states.pop()
        self.upright = None
        return True

    def search(self, guide: Guide | None, watch: Watch) -> str:
        """Look for a way to the end from here, and take it.

        Args:
            guide: suggests merges; plain reasoning if None.
            watch: told how far it is before each merge that is tried; False gives up.

        Returns:
            Why there is none; empty if there is one.
        """

        def watched(standing: SearchProgress) -> bool:
            # Others get a chance between two merges.
            _PLANNER.release()
            go_on = watch(standing)
            _PLANNER.acquire()
            return go_on

        with _PLANNER:
            if self.setting == "full":
                result = solve_full_from(self.task, self.state, self.seed, FULL_LIMITS, guide, watched)
            else:
                result = solve_from(self.task, self.state, self.seed, SearchLimits(), guide, watched)
        self.planning_steps += result.planning_steps
        if result.plan.success:
            self._steps += result.plan.steps
            self._states += result.states
            self._set_upright()
        return result.reason

    def _set_upright(self) -> None:
        """Once all is assembled, plan the motion that sets the piece on its feet."""
        if self.joined.complete:
            with _PLANNER:
                self.upright = set_upright(self.plan()).upright

    def suggestion(self, guide: Guide) -> tuple[int, ...] | None:
        """What a policy would do now; None if it sees nothing."""
        suggestions = guide(self.task, self.state)
        return suggestions[0].action if suggestions else None

    def plan(self) -> Plan | FullPlan:
        """All steps so far as a record, and the motion after the last of all."""
        steps, complete = tuple(self._steps), self.joined.complete
        if self.setting == "full":
            return FullPlan(self.furniture, self._states[0], steps, complete, self.seed, self.upright)
        return Plan(self.furniture, self._states[0].part_poses, steps, complete, self.seed, self.upright)
