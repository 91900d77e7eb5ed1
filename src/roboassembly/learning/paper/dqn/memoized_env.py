"""The environment of one expert: the outcome of each merge is remembered, so that trying it again costs nothing.

As in the paper, outcomes are remembered in training only; evaluation always plans. An outcome is stored for the two
groups (their shapes), how they come together, and the action branch, not for where things lie: the first verdict holds
from then on, although clutter or the planner's luck might have changed it. A chair that an expert masters here is
therefore assembled in the real environment before it counts, and what fails there is taken over (`mark_failed`).

No knowledge of the chair is used, but rules that hold for all furniture and that an agent can see:

- a wrong pair is wrong with every choice and with the roles of the two groups swapped;
- two pairs of points that bring the same groups together in the same relative pose are the same action;
- parts of equal shape with equal points are equal: what is known of one leg is known of all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Int, Int8

from roboassembly.errors import InputError
from roboassembly.furniture.model import PAPER_PARTS
from roboassembly.geometry.poses import SE3
from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.group_table import GroupTable, GroupType, RowTable, TypedGroup
from roboassembly.learning.paper.dqn.mate_geometry import MateGeometry
from roboassembly.settings import SETTINGS
from roboassembly.solvers.mate_checks import FAILS, MERGES, UNKNOWN
from roboassembly.task.full.task import FullTask
from roboassembly.task.layout import free_spot
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.groups import Circle, Group, TaskState, group_footprint
from roboassembly.task.setting import Task

_CACHED = 150e6
"""Largest size of the cached tables of knowledge, one a state [bytes]."""
State = tuple[int, ...]
"""Numbers of the groups of a state, ascending."""
Action = tuple[int, int, int]
"""Rows of the two points among all points of the chair, and number of the choice: `w`, or `8 g_a + g_b`."""


@dataclass(frozen=True)
class FailedMates:
    """Mates that fail in the real environment, wherever two groups of such types meet."""

    types: tuple[int, int]
    """Types of u's and v's group."""
    mates: frozenset[tuple[int, int]]
    """Points of each mate, as numbers among those of each type."""
    choice: int
    """Number of the combination of choices."""


class MemoizedEnv:
    """An environment with a memory, for one chair.

    Args:
        task: task of the chair, in either setting.
        seed: random seed of the single start that all episodes share, and of the planner.
    """

    def __init__(self, task: ObjectCentricTask | FullTask, seed: int) -> None:
        self.task, self.seed = task, seed
        self.choices = int(np.prod(task.action_branches))
        """Number of choices of each pair of points, over all action branches."""
        self.check = SETTINGS[task.setting].make_mate_check(task)
        rng = np.random.default_rng(seed)
        initial = _initial_groups(task, rng)
        self.table = GroupTable(task, initial.groups, self.check.by_part)
        self.part, self.point, self.equal_part = self.table.part, self.table.point, self.table.equal_part
        self.geometry = MateGeometry(self.table, lambda: self.right_pairs)
        self._knowledge = RowTable(6)
        """Types of u's and v's group, points among those of the types, choice (-1: all), and what is known."""
        self._outcomes: dict[tuple[int, int, int, int], int] = {}
        """Merged group by two groups and their points. (Its slots depend on the very parts.)"""
        self._cache: dict[State, tuple[int, Int8[np.ndarray, "n n w"]]] = {}
        n = len(self.part)
        self._tried = np.zeros((2, n, n), np.int32)
        self._outcome_counts = np.zeros((2, n, n, self.choices), np.int32)
        self.planned = 0
        """Number of merges that were planned, not remembered."""
        self.start: State = tuple(sorted(self._see(self.table.single_part(p)) for p in range(len(self.equal_part))))

    @property
    def tried(self) -> Int[np.ndarray, "2 n n"]:
        """Number of times that two points were found to be a wrong pair, and a right pair, in any groups; symmetric."""
        return self._tried[:, self.table.equal_row][:, :, self.table.equal_row]

    @property
    def right_pairs(self) -> Bool[np.ndarray, "n n"]:
        """Whether two points were ever found to be a right pair, in any groups; symmetric."""
        return self.tried[1] > 0

    def outcome_counts(self, row: int | np.ndarray, column: int | np.ndarray) -> Int[np.ndarray, "2 *k w"]:
        """Return how often right pairs of points failed, and merged, with each choice, in any groups."""
        return self._outcome_counts[:, self.table.equal_row[row], self.table.equal_row[column]]

    def step(self, state: State, action: Action) -> State | None:
        """Return the state after an existing action; None if the action fails."""
        known = self.known(state)[action]
        if known >= FAILS:
            return None
        row, column, _ = action
        u_id, v_id = self.table.owner(state, row), self.table.owner(state, column)
        key = (u_id, v_id, self.table.local(u_id, row), self.table.local(v_id, column))
        if (known == UNKNOWN or key not in self._outcomes) and not self._try(state, action, key):
            return None
        return tuple(sorted((*(g for g in state if g not in (u_id, v_id)), self._outcomes[key])))

    def _try(self, state: State, action: Action, key: tuple[int, int, int, int]) -> bool:
        """Carry out a step as far as its outcome is unknown; returns whether it merges."""
        row, column, choice = action
        u_id, v_id = key[:2]
        names = (int(self.part[row]), int(self.part[column]), int(self.point[row]), int(self.point[column]), choice)
        groups = self.table.group(u_id), self.table.group(v_id)
        merge = self.task.rules.pairs.judge(*groups, names[0], names[2], names[1], names[3])
        mates = self.geometry.same_mates(u_id, v_id, row, column)
        if merge is None:
            self._count(self._tried[0], u_id, v_id, mates)
            self._count(self._tried[0].T, u_id, v_id, mates)
            self._record(u_id, v_id, mates, -1, FAILS)
            self._record(v_id, u_id, mates[:, ::-1], -1, FAILS)
            return False
        type_key = self.table.key(merge.merged)
        merges = bool(self.known(state)[action] == MERGES)
        if not merges:
            fitting = np.count_nonzero(self._tried[1])
            self._count(self._tried[1], u_id, v_id, mates)
            self._count(self._tried[1].T, u_id, v_id, mates)
            if np.count_nonzero(self._tried[1]) > fitting:
                self.geometry.forget_fits()
        if not merges or type_key not in self.table.type_ids:
            self.planned += 1
            types = self._types_of(u_id, v_id)
            seed = int(np.random.SeedSequence([self.seed, *types, *key[2:], choice]).generate_state(1)[0])
            shape_known = type_key in self.table.type_ids
            result = self.check(groups, lambda: self.laid_out(state), names, seed, shape_known)
            if result.merged is not None and type_key not in self.table.type_ids:
                self.table.type_id(result.merged, type_key)
            merges = result.knowledge == MERGES
            if self.check.by_part:
                mates = self._of_same_parts(u_id, v_id, mates)
            for alike in result.choices:
                self._count(self._outcome_counts[int(merges), :, :, alike], u_id, v_id, mates)
                self._record(u_id, v_id, mates, alike, result.knowledge)
        if merges:
            part_in = dict(zip(merge.merged.slots, merge.merged.parts, strict=True))
            type_id = self.table.type_ids[type_key]
            parts = tuple(part_in[slot] for slot in self.table.types[type_id].slots)
            self._outcomes[key] = self._see(self.table.group_id(type_id, parts))
        return merges

    def _of_same_parts(self, u_id: int, v_id: int, mates: Int[np.ndarray, "a 2"]) -> Int[np.ndarray, "a 2"]:
        """Return the pairs of points between the same two parts as the first."""
        parts = [self.part[self.table.groups[g].rows[mates[:, i]]] for i, g in enumerate((u_id, v_id))]
        return mates[(parts[0] == parts[0][0]) & (parts[1] == parts[1][0])]

    def _types_of(self, u_id: int, v_id: int) -> tuple[int, int]:
        return self.table.groups[u_id].type_id, self.table.groups[v_id].type_id

    def _count(self, counts: np.ndarray, u_id: int, v_id: int, mates: Int[np.ndarray, "a 2"]) -> None:
        groups = enumerate((u_id, v_id))
        rows, columns = (self.table.equal_row[self.table.groups[g].rows[mates[:, i]]] for i, g in groups)
        counts[rows, columns] += 1

    def _record(self, u_id: int, v_id: int, mates: Int[np.ndarray, "a 2"], choice: int, knowledge: int) -> None:
        types = self._types_of(u_id, v_id)
        for k, l in mates.tolist():  # noqa: E741
            self._knowledge.append(*types, k, l, choice, knowledge)

    def mark_failed(self, state: State, action: Action) -> FailedMates:
        """Let the action fail from now on wherever such groups meet; returns where that is."""
        row, column, choice = action
        u_id, v_id = self.table.owner(state, row), self.table.owner(state, column)
        mates = self.geometry.same_mates(u_id, v_id, row, column)
        if self.check.by_part:
            mates = self._of_same_parts(u_id, v_id, mates)
        self._record(u_id, v_id, mates, choice, FAILS)
        types = self._types_of(u_id, v_id)
        return FailedMates(types, frozenset((k, l) for k, l in mates.tolist()), choice)  # noqa: E741

    def has_types_of(self, state: State, failed: FailedMates) -> bool:
        """Return whether a state has groups of both types of a failure."""
        return {self.table.groups[group_id].type_id for group_id in state}.issuperset(failed.types)

    def is_among(self, failed: FailedMates, state: State, action: Action) -> bool:
        """Return whether an action of a state is one of those that fail."""
        row, column, choice = action
        u_id, v_id = self.table.owner(state, row), self.table.owner(state, column)
        types = self._types_of(u_id, v_id)
        if choice != failed.choice or types != failed.types:
            return False
        return (self.table.local(u_id, row), self.table.local(v_id, column)) in failed.mates

    def known(self, state: State) -> Int8[np.ndarray, "n n w"]:
        """Return what is known of each action of a state: `UNKNOWN`, `MERGES`, `FAILS` or `BLOCKED`; do not write."""
        n = len(self.part)
        since, out = self._cache.pop(state, None) or (0, np.zeros((n, n, self.choices), np.int8))
        fresh = self._knowledge.since(since)
        if len(fresh):
            members: dict[int, list[TypedGroup]] = {}
            for group_id in state:
                members.setdefault(self.table.groups[group_id].type_id, []).append(self.table.groups[group_id])
            here = np.zeros(len(self.table.types), bool)
            here[list(members)] = True
            fresh = fresh[here[fresh[:, 0]] & here[fresh[:, 1]]]
            pairs = fresh[:, 0].astype(np.int64) * len(self.table.types) + fresh[:, 1]
            order = np.argsort(pairs, kind="stable")
            starts = np.flatnonzero(np.diff(pairs[order], prepend=-1))
            for rows in np.split(fresh[order], starts[1:]) if len(fresh) else ():
                choice = np.where(rows[:, 4] < 0, 0, rows[:, 4])
                knowledge = rows[:, 5].astype(np.int8)
                whole = rows[:, 4] < 0
                for u in members[int(rows[0, 0])]:
                    for v in members[int(rows[0, 1])]:
                        if u is not v:
                            r, c = u.rows[rows[:, 2]], v.rows[rows[:, 3]]
                            out[r, c, choice] = knowledge
                            out[r[whole], c[whole]] = FAILS
        self._cache[state] = (self._knowledge.count, out)
        if len(self._cache) * out.nbytes > _CACHED:
            del self._cache[next(iter(self._cache))]
        return out

    def owners(self, state: State) -> Int[np.ndarray, "n"]:
        """Return the group of each free point of a state, -1 for other points."""
        owner = np.full(len(self.part), -1)
        for group_id in state:
            owner[self.table.groups[group_id].rows[self.table.free(group_id)]] = group_id
        return owner

    def joined(self, state: State) -> Bool[np.ndarray, "20 20"]:
        """Return which parts are in one group, each with itself too; padded."""
        out = np.zeros((PAPER_PARTS, PAPER_PARTS), bool)
        for group_id in state:
            parts = self.table.groups[group_id].parts
            out[np.ix_(parts, parts)] = True
        return out

    def exists(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Return which pairs of points exist: both free, in different groups."""
        owner = self.owners(state)
        return (owner[:, None] != owner[None]) & (owner >= 0)[:, None] & (owner >= 0)[None]

    def members(self, state: State) -> list[tuple[int, ...]]:
        """Return the parts of each group of a state."""
        return [self.table.groups[group_id].parts for group_id in state]

    def laid_out(self, state: State) -> TaskState:
        """Return the groups on the ground, each as it came to rest: single parts where they began, others beside."""
        groups = sorted((self.table.group(group_id) for group_id in state), key=lambda g: (len(g.parts), g.parts))
        placed: list[Group] = []
        footprints: list[Circle] = []
        for group in groups:
            circle = group_footprint(self.task.furniture, group)
            shift = np.array([*(free_spot(circle, footprints) - circle.center), 0.0])
            placed.append(group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture))
            footprints.append(group_footprint(self.task.furniture, placed[-1]))
        return TaskState(tuple(placed))

    def _see(self, group_id: int) -> int:
        """Record that a group has occurred; returns its number."""
        self.geometry.see(group_id)
        return group_id

    def to_arrays(self) -> Params:
        """Return all that is remembered."""
        table = self.table
        fills = {type_id: [fill for _, fill in key] for key, type_id in table.type_ids.items()}
        slots = [(i, s, f) for i, t in enumerate(table.types) for s, f in zip(t.slots, fills[i], strict=True)]
        parts = [(i, g.type_id, p) for i, g in enumerate(table.groups) for p in g.parts]
        return {
            "slots": np.array(slots, np.int32),
            "poses": np.array([p.homogeneous for t in table.types for p in t.poses]),
            "worlds": np.array([t.world.homogeneous for t in table.types]),
            "free": np.array([(i, f) for i, t in enumerate(table.types) for f in t.free], np.int32).reshape(-1, 2),
            "groups": np.array(parts, np.int32),
            "knowledge": self._knowledge.since(0).copy(),
            "outcomes": np.array([(*key, g) for key, g in self._outcomes.items()], np.int32).reshape(-1, 5),
            "tried": self._tried.copy(),
            "outcome_counts": self._outcome_counts.copy(),
            "planned": np.array(self.planned),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what the environment of the same chair and seed remembered.

        Raises:
            InputError: it was of another chair.
        """
        if arrays["tried"].shape != self._tried.shape:
            raise InputError("the remembered outcomes are of another chair; remove the file, or name another")
        table = self.table
        poses = [SE3(h[:3, :3], h[:3, 3]) for h in arrays["poses"]]
        worlds = [SE3(h[:3, :3], h[:3, 3]) for h in arrays["worlds"]]
        slots, free = arrays["slots"], arrays["free"]
        for index, world in enumerate(worlds):
            rows = np.flatnonzero(slots[:, 0] == index)
            if index >= len(table.types):
                free_here = free[free[:, 0] == index, 1].astype(int)
                own_poses = tuple(poses[i] for i in rows)
                table.types.append(GroupType(tuple(slots[rows, 1].tolist()), own_poses, world, free_here))
                table.type_ids[tuple((s, f) for _, s, f in slots[rows].tolist())] = index
        groups = arrays["groups"]
        for index in range(int(groups[-1, 0]) + 1):
            rows = groups[groups[:, 0] == index]
            self._see(table.group_id(int(rows[0, 1]), tuple(rows[:, 2].tolist())))
        for row in arrays["knowledge"].tolist():
            self._knowledge.append(*row)
        for row in arrays["outcomes"].tolist():
            self._outcomes[row[0], row[1], row[2], row[3]] = row[4]
        self._tried, self._outcome_counts = arrays["tried"].copy(), arrays["outcome_counts"].copy()
        self.planned = int(arrays["planned"])
        self._cache.clear()


def _initial_groups(task: Task[Any, Any], rng: np.random.Generator) -> TaskState:
    """Groups of a state in which an episode begins, in either setting."""
    return task.groups_of(task.initial_state(rng))
