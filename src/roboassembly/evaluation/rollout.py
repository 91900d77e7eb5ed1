"""Agents that run one episode: a policy alone, a policy that guides the search, or a solver; in either setting."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from roboassembly.envs.arguments import checked_action
from roboassembly.envs.observation import AS_IN_PAPER, ObservationConfig, Observer
from roboassembly.errors import InputError, UnknownNameError
from roboassembly.evaluation.episodes import Episode
from roboassembly.furniture.model import Furniture
from roboassembly.learning.policy import Choices, Policy, check_setting, guide_of, with_frames, with_meshes
from roboassembly.learning.policy_weights import FILES, NAMES
from roboassembly.learning.registry import PolicyFactory, policy_factory
from roboassembly.planning.problem import Budget, PlanningStatus
from roboassembly.settings import DEFAULT, SETTINGS, ExecutionName, Setting
from roboassembly.solvers.guide import Guide
from roboassembly.solvers.joint_rrt import solve_jointly
from roboassembly.solvers.random_order import assemble_in_random_order
from roboassembly.task.full.execution import summarize_execution
from roboassembly.task.full.failure import Failure
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rollout import Action, Transition, rollout
from roboassembly.task.setting import SettingName, Task

SEARCH = "search"
REFUSED = "refused"
"""Verdict on furniture that does not suit the cell."""
_MERGED, _NO_PLAN, _STUCK = "merged", "no_plan", "stuck"


@dataclass(frozen=True)
class RolloutConfig:
    """Everything that decides how an episode is run."""

    policy: str | Policy = SEARCH
    """Name of a solver or of a policy, path of a checkpoint or of a Python file, or a policy object."""
    search: bool = False
    """The policy guides the search; otherwise it acts alone."""
    setting: SettingName = DEFAULT
    execution: ExecutionName = "kinematic"
    """`dynamic`: plans of the full setting are also carried out in physics, and have to succeed there."""
    audit: bool = False
    """Replay every plan with python-fcl."""
    observes: ObservationConfig = AS_IN_PAPER
    """Configuration of the observations of a policy that acts alone."""
    tries: int = 1
    """Number of actions that a policy that acts alone may try in a state."""
    meshes: bool = True
    """Whether a policy that acts alone may know the parts' meshes; without them it knows their clouds only."""

    @property
    def tells_meshes(self) -> bool:
        """Whether the policy acts alone and gets the parts' meshes: not where it is to do with points of surfaces."""
        return self.meshes and not self.search and self.observes.clouds == "shared" and not self.observes.noise


@dataclass(frozen=True, eq=False)
class PolicyRollout:
    """Episode of a policy that acts alone."""

    plan: Any
    """Its merges as a plan of the setting; unsuccessful if the episode failed."""
    actions: tuple[Action, ...]
    """All actions: one more than merges if the episode failed."""
    verdict: str
    """Outcome of the last step."""
    planning_steps: int
    planning_seconds: float
    policy_seconds: float
    failure: Failure | None = None
    """Failure of the last step, with robots."""


@dataclass(frozen=True, eq=False)
class _Start:
    """A piece of furniture at the start of an episode."""

    setting: Setting
    task: Task[Any, Any]
    state: Any
    rng: np.random.Generator
    """Source of the episode's further draws."""
    seed: int


Agent = Callable[[Furniture, int], Episode]
"""Runs an episode of a piece of furniture with a seed."""
_Result = tuple[Episode, Any]
"""An episode and its plan; None if the solver makes none."""
_Run = Callable[[_Start], _Result]


def make_agent(config: RolloutConfig) -> Agent:
    """Return the function that runs episodes.

    Raises:
        UnknownNameError: no such policy.
        InputError: the file cannot be used, or the policy cannot guide the search or does not know the setting.
        MissingExtraError: an audit without python-fcl.
    """
    setting = SETTINGS[config.setting]
    setting.check_option(f"--execution {config.execution}")
    if config.audit:
        from roboassembly.audit.object_centric import fcl_module

        fcl_module()
    return partial(_episode, config, _runner(config))


def run_episode(policy: Policy, furniture: Furniture, seed: int) -> Episode:
    """Run one object-centric episode of a policy."""
    return make_agent(RolloutConfig(policy))(furniture, seed)


