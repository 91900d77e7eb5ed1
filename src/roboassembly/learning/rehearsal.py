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

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from scipy.spatial import KDTree

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_PARTS
from roboassembly.learning.features import turns_between
from roboassembly.learning.kinds import Kind, Named, Table, equals, point_counts
from roboassembly.learning.layers import Params
from roboassembly.learning.relations import Placed, Relations
from roboassembly.learning.trials import FAILS, MERGES, UNKNOWN, trial_of
from roboassembly.poses import SE3
from roboassembly.task.full import FullTask
from roboassembly.task.groups import Group, TaskState, part_from_points
from roboassembly.task.layout import free_spot, group_footprint
from roboassembly.task.object_centric import ObjectCentricTask
from roboassembly.task.pairs import ANGLE_TOLERANCE, POSITION_TOLERANCE

_SAME_WAY = 0.7
"""Cosine: joints whose normals are within 45° can be closed in one straight move."""
_CACHED = 150e6
"""Bytes of tables of what is known that are kept, each of one state."""
State = tuple[int, ...]
"""Names of its groups, ascending."""
Action = tuple[int, int, int]
"""Rows of the two points among all points of the chair, and the number of the way: `w`, or `8 g_a + g_b`."""


@dataclass(frozen=True, eq=False)
class _Fits:
    """Ways in which one group fits another."""

    rows: Int[np.ndarray, "n"]
    """Numbers of its points."""
    turns: Float[np.ndarray, "n 3 3"]
    shifts: Float[np.ndarray, "n 3"]
    """Of its frame in the other's."""
    normals: Float[np.ndarray, "n 3"]
    """Of its points, in its frame."""


