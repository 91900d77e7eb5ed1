"""What it takes to find out what a merge leads to, in a rehearsal: of parts that fly, and of parts that hands hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from roboassembly.planning.problem import Budget
from roboassembly.task.full.failure import Failure, FullVerdict
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask, ObjectCentricVerdict
from roboassembly.task.rules.connections import GRASPS
from roboassembly.task.rules.groups import Group, TaskState

BUDGET = Budget(states=0)
"""Of the planner: straight retreats only. What they do not solve, a sampling planner seldom does."""
UNKNOWN, MERGES, FAILS, BLOCKED = range(4)
"""What is known of an action; it fails from `FAILS` on: a wrong pair or a goal in collision, or no way to the goal."""
_KNOWN = {ObjectCentricVerdict.MERGED: MERGES, ObjectCentricVerdict.GOAL_IN_COLLISION: FAILS}


@dataclass(frozen=True, eq=False)
class Found:
    """What a right pair led to."""

    verdict: int
    """`MERGES`, `FAILS` or `BLOCKED`."""
    ways: Sequence[int]
    """All ways of which it is now known."""
    merged: Group | None = None
    """Both groups as one, where it came about and was asked for."""


class Trial(Protocol):
    """How a right pair is tried."""

    roles_matter: bool
    """Whether a way tells much of the same way with the roles of the two groups swapped."""
    by_part: bool
    """Whether a way is told by the two parts, so that it says nothing of other parts of the same groups."""
    patience: tuple[int, int]
    """Ways that do not work after which a play gives two groups up; the same with few groups left."""

    def __call__(
        self, groups: tuple[Group, Group], laid_out: Callable[[], TaskState], names: tuple[int, ...], seed: int,
        shape_known: bool,
    ) -> Found:  # fmt: skip
        """Try it.

        Args:
            groups: u's and v's.
            laid_out: makes the whole state.
            names: `(u, v, k, l)` and the number of the way.
            seed: of the planner.
            shape_known: what comes of it is known, only not whether.
        """
        ...


class Flying:
    """Parts move by themselves: a path has to be there, and what is joined falls."""

    roles_matter: bool = True
    by_part: bool = False
    patience: tuple[int, int] = (2, 6)

    def __init__(self, task: ObjectCentricTask) -> None:
        self._task = task

    def __call__(
        self, groups: tuple[Group, Group], laid_out: Callable[[], TaskState], names: tuple[int, ...], seed: int,
        shape_known: bool,
    ) -> Found:  # fmt: skip
        """As `Trial`."""
        before = laid_out()
        if shape_known:
            # How it comes to rest is known, too.
            mating = self._task.prepare(before, names)
            assert mating is not None
            result = self._task.plan(mating, seed, BUDGET)
            verdict = ObjectCentricVerdict.MERGED if result.solved else ObjectCentricVerdict(result.status.value)
            return Found(_KNOWN.get(verdict, BLOCKED), names[4:])
        outcome = self._task.step(before, names, seed, BUDGET)
        merged = None
        if outcome.verdict is ObjectCentricVerdict.MERGED:
            merged = next(g for g in outcome.state.groups if names[0] in g.parts)
        return Found(_KNOWN.get(outcome.verdict, BLOCKED), names[4:], merged)


class Held:
    """Two hands hold the groups. Everything is tested but the arms: what they cannot do comes out in the plays in the
    real environment by which a chair counts as mastered, and is taken over then."""

    roles_matter: bool = False
    by_part: bool = True
    patience: tuple[int, int] = (10, 40)

    def __init__(self, task: FullTask) -> None:
        self._task = task

    def __call__(
        self, groups: tuple[Group, Group], laid_out: Callable[[], TaskState], names: tuple[int, ...], seed: int,
        shape_known: bool,
    ) -> Found:  # fmt: skip
        """As `Trial`."""
        *ends, way = names
        g_a, g_b = divmod(way, GRASPS)
        joint = self._task.mate_grasp(TaskState(groups), (*ends, g_a, g_b))
        if not isinstance(joint, Failure):
            return Found(MERGES, [way], joint.merge.merged)
        if joint.kind is FullVerdict.GRASP_BLOCKED:
            return Found(BLOCKED, _sharing(g_a, g_b, joint.robot == 0, joint.robot == 1))
        return Found(BLOCKED, self._as_blocked(groups, names))

    def _as_blocked(self, groups: tuple[Group, Group], names: tuple[int, ...]) -> Sequence[int]:
        """All ways that are blocked at the joint by what blocks this one: the groups, one hand by itself, or both."""
        (one, two), (u, v, k, l, way) = groups, names  # noqa: E741
        merge = self._task.merge(TaskState(groups), (u, v, k, l))
        assert merge is not None

        def blocked(robot: int, group: Group, part: int, grasp: int) -> bool:
            held = self._task.free_grip(group, part, grasp)
            return held is None or not self._task.grip_fits(one, two, merge, held, robot)

        g_a, g_b = divmod(way, GRASPS)
        a, b = blocked(0, one, u, g_a), blocked(1, two, v, g_b)
        if a and b and not self._task.separates(one, two, merge):
            return range(GRASPS**2)
        return _sharing(g_a, g_b, a, b) or [way]


def _sharing(g_a: int, g_b: int, a: bool, b: bool) -> list[int]:
    """The ways with `g_a`, whatever the other hand does, those with `g_b`, or both."""
    return [x * GRASPS + y for x in range(GRASPS) for y in range(GRASPS) if (a and x == g_a) or (b and y == g_b)]


def trial_of(task: ObjectCentricTask | FullTask) -> Trial:
    """How the task's right pairs are tried."""
    return Held(task) if isinstance(task, FullTask) else Flying(task)