def rollout_policy(
    policy: Policy, furniture: Furniture, seed: int, setting: SettingName = DEFAULT,
    observes: ObservationConfig = AS_IN_PAPER, tries: int = 1, meshes: bool = True,
) -> PolicyRollout:  # fmt: skip
    """Let a policy act alone for one episode; it sees observations and masks, and may know the parts' meshes.

    The episode is the one that the setting's environment runs after `reset(seed=seed)`.

    Args:
        policy: the policy.
        furniture: the piece.
        seed: seed of the start and of all draws.
        setting: setting of the environment.
        observes: configuration of the observations.
        tries: number of actions that the policy may try in a state. After an action that does not merge, it is asked
            again, with the action left out of the mask; with the whole pair if the pair is wrong.
        meshes: whether the policy may know the parts' meshes besides the observations.

    Raises:
        PolicyError: the policy picks something that is no action.
        InputError: the furniture does not suit the setting.
    """
    config = RolloutConfig(policy, setting=setting, observes=observes, tries=tries, meshes=meshes)
    return _rollout(policy, _start(SETTINGS[setting], furniture, seed), config)


def _start(setting: Setting, furniture: Furniture, seed: int) -> _Start:
    rng = np.random.default_rng(seed)
    task = setting.make_task(furniture)
    return _Start(setting, task, task.initial_state(rng), rng, seed)


def _rollout(policy: Policy, start: _Start, config: RolloutConfig) -> PolicyRollout:
    observes, furniture = config.observes, start.task.furniture
    rng = None if observes.is_default else start.rng
    policy = with_frames(policy, observes.frames)
    observer = Observer(furniture, *furniture.padding, policy.cloud_points, observes, rng)
    if config.tells_meshes:
        policy = with_meshes(policy, observer.meshes)
    task = start.task.with_frames(observer.frames)
    names = ("u", "v", "k", "l", *start.setting.choices)
    thinking = 0.0
    tried: list[Transition[Any, Any]] = []

    def propose(state: Any) -> Iterable[Action]:
        nonlocal thinking
        groups = task.groups_of(state)
        choices = Choices(policy, observer.observe(groups), task.existing_actions(groups, *furniture.padding))
        for _ in range(config.tries):
            begun = time.perf_counter()
            action = choices.next()
            thinking += time.perf_counter() - begun
            if action is None:
                return
            yield checked_action(action, choices.mask.shape, names)
            choices.refuse(action, wrong_pair=str(tried[-1].outcome.verdict) == ObjectCentricVerdict.WRONG_PAIR)

    # One after the other: `propose` looks at the last one.
    for transition in rollout(task, start.state, propose, start.rng):
        tried.append(transition)  # noqa: PERF402
    last = tried[-1].outcome
    merges = tuple(t.outcome.step for t in tried if t.merged)
    complete = task.groups_of(last.state).complete
    return PolicyRollout(
        plan=start.setting.make_plan(furniture, start.state, merges, complete, start.seed),
        actions=tuple(t.action for t in tried),
        verdict=str(last.verdict),
        planning_steps=sum(t.outcome.planning_steps for t in tried),
        planning_seconds=sum(t.outcome.planning_seconds for t in tried),
        policy_seconds=thinking,
        failure=last.failure,
    )


def _episode(config: RolloutConfig, run: _Run, furniture: Furniture, seed: int) -> Episode:
    """Run an episode, then audit its plan and carry it out in physics if the configuration says so."""
    setting = SETTINGS[config.setting]
    try:
        start = _start(setting, furniture, seed)
    except InputError as error:
        return Episode(furniture.name, len(furniture.parts), seed, False, 0, REFUSED, 0, 0.0, reason=str(error))
    episode, plan = run(start)
    if plan is None:
        return episode
    episode = replace(episode, step_seconds=tuple(round(s.planning_seconds, 5) for s in plan.steps))
    if config.audit:
        episode = replace(episode, violations=sum(setting.audit(plan).counts.values()))
    if config.execution == "dynamic" and plan.success:
        done = summarize_execution(plan, setting.execute(plan))
        verdict = episode.verdict if done.success else done.ending
        episode = replace(episode, success=done.success, verdict=verdict, reason=done.reason, executed=asdict(done))
    return episode


