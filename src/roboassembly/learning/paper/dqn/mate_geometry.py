"""Predicts a mate of two groups at two points, from the frames of their points and from mates that are known to fit.

No knowledge of the furniture is used: the frames of points are part of what an agent sees, and which points fit it has
found out itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from scipy.spatial import KDTree

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.paper.dqn.group_table import GroupTable
from roboassembly.learning.paper.dqn.relative_poses import PlacedPart, RelativePoses
from roboassembly.task.rules.pairs import ANGLE_TOLERANCE, POSITION_TOLERANCE

_KEPT = 4_000
"""Largest number of pairs of groups whose motions are kept."""
_KEPT_STATES = 500
"""Largest number of states whose coincident points are kept."""
_UNKNOWN = -1
_SAME_WAY = 0.7
"""Cosine: mates whose normals are within 45° can be closed in one straight move."""


@dataclass(frozen=True, eq=False)
class _Fits:
    """Ways in which one group is known to fit another."""

    rows: Int[np.ndarray, "n"]
    """Numbers of its points."""
    turns: Float[np.ndarray, "n 3 3"]
    """Rotations of its frame in the other's frame."""
    shifts: Float[np.ndarray, "n 3"]
    """Origins of its frame in the other's frame [m]."""
    normals: Float[np.ndarray, "n 3"]
    """Normals of its points, in its frame."""


def _unscaled(motions: Float[np.ndarray, "*n 12"]) -> tuple[Float[np.ndarray, "*n 3 3"], Float[np.ndarray, "*n 3"]]:
    turns = motions[..., 3:].reshape(*motions.shape[:-1], 3, 3)
    return turns * ANGLE_TOLERANCE, motions[..., :3] * POSITION_TOLERANCE


