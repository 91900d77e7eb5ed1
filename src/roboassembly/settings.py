"""The two settings as a table. Whoever needs what differs between them looks it up here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from roboassembly.audit.full import audit_full_plan
from roboassembly.audit.object_centric import audit_plan
from roboassembly.envs import FULL, OBJECT_CENTRIC
from roboassembly.furniture.model import Furniture
from roboassembly.solvers.forward import SearchLimits, SearchResult
from roboassembly.solvers.search import FULL_LIMITS, solve, solve_from, solve_full, solve_full_from
from roboassembly.task.full.execution import execute_plan
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName


@dataclass(frozen=True)
class Setting:
    """Everything that makes one setting."""

    name: SettingName
    environment: str
    """Name of its environment in Gymnasium."""
    choices: tuple[str, ...]
    """Names of an action's components after `(u, v, k, l)`."""
    has_robots: bool
    """Robots move the parts: furniture needs grasps, and plans can be carried out in physics."""
    make_task: Callable[[Furniture], ObjectCentricTask | FullTask]
    solve: Callable[..., SearchResult[Any]]
    """Search from a random start, as `solvers.search.solve`."""
    solve_from: Callable[..., SearchResult[Any]]
    """Search from a given state, as `solvers.search.solve_from`."""
    limits: SearchLimits
    """Default limits of the search."""
    make_plan: Callable[..., Any]
    """Record of an assembly: `(furniture, initial state, steps, success, seed, upright=None)`."""
    audit: Callable[[Any], Any]
    """Replays a plan with python-fcl and returns a report."""
    execute: Callable[[Any], Any] | None
    """Carries a plan out in physics; None if no robots move the parts."""

    @property
    def option(self) -> str:
        """Command line option that selects the setting, with a leading blank; empty for the default."""
        return "" if self.name == DEFAULT else f" --setting {self.name}"


def _object_centric_plan(furniture: Furniture, initial: TaskState, *rest: Any, **named: Any) -> Plan:
    return Plan(furniture, initial.part_poses, *rest, **named)


DEFAULT: SettingName = "object-centric"
SETTINGS: Mapping[SettingName, Setting] = {
    "object-centric": Setting(
        name="object-centric",
        environment=OBJECT_CENTRIC,
        choices=("w",),
        has_robots=False,
        make_task=ObjectCentricTask,
        solve=solve,
        solve_from=solve_from,
        limits=SearchLimits(),
        make_plan=_object_centric_plan,
        audit=audit_plan,
        execute=None,
    ),
    "full": Setting(
        name="full",
        environment=FULL,
        choices=("g_a", "g_b"),
        has_robots=True,
        make_task=FullTask,
        solve=solve_full,
        solve_from=solve_full_from,
        limits=FULL_LIMITS,
        make_plan=FullPlan,
        audit=audit_full_plan,
        execute=execute_plan,
    ),
}