def _runner(config: RolloutConfig) -> _Run:
    """Return what runs the configuration's episodes from their start."""
    policy = config.policy
    alone = not config.search and not (isinstance(policy, str) and policy in SOLVERS)
    if not alone and (config.tries > 1 or not config.observes.is_default):
        raise InputError(
            "--tries, --frames, --clouds and --noise-mm are for a policy that acts alone; leave out --search"
        )
    known = [name for name, solver in SOLVERS.items() if config.setting in solver.settings]
    if isinstance(policy, str) and policy in SOLVERS:
        if policy not in known:
            raise InputError(f"'{policy}' chooses no grasps; --setting {config.setting} takes --policy {SEARCH}")
        if config.search:
            raise InputError(f"'{policy}' cannot guide the search; expected a policy that values actions")
        return SOLVERS[policy].run
    make = _factory(policy, known)
    # Only to check it; each episode makes its own.
    sample = make(0)
    check_setting(sample, config.setting, SEARCH)
    if config.search:
        guide_of(sample)
        return lambda start: _search(start, guide_of(make(start.seed)))
    return lambda start: _act_alone(config, make(start.seed), start)


def _factory(policy: str | Policy, solvers: Iterable[str]) -> PolicyFactory:
    if not isinstance(policy, str):
        return lambda seed: policy
    try:
        return policy_factory(policy)
    except UnknownNameError:
        raise UnknownNameError("policy", policy, [*solvers, *NAMES, *FILES]) from None


def _act_alone(config: RolloutConfig, policy: Policy, start: _Start) -> _Result:
    done = _rollout(policy, start, config)
    failure = done.failure
    furniture = start.task.furniture
    episode = Episode(
        furniture.name, len(furniture.parts), start.seed, done.plan.success, len(done.plan.steps), done.verdict,
        done.planning_steps, done.planning_seconds, done.policy_seconds, done.actions,
        reason="" if failure is None else failure.stage_text, stage="" if failure is None else str(failure.stage or ""),
    )  # fmt: skip
    return episode, done.plan


def _search(start: _Start, guide: Guide[Any] | None = None) -> _Result:
    setting = start.setting
    result = setting.solve_from(start.task, start.state, start.seed, setting.limits, guide)
    plan = result.plan
    episode = Episode(
        plan.furniture.name, len(plan.furniture.parts), plan.seed, plan.success, len(plan.steps),
        _MERGED if plan.success else _NO_PLAN, result.planning_steps, result.planning_seconds,
        result.guide_seconds, tuple(step.action for step in plan.steps), reason=result.reason,
    )  # fmt: skip
    return episode, plan


def _joint_rrt(start: _Start) -> _Result:
    furniture = start.task.furniture
    result = solve_jointly(furniture, start.seed)
    parts, solved = len(furniture.parts), result.status is PlanningStatus.SOLVED
    verdict = _MERGED if solved else result.status.value
    steps, seconds = result.planning_steps, result.planning_seconds
    return Episode(furniture.name, parts, start.seed, solved, (parts - 1) * solved, verdict, steps, seconds), None


def _right_pairs(start: _Start, best_w: bool) -> _Result:
    furniture = start.task.furniture
    result = assemble_in_random_order(
        ObjectCentricTask(furniture), start.seed, best_w=best_w, patient=False, budget=Budget()
    )
    episode = Episode(
        furniture.name, len(furniture.parts), start.seed, result.completed, result.merges,
        _MERGED if result.completed else _STUCK, result.planning_steps, result.planning_seconds,
    )  # fmt: skip
    return episode, None


@dataclass(frozen=True)
class Solver:
    """A solver that can be named in place of a policy."""

    run: _Run
    settings: tuple[SettingName, ...] = (DEFAULT,)
    has_actions: bool = False
    """Its episodes name their actions, so that they can be exported."""


SOLVERS: dict[str, Solver] = {
    SEARCH: Solver(_search, ("object-centric", "full"), has_actions=True),
    "joint-rrt": Solver(_joint_rrt),
    "right-pairs": Solver(partial(_right_pairs, best_w=True)),
    "right-pairs-random-w": Solver(partial(_right_pairs, best_w=False)),
}
"""`search` plans by disassembly; `joint-rrt` is the paper's RRT-Connect baseline; `right-pairs` joins right pairs in
random order, each with its best `w` or a random one: what is left to learn once pairs are known."""