class MateGeometry:
    """Geometry of the mates between the groups of one chair.

    Args:
        table: all groups.
        right: returns which two points were found to be a right pair in some groups.
    """

    def __init__(self, table: GroupTable, right: Callable[[], Bool[np.ndarray, "n n"]]) -> None:
        self._table, self._right = table, right
        self._coincident: dict[tuple[int, int], Int[np.ndarray, "k l"]] = {}
        self._axes: dict[tuple[int, int], int] = {}
        self._relative_poses = RelativePoses()
        self._fits: dict[tuple[int, int], _Fits] = {}
        """Fits by groups, not by their types: a part alone has the frame of its own slot."""
        self._kept_motions = lru_cache(_KEPT)(self._compute_motions)
        self._kept_coincident = lru_cache(_KEPT_STATES)(self._count_coincident)
        self._locked: dict[tuple[int, int, int], Int8[np.ndarray, "k l"]] = {}
        """Whether each pair of points of two groups locks a third out, or `_UNKNOWN`, by the types of the groups."""
        self._between_both: dict[tuple[int, int, int], bool] = {}
        """A third group is known to fit two others (true) or not, by their types."""
        self._seen_types: set[int] = set()
        """Types of groups whose relative poses were recorded."""
        self._between: dict[tuple[int, int, int, int], list[int]] = {}

    def see(self, group_id: int) -> None:
        """Record that a group has occurred."""
        type_id = self._table.groups[group_id].type_id
        if type_id not in self._seen_types:
            self._seen_types.add(type_id)
            self._relative_poses.see(self._placed(group_id))

    def forget_fits(self) -> None:
        """Forget what depends on which points fit; call it when that changes."""
        self._fits, self._locked, self._between_both = {}, {}, {}

    def same_mates(self, u_id: int, v_id: int, row: int, column: int) -> Int[np.ndarray, "a 2"]:
        """Return the pairs of points that bring two groups together just as the given pair does, itself first.

        Points are numbers among the points of each group.
        """
        k, l = self._table.local(u_id, row), self._table.local(v_id, column)  # noqa: E741
        u, v = self._table.free(u_id), self._table.free(v_id)
        motion = self._motions(u_id, v_id)
        i, j = int(np.searchsorted(u, k)), int(np.searchsorted(v, l))
        same = np.linalg.norm(motion - motion[i, j], axis=2) < 1.0
        same[i, j] = False
        found = np.argwhere(same)
        return np.concatenate([[[k, l]], np.stack([u[found[:, 0]], v[found[:, 1]]], axis=1)]).astype(int)

    def _motions(self, u_id: int, v_id: int) -> Float[np.ndarray, "k l 12"]:
        """Return the pose of u's group in v's for each pair of free points: translation and rotation, in tolerances.

        The results of the latest pairs of groups are kept; do not write.
        """
        return self._kept_motions(u_id, v_id)

    def _compute_motions(self, u_id: int, v_id: int) -> Float[np.ndarray, "k l 12"]:
        u_frames, u_origins, u_gaps = self._table.frames(u_id, self._table.free(u_id))
        v_frames, v_origins, v_gaps = self._table.frames(v_id, self._table.free(v_id))
        gaps = 0.5 * (u_gaps[:, None] + v_gaps[None])
        turn, shift = mating_poses(u_frames, u_origins, v_frames, v_origins, gaps)
        flat = turn.reshape(*turn.shape[:2], 9)
        return np.concatenate([shift / POSITION_TOLERANCE, flat / ANGLE_TOLERANCE], axis=2)

    def _motion(
        self, u_id: int, v_id: int, k: int, l: int  # noqa: E741
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:  # fmt: skip
        """Return the pose of u's group in v's frame with its point `k` on the other's `l`."""
        at = int(np.searchsorted(self._table.free(u_id), k)), int(np.searchsorted(self._table.free(v_id), l))
        return _unscaled(self._motions(u_id, v_id)[at])

    def coincident(self, state: Sequence[int]) -> Int[np.ndarray, "m m"]:
        """Return for each pair of free points of different groups how many pairs meet if it does; symmetric.

        The results of the latest states are kept; do not write.
        """
        return self._kept_coincident(tuple(state))

    def _count_coincident(self, state: Sequence[int]) -> Int[np.ndarray, "m m"]:
        out = np.zeros((len(self._table.part), len(self._table.part)), np.int32)
        for i, u_id in enumerate(state):
            u = self._table.groups[u_id]
            for v_id in state[:i]:
                v = self._table.groups[v_id]
                key = (u.type_id, v.type_id)
                if key not in self._coincident:
                    motions = self._motions(u_id, v_id)
                    tree = KDTree(motions.reshape(-1, 12))
                    counts = tree.query_ball_point(tree.data, 1.0, return_length=True)
                    self._coincident[key] = np.asarray(counts, np.int32).reshape(motions.shape[:2])
                rows, columns = u.rows[self._table.free(u_id)][:, None], v.rows[self._table.free(v_id)]
                out[rows, columns] = self._coincident[key]
                out[columns, rows] = self._coincident[key]
        return out

    def novelty(self, state: Sequence[int], pairs: Int[np.ndarray, "p 2"]) -> Float[np.ndarray, "p"]:
        """Return for pairs of points the share of relative poses never seen before, of all between their groups."""
        owner, local = self._places(state)
        out = np.zeros(len(pairs))
        ends: list[list[int]] = np.concatenate([owner[pairs], local[pairs]], axis=1).tolist()
        for i, (u_id, v_id, k, l) in enumerate(ends):  # noqa: E741
            key = (self._table.groups[u_id].type_id, self._table.groups[v_id].type_id, k, l)
            if key not in self._between:
                turn, shift = self._motion(u_id, v_id, k, l)
                moved = [p.moved(turn, shift) for p in self._placed(u_id)]
                self._between[key] = self._relative_poses.between(moved, self._placed(v_id))
            numbers = self._between[key]
            out[i] = self._relative_poses.novel_count(numbers) / len(numbers)
        return out

    def locked_out(self, state: Sequence[int], pairs: Int[np.ndarray, "p 2"]) -> Int[np.ndarray, "p"]:
        """Return for each pair of points how many other groups would no longer go in if it were joined.

        Those belong between the two groups, as far as it is known which points fit, and their mates face different
        ways.
        """
        owner, local = self._places(state)
        ends: dict[tuple[int, int], list[int]] = {}
        for i, (u_id, v_id) in enumerate(owner[pairs].tolist()):
            ends.setdefault((u_id, v_id), []).append(i)
        out = np.zeros(len(pairs), int)
        for (u_id, v_id), some in ends.items():
            others = [g for g in state if g not in (u_id, v_id) and self._fits_between(u_id, v_id, g)]
            if others:
                k, l = local[pairs[some]].T  # noqa: E741
                out[some] = sum(self._locks(u_id, v_id, k, l, other) for other in others)
        return out

    def _fits_between(self, u_id: int, v_id: int, other: int) -> bool:
        """Return whether another group is known to fit both groups, and so may be locked out."""
        groups = self._table.groups
        key = (groups[u_id].type_id, groups[v_id].type_id, groups[other].type_id)
        if key not in self._between_both:
            self._between_both[key] = all(len(self._known_fits(other, g).rows) > 0 for g in (u_id, v_id))
        return self._between_both[key]

    def _places(self, state: Sequence[int]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
        """Return the group of each point, and the point's number among the points of its group."""
        owner, local = np.zeros_like(self._table.part), np.zeros_like(self._table.part)
        for group_id in state:
            rows = self._table.groups[group_id].rows
            owner[rows], local[rows] = group_id, np.arange(len(rows))
        return owner, local

    def _locks(
        self, u_id: int, v_id: int, k: Int[np.ndarray, "p"], l: Int[np.ndarray, "p"], other: int  # noqa: E741
    ) -> Bool[np.ndarray, "p"]:  # fmt: skip
        """Return for each pair of points of two groups whether it locks another group out."""
        groups = self._table.groups
        key = (groups[u_id].type_id, groups[v_id].type_id, groups[other].type_id)
        if key not in self._locked:
            self._locked[key] = np.full((len(groups[u_id].rows), len(groups[v_id].rows)), _UNKNOWN, np.int8)
        known = self._locked[key]
        unknown = np.flatnonzero(known[k, l] == _UNKNOWN)
        if len(unknown):
            some = k[unknown], l[unknown]
            known[some] = self._compute_locks(u_id, v_id, *some, other)
        return known[k, l] > 0

    def _compute_locks(
        self, u_id: int, v_id: int, k: Int[np.ndarray, "p"], l: Int[np.ndarray, "p"], other: int  # noqa: E741
    ) -> Bool[np.ndarray, "p"]:  # fmt: skip
        on_u, on_v = self._known_fits(other, u_id), self._known_fits(other, v_id)
        at = np.searchsorted(self._table.free(u_id), k), np.searchsorted(self._table.free(v_id), l)
        turn, shift = _unscaled(self._motions(u_id, v_id)[at])
        shifts = on_u.shifts @ np.swapaxes(turn, 1, 2) + shift[:, None]
        near = np.linalg.norm(shifts[:, :, None] - on_v.shifts, axis=3) < 2.0 * POSITION_TOLERANCE
        facing = on_u.normals @ on_v.normals.T > _SAME_WAY
        pair, a, b = np.nonzero(near & ~facing & (on_u.rows[:, None] != on_v.rows))
        traces = np.einsum("pij,pij->p", turn[pair] @ on_u.turns[a], on_v.turns[b])
        out = np.zeros(len(k), bool)
        out[pair[traces > 1.0 + 2.0 * np.cos(2.0 * ANGLE_TOLERANCE)]] = True
        return out

    def _known_fits(self, u_id: int, v_id: int) -> _Fits:
        """Return the ways in which u's free points are known to fit v's."""
        u, v = self._table.groups[u_id], self._table.groups[v_id]
        key = (u_id, v_id)
        if key not in self._fits:
            free_u, free_v = self._table.free(u_id), self._table.free(v_id)
            right = self._right()[np.ix_(u.rows[free_u], v.rows[free_v])]
            rows, columns = np.nonzero(right)
            motions = self._motions(u_id, v_id)[rows, columns] if len(rows) else np.zeros((0, 12))
            turns, shifts = _unscaled(motions)
            frames, _, _ = self._table.frames(u_id, free_u)
            normals = frames[rows, :, 2] if len(rows) else np.zeros((0, 3))
            self._fits[key] = _Fits(rows, turns, shifts, normals)
        return self._fits[key]

    def axis(self, state: Sequence[int], row: int, column: int) -> int:
        """Return the axis of the furniture's frame along which two points come together, as the larger group has it."""
        u_id, v_id = self._table.owner(state, row), self._table.owner(state, column)
        if (len(self._table.groups[u_id].rows), u_id) < (len(self._table.groups[v_id].rows), v_id):
            u_id, row = v_id, column
        if (u_id, row) not in self._axes:
            turns, _, _ = self._table.frames(u_id, np.array([self._table.local(u_id, row)]))
            self._axes[u_id, row] = int(np.argmax(np.abs(turns[0, :, 2])))
        return self._axes[u_id, row]

    def _placed(self, group_id: int) -> list[PlacedPart]:
        """Return the parts of a group in its frame."""
        typed, group = self._table.groups[group_id], self._table.group(group_id)
        # Equal parts may have points that others of them lack.
        count = {p: len(group.points_of(self._table.furniture, p)) for p in group.parts}
        there = [i for i, row in enumerate(typed.rows) if self._table.point[row] < count[int(self._table.part[row])]]
        _, origins, _ = self._table.frames(group_id, np.array(there, int))
        part_of = self._table.part[typed.rows[there]]
        return [
            PlacedPart(self._table.furniture.class_of[p], pose.translation, origins[part_of == p])
            for p, pose in zip(group.parts, group.furniture_from_part, strict=True)
        ]
