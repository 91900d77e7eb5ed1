"""The full setting. What a plan does not need, such as audits and physics, is imported when it is called."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float32

from roboassembly.envs import FULL
from roboassembly.errors import InputError
from roboassembly.settings import PaperFigures, Setting
from roboassembly.solvers.full_search import FULL_LIMITS, solve_full, solve_full_from
from roboassembly.solvers.mate_checks import FullMateCheck
from roboassembly.task.full.failure import coarse_kind
from roboassembly.task.full.task import FullTask
from roboassembly.task.full.upright import plan_full_upright
from roboassembly.task.plans.full_plan import FullPlan

if TYPE_CHECKING:
    from roboassembly.audit.full import RobotAuditReport
    from roboassembly.envs.observation import Observer
    from roboassembly.task.full.execution import StepExecution

_CELL_RADIUS, _HEIGHTS = 3.5, (0.4, 1.5)
"""Radius of the region where the posts of nearly all furniture stand, and range of the parts' heights there [m]."""


def _audit(plan: FullPlan) -> RobotAuditReport:
    from roboassembly.audit.full import audit_full_plan

    return audit_full_plan(plan)


def _execute(plan: FullPlan) -> list[StepExecution]:
    from roboassembly.task.full.execution import execute_plan

    return execute_plan(plan)


def _grasps(observer: Observer) -> Float32[np.ndarray, "P 8 6"]:
    return observer.grasp_poses


def _in_the_cell(places: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    # Experts explore without a cell, with all groups side by side on the ground. In a cell they hang on posts in a
    # ring, merged ones anywhere.
    angle, share = rng.uniform(-np.pi, np.pi, len(places)), rng.uniform(0.0, 1.0, len(places))
    radius = _CELL_RADIUS * np.sqrt(share)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(*_HEIGHTS, len(places))], axis=1)


def _on_grasps(later: int) -> tuple[int, int]:
    return 0, later + 1


def _counted(ends: Iterable[tuple[str, str]]) -> dict[str, Any]:
    return {"failures": dict(Counter(coarse_kind(*end) for end in ends).most_common())}


SETTING = Setting(
    name="full",
    environment=FULL,
    choices=("g_a", "g_b"),
    needs_grasps=True,
    make_task=FullTask,
    solve=solve_full,
    solve_from=solve_full_from,
    limits=FULL_LIMITS,
    make_plan=FullPlan,
    plan_upright=plan_full_upright,
    insert_fasteners=None,
    audit=_audit,
    execute=_execute,
    execution="dynamic",
    refused_options={
        "--export": "--export does not support --setting full; use --setting object-centric",
        "--stable": "--stable is for --setting object-centric: with robots, posts hold every group",
    },
    make_mate_check=FullMateCheck,
    grasp_inputs=_grasps,
    rounds_of_networks=_on_grasps,
    refusals=(InputError,),
    # From other starts the arms often cannot carry out what an expert chooses.
    repeated_starts=3,
    scatter=_in_the_cell,
    lacking="chooses no grasps",
    failures=_counted,
    experts_note="Experts count as in the paper, where found paths are kept: by episodes from starts of their "
    "training.",
    paper=PaperFigures(59.3, 25.8, 50.0),
    on_manuals="This manual was made from a plan in which two robots join the parts. Its order is rearranged for "
    "people; plan.json has that of the robots.",
)
