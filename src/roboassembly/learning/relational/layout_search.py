"""Search for a layout of all groups in which connection points find mates.

One pair of points may look right and still be wrong: boards that differ by millimetres fit many places alone, but only
one of them leaves a mate for every other point. The search puts the groups together on paper, one after the other, by
the pairs that the network believes in, and takes the first layout that places all groups. No path is planned.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.relational.policy_view import CONTACT_COSINE

MAX_STATES = 80
"""Number of incomplete layouts that are extended."""
_MATE_DISTANCE = 0.005
"""Distance up to which two points of a layout meet [m]; gaps at mates add up."""
_MISS_DISTANCE = 0.012
"""Distance up to which two points that face each other but do not meet speak against a layout [m]."""
_CHOICES = 5
"""Largest number of mates that are tried for a point."""
_ALONE = 4.0
"""Cost of a point without a mate."""
_MISSED = 1.5
"""Cost of two points that nearly meet."""
_LARGEST_COST = 6.0
"""Largest cost of a pair that places a group; unlikelier pairs are not tried."""
_LARGEST_FURTHER = 2.5
"""Largest cost of a pair that meets because others were mated: it has geometry on its side."""
_EXPECTED = 0.3
"""Further cost that is expected of each point without a mate yet: the search goes deep where the network has doubts."""
_MOST_ALONE = 0.2
"""Largest share of points without a mate in a layout that is accepted."""


@dataclass(frozen=True, eq=False)
class LayoutProblem:
    """Groups with n free points in all."""

    group: Int[np.ndarray, "n"]
    """Group of each point, from 0 on."""
    position: Float[np.ndarray, "n 3"]
    """Position of each point in its group's frame [m]."""
    frame: Float[np.ndarray, "n 3 3"]
    """`group_from_point` of each point."""
    cost: Float[np.ndarray, "n n"]
    """Cost of each pair: minus the logarithm of the probability that it fits; symmetric, infinite within a group."""
    types: Sequence[int]
    """Type of each group: number of the first group that is alike."""


@dataclass(frozen=True)
class Layout:
    """A layout of all groups."""

    mates: tuple[tuple[int, int], ...]
    """Pairs of points that meet."""
    placed_by: frozenset[tuple[int, int]]
    """Those of them whose tangents are equal, so that mating them gives this layout; each in ascending order."""
    alone: int
    """Number of points without a mate."""
    cost: float
    """Sum of the costs of all pairs and of the points without a mate."""
    rotation: Float[np.ndarray, "g 3 3"] = field(repr=False)
    """`layout_from_group` of each group."""
    translation: Float[np.ndarray, "g 3"] = field(repr=False)
    """`layout_from_group` of each group [m]."""


@dataclass(frozen=True, eq=False)
class _Partial:
    """A layout of some groups."""

    cost: float
    placed: frozenset[int]
    rotation: Float[np.ndarray, "g 3 3"]
    translation: Float[np.ndarray, "g 3"]
    open: Bool[np.ndarray, "n"]
    """Whether each point of a placed group has neither a mate nor been given up."""
    mates: tuple[tuple[int, int], ...]
    alone: int


def find_layout(problem: LayoutProblem, max_states: int = MAX_STATES) -> Layout | None:
    """Return the first complete layout of a best-first search; None if there is none among so many states.

    Args:
        problem: groups and the costs of their pairs.
        max_states: number of incomplete layouts that are extended.
    """
    n, groups = len(problem.group), len(problem.types)
    if groups < 2 or len(np.unique(problem.group)) < groups:
        return None
    search = _Search(problem)
    root = int(np.argmax(np.bincount(problem.group, minlength=groups)))
    first = _Partial(
        0.0, frozenset((root,)), np.tile(np.eye(3), (groups, 1, 1)), np.zeros((groups, 3)), problem.group == root, (), 0
    )
    ties = count()
    queue = [(search.estimate(first), next(ties), first)]
    seen: set[frozenset[tuple[int, int]]] = set()
    for _ in range(max_states):
        if not queue:
            return None
        _, _, state = heapq.heappop(queue)
        if len(state.placed) == groups:
            alone = state.alone + int(state.open.sum())
            if alone > _MOST_ALONE * n:
                continue
            equal = frozenset((min(pair), max(pair)) for pair in state.mates if search.same_tangents(state, *pair))
            return Layout(state.mates, equal, alone, state.cost, state.rotation, state.translation)
        for extended in search.extensions(state):
            key = frozenset(extended.mates)
            if extended.alone or key not in seen:
                seen.add(key)
                heapq.heappush(queue, (search.estimate(extended), next(ties), extended))
    return None


