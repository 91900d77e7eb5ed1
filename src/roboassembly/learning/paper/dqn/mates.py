"""What joining two groups at two points would mean, told by where their points are and by what is known to fit what.

No knowledge of the furniture is used: points' frames are part of what a learner sees, and that points fit it has found
out itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.paper.dqn.group_table import Registry
from roboassembly.learning.paper.dqn.relative_poses import Placed, Relations
from roboassembly.task.rules.pairs import ANGLE_TOLERANCE, POSITION_TOLERANCE

_SAME_WAY = 0.7
"""Cosine: joints whose normals are within 45° can be closed in one straight move."""


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


def _unscaled(motions: Float[np.ndarray, "*n 12"]) -> tuple[Float[np.ndarray, "*n 3 3"], Float[np.ndarray, "*n 3"]]:
    turns = motions[..., 3:].reshape(*motions.shape[:-1], 3, 3)
    return turns * ANGLE_TOLERANCE, motions[..., :3] * POSITION_TOLERANCE


class Joints:
    """Of the groups of one chair.

    Args:
        every: all groups.
        right: tells which two points were found to be a right pair in some groups.
    """

    def __init__(self, every: Registry, right: Callable[[], Bool[np.ndarray, "n n"]]) -> None:
        self._all, self._right = every, right
        self._meets: dict[tuple[int, int], Int[np.ndarray, "k l"]] = {}
        self._axes: dict[tuple[int, int], int] = {}
        self._relations = Relations()
        self._fits: dict[tuple[int, int], _Fits] = {}
        self._locked: dict[tuple[int, int, int, int, int], bool] = {}
        self._related: set[int] = set()
        """Kinds of groups whose relations were seen."""
        self._between: dict[tuple[int, int, int, int], Int[np.ndarray, "n"]] = {}

    def see(self, name: int) -> None:
        """A group has come about."""
        kind = self._all.groups[name].kind
        if kind not in self._related:
            self._related.add(kind)
            self._relations.see(self._placed(name))

    def learn(self) -> None:
        """Another two points are known to be right, or wrong."""
        self._fits, self._locked = {}, {}

    def alike(self, one: int, two: int, row: int, column: int) -> Int[np.ndarray, "a 2"]:
        """Pairs of points that would bring two groups together just as the given pair does, itself first.

        As numbers among the points of each group.
        """
        k, l = self._all.local(one, row), self._all.local(two, column)  # noqa: E741
        u, v = self._all.free(one), self._all.free(two)
        motion = self._motions(one, two)
        i, j = int(np.searchsorted(u, k)), int(np.searchsorted(v, l))
        same = np.linalg.norm(motion - motion[i, j], axis=2) < 1.0
        same[i, j] = False
        found = np.argwhere(same)
        return np.concatenate([[[k, l]], np.stack([u[found[:, 0]], v[found[:, 1]]], axis=1)]).astype(int)

    def _motions(self, one: int, two: int) -> Float[np.ndarray, "k l 12"]:
        """How each free point of a group, laid on each of another's, places the two; in tolerances."""
        turns_u, at_u, gap_u = self._all.frames(one, self._all.free(one))
        turns_v, at_v, gap_v = self._all.frames(two, self._all.free(two))
        gaps = 0.5 * (gap_u[:, None] + gap_v[None])
        turn, shift = mating_poses(turns_u, at_u, turns_v, at_v, gaps)
        flat = turn.reshape(*turn.shape[:2], 9)
        return np.concatenate([shift / POSITION_TOLERANCE, flat / ANGLE_TOLERANCE], axis=2)

    def _motion(
        self, one: int, two: int, k: int, l: int  # noqa: E741
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:  # fmt: skip
        """Where a group is in the other's frame with its point `k` on the other's `l`."""
        at = int(np.searchsorted(self._all.free(one), k)), int(np.searchsorted(self._all.free(two), l))
        return _unscaled(self._motions(one, two)[at])

    def meets(self, state: Sequence[int]) -> Int[np.ndarray, "m m"]:
        """For two free points of different groups, how many pairs of points would meet if these did; symmetric."""
        out = np.zeros((len(self._all.part), len(self._all.part)), np.int32)
        for i, one in enumerate(state):
            u = self._all.groups[one]
            for two in state[:i]:
                v = self._all.groups[two]
                key = (u.kind, v.kind)
                if key not in self._meets:
                    motions = self._motions(one, two)
                    tree = KDTree(motions.reshape(-1, 12))
                    counts = tree.query_ball_point(tree.data, 1.0, return_length=True)
                    self._meets[key] = np.asarray(counts, np.int32).reshape(motions.shape[:2])
                rows, columns = u.rows[self._all.free(one)], v.rows[self._all.free(two)]
                out[np.ix_(rows, columns)] = self._meets[key]
                out[np.ix_(columns, rows)] = self._meets[key].T
        return out

    def strange(self, state: Sequence[int], row: int, column: int) -> float:
        """Of all pairs of parts of the two points' groups, joined so, the share that would lie to each other as was
        never seen in a group."""
        one, two = self._all.owner(state, row), self._all.owner(state, column)
        u, v = self._all.groups[one], self._all.groups[two]
        k, l = self._all.local(one, row), self._all.local(two, column)  # noqa: E741
        key = (u.kind, v.kind, k, l)
        if key not in self._between:
            turn, shift = self._motion(one, two, k, l)
            moved = [p.moved(turn, shift) for p in self._placed(one)]
            self._between[key] = self._relations.between(moved, self._placed(two))
        numbers = self._between[key]
        return self._relations.strange(numbers) / len(numbers)

    def locked_out(self, state: Sequence[int], row: int, column: int) -> int:
        """How many other groups would no longer go in if two points were joined: those that belong between the two
        groups, as far as known by which points fit, with joints of which one faces another way than the other."""
        one, two = self._all.owner(state, row), self._all.owner(state, column)
        u, v = self._all.groups[one], self._all.groups[two]
        k, l = self._all.local(one, row), self._all.local(two, column)  # noqa: E741
        count = 0
        for name in state:
            if name in (one, two):
                continue
            key = (u.kind, v.kind, k, l, self._all.groups[name].kind)
            if key not in self._locked:
                self._locked[key] = self._locks(one, two, k, l, name)
            count += self._locked[key]
        return count

    def _locks(self, one: int, two: int, k: int, l: int, other: int) -> bool:  # noqa: E741
        turn, shift = self._motion(one, two, k, l)
        on_one, on_two = self._fitting(other, one), self._fitting(other, two)
        if not len(on_one.rows) or not len(on_two.rows):
            return False
        turns, shifts = turn @ on_one.turns, on_one.shifts @ turn.T + shift
        near = np.linalg.norm(shifts[:, None] - on_two.shifts[None], axis=2) < 2.0 * POSITION_TOLERANCE
        alike = np.einsum("aij,bij->ab", turns, on_two.turns) > 1.0 + 2.0 * np.cos(2.0 * ANGLE_TOLERANCE)
        facing = on_one.normals @ on_two.normals.T > _SAME_WAY
        return bool((near & alike & ~facing & (on_one.rows[:, None] != on_two.rows[None])).any())

    def _fitting(self, one: int, two: int) -> _Fits:
        """The ways in which a group's free points are known to fit another's."""
        u, v = self._all.groups[one], self._all.groups[two]
        key = (u.kind, v.kind)
        if key not in self._fits:
            free_u, free_v = self._all.free(one), self._all.free(two)
            right = self._right()[np.ix_(u.rows[free_u], v.rows[free_v])]
            rows, columns = np.nonzero(right)
            motions = self._motions(one, two)[rows, columns] if len(rows) else np.zeros((0, 12))
            turns, shifts = _unscaled(motions)
            frames, _, _ = self._all.frames(one, free_u)
            normals = frames[rows, :, 2] if len(rows) else np.zeros((0, 3))
            self._fits[key] = _Fits(rows, turns, shifts, normals)
        return self._fits[key]

    def axis(self, state: Sequence[int], row: int, column: int) -> int:
        """Along which axis of the furniture's frame two points come together, as it looks to the larger group."""
        one, two = self._all.owner(state, row), self._all.owner(state, column)
        if (len(self._all.groups[one].rows), one) < (len(self._all.groups[two].rows), two):
            one, row = two, column
        if (one, row) not in self._axes:
            turns, _, _ = self._all.frames(one, np.array([self._all.local(one, row)]))
            self._axes[one, row] = int(np.argmax(np.abs(turns[0, :, 2])))
        return self._axes[one, row]

    def _placed(self, name: int) -> list[Placed]:
        """The parts of a group in its frame."""
        named, group = self._all.groups[name], self._all.group(name)
        # Parts that are equal may have points that others of them lack.
        count = {p: len(group.points_of(self._all.furniture, p)) for p in group.parts}
        there = [i for i, row in enumerate(named.rows) if self._all.point[row] < count[int(self._all.part[row])]]
        _, origins, _ = self._all.frames(name, np.array(there, int))
        part_of = self._all.part[named.rows[there]]
        return [
            Placed(self._all.furniture.class_of[p], pose.translation, origins[part_of == p])
            for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
        ]