def _unscaled(motion: Float[np.ndarray, "12"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    return motion[3:].reshape(3, 3) * ANGLE_TOLERANCE, motion[:3] * POSITION_TOLERANCE


class Rehearsal:
    """An environment with a memory, for one chair.

    Args:
        task: of the chair, in either setting.
        seed: of the one start that all episodes share, and of the planner.
    """

    def __init__(self, task: ObjectCentricTask | FullTask, seed: int) -> None:
        self.task, self._seed = task, seed
        self.ways = int(np.prod(task.ways))
        """That every two points have."""
        self.trial = trial_of(task)
        counts = point_counts(task.furniture)
        self.part = np.repeat(np.arange(len(counts)), counts)
        """Part of each row; the chair's points are numbered through."""
        self.point = np.concatenate([np.arange(n) for n in counts])
        self._first = np.cumsum([0, *counts])
        self.like = equals(task.furniture)
        """The first part that equals each part."""
        self._row_like = self._first[self.like[self.part]] + self.point
        self._kinds: list[Kind] = []
        self._kind_names: dict[tuple[tuple[int, int], ...], int] = {}
        self._groups: list[Named] = []
        self._names: dict[tuple[int, tuple[int, ...]], int] = {}
        self._known = Table(6)
        """u's kind, v's kind, points among those of the kinds, `w` (-1: any), and what is known."""
        self._outcomes: dict[tuple[int, int, int, int], int] = {}
        """Two groups and their points to the merged group. (Which slots it is told in depends on the very parts.)"""
        self._cache: dict[State, tuple[int, Int8[np.ndarray, "n n 6"]]] = {}
        self._meets: dict[tuple[int, int], Int[np.ndarray, "k l"]] = {}
        self._axes: dict[tuple[int, int], int] = {}
        self._relations = Relations()
        self._fits: dict[tuple[int, int], _Fits] = {}
        self._locked: dict[tuple[int, int, int, int, int], bool] = {}
        self._related: set[int] = set()
        """Kinds of groups whose relations were seen."""
        self._between: dict[tuple[int, int, int, int], Int[np.ndarray, "n"]] = {}
        n = len(self.part)
        self._tried = np.zeros((2, n, n), np.int32)
        self._went = np.zeros((2, n, n, self.ways), np.int32)
        self.planned = 0
        """Merges that were planned, not remembered."""
        rng = np.random.default_rng(seed)
        initial = task.initial_state(rng).groups if isinstance(task, FullTask) else task.initial_state(rng)
        self._start = {g.parts[0]: g for g in initial.groups}
        self.start: State = tuple(sorted(self._loose(p) for p in range(len(counts))))

    @property
    def tried(self) -> Int[np.ndarray, "2 n n"]:
        """How often two points were found to be a wrong pair, and a right one, whatever the groups; symmetric."""
        return self._tried[:, self._row_like][:, :, self._row_like]

    def went(self, row: int | np.ndarray, column: int | np.ndarray) -> Int[np.ndarray, "2 *k w"]:
        """How often right pairs of points failed, and merged, in each way, whatever the groups."""
        return self._went[:, self._row_like[row], self._row_like[column]]

    def step(self, state: State, action: Action) -> State | None:
        """The state after a merge; None if the action fails. Takes an action that exists."""
        known = self.known(state)[action]
        if known >= FAILS:
            return None
        row, column, _ = action
        one, two = self.owner(state, row), self.owner(state, column)
        key = (one, two, self._local(one, row), self._local(two, column))
        if (known == UNKNOWN or key not in self._outcomes) and not self._try(state, action, key):
            return None
        return tuple(sorted((*(g for g in state if g not in (one, two)), self._outcomes[key])))

    def _try(self, state: State, action: Action, key: tuple[int, int, int, int]) -> bool:
        """Take a step in earnest as far as its outcome is not known; whether it merges."""
        row, column, w = action
        one, two = key[:2]
        names = (int(self.part[row]), int(self.part[column]), int(self.point[row]), int(self.point[column]), w)
        merge = self.task.rules.pairs.judge(self._group(one), self._group(two), names[0], names[2], names[1], names[3])
        alike = self._alike(one, two, row, column)
        if merge is None:
            self._count(self._tried[0], one, two, alike)
            self._count(self._tried[0].T, one, two, alike)
            self._learn(one, two, alike, -1, FAILS)
            self._learn(two, one, alike[:, ::-1], -1, FAILS)
            return False
        label = self._key(merge.merged)
        merges = bool(self.known(state)[action] == MERGES)
        if not merges:
            self._count(self._tried[1], one, two, alike)
            self._count(self._tried[1].T, one, two, alike)
        if not merges or label not in self._kind_names:
            self.planned += 1
            kinds = self._groups[one].kind, self._groups[two].kind
            seed = int(np.random.SeedSequence([self._seed, *kinds, *key[2:], w]).generate_state(1)[0])
            groups = self._group(one), self._group(two)
            found = self.trial(groups, lambda: self.laid_out(state), names, seed, label in self._kind_names)
            if found.merged is not None and label not in self._kind_names:
                self._kind(found.merged, label)
            merges = found.verdict == MERGES
            if self.trial.by_part:
                alike = self._of_same_parts(one, two, alike)
            for way in found.ways:
                self._count(self._went[int(merges), :, :, way], one, two, alike)
                self._learn(one, two, alike, way, found.verdict)
        if merges:
            part_in = dict(zip(merge.merged.slots, merge.merged.parts, strict=True))
            kind = self._kind_names[label]
            self._outcomes[key] = self._name(kind, tuple(part_in[slot] for slot in self._kinds[kind].slots))
        return merges

    def _of_same_parts(self, one: int, two: int, alike: Int[np.ndarray, "a 2"]) -> Int[np.ndarray, "a 2"]:
        """Of such pairs those between the same two parts as the first."""
        parts = [self.part[self._groups[g].rows[alike[:, i]]] for i, g in enumerate((one, two))]
        return alike[(parts[0] == parts[0][0]) & (parts[1] == parts[1][0])]

    def _count(self, counts: np.ndarray, one: int, two: int, alike: Int[np.ndarray, "a 2"]) -> None:
        rows, columns = (self._row_like[self._groups[g].rows[alike[:, i]]] for i, g in enumerate((one, two)))
        if (counts[rows, columns] == 0).any():
            # Another two points are known to fit, or not to.
            self._fits, self._locked = {}, {}
        counts[rows, columns] += 1

    def _learn(self, one: int, two: int, alike: Int[np.ndarray, "a 2"], w: int, verdict: int) -> None:
        for k, l in alike.tolist():  # noqa: E741
            self._known.append(self._groups[one].kind, self._groups[two].kind, k, l, w, verdict)

    def _alike(self, one: int, two: int, row: int, column: int) -> Int[np.ndarray, "a 2"]:
        """Pairs of points that would bring two groups together just as the given pair does, itself first.

        As numbers among the points of each group.
        """
        k, l = self._local(one, row), self._local(two, column)  # noqa: E741
        u, v = self._kinds[self._groups[one].kind].free, self._kinds[self._groups[two].kind].free
        motion = self._motions(one, two)
        i, j = int(np.searchsorted(u, k)), int(np.searchsorted(v, l))
        same = np.linalg.norm(motion - motion[i, j], axis=2) < 1.0
        same[i, j] = False
        found = np.argwhere(same)
        return np.concatenate([[[k, l]], np.stack([u[found[:, 0]], v[found[:, 1]]], axis=1)]).astype(int)

    def _motions(self, one: int, two: int) -> Float[np.ndarray, "k l 12"]:
        """How each free point of a group, laid on each of another's, places the two; in tolerances."""
        turns_u, at_u, gap_u = self._frames(one, self._kinds[self._groups[one].kind].free)
        turns_v, at_v, gap_v = self._frames(two, self._kinds[self._groups[two].kind].free)
        at_v = at_v[None] + 0.5 * (gap_u[:, None] + gap_v[None])[..., None] * turns_v[None, :, :, 2]
        turn = turns_between(turns_u, turns_v)
        shift = at_v - np.einsum("klij,kj->kli", turn, at_u)
        flat = turn.reshape(*turn.shape[:2], 9)
        return np.concatenate([shift / POSITION_TOLERANCE, flat / ANGLE_TOLERANCE], axis=2)

    def meets(self, state: State) -> Int[np.ndarray, "m m"]:
        """For two free points of different groups, how many pairs of points would meet if these did; symmetric."""
        out = np.zeros((len(self.part), len(self.part)), np.int32)
        for i, one in enumerate(state):
            u = self._groups[one]
            for two in state[:i]:
                v = self._groups[two]
                key = (u.kind, v.kind)
                if key not in self._meets:
                    motions = self._motions(one, two)
                    tree = KDTree(motions.reshape(-1, 12))
                    counts = tree.query_ball_point(tree.data, 1.0, return_length=True)
                    self._meets[key] = np.asarray(counts, np.int32).reshape(motions.shape[:2])
                rows, columns = u.rows[self._kinds[u.kind].free], v.rows[self._kinds[v.kind].free]
                out[np.ix_(rows, columns)] = self._meets[key]
                out[np.ix_(columns, rows)] = self._meets[key].T
        return out

    def strange(self, state: State, row: int, column: int) -> float:
        """Of all pairs of parts of the two points' groups, joined so, the share that would lie to each other as was
        never seen in a group."""
        one, two = self.owner(state, row), self.owner(state, column)
        u, v = self._groups[one], self._groups[two]
        k, l = self._local(one, row), self._local(two, column)  # noqa: E741
        key = (u.kind, v.kind, k, l)
        if key not in self._between:
            free_u, free_v = self._kinds[u.kind].free, self._kinds[v.kind].free
            motion = self._motions(one, two)[int(np.searchsorted(free_u, k)), int(np.searchsorted(free_v, l))]
            turn, shift = motion[3:].reshape(3, 3) * ANGLE_TOLERANCE, motion[:3] * POSITION_TOLERANCE
            moved = [p.moved(turn, shift) for p in self._placed(one)]
            self._between[key] = self._relations.between(moved, self._placed(two))
        numbers = self._between[key]
        return self._relations.strange(numbers) / len(numbers)

    def locked_out(self, state: State, row: int, column: int) -> int:
        """How many other groups would no longer go in if two points were joined: those that belong between the two
        groups, as far as known by which points fit, with joints of which one faces another way than the other."""
        one, two = self.owner(state, row), self.owner(state, column)
        u, v = self._groups[one], self._groups[two]
        k, l = self._local(one, row), self._local(two, column)  # noqa: E741
        count = 0
        for name in state:
            if name in (one, two):
                continue
            key = (u.kind, v.kind, k, l, self._groups[name].kind)
            if key not in self._locked:
                self._locked[key] = self._locks(one, two, k, l, name)
            count += self._locked[key]
        return count

    def _locks(self, one: int, two: int, k: int, l: int, other: int) -> bool:  # noqa: E741
        u, v = self._groups[one], self._groups[two]
        free_u, free_v = self._kinds[u.kind].free, self._kinds[v.kind].free
        motion = _unscaled(self._motions(one, two)[int(np.searchsorted(free_u, k)), int(np.searchsorted(free_v, l))])
        on_one, on_two = self._fitting(other, one), self._fitting(other, two)
        if not len(on_one.rows) or not len(on_two.rows):
            return False
        turns = motion[0] @ on_one.turns
        shifts = on_one.shifts @ motion[0].T + motion[1]
        near = np.linalg.norm(shifts[:, None] - on_two.shifts[None], axis=2) < 2.0 * POSITION_TOLERANCE
        alike = np.einsum("aij,bij->ab", turns, on_two.turns) > 1.0 + 2.0 * np.cos(2.0 * ANGLE_TOLERANCE)
        facing = on_one.normals @ on_two.normals.T > _SAME_WAY
        return bool((near & alike & ~facing & (on_one.rows[:, None] != on_two.rows[None])).any())

    def _fitting(self, one: int, two: int) -> _Fits:
        """The ways in which a group's free points are known to fit another's."""
        u, v = self._groups[one], self._groups[two]
        key = (u.kind, v.kind)
        if key not in self._fits:
            free_u, free_v = self._kinds[u.kind].free, self._kinds[v.kind].free
            right = self.tried[1][np.ix_(u.rows[free_u], v.rows[free_v])] > 0
            rows, columns = np.nonzero(right)
            motions = self._motions(one, two)[rows, columns] if len(rows) else np.zeros((0, 12))
            turns, shifts = motions[:, 3:].reshape(-1, 3, 3) * ANGLE_TOLERANCE, motions[:, :3] * POSITION_TOLERANCE
            frames, _, _ = self._frames(one, free_u)
            normals = frames[rows, :, 2] if len(rows) else np.zeros((0, 3))
            self._fits[key] = _Fits(rows, turns, shifts, normals)
        return self._fits[key]

    def axis(self, state: State, row: int, column: int) -> int:
        """Along which axis of the furniture's frame two points come together, as it looks to the larger group."""
        one, two = self.owner(state, row), self.owner(state, column)
        if (len(self._groups[one].rows), one) < (len(self._groups[two].rows), two):
            one, row = two, column
        if (one, row) not in self._axes:
            turns, _, _ = self._frames(one, np.array([self._local(one, row)]))
            self._axes[one, row] = int(np.argmax(np.abs(turns[0, :, 2])))
        return self._axes[one, row]

    def _placed(self, name: int) -> list[Placed]:
        """The parts of a group in its frame."""
        named, group = self._groups[name], self._group(name)
        # Parts that are equal may have points that others of them lack.
        count = {p: len(group.points_of(self.task.furniture, p)) for p in group.parts}
        there = [i for i, row in enumerate(named.rows) if self.point[row] < count[int(self.part[row])]]
        _, origins, _ = self._frames(name, np.array(there, int))
        part_of = self.part[named.rows[there]]
        return [
            Placed(self.task.furniture.class_of[p], pose.translation, origins[part_of == p])
            for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
        ]

    def _frames(
        self, name: int, points: Int[np.ndarray, "r"]
    ) -> tuple[Float[np.ndarray, "r 3 3"], Float[np.ndarray, "r 3"], Float[np.ndarray, "r"]]:
        """Rotation, origin and gap of some points of a group in its frame."""
        furniture, named = self.task.furniture, self._groups[name]
        slots = self._kinds[named.kind].slots if len(named.parts) > 1 else named.parts
        slot_of = dict(zip(named.parts, slots, strict=True))
        turns, origins, gaps = [], [], []
        for row in named.rows[points]:
            slot = slot_of[int(self.part[row])]
            point = furniture.parts[slot].points[int(self.point[row])]
            frame = furniture.assembled[slot] * point.frame
            turns.append(frame.rotation)
            origins.append(frame.translation)
            gaps.append(point.gap)
        return np.array(turns), np.array(origins), np.array(gaps)

    def correct(self, state: State, action: Action) -> None:
        """From now on the action fails wherever such groups meet."""
        row, column, w = action
        one, two = self.owner(state, row), self.owner(state, column)
        alike = self._alike(one, two, row, column)
        self._learn(one, two, self._of_same_parts(one, two, alike) if self.trial.by_part else alike, w, FAILS)

    def known(self, state: State) -> Int8[np.ndarray, "n n w"]:
        """What is known of each action of a state: `UNKNOWN`, `MERGES`, `FAILS` or `BLOCKED`. Not to be changed."""
        n = len(self.part)
        seen, out = self._cache.pop(state, None) or (0, np.zeros((n, n, self.ways), np.int8))
        fresh = self._known.since(seen)
        if len(fresh):
            members: dict[int, list[Named]] = {}
            for name in state:
                members.setdefault(self._groups[name].kind, []).append(self._groups[name])
            here = np.zeros(len(self._kinds), bool)
            here[list(members)] = True
            fresh = fresh[here[fresh[:, 0]] & here[fresh[:, 1]]]
            pairs = fresh[:, 0].astype(np.int64) * len(self._kinds) + fresh[:, 1]
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
            owner[self._groups[name].rows[self._kinds[self._groups[name].kind].free]] = name
        return owner

    def joined(self, state: State) -> Bool[np.ndarray, "20 20"]:
        """Which parts are in one group, each with itself too; padded."""
        out = np.zeros((MAX_PARTS, MAX_PARTS), bool)
        for name in state:
            parts = self._groups[name].parts
            out[np.ix_(parts, parts)] = True
        return out

    def exists(self, state: State) -> Bool[np.ndarray, "n n"]:
        """Which pairs of points exist: both free, in different groups."""
        owner = self.owners(state)
        return (owner[:, None] != owner[None]) & (owner >= 0)[:, None] & (owner >= 0)[None]

    def members(self, state: State) -> list[tuple[int, ...]]:
        """The parts of each group of a state."""
        return [self._groups[name].parts for name in state]

    def owner(self, state: State, row: int) -> int:
        """Name of the group that a point belongs to."""
        part = self.part[row]
        return next(name for name in state if part in self._groups[name].parts)

    def laid_out(self, state: State) -> TaskState:
        """The groups on the ground, each as it came to rest: single parts where they began, others in free spots."""
        groups = sorted((self._group(name) for name in state), key=lambda g: (len(g.parts), g.parts))
        placed: list[Group] = []
        taken = []
        for group in groups:
            circle = group_footprint(self.task.furniture, group)
            shift = np.array([*(free_spot(circle, taken) - circle.center), 0.0])
            placed.append(group.moved_to(SE3(np.eye(3), shift) * group.world_from_furniture))
            taken.append(group_footprint(self.task.furniture, placed[-1]))
        return TaskState(tuple(placed))

    def _group(self, name: int) -> Group:
        named = self._groups[name]
        if len(named.parts) == 1:
            return self._start[named.parts[0]]
        kind = self._kinds[named.kind]
        order = np.argsort(named.parts)
        return Group(
            tuple(named.parts[i] for i in order),
            tuple(kind.slots[i] for i in order),
            tuple(kind.poses[i] for i in order),
            kind.world,
        )

    def _local(self, name: int, row: int) -> int:
        """A row's number among the points of its group."""
        return int(np.flatnonzero(self._groups[name].rows == row)[0])

    def _loose(self, part: int) -> int:
        group = self._start[part]
        return self._name(self._kind(group, ((-1, int(self.like[part])),)), (part,))

    def _key(self, merged: Group) -> tuple[tuple[int, int], ...]:
        """Slots in order. Which equal parts fill them makes no difference: they have the points of their slots then.

        Hands hold a part where its own grasps are, so that to them it matters how it is turned in its slot.
        """
        turns = (self._turn(merged, part) if self.trial.by_part else -1 for part in merged.parts)
        return tuple(sorted(zip(merged.slots, turns, strict=True)))

    def _turn(self, group: Group, part: int) -> int:
        """By which symmetry of its shape a part is turned in its slot, as a number."""
        furniture = self.task.furniture
        symmetries = furniture.classes[furniture.class_of[part]].symmetries
        return int(np.argmax(np.einsum("nij,ij->n", symmetries, part_from_points(furniture, group, part).rotation)))

    def _kind(self, group: Group, key: tuple[tuple[int, int], ...]) -> int:
        """The kind of a group, after `key`."""
        if key not in self._kind_names:
            self._kind_names[key] = len(self._kinds)
            order = np.argsort(group.slots)
            free_points = self.task.rules.free_points(TaskState((group,)))
            parts = [group.parts[i] for i in order]
            free = np.flatnonzero(np.concatenate([free_points[p, : len(self._points(p))] for p in parts]))
            slots, poses = (tuple(of[i] for i in order) for of in (group.slots, group.furniture_from_part))
            self._kinds.append(Kind(slots, poses, group.world_from_furniture, free))  # pyright: ignore[reportArgumentType]
        return self._kind_names[key]

    def _points(self, part: int) -> range:
        return range(self._first[part], self._first[part + 1])

    def _name(self, kind: int, parts: tuple[int, ...]) -> int:
        if (kind, parts) not in self._names:
            self._names[kind, parts] = len(self._groups)
            rows = np.concatenate([np.array(self._points(p), dtype=int) for p in parts])
            self._groups.append(Named(kind, parts, rows))
            if kind not in self._related:
                self._related.add(kind)
                self._relations.see(self._placed(len(self._groups) - 1))
        return self._names[kind, parts]

    def to_arrays(self) -> Params:
        """All that is remembered."""
        like = {name: [fill for _, fill in key] for key, name in self._kind_names.items()}
        slots = [(i, s, f) for i, k in enumerate(self._kinds) for s, f in zip(k.slots, like[i], strict=True)]
        parts = [(i, g.kind, p) for i, g in enumerate(self._groups) for p in g.parts]
        return {
            "slots": np.array(slots, np.int32),
            "poses": np.array([p.homogeneous for k in self._kinds for p in k.poses]),
            "worlds": np.array([k.world.homogeneous for k in self._kinds]),
            "free": np.array([(i, f) for i, k in enumerate(self._kinds) for f in k.free], np.int32).reshape(-1, 2),
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
            if index >= len(self._kinds):
                self._kinds.append(
                    Kind(
                        tuple(slots[rows, 1].tolist()),
                        tuple(poses[i] for i in rows),
                        world,
                        free[free[:, 0] == index, 1].astype(int),
                    )
                )
                self._kind_names[tuple((s, f) for _, s, f in slots[rows].tolist())] = index
        groups = arrays["groups"]
        for index in range(int(groups[-1, 0]) + 1):
            rows = groups[groups[:, 0] == index]
            self._name(int(rows[0, 1]), tuple(rows[:, 2].tolist()))
        for row in arrays["known"].tolist():
            self._known.append(*row)
        for row in arrays["outcomes"].tolist():
            self._outcomes[row[0], row[1], row[2], row[3]] = row[4]
        self._tried, self._went = arrays["tried"].copy(), arrays["went"].copy()
        self.planned = int(arrays["planned"])
        self._cache.clear()