class _Search:
    """Geometry that all states of a search share."""

    def __init__(self, problem: LayoutProblem) -> None:
        self.problem = problem
        # waiting_from_moving of every pair: rows move.
        self._turn, self._shift = mating_poses(problem.frame, problem.position, problem.frame, problem.position)
        # A point costs at least half of its best pair.
        self._least = 0.5 * np.minimum(problem.cost.min(axis=1), _ALONE)
        self._members = [np.flatnonzero(problem.group == g) for g in range(len(problem.types))]

    def estimate(self, state: _Partial) -> float:
        """Return the expected cost of a complete layout."""
        if len(state.placed) == len(self.problem.types):
            return state.cost + _ALONE * float(state.open.sum())
        waiting = ~np.isin(self.problem.group, list(state.placed))
        return state.cost + float((self._least[waiting | state.open] + _EXPECTED).sum())

    def same_tangents(self, state: _Partial, k: int, l: int) -> bool:  # noqa: E741
        """Return whether two points that meet have equal tangents."""
        p = self.problem
        first, second = (state.rotation[p.group[i]] @ p.frame[i, :, 0] for i in (k, l))
        return float(first @ second) > -CONTACT_COSINE

    def extensions(self, state: _Partial) -> Iterator[_Partial]:
        """Yield the layouts with a mate for the point that has the clearest one, or without a mate for it."""
        cost, group = self.problem.cost, self.problem.group
        open_points = np.flatnonzero(state.open)
        left = np.flatnonzero(~np.isin(group, list(state.placed)))
        if not len(open_points):
            return
        costs = cost[np.ix_(open_points, left)]
        ordered = np.sort(costs, axis=1)
        second = ordered[:, 1] if costs.shape[1] > 1 else np.full(len(costs), _LARGEST_COST)
        # A point whose best pair is far better than its second one leaves no doubt.
        clear = np.minimum(second, _LARGEST_COST) - np.minimum(ordered[:, 0], _LARGEST_COST) - 0.5 * ordered[:, 0]
        k = int(open_points[np.argmax(clear)])
        choices: list[int] = left[np.argsort(cost[k, left], kind="stable")].tolist()
        tried: set[tuple[int, int]] = set()
        for l in choices:  # noqa: E741
            if cost[k, l] > _LARGEST_COST or len(tried) >= _CHOICES:
                break
            # Equal groups are alike: the first that is left stands for all.
            h = int(group[l])
            kind = (self.problem.types[h], self._members[h].tolist().index(l))
            if kind not in tried:
                tried.add(kind)
                placed = self._placed(state, k, l)
                if placed is not None:
                    yield placed
        given_up = state.open.copy()
        given_up[k] = False
        yield _Partial(
            state.cost + _ALONE, state.placed, state.rotation, state.translation, given_up, state.mates, state.alone + 1
        )

    def _placed(self, state: _Partial, k: int, l: int) -> _Partial | None:  # noqa: E741
        """Return the layout in which point `l` of a new group mates with point `k`; None if the group has no room."""
        p = self.problem
        g, h = int(p.group[k]), int(p.group[l])
        rotation, translation = state.rotation.copy(), state.translation.copy()
        rotation[h] = state.rotation[g] @ self._turn[l, k]
        translation[h] = state.rotation[g] @ self._shift[l, k] + state.translation[g]
        mine = self._members[h]
        there = np.flatnonzero(np.isin(p.group, list(state.placed)))
        at = p.position[mine] @ rotation[h].T + translation[h]
        owner = p.group[there]
        others = np.einsum("nij,nj->ni", rotation[owner], p.position[there]) + translation[owner]
        normal = p.frame[mine, :, 2] @ rotation[h].T
        other_normal = np.einsum("nij,nj->ni", rotation[owner], p.frame[there, :, 2])
        distance = np.linalg.norm(at[:, None] - others[None], axis=2)
        facing = normal @ other_normal.T < CONTACT_COSINE
        meets = (distance < _MATE_DISTANCE) & facing
        costs, free = p.cost[np.ix_(mine, there)], state.open[there]
        # Two points of a part can lie closer together than points may be apart that meet.
        order = np.where(meets & free, costs + distance / _MATE_DISTANCE, np.inf)
        # The mate itself meets, whatever rounding says.
        order[np.searchsorted(mine, l), np.searchsorted(there, k)] = -1.0
        rows, columns = _one_to_one(order)
        unmatched = np.ones((len(mine), 1), bool)
        unmatched[rows] = False
        if (meets & unmatched & ~free).any():
            return None
        free[columns] = False
        misses = (distance < _MISS_DISTANCE) & facing & unmatched & free
        cost = state.cost + _MISSED * float(misses.sum())
        if not np.isfinite(costs[rows, columns]).all():
            return None
        pairs: list[tuple[int, int]] = []
        open_points = state.open.copy()
        open_points[mine] = True
        for row, column in zip(mine[rows].tolist(), there[columns].tolist(), strict=True):
            most = _LARGEST_COST if (row, column) == (l, k) else _LARGEST_FURTHER
            cost += min(float(p.cost[row, column]), most)
            pairs.append((column, row))
            open_points[[row, column]] = False
        return _Partial(
            cost, state.placed | {h}, rotation, translation, open_points, (*state.mates, *pairs), state.alone
        )


def _one_to_one(costs: Float[np.ndarray, "m n"]) -> tuple[Int[np.ndarray, "r"], Int[np.ndarray, "r"]]:
    """Return the rows and columns of pairs of finite cost, the cheapest first, with no row or column twice."""
    rows: list[int] = []
    columns: list[int] = []
    for flat in np.argsort(costs, axis=None, kind="stable")[: int(np.isfinite(costs).sum())].tolist():
        row, column = divmod(flat, costs.shape[1])
        if row not in rows and column not in columns:
            rows.append(row)
            columns.append(column)
    return np.array(rows, int), np.array(columns, int)
