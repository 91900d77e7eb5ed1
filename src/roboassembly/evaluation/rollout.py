"""What plays an episode: a policy alone, a policy that guides the search, or a solver; in either setting."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from roboassembly.envs.full import FullEnv
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.errors import InputError, PolicyError, UnknownNameError
from roboassembly.furniture.model import Furniture
from roboassembly.learning.policy import Policy, check_setting, chosen, guide_of
from roboassembly.learning.policy_weights import FILES, NAMES
from roboassembly.learning.registry import PolicyFactory, policy_factory
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.joint_rrt import solve_jointly
from roboassembly.solvers.random_order import assemble_in_random_order
from roboassembly.solvers.search import SearchResult, solve, solve_full
from roboassembly.task.full.execution import execute_plan, summarize_execution
from roboassembly.task.full.failure import Failure
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.task.plans.plan import Plan
from roboassembly.task.setting import SettingName

ExecutionName = Literal["kinematic", "dynamic"]
SEARCH = "search"
REFUSED = "refused"
"""Verdict on furniture that does not suit the cell."""
_NO_PLAN = "no_plan"


@dataclass(frozen=True)
class Episode:
    """One try at one piece."""

    furniture: str
    parts: int
    seed: int
    """Of the start, and of all that is drawn; `reset(seed=...)` of the environment."""
    success: bool
    merges: int
    verdict: str
    """How the last step ended (`ObjectCentricVerdict`, `FullVerdict`, `ExecutionVerdict`); of a solver:
    `merged`, or why it did not get there."""
    planning_steps: int
    """Configurations tested for collision."""
    planning_seconds: float
    policy_seconds: float = 0.0
    """Time that the policy took to choose."""
    actions: tuple[tuple[int, ...], ...] = ()
    """Of each step, where the way of assembling has such."""
    family: str = ""
    """Empty if the set does not know."""
    unseen: bool | None = None
    """Whether the family occurs in no training; None if the set does not know."""
    reason: str = ""
    """Why a solver found nothing, or the stage in which a policy's last step failed with robots, in words."""
    stage: str = ""
    """Stage in which a policy's last step failed with robots (`Stage`); empty if none did."""
    step_seconds: tuple[float, ...] = ()
    """Of planning each merge of the plan."""
    executed: dict[str, Any] | None = None
    """Of a plan that was carried out in physics: `task.full.execution.PlanExecution` in numbers."""
    violations: int | None = None
    """That an audit of the plan found; None without one."""


@dataclass(frozen=True)
class RolloutConfig:
    """A way of assembling."""

    policy: str | Policy = SEARCH
    """A solver's name, a policy's, the path of a checkpoint or of a Python file, or a policy of your own."""
    search: bool = False
    """The policy guides the search; else it plays alone."""
    setting: SettingName = "object-centric"
    execution: ExecutionName = "kinematic"
    """`dynamic`: what is planned in the full setting is carried out in physics besides, and has to succeed there."""
    audit: bool = False
    """Replay every plan with python-fcl."""


@dataclass(frozen=True, eq=False)
class PolicyRollout:
    """What a policy did alone."""

    plan: Plan | FullPlan
    """Its merges; not a success if it failed."""
    actions: tuple[tuple[int, ...], ...]
    """One more than merges if it failed."""
    verdict: str
    """Of the last step."""
    planning_steps: int
    planning_seconds: float
    policy_seconds: float
    failure: Failure | None = None
    """Failure of the last step, with robots."""


Agent = Callable[[Furniture, int], Episode]
_Played = tuple[Episode, Plan | FullPlan | None]


def make_agent(way: RolloutConfig) -> Agent:
    """What plays an episode of a piece with a seed.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file is of no use, what is named cannot guide the search, or does not know the setting.
        MissingExtraError: an audit without python-fcl.
    """
    if way.execution == "dynamic" and way.setting != "full":
        raise InputError("--execution dynamic takes --setting full: there are no robots in the other one")
    if way.audit:
        from roboassembly.audit.object_centric import fcl_module

        fcl_module()
    return partial(_play, way, _own(way))


