"""The two settings as a table. Whoever needs what differs between them looks it up here.

No other module asks which setting it is in, but for two that the table cannot reach: `task.plans.plan_file`, which
writes the records of both, and `viewer.playback`, which shows them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn, TypeVar

import numpy as np
from jaxtyping import Float32

from roboassembly.audit.full import audit_full_plan
from roboassembly.audit.object_centric import audit_plan
from roboassembly.envs import FULL, OBJECT_CENTRIC
from roboassembly.envs.observation import Observer
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.solvers.forward import SearchLimits, SearchResult
from roboassembly.solvers.hand_oracle import hand_oracle
from roboassembly.solvers.mate_checks import FullMateCheck, MateCheck, ObjectCentricMateCheck
from roboassembly.solvers.oracle import Oracle
from roboassembly.solvers.search import FULL_LIMITS, solve, solve_from, solve_full, solve_full_from
from roboassembly.task.full.execution import execute_plan
from roboassembly.task.full.failure import coarse_kind
from roboassembly.task.full.task import FullTask
from roboassembly.task.full.upright import plan_full_upright
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.object_centric.upright import plan_upright
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan, UprightResult
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import SettingName

ExecutionName = Literal["kinematic", "dynamic"]
AnyPlan = TypeVar("AnyPlan", bound=Plan | FullPlan)


@dataclass(frozen=True)
class PaperFigures:
    """Results of the paper in one setting; success in per cent."""

    easy: float
    """Success of experts on easy training chairs."""
    hard: float
    """Success of experts on hard training chairs."""
    test: float
    """Success of the policy on unseen chairs."""
    steps: str = ""
    """Planning steps of the policy."""
    rrt_connect: float | None = None
    """Success of the RRT-Connect baseline in 6M dimensions; None if the setting has none."""
    rrt_connect_steps: str = ""
    """Planning steps of that baseline."""


@dataclass(frozen=True)
class Setting:
    """Everything that makes one setting."""

    name: SettingName
    environment: str
    """Name of its environment in Gymnasium."""
    choices: tuple[str, ...]
    """Names of an action's components after `(u, v, k, l)`."""
    needs_grasps: bool
    """Whether its furniture needs grasps; to be handed on to what makes the furniture."""
    make_task: Callable[[Furniture], ObjectCentricTask | FullTask]

    # Planning
    solve: Callable[..., SearchResult[Any]]
    """Search from a random start, as `solvers.search.solve`."""
    solve_from: Callable[..., SearchResult[Any]]
    """Search from a given state, as `solvers.search.solve_from`."""
    limits: SearchLimits
    """Default limits of the search."""
    make_plan: Callable[..., Any]
    """Record of an assembly: `(furniture, initial state, steps, success, seed, upright=None)`."""
    plan_upright: Callable[[Any], UprightResult[Any]]
    """Plans the last motion of a plan, which sets the piece on its feet."""
    audit: Callable[[Any], Any]
    """Replays a plan with python-fcl and returns a report."""
    execute: Callable[[Any], Any]
    """Carries a plan out in physics."""
    execution: ExecutionName
    """The most lifelike way in which it carries plans out."""
    refused_options: Mapping[str, str]
    """Options of commands that it does not have, each with the message that says so."""

    # Learning
    make_oracle: Callable[[Furniture], Oracle]
    """Oracle that labels states of a piece; raises `InputError` if the piece does not suit it."""
    make_mate_check: Callable[[Any], MateCheck]
    """Check of right pairs in the experts' memoized environment, of a task."""
    grasp_inputs: Callable[[Observer], Float32[np.ndarray, "P 8 6"] | None]
    """Grasps that a policy sees; None if actions have none."""
    rounds_of_networks: Callable[[int], tuple[int, int]]
    """Rounds of the relational policy's networks, on pairs and on grasps, from the number of rounds after the first."""
    refusals: tuple[type[InputError], ...]
    """Errors which mean that a training chair does not suit the setting. Any others stop the training."""
    repeated_starts: int
    """Number of an expert's episodes, at most, that start as in its validation and become samples."""
    lacking: str
    """Words on a policy that does not play in this setting: `the policy ...`."""

    # Reports
    failures: Callable[[Iterable[tuple[str, str]]], dict[str, Any]]
    """Figures on what ended failed episodes, from their verdicts and stages."""
    experts_note: str
    """How the experts' success was counted; empty if as that of other policies."""
    paper: PaperFigures

    @property
    def suffix(self) -> str:
        """Ending of a default folder's name; empty for the default setting."""
        return "" if self.name == DEFAULT else f"-{self.name}"

    @property
    def option(self) -> str:
        """Command line option that selects the setting, with a leading blank; empty for the default."""
        return "" if self.name == DEFAULT else f" --setting {self.name}"

    def check_option(self, option: str) -> None:
        """Check that a command's option goes with the setting.

        Raises:
            InputError: it does not.
        """
        if option in self.refused_options:
            raise InputError(self.refused_options[option])


