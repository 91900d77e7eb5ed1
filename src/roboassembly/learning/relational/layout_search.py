"""Search for a layout of all groups in which connection points find mates.

One pair of points may look right and still be wrong: boards that differ by millimetres fit many places alone, but only
one of them leaves a mate for every other point. The search puts the groups together on paper, one after the other, by
the pairs that the network believes in, and keeps the layouts that cost least. No path is planned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.relational.policy_view import CONTACT_COSINE

BEAM_WIDTH = 4
"""Number of layouts of some groups that are extended by another group."""
_CHOICES = 8
"""Largest number of mates by which a layout is extended."""
_MATE_DISTANCE = 0.005
"""Distance up to which two points of a layout meet [m]; gaps at mates add up."""
_MISS_DISTANCE = 0.012
"""Distance up to which two points that face each other but do not meet speak against a layout [m]."""
_MATED = 1.0
"""Number subtracted from the cost of a layout of some groups for each of its mates, when it is compared with others."""
_ALONE = 3.0
"""Cost of a point without a mate."""
_MISSED = 1.5
"""Cost of two points that nearly meet."""
_LARGEST_COST = 6.0
"""Largest cost of a pair that places a group; unlikelier pairs are not tried."""
_LARGEST_FURTHER = 2.5
"""Largest cost of a pair that meets because others were mated: it has geometry on its side."""
_MOST_ALONE = 0.45
"""Largest share of points without a mate in a layout that is accepted."""
_MOST_DOUBT = 3.0
"""Largest cost of the mates of a layout that leaves points without one."""
_AS_GOOD = 0.5
"""Cost up to which a layout may exceed the least one to be returned with it."""
_PLACE_CELL = 0.01
"""Size of the cells in which two groups count as at the same place [m]."""


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
    doubt: float
    """Sum of the costs of all pairs."""
    rotation: Float[np.ndarray, "g 3 3"] = field(repr=False)
    """`layout_from_group` of each group."""
    translation: Float[np.ndarray, "g 3"] = field(repr=False)
    """`layout_from_group` of each group [m]."""

    @property
    def cost(self) -> float:
        """Sum of the costs of all pairs and of the points without a mate."""
        return self.doubt + _ALONE * self.alone


@dataclass(frozen=True, eq=False)
class _Partial:
    """A layout of some groups."""

    cost: float
    rotation: Float[np.ndarray, "g 3 3"]
    translation: Float[np.ndarray, "g 3"]
    placed: Bool[np.ndarray, "n"]
    """Whether each point's group is placed."""
    open: Bool[np.ndarray, "n"]
    """Whether each point of a placed group has no mate yet."""
    position: Float[np.ndarray, "n 3"]
    """Positions of the points of placed groups [m]."""
    normal: Float[np.ndarray, "n 3"]
    """Their normals."""
    mates: tuple[tuple[int, int], ...]
    places: frozenset[tuple[float, ...]]
    """Types and places of the groups: equal for states that differ in which of equal groups lies where."""

    @property
    def score(self) -> float:
        """Cost beside other layouts of as many groups."""
        return self.cost - _MATED * len(self.mates)


def find_layouts(problem: LayoutProblem, width: int = BEAM_WIDTH) -> list[Layout]:
    """Return the layouts of least cost that a beam search finds, those of nearly equal cost too, the best first.

    The search adds one group after the other. Points may stay without a mate: in real furniture, equal parts have
    points that only some of them use.

    Args:
        problem: groups and the costs of their pairs.
        width: number of layouts of some groups that are extended by another group.
    """
    n, groups = len(problem.group), len(problem.types)
    if groups < 2 or len(np.unique(problem.group)) < groups:
        return []
    search = _Search(problem)
    beam = [search.first(int(np.argmax(np.bincount(problem.group, minlength=groups))))]
    for _ in range(groups - 1):
        found: dict[frozenset[tuple[float, ...]], _Partial] = {}
        for state in beam:
            for extended in search.extensions(state):
                known = found.get(extended.places)
                if known is None or extended.score < known.score:
                    found[extended.places] = extended
        beam = sorted(found.values(), key=lambda state: state.score)[:width]
    complete = sorted((search.layout(state) for state in beam), key=lambda layout: layout.cost)
    best = [layout for layout in complete if layout.cost <= complete[0].cost + _AS_GOOD]
    return [
        layout
        for layout in best
        if layout.alone <= _MOST_ALONE * n and not (layout.alone and layout.doubt > _MOST_DOUBT)
    ]