def _play(way: RolloutConfig, own: Callable[[Furniture, int], _Played], furniture: Furniture, seed: int) -> Episode:
    episode, plan = own(furniture, seed)
    if plan is not None:
        episode = replace(episode, step_seconds=tuple(round(s.planning_seconds, 5) for s in plan.steps))
    if way.audit and plan is not None:
        episode = replace(episode, violations=_violations(plan))
    if way.execution == "dynamic" and isinstance(plan, FullPlan) and plan.success:
        done = summarize_execution(plan, execute_plan(plan))
        verdict = episode.verdict if done.success else done.ending
        episode = replace(episode, success=done.success, verdict=verdict, reason=done.reason, executed=asdict(done))
    return episode


def _violations(plan: Plan | FullPlan) -> int:
    from roboassembly.audit.full import audit_full_plan
    from roboassembly.audit.object_centric import audit_plan

    report = audit_full_plan(plan) if isinstance(plan, FullPlan) else audit_plan(plan)
    return sum(report.counts.values())


def _search_full(furniture: Furniture, seed: int, guide: Guide | None = None) -> _Played:
    try:
        return _searched(solve_full(furniture, seed, guide=guide))
    except PolicyError:
        raise
    except InputError as error:
        return _refused(furniture, seed, error), None


def _refused(furniture: Furniture, seed: int, why: InputError) -> Episode:
    return Episode(furniture.name, len(furniture.parts), seed, False, 0, REFUSED, 0, 0.0, reason=str(why))


def _searched(result: SearchResult[Plan] | SearchResult[FullPlan]) -> _Played:
    plan = result.plan
    episode = Episode(
        plan.furniture.name, len(plan.furniture.parts), plan.seed, plan.success, len(plan.steps),
        ObjectCentricVerdict.MERGED.value if plan.success else _NO_PLAN, result.planning_steps, result.planning_seconds,
        result.guide_seconds, tuple(step.action for step in plan.steps), reason=result.reason,
    )  # fmt: skip
    return episode, plan


def _own(way: RolloutConfig) -> Callable[[Furniture, int], _Played]:
    """What plays in the way's setting, without what may follow."""
    policy, full = way.policy, way.setting == "full"
    solvers = FULL_SOLVERS if full else SOLVERS
    if isinstance(policy, str):
        if policy in solvers:
            if way.search:
                raise InputError(f"'{policy}' cannot guide the search; a policy that values actions would do")
            return solvers[policy]
        if policy in SOLVERS:
            raise InputError(f"'{policy}' chooses no grasps; --setting full takes --policy {SEARCH}")
    make = _maker(policy, solvers)
    # One to look at; each episode has its own.
    looked_at = make(0)
    check_setting(looked_at, way.setting, SEARCH)
    if way.search:
        guide_of(looked_at)
        search = _search_full if full else _search
        return lambda furniture, seed: search(furniture, seed, guide_of(make(seed)))
    return lambda furniture, seed: _alone(make(seed), way.setting, furniture, seed)


def _maker(policy: str | Policy, solvers: Iterable[str]) -> PolicyFactory:
    if not isinstance(policy, str):
        return lambda seed: policy
    try:
        return policy_factory(policy)
    except UnknownNameError:
        raise UnknownNameError("policy", policy, [*solvers, *NAMES, *FILES]) from None


