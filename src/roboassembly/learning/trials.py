"""What it takes to find out what a merge leads to, in a rehearsal: of parts that fly, and of parts that hands hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from roboassembly.planning.problem import Budget
from roboassembly.task.full import FullTask, FullVerdict, Refusal
from roboassembly.task.groups import Group, TaskState
from roboassembly.task.object_centric import ObjectCentricTask, Verdict
from roboassembly.task.rules import GRASPS

BUDGET = Budget(states=0)
"""Of the planner: straight retreats only. What they do not solve, a sampling planner seldom does."""
UNKNOWN, MERGES, FAILS, BLOCKED = range(4)
"""What is known of an action; it fails from `FAILS` on: a wrong pair or a goal in collision, or no way to the goal."""
_KNOWN = {Verdict.MERGED: MERGES, Verdict.GOAL_IN_COLLISION: FAILS}


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
            verdict = Verdict.MERGED if result.solved else Verdict(result.status.value)
            return Found(_KNOWN.get(verdict, BLOCKED), names[4:])
        outcome = self._task.step(before, names, seed, BUDGET)
        merged = None
        if outcome.verdict is Verdict.MERGED:
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
        joint = self._task.joint(TaskState(groups), (*ends, g_a, g_b))
        if not isinstance(joint, Refusal):
            return Found(MERGES, [way], joint.merge.merged)
        if joint.verdict is FullVerdict.GRASP_BLOCKED:
            # Whatever the other hand does.
            u_is = joint.leg == "grasp u"
            return Found(BLOCKED, [g_a * GRASPS + g if u_is else g * GRASPS + g_b for g in range(GRASPS)])
        return Found(BLOCKED, [way])


def trial_of(task: ObjectCentricTask | FullTask) -> Trial:
    """How the task's right pairs are tried."""
    return Held(task) if isinstance(task, FullTask) else Flying(task)
