"""One chair, played again and again: what every merge led to is remembered, so that trying it once more costs nothing.

As in the paper, outcomes are remembered during training only; evaluation always plans. What is remembered is told by
the two groups (which parts, in which slots), the pair and `w`, not by where things lie: the verdict of the first time
stands for all later ones, although clutter or the planner's luck might have changed it. A chair that an expert masters
here is therefore played in the real environment before it counts, and what fails there is taken over (`correct`).

Two rules of the task are used, no knowledge of the chair: a wrong pair is wrong with every `w` and with the roles of
the two groups swapped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int, Int8

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_PARTS
from roboassembly.learning.layers import Params
from roboassembly.planning.problem import Budget
from roboassembly.poses import SE3
from roboassembly.task.groups import Group, TaskState
from roboassembly.task.layout import free_spot, group_footprint
from roboassembly.task.object_centric import UP_AXES, ObjectCentricTask, Verdict

BUDGET = Budget(states=0)
"""Of the planner: straight retreats only. What they do not solve, a sampling planner seldom does."""
UNKNOWN, FAILS, MERGES = 0, 1, 2
"""What is known of an action."""
WAYS = len(UP_AXES)
_CACHED = 1_500
"""States whose table of what is known is kept."""
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


class _Table:
    """Rows of integers that are only ever added to."""

    def __init__(self, width: int) -> None:
        self._rows = np.zeros((256, width), np.int32)
        self.count = 0

    def append(self, *row: int) -> None:
        if self.count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self.count] = row
        self.count += 1

    def since(self, first: int) -> np.ndarray:
        return self._rows[first : self.count]


class Rehearsal:
    """An environment with a memory, for one chair.

    Args:
        task: of the chair.
        seed: of the one start that all episodes share, and of the planner.
    """

    def __init__(self, task: ObjectCentricTask, seed: int) -> None:
        self.task, self._seed = task, seed
        counts = [len(p.points) for p in task.furniture.parts]
        self.part = np.repeat(np.arange(len(counts)), counts)
        """Part of each row; the chair's points are numbered through."""
        self.point = np.concatenate([np.arange(n) for n in counts])
        self._groups: list[_Known] = []
        self._names: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = {}
        self._wrong = _Table(4)
        """u's group, v's group and rows of pairs that are wrong, in one of the two directions."""
        self._ways = _Table(6)
        """u's group, v's group, rows, `w` and the merged group, -1 where there is none."""
        self._outcomes: dict[tuple[int, int, int, int, int], int] = {}
        """The same as `_ways`, to look up."""
        self._cache: dict[State, tuple[int, int, Int8[np.ndarray, "n n 6"]]] = {}
        self.tried = np.zeros((2, len(self.part), len(self.part)), np.int32)
        """How often two points were found to be a wrong pair, and a right one, whatever the groups; symmetric."""
        self.planned = 0
        """Merges that were planned, not remembered."""
        initial = task.initial_state(np.random.default_rng(seed))
        self.start: State = tuple(sorted(self._name(g) for g in initial.groups))

    def step(self, state: State, action: Action) -> State | None:
        """The state after a merge; None if the action fails. Takes an action that exists."""
        row, column, w = action
        one, two = self.owner(state, row), self.owner(state, column)
        known = self.known(state)[row, column, w]
        if known == UNKNOWN:
            self._try(state, one, two, action)
            known = self.known(state)[row, column, w]
        return self.after(state, action) if known == MERGES else None

    def after(self, state: State, action: Action) -> State:
        """The state after an action that is known to merge."""
        row, column, w = action
        one, two = self.owner(state, row), self.owner(state, column)
        return tuple(sorted((*(g for g in state if g not in (one, two)), self._outcomes[one, two, row, column, w])))

    def _try(self, state: State, one: int, two: int, action: Action) -> None:
        row, column, w = action
        u, k, v, l = (int(i) for i in (self.part[row], self.point[row], self.part[column], self.point[column]))  # noqa: E741
        merge = self.task.pairs.judge(self._groups[one].group, self._groups[two].group, u, k, v, l)
        right = merge is not None
        self.tried[int(right), row, column] += 1
        self.tried[int(right), column, row] += 1
        if merge is None:
            self._wrong.append(one, two, row, column)
            return
        self.planned += 1
        seed = int(np.random.SeedSequence([self._seed, one, two, row, column, w]).generate_state(1)[0])
        before, names = self.laid_out(state), (u, v, k, l, w)
        name = self._names.get((merge.merged.parts, merge.merged.slots))
        if name is None:
            outcome = self.task.step(before, names, seed, BUDGET)
            if outcome.verdict is Verdict.MERGED:
                name = self._name(next(g for g in outcome.state.groups if u in g.parts))
        else:
            # How it comes to rest is known; only whether it comes about is not.
            mating = self.task.prepare(before, names)
            assert mating is not None
            if not self.task.plan(mating, seed, BUDGET).solved:
                name = None
        self._remember(one, two, row, column, w, -1 if name is None else name)

    def _remember(self, *row: int) -> None:
        self._ways.append(*row)
        self._outcomes[row[0], row[1], row[2], row[3], row[4]] = row[5]

    def correct(self, state: State, action: Action) -> None:
        """From now on the action fails wherever these two groups meet."""
        row, column, w = action
        self._remember(self.owner(state, row), self.owner(state, column), row, column, w, -1)

    def known(self, state: State) -> Int8[np.ndarray, "n n 6"]:
        """What is known of each action of a state: `UNKNOWN`, `FAILS` or `MERGES`. Not to be changed."""
        n = len(self.part)
        cached = self._cache.pop(state, None)
        wrong, ways, out = cached or (0, 0, np.zeros((n, n, WAYS), np.int8))
        here = np.zeros(len(self._groups), bool)
        here[list(state)] = True
        fresh = self._wrong.since(wrong)
        fresh = fresh[here[fresh[:, 0]] & here[fresh[:, 1]]]
        out[fresh[:, 2], fresh[:, 3]] = out[fresh[:, 3], fresh[:, 2]] = FAILS
        fresh = self._ways.since(ways)
        fresh = fresh[here[fresh[:, 0]] & here[fresh[:, 1]]]
        out[fresh[:, 2], fresh[:, 3], fresh[:, 4]] = np.where(fresh[:, 5] < 0, FAILS, MERGES)
        self._cache[state] = (self._wrong.count, self._ways.count, out)
        if len(self._cache) > _CACHED:
            del self._cache[next(iter(self._cache))]
        return out

    def owners(self, state: State) -> Int[np.ndarray, "n"]:
        """The group of each free point of a state, -1 for others. Pairs exist between points of different groups."""
        owner = np.full(len(self.part), -1)
        for name in state:
            owner[self._groups[name].rows] = name
        return owner

    def joined(self, state: State) -> Bool[np.ndarray, "20 20"]:
        """Which parts are in one group, each with itself too; padded."""
        out = np.zeros((MAX_PARTS, MAX_PARTS), bool)
        for name in state:
            parts = self._groups[name].group.parts
            out[np.ix_(parts, parts)] = True
        return out

    def exists(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Which pairs of points exist: both free, in different groups."""
        owner = self.owners(state)
        return (owner[:, None] != owner[None]) & (owner >= 0)[:, None] & (owner >= 0)[None]

    def owner(self, state: State, row: int) -> int:
        """Name of the group that a point belongs to."""
        part = self.part[row]
        return next(name for name in state if part in self._groups[name].group.parts)

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

    def _name(self, group: Group) -> int:
        key = (group.parts, group.slots)
        if key not in self._names:
            self._names[key] = len(self._groups)
            occupied = TaskState((group,)).occupied(self.task.furniture)
            inside = np.isin(self.part, group.parts)
            rows = [r for r in np.flatnonzero(inside) if (self.part[r], self.point[r]) not in occupied]
            self._groups.append(_Known(group, np.array(rows, dtype=int)))
        return self._names[key]

    def to_arrays(self) -> Params:
        """All that is remembered."""
        members = [(name, *pair) for name, g in enumerate(self._groups) for pair in zip(*_labels(g.group), strict=True)]
        poses = [p.homogeneous for g in self._groups for p in (g.group.world_from_furniture, *_turned(g.group))]
        return {
            "members": np.array(members, np.int32),
            "poses": np.array(poses),
            "wrong": self._wrong.since(0).copy(),
            "ways": self._ways.since(0).copy(),
            "tried": self.tried,
            "planned": np.array(self.planned),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what another one with the same chair and seed remembered.

        Raises:
            InputError: it was of another chair or seed.
        """
        members, poses = arrays["members"], [SE3(h[:3, :3], h[:3, 3]) for h in arrays["poses"]]
        first = 0
        for name in range(int(members[-1, 0]) + 1):
            labels = members[members[:, 0] == name, 1:]
            ours = poses[first + 1 : first + 1 + len(labels)]
            parts, slots = (tuple(int(i) for i in column) for column in labels.T)
            if self._name(Group(parts, slots, tuple(ours), poses[first])) != name:
                raise InputError("what was remembered is of another chair or seed; remove the file, or name another")
            first += 1 + len(labels)
        for row in arrays["wrong"].tolist():
            self._wrong.append(*row)
        for row in arrays["ways"].tolist():
            self._remember(*row)
        self.tried, self.planned = arrays["tried"].copy(), int(arrays["planned"])
        self._cache.clear()


def _labels(group: Group) -> tuple[tuple[int, ...], tuple[int, ...]]:
    return group.parts, group.slots


def _turned(group: Group) -> tuple[SE3, ...]:
    return group.furniture_from_part