def rollout_policy(
    policy: Policy, furniture: Furniture, seed: int, setting: SettingName = "object-centric"
) -> PolicyRollout:
    """Let a policy play one episode of the environment, by `reset` and `step` alone.

    Raises:
        PolicyError: what the policy picks is no action.
        InputError: the furniture does not suit the setting.
    """
    env: Any = (FullEnv if setting == "full" else ObjectCentricEnv)(furniture, cloud_points=policy.cloud_points)
    observation, info = env.reset(seed=seed)
    initial = env.state
    actions: list[tuple[int, ...]] = []
    merges: list[Any] = []
    states, planning, thinking, over = 0, 0.0, 0.0, False
    while not over:
        begun = time.perf_counter()
        action = chosen(policy, observation, info["action_mask"])
        thinking += time.perf_counter() - begun
        observation, _, terminated, truncated, info = env.step(np.array(action))
        over = terminated or truncated
        actions.append(action)
        states += info["planning_steps"]
        outcome = env.last_outcome
        if outcome is not None:
            planning += outcome.planning_seconds
            merges += [outcome.step] if outcome.step is not None else []
    if setting == "full":
        plan = FullPlan(furniture, initial, tuple(merges), bool(info["success"]), seed)
    else:
        plan = Plan(furniture, initial.part_poses, tuple(merges), bool(info["success"]), seed)
    failure = getattr(env.last_outcome, "failure", None)
    return PolicyRollout(plan, tuple(actions), info["verdict"], states, planning, thinking, failure)


def run_episode(policy: Policy, furniture: Furniture, seed: int) -> Episode:
    """One episode of a policy, your own included."""
    return make_agent(RolloutConfig(policy))(furniture, seed)


def _alone(policy: Policy, setting: SettingName, furniture: Furniture, seed: int) -> _Played:
    try:
        done = rollout_policy(policy, furniture, seed, setting)
    except PolicyError:
        raise
    except InputError as error:
        if setting == "full":
            return _refused(furniture, seed, error), None
        raise
    failed = done.failure
    episode = Episode(
        furniture.name, len(furniture.parts), seed, done.plan.success, len(done.plan.steps), done.verdict,
        done.planning_steps, done.planning_seconds, done.policy_seconds, done.actions,
        reason="" if failed is None else failed.stage_text, stage="" if failed is None else str(failed.stage or ""),
    )  # fmt: skip
    return episode, done.plan


def _search(furniture: Furniture, seed: int, guide: Guide | None = None) -> _Played:
    return _searched(solve(furniture, seed, guide=guide))


def _joint(furniture: Furniture, seed: int) -> _Played:
    result = solve_jointly(furniture, seed)
    parts, solved = len(furniture.parts), result.status is PlanningStatus.SOLVED
    verdict = ObjectCentricVerdict.MERGED.value if solved else result.status.value
    merges = (parts - 1) * solved
    steps, seconds = result.planning_steps, result.planning_seconds
    return Episode(furniture.name, parts, seed, solved, merges, verdict, steps, seconds), None


def _right_pairs(furniture: Furniture, seed: int, best_w: bool) -> _Played:
    play = assemble_in_random_order(ObjectCentricTask(furniture), seed, best_w=best_w, patient=False, budget=Budget())
    verdict = ObjectCentricVerdict.MERGED.value if play.completed else "stuck"
    episode = Episode(
        furniture.name, len(furniture.parts), seed, play.completed, play.merges, verdict, play.planning_steps,
        play.planning_seconds,
    )  # fmt: skip
    return episode, None


SOLVERS: dict[str, Callable[[Furniture, int], _Played]] = {
    SEARCH: _search,
    "joint-rrt": _joint,
    "right-pairs": partial(_right_pairs, best_w=True),
    "right-pairs-random-w": partial(_right_pairs, best_w=False),
}
"""`search` knows how the furniture comes apart; `joint-rrt` is the paper's baseline; `right-pairs` always takes a right
pair, in random order, with its best `w` or a random one: what is left to learn once pairs are known."""
FULL_SOLVERS: dict[str, Callable[[Furniture, int], _Played]] = {SEARCH: _search_full}
EXPORTABLE = (SEARCH,)
"""Solvers whose episodes tell their actions."""
