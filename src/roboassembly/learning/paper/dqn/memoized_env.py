"""One chair, played again and again: what every merge led to is remembered, so that trying it once more costs nothing.

As in the paper, outcomes are remembered during training only; evaluation always plans. What is remembered is told by
the two groups (their shapes), how they come together, and `w`, not by where things lie: the verdict of the first time
stands for all later ones, although clutter or the planner's luck might have changed it. A chair that an expert masters
here is therefore played in the real environment before it counts, and what fails there is taken over (`correct`).

No knowledge of the chair is used, but rules that hold for all furniture and that a learner can see:

- a wrong pair is wrong with every `w` and with the roles of the two groups swapped;
- two pairs of points that bring the same groups together in the same relative pose are the same action;
- parts of equal shape with equal points are equal: what is known of one leg is known of all.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int, Int8

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_PARTS
from roboassembly.geometry.poses import SE3
from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.group_table import Kind, Named, Registry, Table
from roboassembly.learning.paper.dqn.mates import Joints
from roboassembly.learning.paper.dqn.trials import FAILS, MERGES, UNKNOWN, trial_of
from roboassembly.task.full.task import FullTask
from roboassembly.task.layout import free_spot
from roboassembly.task.object_centric.task import ObjectCentricTask
from roboassembly.task.rules.groups import Group, TaskState, group_footprint

_CACHED = 150e6
"""Bytes of tables of what is known that are kept, each of one state."""
State = tuple[int, ...]
"""Names of its groups, ascending."""
Action = tuple[int, int, int]
"""Rows of the two points among all points of the chair, and the number of the way: `w`, or `8 g_a + g_b`."""


class Rehearsal:
    """An environment with a memory, for one chair.

    Args:
        task: of the chair, in either setting.
        seed: of the one start that all episodes share, and of the planner.
    """

    def __init__(self, task: ObjectCentricTask | FullTask, seed: int) -> None:
        self.task, self._seed = task, seed
        self.ways = int(np.prod(task.action_branches))
        """That every two points have."""
        self.trial = trial_of(task)
        rng = np.random.default_rng(seed)
        initial = task.groups_of(task.initial_state(rng))  # pyright: ignore[reportArgumentType]
        self.every = Registry(task, initial.groups, self.trial.by_part)
        self.part, self.point, self.like = self.every.part, self.every.point, self.every.like
        """Of `Registry`."""
        self.joints = Joints(self.every, lambda: self.tried[1] > 0)
        self._known = Table(6)
        """u's kind, v's kind, points among those of the kinds, `w` (-1: any), and what is known."""
        self._outcomes: dict[tuple[int, int, int, int], int] = {}
        """Two groups and their points to the merged group. (Which slots it is told in depends on the very parts.)"""
        self._cache: dict[State, tuple[int, Int8[np.ndarray, "n n 6"]]] = {}
        n = len(self.part)
        self._tried = np.zeros((2, n, n), np.int32)
        self._went = np.zeros((2, n, n, self.ways), np.int32)
        self.planned = 0
        """Merges that were planned, not remembered."""
        self.start: State = tuple(sorted(self._seen(self.every.loose(p)) for p in range(len(self.like))))

    @property
    def tried(self) -> Int[np.ndarray, "2 n n"]:
        """How often two points were found to be a wrong pair, and a right one, whatever the groups; symmetric."""
        return self._tried[:, self.every.row_like][:, :, self.every.row_like]

    def went(self, row: int | np.ndarray, column: int | np.ndarray) -> Int[np.ndarray, "2 *k w"]:
        """How often right pairs of points failed, and merged, in each way, whatever the groups."""
        return self._went[:, self.every.row_like[row], self.every.row_like[column]]

    def step(self, state: State, action: Action) -> State | None:
        """The state after a merge; None if the action fails. Takes an action that exists."""
        known = self.known(state)[action]
        if known >= FAILS:
            return None
        row, column, _ = action
        one, two = self.every.owner(state, row), self.every.owner(state, column)
        key = (one, two, self.every.local(one, row), self.every.local(two, column))
        if (known == UNKNOWN or key not in self._outcomes) and not self._try(state, action, key):
            return None
        return tuple(sorted((*(g for g in state if g not in (one, two)), self._outcomes[key])))

    def _try(self, state: State, action: Action, key: tuple[int, int, int, int]) -> bool:
        """Take a step in earnest as far as its outcome is not known; whether it merges."""
        row, column, w = action
        one, two = key[:2]
        names = (int(self.part[row]), int(self.part[column]), int(self.point[row]), int(self.point[column]), w)
        groups = self.every.group(one), self.every.group(two)
        merge = self.task.rules.pairs.judge(*groups, names[0], names[2], names[1], names[3])
        alike = self.joints.alike(one, two, row, column)
        if merge is None:
            self._count(self._tried[0], one, two, alike)
            self._count(self._tried[0].T, one, two, alike)
            self._learn(one, two, alike, -1, FAILS)
            self._learn(two, one, alike[:, ::-1], -1, FAILS)
            return False
        label = self.every.key(merge.merged)
        merges = bool(self.known(state)[action] == MERGES)
        if not merges:
            self._count(self._tried[1], one, two, alike)
            self._count(self._tried[1].T, one, two, alike)
        if not merges or label not in self.every.kind_names:
            self.planned += 1
            kinds = self.every.groups[one].kind, self.every.groups[two].kind
            seed = int(np.random.SeedSequence([self._seed, *kinds, *key[2:], w]).generate_state(1)[0])
            found = self.trial(groups, lambda: self.laid_out(state), names, seed, label in self.every.kind_names)
            if found.merged is not None and label not in self.every.kind_names:
                self.every.kind(found.merged, label)
            merges = found.verdict == MERGES
            if self.trial.by_part:
                alike = self._of_same_parts(one, two, alike)
            for way in found.ways:
                self._count(self._went[int(merges), :, :, way], one, two, alike)
                self._learn(one, two, alike, way, found.verdict)
        if merges:
            part_in = dict(zip(merge.merged.slots, merge.merged.parts, strict=True))
            kind = self.every.kind_names[label]
            parts = tuple(part_in[slot] for slot in self.every.kinds[kind].slots)
            self._outcomes[key] = self._seen(self.every.name(kind, parts))
        return merges

    def _of_same_parts(self, one: int, two: int, alike: Int[np.ndarray, "a 2"]) -> Int[np.ndarray, "a 2"]:
        """Of such pairs those between the same two parts as the first."""
        parts = [self.part[self.every.groups[g].rows[alike[:, i]]] for i, g in enumerate((one, two))]
        return alike[(parts[0] == parts[0][0]) & (parts[1] == parts[1][0])]

    def _count(self, counts: np.ndarray, one: int, two: int, alike: Int[np.ndarray, "a 2"]) -> None:
        rows, columns = (self.every.row_like[self.every.groups[g].rows[alike[:, i]]] for i, g in enumerate((one, two)))
        if (counts[rows, columns] == 0).any():
            self.joints.learn()
        counts[rows, columns] += 1

    def _learn(self, one: int, two: int, alike: Int[np.ndarray, "a 2"], w: int, verdict: int) -> None:
        for k, l in alike.tolist():  # noqa: E741
            self._known.append(self.every.groups[one].kind, self.every.groups[two].kind, k, l, w, verdict)

    def correct(self, state: State, action: Action) -> None:
        """From now on the action fails wherever such groups meet."""
        row, column, w = action
        one, two = self.every.owner(state, row), self.every.owner(state, column)
        alike = self.joints.alike(one, two, row, column)
        self._learn(one, two, self._of_same_parts(one, two, alike) if self.trial.by_part else alike, w, FAILS)

    def known(self, state: State) -> Int8[np.ndarray, "n n w"]:
        """What is known of each action of a state: `UNKNOWN`, `MERGES`, `FAILS` or `BLOCKED`. Not to be changed."""
        n = len(self.part)
        seen, out = self._cache.pop(state, None) or (0, np.zeros((n, n, self.ways), np.int8))
        fresh = self._known.since(seen)
        if len(fresh):
            members: dict[int, list[Named]] = {}
            for name in state:
                members.setdefault(self.every.groups[name].kind, []).append(self.every.groups[name])
            here = np.zeros(len(self.every.kinds), bool)
            here[list(members)] = True
            fresh = fresh[here[fresh[:, 0]] & here[fresh[:, 1]]]
            pairs = fresh[:, 0].astype(np.int64) * len(self.every.kinds) + fresh[:, 1]
            order = np.argsort(pairs, kind="stable")
            starts = np.flatnonzero(np.diff(pairs[order], prepend=-1))
            for rows in np.split(fresh[order], starts[1:]) if len(fresh) else ():
                way = np.where(rows[:, 4] < 0, 0, rows[:, 4])
                verdict = rows[:, 5].astype(np.int8)
                whole = rows[:, 4] < 0
                for u in members[int(rows[0, 0])]:
                    for v in members[int(rows[0, 1])]:
                        if u is not v:
                            r, c = u.rows[rows[:, 2]], v.rows[rows[:, 3]]
                            out[r, c, way] = verdict
                            out[r[whole], c[whole]] = FAILS
        self._cache[state] = (self._known.count, out)
        if len(self._cache) * out.nbytes > _CACHED:
            del self._cache[next(iter(self._cache))]
        return out

    def owners(self, state: State) -> Int[np.ndarray, "n"]:
        """The group of each free point of a state, -1 for others. Pairs exist between points of different groups."""
        owner = np.full(len(self.part), -1)
        for name in state:
            owner[self.every.groups[name].rows[self.every.free(name)]] = name
        return owner

    def joined(self, state: State) -> Bool[np.ndarray, "20 20"]:
        """Which parts are in one group, each with itself too; padded."""
        out = np.zeros((MAX_PARTS, MAX_PARTS), bool)
        for name in state:
            parts = self.every.groups[name].parts
            out[np.ix_(parts, parts)] = True
        return out

    def exists(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Which pairs of points exist: both free, in different groups."""
        owner = self.owners(state)
        return (owner[:, None] != owner[None]) & (owner >= 0)[:, None] & (owner >= 0)[None]

    def members(self, state: State) -> list[tuple[int, ...]]:
        """The parts of each group of a state."""
        return [self.every.groups[name].parts for name in state]

    def laid_out(self, state: State) -> TaskState:
        """The groups on the ground, each as it came to rest: single parts where they began, others in free spots."""
        groups = sorted((self.every.group(name) for name in state), key=lambda g: (len(g.parts), g.parts))
        placed: list[Group] = []
        taken = []
        for group in groups:
            circle = group_footprint(self.task.furniture, group)
            shift = np.array([*(free_spot(circle, taken) - circle.center), 0.0])
            placed.append(group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture))
            taken.append(group_footprint(self.task.furniture, placed[-1]))
        return TaskState(tuple(placed))

    def _seen(self, name: int) -> int:
        """The name of a group that has come about."""
        self.joints.see(name)
        return name

    def to_arrays(self) -> Params:
        """All that is remembered."""
        like = {name: [fill for _, fill in key] for key, name in self.every.kind_names.items()}
        slots = [(i, s, f) for i, k in enumerate(self.every.kinds) for s, f in zip(k.slots, like[i], strict=True)]
        parts = [(i, g.kind, p) for i, g in enumerate(self.every.groups) for p in g.parts]
        return {
            "slots": np.array(slots, np.int32),
            "poses": np.array([p.homogeneous for k in self.every.kinds for p in k.poses]),
            "worlds": np.array([k.world.homogeneous for k in self.every.kinds]),
            "free": np.array([(i, f) for i, k in enumerate(self.every.kinds) for f in k.free], np.int32).reshape(-1, 2),
            "groups": np.array(parts, np.int32),
            "known": self._known.since(0).copy(),
            "outcomes": np.array([(*key, name) for key, name in self._outcomes.items()], np.int32).reshape(-1, 5),
            "tried": self._tried.copy(),
            "went": self._went.copy(),
            "planned": np.array(self.planned),
        }

    def restore(self, arrays: Params) -> None:
        """Take over what another one with the same chair and seed remembered.

        Raises:
            InputError: it was of another chair.
        """
        if arrays["tried"].shape != self._tried.shape:
            raise InputError("what was remembered is of another chair; remove the file, or name another")
        poses = [SE3(h[:3, :3], h[:3, 3]) for h in arrays["poses"]]
        worlds = [SE3(h[:3, :3], h[:3, 3]) for h in arrays["worlds"]]
        slots, free = arrays["slots"], arrays["free"]
        for index, world in enumerate(worlds):
            rows = np.flatnonzero(slots[:, 0] == index)
            if index >= len(self.every.kinds):
                self.every.kinds.append(
                    Kind(
                        tuple(slots[rows, 1].tolist()),
                        tuple(poses[i] for i in rows),
                        world,
                        free[free[:, 0] == index, 1].astype(int),
                    )
                )
                self.every.kind_names[tuple((s, f) for _, s, f in slots[rows].tolist())] = index
        groups = arrays["groups"]
        for index in range(int(groups[-1, 0]) + 1):
            rows = groups[groups[:, 0] == index]
            self._seen(self.every.name(int(rows[0, 1]), tuple(rows[:, 2].tolist())))
        for row in arrays["known"].tolist():
            self._known.append(*row)
        for row in arrays["outcomes"].tolist():
            self._outcomes[row[0], row[1], row[2], row[3]] = row[4]
        self._tried, self._went = arrays["tried"].copy(), arrays["went"].copy()
        self.planned = int(arrays["planned"])
        self._cache.clear()
