"""The two settings as a table. Whoever needs what differs between them looks it up here.

Each setting has a module of its own, `settings.object_centric` and `settings.full`, which is loaded when it is first
looked up: what concerns no robots starts without the libraries for robots.

No other module asks which setting it is in, but for two that the table cannot reach: `task.plans.plan_file`, which
writes the records of both, and `viewer.playback`, which shows them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from roboassembly.errors import InputError
from roboassembly.task.setting import SettingName

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float, Float32

    from roboassembly.envs.observation import Observer
    from roboassembly.furniture.model import Furniture
    from roboassembly.solvers.forward import SearchLimits, SearchResult
    from roboassembly.solvers.mate_checks import MateCheck
    from roboassembly.task.full.task import FullTask
    from roboassembly.task.object_centric.task import ObjectCentricTask
    from roboassembly.task.plans.full_plan import FullPlan
    from roboassembly.task.plans.plan import Plan, UprightResult

ExecutionName = Literal["kinematic", "dynamic"]
AnyPlan = TypeVar("AnyPlan", bound="Plan | FullPlan")
DEFAULT: SettingName = "object-centric"
"""Setting of commands that name none."""


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
    insert_fasteners: Callable[[Any], Plan] | None
    """Returns a plan with the insertions of its fasteners; None if a person puts them in."""
    audit: Callable[[Any], Any]
    """Replays a plan with python-fcl and returns a report."""
    execute: Callable[[Any], Any]
    """Carries a plan out in physics."""
    execution: ExecutionName
    """The most lifelike way in which it carries plans out."""
    refused_options: Mapping[str, str]
    """Options of commands that it does not have, each with the message that says so."""

    # Learning
    make_mate_check: Callable[[Any], MateCheck]
    """Check of right pairs in the experts' memoized environment, of a task."""
    grasp_inputs: Callable[[Observer], Float32[np.ndarray, "P 8 6"] | None]
    """Grasps that a policy sees; None if actions have none."""
    rounds_of_networks: Callable[[int], tuple[int, int]]
    """Rounds of the relational policy's networks, on pairs and on grasps, from the number of rounds after the first."""
    refusals: tuple[type[InputError], ...]
    """Errors which mean that a training chair does not suit the setting. Any others stop the training."""
    scatter: Callable[[Float[np.ndarray, "n 3"], np.random.Generator], Float[np.ndarray, "n 3"]]
    """Places where groups may be in episodes, drawn at random for training, given where they are [m]."""
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
    on_manuals: str
    """Paragraph on the plan, for the last page of a manual that is made from it."""

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


def _object_centric() -> Setting:
    from roboassembly.settings.object_centric import SETTING

    return SETTING


def _full() -> Setting:
    from roboassembly.settings.full import SETTING

    return SETTING


_LOADERS: dict[SettingName, Callable[[], Setting]] = {"object-centric": _object_centric, "full": _full}


class _Settings(Mapping[SettingName, Setting]):
    """Settings by their names. The module of a setting is imported when it is asked for."""

    def __getitem__(self, name: SettingName) -> Setting:
        return _LOADERS[name]()

    def __iter__(self) -> Iterator[SettingName]:
        return iter(_LOADERS)

    def __len__(self) -> int:
        return len(_LOADERS)


SETTINGS: Mapping[SettingName, Setting] = _Settings()
"""The settings by their names."""
