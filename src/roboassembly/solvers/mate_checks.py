"""Checks of a right pair in the memoized environment: what a merge leads to, in either setting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol

from roboassembly.planning.problem import Budget
from roboassembly.task.full.failure import Failure, FullVerdict
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, TaskState

if TYPE_CHECKING:
    # The check without robots loads nothing of them.
    from roboassembly.task.full.task import FullTask

BUDGET = Budget(states=0)
"""Budget of the planner: straight retreats only. A sampling planner seldom solves what they do not."""


class Knowledge(IntEnum):
    """Knowledge of an action; the action fails from `FAILS` on."""

    UNKNOWN = 0
    MERGES = 1
    FAILS = 2
    """A wrong pair, or a goal in collision."""
    BLOCKED = 3
    """No way to the goal."""


UNKNOWN, MERGES, FAILS, BLOCKED = (int(k) for k in Knowledge)
_KNOWLEDGE = {ObjectCentricVerdict.MERGED: MERGES, ObjectCentricVerdict.GOAL_IN_COLLISION: FAILS}


@dataclass(frozen=True, eq=False)
class CheckResult:
    """Result of a right pair."""

    knowledge: int
    """`MERGES`, `FAILS` or `BLOCKED`."""
    choices: Sequence[int]
    """All combinations of branches that the result holds for."""
    merged: Group | None = None
    """Both groups as one, if they merge and the shape was unknown."""


class MateCheck(Protocol):
    """Checks right pairs of one setting."""

    roles_matter: bool
    """Whether a result says something about the same choice with the roles of the two groups swapped."""
    by_part: bool
    """Whether a result depends on the two parts, so that it does not hold for other parts of the same groups."""
    patience: tuple[int, int]
    """Number of failed choices after which an episode gives two groups up, and the same with few groups left."""

    def __call__(
        self,
        groups: tuple[Group, Group],
        laid_out: Callable[[], TaskState],
        action: tuple[int, ...],
        seed: int,
        shape_known: bool,
    ) -> CheckResult:
        """Check one choice.

        Args:
            groups: the groups of u and v.
            laid_out: makes the whole state.
            action: `(u, v, k, l)` and the number of the choice.
            seed: random seed of the planner.
            shape_known: whether the merged group is known, so that only the success is asked for.
        """
        ...


class ObjectCentricMateCheck:
    """Check of the object-centric setting: a path must exist, and the merged group must come to rest."""

    roles_matter: bool = True
    by_part: bool = False
    patience: tuple[int, int] = (2, 6)

    def __init__(self, task: ObjectCentricTask) -> None:
        self._task = task

    def __call__(
        self,
        groups: tuple[Group, Group],
        laid_out: Callable[[], TaskState],
        action: tuple[int, ...],
        seed: int,
        shape_known: bool,
    ) -> CheckResult:
        """Check one choice; see `MateCheck`."""
        before = laid_out()
        if shape_known:
            # The rest pose is known, too.
            mating = self._task.prepare(before, action)
            assert mating is not None
            result = self._task.plan(mating, seed, BUDGET)
            verdict = ObjectCentricVerdict.MERGED if result.solved else ObjectCentricVerdict(result.status.value)
            return CheckResult(_KNOWLEDGE.get(verdict, BLOCKED), action[4:])
        outcome = self._task.step(before, action, seed, BUDGET)
        merged = None
        if outcome.verdict is ObjectCentricVerdict.MERGED:
            merged = next(g for g in outcome.state.groups if action[0] in g.parts)
        return CheckResult(_KNOWLEDGE.get(outcome.verdict, BLOCKED), action[4:], merged)


class FullMateCheck:
    """Check of the full setting: everything but the arms.

    What the arms cannot do shows in the episodes in the real environment that validate an expert, and is learnt then.
    """

    roles_matter: bool = False
    by_part: bool = True
    patience: tuple[int, int] = (10, 40)

    def __init__(self, task: FullTask) -> None:
        self._task = task

    def __call__(
        self,
        groups: tuple[Group, Group],
        laid_out: Callable[[], TaskState],
        action: tuple[int, ...],
        seed: int,
        shape_known: bool,
    ) -> CheckResult:
        """Check one choice; see `MateCheck`."""
        *ends, choice = action
        g_a, g_b = divmod(choice, GRASPS)
        made = self._task.hands_merge(TaskState(groups), (*ends, g_a, g_b))
        if not isinstance(made, Failure):
            return CheckResult(MERGES, [choice], made.merged)
        if made.kind is FullVerdict.GRASP_BLOCKED:
            return CheckResult(BLOCKED, _sharing(g_a, g_b, made.robot == 0, made.robot == 1))
        return CheckResult(BLOCKED, self._blocked_alike(groups, action))

    def _blocked_alike(self, groups: tuple[Group, Group], action: tuple[int, ...]) -> Sequence[int]:
        """Return all choices that fail for the same reason: the groups, one gripper by itself, or both grippers."""
        (u_group, v_group), (u, v, k, l, choice) = groups, action  # noqa: E741
        merge = self._task.merge(TaskState(groups), (u, v, k, l))
        assert merge is not None

        def blocked(robot: int, group: Group, part: int, grasp: int) -> bool:
            grip = self._task.free_grip(group, part, grasp)
            return grip is None or not self._task.grip_fits(u_group, v_group, merge, grip, robot)

        g_a, g_b = divmod(choice, GRASPS)
        a, b = blocked(0, u_group, u, g_a), blocked(1, v_group, v, g_b)
        if a and b and not self._task.separates(u_group, v_group, merge):
            return range(GRASPS**2)
        return _sharing(g_a, g_b, a, b) or [choice]


def _sharing(g_a: int, g_b: int, a: bool, b: bool) -> list[int]:
    """Return the choices with `g_a` if `a`, whatever the other gripper does, and those with `g_b` if `b`."""
    return [x * GRASPS + y for x in range(GRASPS) for y in range(GRASPS) if (a and x == g_a) or (b and y == g_b)]