class _Search:
    """Geometry that all states of a search share."""

    def __init__(self, problem: LayoutProblem) -> None:
        self.problem = problem
        # waiting_from_moving of every pair: rows move.
        self._turn, self._shift = mating_poses(problem.frame, problem.position, problem.frame, problem.position)
        self._members = [np.flatnonzero(problem.group == g) for g in range(len(problem.types))]

    def layout(self, state: _Partial) -> Layout:
        """Return a state that places all groups as a layout."""
        alone = int(state.open.sum())
        equal = frozenset((min(pair), max(pair)) for pair in state.mates if self._same_tangents(state, *pair))
        return Layout(state.mates, equal, alone, state.cost, state.rotation, state.translation)

    def first(self, group: int) -> _Partial:
        """Return the layout of one group."""
        p = self.problem
        groups, mine = len(p.types), p.group == group
        eye, zero = np.eye(3), np.zeros(3)
        return _Partial(
            0.0, np.tile(eye, (groups, 1, 1)), np.zeros((groups, 3)), mine, mine, p.position, p.frame[:, :, 2], (),
            frozenset((self._place(group, eye, zero),)),
        )  # fmt: skip

    def _place(
        self, group: int, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
    ) -> tuple[float, ...]:
        turn, shift = np.rint(rotation).ravel() + 0.0, np.rint(translation / _PLACE_CELL) + 0.0
        return (float(self.problem.types[group]), *turn.tolist(), *shift.tolist())

    def _same_tangents(self, state: _Partial, k: int, l: int) -> bool:  # noqa: E741
        """Return whether two points that meet have equal tangents."""
        p = self.problem
        first, second = (state.rotation[p.group[i]] @ p.frame[i, :, 0] for i in (k, l))
        return float(first @ second) > -CONTACT_COSINE

    def extensions(self, state: _Partial) -> Iterator[_Partial]:
        """Yield the layouts with one more group, by the likeliest mates of open points."""
        cost, group = self.problem.cost, self.problem.group
        open_points = np.flatnonzero(state.open)
        left = np.flatnonzero(~state.placed)
        costs = cost[np.ix_(open_points, left)]
        tried: set[tuple[float, ...]] = set()
        extended = 0
        for flat in np.argsort(costs, axis=None, kind="stable").tolist():
            row, column = divmod(flat, len(left))
            if costs[row, column] > _LARGEST_COST or extended >= _CHOICES:
                return
            k, l = int(open_points[row]), int(left[column])  # noqa: E741
            g = int(group[k])
            turn = state.rotation[g] @ self._turn[l, k]
            shift = state.rotation[g] @ self._shift[l, k] + state.translation[g]
            # Equal groups are alike: the first that is left stands for all. Further mates lead to the same place.
            place = self._place(int(group[l]), turn, shift)
            if place not in tried:
                tried.add(place)
                placed = self._placed(state, k, l, turn, shift)
                if placed is not None:
                    extended += 1
                    yield placed

    def _placed(
        self, state: _Partial, k: int, l: int, turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]  # noqa: E741
    ) -> _Partial | None:  # fmt: skip
        """Return the layout in which point `l` of a new group mates with point `k`; None if the group has no room.

        Args:
            state: layout without the group.
            k: open point.
            l: point of the group.
            turn: `layout_from_group` of the group.
            shift: the same [m].
        """
        p = self.problem
        h = int(p.group[l])
        mine, there = self._members[h], np.flatnonzero(state.placed)
        at, normal = p.position[mine] @ turn.T + shift, p.frame[mine, :, 2] @ turn.T
        distance = np.linalg.norm(at[:, None] - state.position[there], axis=2)
        near = (distance < _MISS_DISTANCE) & (normal @ state.normal[there].T < CONTACT_COSINE)
        meets = near & (distance < _MATE_DISTANCE)
        costs, free = p.cost[np.ix_(mine, there)], state.open[there]
        # Two points of a part can lie closer together than points may be apart that meet.
        order = np.where(meets & free, costs + distance / _MATE_DISTANCE, np.inf)
        # The mate itself meets, whatever rounding says.
        order[np.searchsorted(mine, l), np.searchsorted(there, k)] = -1.0
        rows, columns = _one_to_one(order)
        unmatched = np.ones((len(mine), 1), bool)
        unmatched[rows] = False
        if (meets & unmatched & ~free).any() or not np.isfinite(costs[rows, columns]).all():
            return None
        free[columns] = False
        cost = state.cost + _MISSED * float((near & unmatched & free).sum())
        pairs: list[tuple[int, int]] = []
        open_points, placed = state.open.copy(), state.placed.copy()
        open_points[mine] = placed[mine] = True
        for row, column in zip(mine[rows].tolist(), there[columns].tolist(), strict=True):
            most = _LARGEST_COST if (row, column) == (l, k) else _LARGEST_FURTHER
            cost += min(float(p.cost[row, column]), most)
            pairs.append((column, row))
            open_points[[row, column]] = False
        rotation, translation, position, normals = (
            array.copy() for array in (state.rotation, state.translation, state.position, state.normal)
        )
        rotation[h], translation[h], position[mine], normals[mine] = turn, shift, at, normal
        return _Partial(
            cost, rotation, translation, placed, open_points, position, normals, (*state.mates, *pairs),
            state.places | {self._place(h, turn, shift)},
        )  # fmt: skip


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
