"""The object-centric setting. What a plan does not need, such as the audit, is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NoReturn

from roboassembly.envs import OBJECT_CENTRIC
from roboassembly.errors import InputError
from roboassembly.settings import PaperFigures, Setting
from roboassembly.solvers.forward import SearchLimits
from roboassembly.solvers.mate_checks import ObjectCentricMateCheck
from roboassembly.solvers.search import solve, solve_from
from roboassembly.task.object_centric.insertion import with_insertions
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.object_centric.upright import plan_upright
from roboassembly.task.plans.plan import Plan

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from roboassembly.audit.object_centric import AuditReport
    from roboassembly.envs.observation import Observer
    from roboassembly.furniture.model import Furniture
    from roboassembly.task.rules.groups import TaskState

_NO_ROBOTS = "--execution dynamic takes --setting full: there are no robots in the other one"


def _make_plan(furniture: Furniture, initial: TaskState, *rest: Any, **named: Any) -> Plan:
    return Plan(furniture, initial.part_poses, *rest, **named)


def _audit(plan: Plan) -> AuditReport:
    from roboassembly.audit.object_centric import audit_plan

    return audit_plan(plan)


def _not_executed(_: Plan) -> NoReturn:
    raise InputError(_NO_ROBOTS)


def _no_grasps(_: Observer) -> None:
    return None


def _nearby(places: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    return places + rng.uniform(-0.5, 0.5, places.shape)


def _on_pairs(later: int) -> tuple[int, int]:
    return later + 1, 0


def _not_counted(_: Iterable[tuple[str, str]]) -> dict[str, Any]:
    return {}


SETTING = Setting(
    name="object-centric",
    environment=OBJECT_CENTRIC,
    choices=("w",),
    needs_grasps=False,
    make_task=ObjectCentricTask,
    solve=solve,
    solve_from=solve_from,
    limits=SearchLimits(),
    make_plan=_make_plan,
    plan_upright=plan_upright,
    insert_fasteners=with_insertions,
    audit=_audit,
    execute=_not_executed,
    execution="kinematic",
    refused_options={"--execution dynamic": _NO_ROBOTS},
    make_mate_check=ObjectCentricMateCheck,
    grasp_inputs=_no_grasps,
    rounds_of_networks=_on_pairs,
    refusals=(),
    scatter=_nearby,
    repeated_starts=0,
    lacking="plays with robots only",
    failures=_not_counted,
    experts_note="",
    paper=PaperFigures(79.4, 66.4, 74.5, "37.8k", rrt_connect=18.8, rrt_connect_steps="91.7k"),
    on_manuals="This manual was made from a plan without robots. `roboassembly assemble --setting full` tries to plan "
    "for two mobile arms.",
)