def set_upright(plan: AnyPlan) -> AnyPlan:
    """Return the plan with its last motion, which sets the piece on its feet, or with the reason why there is none.

    In the object-centric setting the piece moves by itself; in the full setting a robot takes it from its post and sets
    it on the floor. A plan that did not succeed, or that has been set upright already, comes back as it is. The same
    plan gives the same motion.

    Args:
        plan: of a whole assembly.
    """
    if not plan.success or plan.upright is not None:
        return plan
    return replace(plan, upright=SETTINGS[plan.setting].plan_upright(plan))


_NO_ROBOTS = "--execution dynamic takes --setting full: there are no robots in the other one"


def _object_centric_plan(furniture: Furniture, initial: TaskState, *rest: Any, **named: Any) -> Plan:
    return Plan(furniture, initial.part_poses, *rest, **named)


def _not_executed(_: Plan) -> NoReturn:
    raise InputError(_NO_ROBOTS)


def _oracle(furniture: Furniture) -> Oracle:
    return Oracle(ObjectCentricTask(furniture))


def _no_grasps(_: Observer) -> None:
    return None


def _grasps(observer: Observer) -> Float32[np.ndarray, "P 8 6"]:
    return observer.grasp_poses


def _on_pairs(later: int) -> tuple[int, int]:
    return later + 1, 0


def _on_grasps(later: int) -> tuple[int, int]:
    return 1, later + 1


def _not_counted(_: Iterable[tuple[str, str]]) -> dict[str, Any]:
    return {}


def _counted(ends: Iterable[tuple[str, str]]) -> dict[str, Any]:
    return {"failures": dict(Counter(coarse_kind(*end) for end in ends).most_common())}


DEFAULT: SettingName = "object-centric"
SETTINGS: Mapping[SettingName, Setting] = {
    "object-centric": Setting(
        name="object-centric",
        environment=OBJECT_CENTRIC,
        choices=("w",),
        needs_grasps=False,
        make_task=ObjectCentricTask,
        solve=solve,
        solve_from=solve_from,
        limits=SearchLimits(),
        make_plan=_object_centric_plan,
        plan_upright=plan_upright,
        audit=audit_plan,
        execute=_not_executed,
        execution="kinematic",
        refused_options={"--execution dynamic": _NO_ROBOTS},
        make_oracle=_oracle,
        make_mate_check=ObjectCentricMateCheck,
        grasp_inputs=_no_grasps,
        rounds_of_networks=_on_pairs,
        refusals=(),
        repeated_starts=0,
        lacking="plays with robots only",
        failures=_not_counted,
        experts_note="",
        paper=PaperFigures(79.4, 66.4, 74.5, "37.8k", rrt_connect=18.8, rrt_connect_steps="91.7k"),
    ),
    "full": Setting(
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
        audit=audit_full_plan,
        execute=execute_plan,
        execution="dynamic",
        refused_options={"--export": "--export does not support --setting full; use --setting object-centric"},
        make_oracle=hand_oracle,
        make_mate_check=FullMateCheck,
        grasp_inputs=_grasps,
        rounds_of_networks=_on_grasps,
        refusals=(InputError,),
        # From other starts the arms often cannot carry out what an expert chooses.
        repeated_starts=3,
        lacking="chooses no grasps",
        failures=_counted,
        experts_note="Experts count as in the paper, where found paths are kept: by episodes from starts of their "
        "training.",
        paper=PaperFigures(59.3, 25.8, 50.0),
    ),
}
