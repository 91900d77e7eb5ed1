"""One chair, played again and again: what every merge led to is remembered, so that trying it once more costs nothing.

As in the paper, outcomes are remembered during training only; evaluation always plans. What is remembered is told by
the two groups (which parts, in which slots), the pair and `w`, not by where things lie: the verdict of the first time
stands for all later ones, although clutter or the planner's luck might have changed it (a few in a hundred merges near
the limit of the planner's budget).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Int, Int8

from roboassembly.planning.problem import Budget
from roboassembly.poses import SE3, pose_to_euler
from roboassembly.task.groups import Group, TaskState
from roboassembly.task.layout import free_spot, group_footprint
from roboassembly.task.object_centric import UP_AXES, ObjectCentricTask, Verdict

BUDGET = Budget(states=0)
"""Of the planner: straight retreats only. What they do not solve, a sampling planner seldom does."""
UNKNOWN, FAILS, MERGES = 0, 1, 2
"""What is known of an action."""
State = tuple[int, ...]
"""Names of its groups, ascending."""
Action = tuple[int, int, int]
"""Rows of the two points among all points of the chair, and `w`."""


@dataclass(frozen=True, eq=False)
class _Known:
    """A group that has come about."""

    group: Group
    """Where it came to rest the first time."""
    rows: Int[np.ndarray, "r"]
    """Of its free points."""


class Rehearsal:
    """An environment with a memory, for one chair.

    Args:
        task: of the chair.
        rng: of the one start that all episodes share.
    """

    def __init__(self, task: ObjectCentricTask, rng: np.random.Generator) -> None:
        self.task = task
        counts = [len(p.points) for p in task.furniture.parts]
        self.part = np.repeat(np.arange(len(counts)), counts)
        """Part of each row; the chair's points are numbered through."""
        self.point = np.concatenate([np.arange(n) for n in counts])
        self._groups: list[_Known] = []
        self._names: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = {}
        self._outcomes: dict[tuple[int, int, int, int], int | None] = {}
        """`(u's group, v's group, row, column)` to the merged group's name; None if the pair is wrong."""
        self._tables: dict[tuple[int, int], Int8[np.ndarray, "r c 6"]] = {}
        """For two groups, what is known of each of their free points' actions."""
        self._seed = int(rng.integers(2**31))
        initial = task.initial_state(rng)
        self.start: State = tuple(sorted(self._name(g) for g in initial.groups))
        self.planned = 0
        """Merges that were planned, not remembered."""

    def step(self, state: State, action: Action) -> State | None:
        """The state after a merge; None if the action fails. Takes an action that exists."""
        row, column, w = action
        one, two = self.owner(state, row), self.owner(state, column)
        table = self._table(one, two)
        where = (self._index(one, row), self._index(two, column), w)
        if table[where] == UNKNOWN:
            self._try(state, one, two, action, table, where)
        if table[where] == FAILS:
            return None
        merged = self._outcomes[one, two, row, column]
        assert merged is not None
        return tuple(sorted((*(g for g in state if g not in (one, two)), merged)))

    def _try(self, state: State, one: int, two: int, action: Action, table: np.ndarray, where: Action) -> None:
        row, column, w = action
        key = (one, two, row, column)
        u, k, v, l = self.part[row], self.point[row], self.part[column], self.point[column]  # noqa: E741
        if key not in self._outcomes:
            merge = self.task.pairs.judge(self._groups[one].group, self._groups[two].group, u, k, v, l)
            if merge is None:
                self._outcomes[key] = self._outcomes[two, one, column, row] = None
                table[where[0], where[1]] = FAILS
                self._table(two, one)[where[1], where[0]] = FAILS
                return
        words = np.random.SeedSequence([self._seed, *key, w]).generate_state(1)
        names = tuple(int(n) for n in (u, v, k, l, w))
        outcome = self.task.step(self.laid_out(state), names, int(words[0]), BUDGET)
        self.planned += 1
        if outcome.verdict is not Verdict.MERGED:
            table[where] = FAILS
            return
        table[where] = MERGES
        merged = next(g for g in outcome.state.groups if u in g.parts)
        self._outcomes[key] = self._name(merged)

    def done(self, state: State) -> bool:
        """All parts in one group."""
        return len(state) == 1

    def known(self, state: State) -> Int8[np.ndarray, "n n 6"]:
        """What is known of each action of a state: `UNKNOWN`, `FAILS` or `MERGES`; `FAILS` where it does not exist."""
        n = len(self.part)
        out = np.full((n, n, len(UP_AXES)), FAILS, np.int8)
        for one in state:
            rows = self._groups[one].rows
            for two in state:
                if one != two:
                    out[np.ix_(rows, self._groups[two].rows)] = self._table(one, two)
        return out

    def exists(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Which pairs of points exist: both free, in different groups."""
        owner = np.full(len(self.part), -1)
        for name in state:
            owner[self._groups[name].rows] = name
        return (owner[:, None] != owner[None]) & (owner >= 0)[:, None] & (owner >= 0)[None]

    def connections(self, state: State) -> Float32[np.ndarray, "P P 6"]:
        """Poses of parts in the frames of other parts of their group, as in the observation."""
        n = len(self.task.furniture.parts)
        out = np.zeros((n, n, 6), np.float32)
        for name in state:
            for i, j, row in self._relative(name):
                out[i, j] = row
        return out

    def laid_out(self, state: State) -> TaskState:
        """The groups on the ground, each as it came to rest: single parts where they began, others in free spots."""
        groups = sorted((self._groups[name].group for name in state), key=lambda g: (len(g.parts), g.parts))
        placed: list[Group] = []
        taken = []
        for group in groups:
            circle = group_footprint(self.task.furniture, group)
            shift = np.array([*(free_spot(circle, taken) - circle.center), 0.0])
            placed.append(group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture))
            taken.append(group_footprint(self.task.furniture, placed[-1]))
        return TaskState(tuple(placed))

    def owner(self, state: State, row: int) -> int:
        """Name of the group that a point belongs to."""
        part = self.part[row]
        return next(name for name in state if part in self._groups[name].group.parts)

    def _name(self, group: Group) -> int:
        key = (group.parts, group.slots)
        if key not in self._names:
            self._names[key] = len(self._groups)
            occupied = TaskState((group,)).occupied(self.task.furniture)
            inside = np.isin(self.part, group.parts)
            rows = [r for r in np.flatnonzero(inside) if (self.part[r], self.point[r]) not in occupied]
            self._groups.append(_Known(group, np.array(rows, dtype=int)))
        return self._names[key]

    def _index(self, name: int, row: int) -> int:
        return int(np.searchsorted(self._groups[name].rows, row))

    def _table(self, one: int, two: int) -> Int8[np.ndarray, "r c 6"]:
        if (one, two) not in self._tables:
            shape = (len(self._groups[one].rows), len(self._groups[two].rows), len(UP_AXES))
            self._tables[one, two] = np.zeros(shape, np.int8)
        return self._tables[one, two]

    @cached_property
    def _relatives(self) -> dict[int, list[tuple[int, int, np.ndarray]]]:
        return {}

    def _relative(self, name: int) -> Iterable[tuple[int, int, np.ndarray]]:
        if name not in self._relatives:
            group = self._groups[name].group
            pairs = list(zip(group.parts, group.furniture_from_part, strict=True))
            self._relatives[name] = [
                (i, j, pose_to_euler(a.actInv(b)).astype(np.float32)) for i, a in pairs for j, b in pairs if i != j
            ]
        return self._relatives[name]
