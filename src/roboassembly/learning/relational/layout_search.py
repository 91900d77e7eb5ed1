"""Search for a layout of all groups in which connection points find mates.

One pair of points may look right and still be wrong: boards that differ by millimetres fit many places alone, but only
one of them leaves a mate for every other point. The search puts the groups together on paper, one after the other, by
the pairs that the network believes in, and keeps the layouts that cost least. No path is planned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.relational.mesh_tests import GroupMeshes
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
_LARGEST_COSTS = (6.0, 9.0, 12.0)
"""Largest cost of a pair that places a group; unlikelier pairs are not tried. The further ones are for layouts whose
meshes are known not to overlap, one after the other while no layout is found."""
_LARGEST_FURTHER = 2.5
"""Largest cost of a pair that meets because others were mated: it has geometry on its side."""
_MOST_ALONE = 0.45
"""Largest share of points without a mate in a layout that is accepted."""
_MOST_DOUBT, _MOST_DOUBT_CHECKED = 3.0, 10.0
"""Largest cost of the mates of a layout that leaves points without one, and of one whose meshes do not overlap."""
_AS_GOOD = 0.5
"""Cost up to which a layout may exceed the least one to be returned with it."""
_PLACE_CELL = 0.01
"""Size of the cells in which two groups count as at the same place [m]."""
_Place = tuple[float, ...]
"""Type and rounded pose of a group."""


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
    meshes: GroupMeshes | None = None
    """Meshes of the groups, which must not overlap; None if they are not known."""


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
    doubtful: bool = False
    """Whether the costs alone would not make it acceptable; its meshes do not overlap."""

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
    places: frozenset[_Place]
    """Types and places of the groups: equal for states that differ in which of equal groups lies where."""


@dataclass(frozen=True, eq=False)
class _Extension:
    """A layout with one more group."""

    state: _Partial
    """The layout without it."""
    group: int
    """Number of the group."""
    rotation: Float[np.ndarray, "3 3"]
    """`layout_from_group` of the group."""
    translation: Float[np.ndarray, "3"]
    """`layout_from_group` of the group [m]."""
    position: Float[np.ndarray, "m 3"]
    """Positions of the group's points [m]."""
    normal: Float[np.ndarray, "m 3"]
    """Their normals."""
    cost: float
    mates: tuple[tuple[int, int], ...]
    places: frozenset[_Place]

    @property
    def score(self) -> float:
        """Cost beside other layouts of as many groups."""
        return self.cost - _MATED * len(self.mates)


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Points of a group at a pose beside the points of a layout."""

    group: int
    """Number of the group."""
    mine: Int[np.ndarray, "m"]
    """Its points."""
    there: Int[np.ndarray, "t"]
    """Points of the layout."""
    position: Float[np.ndarray, "m 3"]
    """Positions of the group's points in the layout [m]."""
    normal: Float[np.ndarray, "m 3"]
    """Their normals."""
    near: Bool[np.ndarray, "m t"]
    """Whether two points face each other and nearly meet."""
    meets: Bool[np.ndarray, "m t"]
    """Whether two points meet."""
    costs: Float[np.ndarray, "m t"]
    """Cost of each pair."""
    order: Float[np.ndarray, "m t"]
    """Rank of each pair of points that meet, the least first; infinite for all others."""


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
    checked = problem.meshes is not None
    for largest in _LARGEST_COSTS if checked else _LARGEST_COSTS[:1]:
        best = [layout for layout in _best_layouts(problem, width, largest) if layout.alone <= _MOST_ALONE * n]
        likely = [layout for layout in best if not layout.alone or layout.doubt <= _MOST_DOUBT]
        if likely and largest == _LARGEST_COSTS[0]:
            return likely
        best = [layout for layout in best if not layout.alone or layout.doubt <= _MOST_DOUBT_CHECKED]
        if best and checked:
            return [replace(layout, doubtful=True) for layout in likely or best]
    return []


def _best_layouts(problem: LayoutProblem, width: int, largest_cost: float) -> list[Layout]:
    """Return the layouts of least cost, those of nearly equal cost too, the best first.

    Args:
        problem: groups and the costs of their pairs.
        width: number of layouts of some groups that are extended by another group.
        largest_cost: largest cost of a pair that places a group.
    """
    groups = len(problem.types)
    search = _Search(problem, largest_cost)
    beam = [search.first(int(np.argmax(np.bincount(problem.group, minlength=groups))))]
    for _ in range(groups - 1):
        found: dict[frozenset[_Place], _Extension] = {}
        for state in beam:
            for extension in search.extensions(state):
                known = found.get(extension.places)
                if known is None or extension.score < known.score:
                    found[extension.places] = extension
        best_found = sorted(found.values(), key=lambda extension: extension.score)[:width]
        beam = [search.extended(extension) for extension in best_found]
    complete = sorted((search.layout(state) for state in beam), key=lambda layout: layout.cost)
    return [layout for layout in complete if layout.cost <= complete[0].cost + _AS_GOOD]


class _Search:
    """Geometry that all states of a search share."""

    def __init__(self, problem: LayoutProblem, largest_cost: float) -> None:
        self.problem, self._largest_cost = problem, largest_cost
        # waiting_from_moving of every pair: rows move.
        self._turn, self._shift = mating_poses(problem.frame, problem.position, problem.frame, problem.position)
        self._members = [np.flatnonzero(problem.group == g) for g in range(len(problem.types))]
        most = max(map(len, self._members))
        # The points of each group, filled up with its last one.
        self._points = np.array([[*points, *[points[-1]] * (most - len(points))] for points in self._members])

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
            frozenset(self._places(np.array([group]), eye[None], zero[None])),
        )  # fmt: skip

    def _places(
        self,
        groups: Int[np.ndarray, "c"],
        rotations: Float[np.ndarray, "c 3 3"],
        translations: Float[np.ndarray, "c 3"],
    ) -> list[_Place]:
        """Return type and place of some groups."""
        types = np.array(self.problem.types, float)[groups, None]
        turns, shifts = np.rint(rotations).reshape(-1, 9) + 0.0, np.rint(translations / _PLACE_CELL) + 0.0
        return [tuple(row) for row in np.concatenate([types, turns, shifts], axis=1).tolist()]

    def _same_tangents(self, state: _Partial, k: int, l: int) -> bool:  # noqa: E741
        """Return whether two points that meet have equal tangents."""
        p = self.problem
        first, second = (state.rotation[p.group[i]] @ p.frame[i, :, 0] for i in (k, l))
        return float(first @ second) > -CONTACT_COSINE

    def extensions(self, state: _Partial) -> Iterator[_Extension]:
        """Yield the layouts with one more group, by the likeliest mates of open points."""
        p = self.problem
        open_points, left, there = (
            np.flatnonzero(state.open),
            np.flatnonzero(~state.placed),
            np.flatnonzero(state.placed),
        )
        costs = p.cost[open_points[:, None], left].ravel()
        likely = np.flatnonzero(costs <= self._largest_cost)
        rows, columns = np.divmod(likely[np.argsort(costs[likely], kind="stable")], len(left))
        k, l = open_points[rows], left[columns]  # noqa: E741
        bases = state.rotation[p.group[k]]
        turns = bases @ self._turn[l, k]
        shifts = np.einsum("cij,cj->ci", bases, self._shift[l, k]) + state.translation[p.group[k]]
        # Equal groups are alike: the first that is left stands for all. Further mates lead to the same place.
        places = self._places(p.group[l], turns, shifts)
        first_at: dict[_Place, int] = {}
        for index, place in enumerate(places):
            first_at.setdefault(place, index)
        distinct = np.array([*first_at.values()], int)
        extended = 0
        while extended < _CHOICES and len(distinct):
            some, distinct = distinct[: _CHOICES - extended], distinct[_CHOICES - extended :]
            meetings = self._meetings(state, there, p.group[l[some]], turns[some], shifts[some])
            numbers: list[int] = some.tolist()
            for index, meeting in zip(numbers, meetings, strict=True):
                mate = int(k[index]), int(l[index])
                extension = self._extension(state, meeting, mate, turns[index], shifts[index], places[index])
                if extension is not None:
                    extended += 1
                    yield extension

    def _meetings(
        self, state: _Partial, there: Int[np.ndarray, "t"], groups: Int[np.ndarray, "c"],
        turns: Float[np.ndarray, "c 3 3"], shifts: Float[np.ndarray, "c 3"],
    ) -> Iterator[_Meeting]:  # fmt: skip
        """Yield how each of some groups would meet a layout.

        Args:
            state: layout.
            there: points of its groups.
            groups: the groups, each at a pose of its own.
            turns: `layout_from_group` of each.
            shifts: the same [m].
        """
        p, points = self.problem, self._points[groups]
        back = turns.swapaxes(1, 2)
        positions, normals = p.position[points] @ back + shifts[:, None], p.frame[points, :, 2] @ back
        offsets = positions[:, :, None] - state.position[there]
        distances = np.sqrt((offsets * offsets).sum(axis=3))
        near = (distances < _MISS_DISTANCE) & (normals @ state.normal[there].T < CONTACT_COSINE)
        meets = near & (distances < _MATE_DISTANCE)
        costs, free = p.cost[points[:, :, None], there], state.open[there]
        # Two points of a part can lie closer together than points may be apart that meet.
        order = np.where(meets & free, costs + distances / _MATE_DISTANCE, np.inf)
        numbers: list[int] = groups.tolist()
        for index, group in enumerate(numbers):
            mine = self._members[group]
            arrays = (a[index, : len(mine)] for a in (positions, normals, near, meets, costs, order))
            yield _Meeting(group, mine, there, *arrays)

    def _extension(
        self, state: _Partial, meeting: _Meeting, mate: tuple[int, int], turn: Float[np.ndarray, "3 3"],
        shift: Float[np.ndarray, "3"], place: _Place,
    ) -> _Extension | None:  # fmt: skip
        """Return the layout in which a point of a new group mates with an open one; None if the group has no room.

        Args:
            state: layout without the group.
            meeting: how the group meets it.
            mate: open point, and point of the group.
            turn: `layout_from_group` of the group.
            shift: the same [m].
            place: type and place of the group.
        """
        mine, there, costs = meeting.mine, meeting.there, meeting.costs
        k, l = mate  # noqa: E741
        # The mate itself meets, whatever rounding says.
        meeting.order[np.searchsorted(mine, l), np.searchsorted(there, k)] = -1.0
        rows, columns = _one_to_one(meeting.order)
        free = state.open[there]
        unmatched = np.ones((len(mine), 1), bool)
        unmatched[rows] = False
        if (meeting.meets & unmatched & ~free).any() or not np.isfinite(costs[rows, columns]).all():
            return None
        free[columns] = False
        cost = state.cost + _MISSED * float((meeting.near & unmatched & free).sum())
        pairs: list[tuple[int, int]] = []
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            pair = int(there[column]), int(mine[row])
            cost += min(float(costs[row, column]), self._largest_cost if pair == mate else _LARGEST_FURTHER)
            pairs.append(pair)
        if self._overlaps(state, meeting.group, turn, shift):
            return None
        return _Extension(
            state, meeting.group, turn, shift, meeting.position, meeting.normal, cost, (*state.mates, *pairs),
            state.places | {place},
        )  # fmt: skip

    def _overlaps(
        self, state: _Partial, group: int, turn: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]
    ) -> bool:
        """Return whether the mesh of a group overlaps that of a layout; arguments as of `_extension`."""
        meshes = self.problem.meshes
        if meshes is None:
            return False
        placed: list[int] = np.unique(self.problem.group[state.placed]).tolist()
        return any(
            meshes.overlap(group, (turn, shift), other, (state.rotation[other], state.translation[other]))
            for other in placed
        )

    def extended(self, extension: _Extension) -> _Partial:
        """Return the layout of a state and one more group."""
        state, h = extension.state, extension.group
        mine = self._members[h]
        open_points, placed, rotation, translation, position, normal = (
            array.copy()
            for array in (state.open, state.placed, state.rotation, state.translation, state.position, state.normal)
        )
        open_points[mine] = placed[mine] = True
        open_points[np.array(extension.mates[len(state.mates) :]).ravel()] = False
        rotation[h], translation[h] = extension.rotation, extension.translation
        position[mine], normal[mine] = extension.position, extension.normal
        return _Partial(
            extension.cost, rotation, translation, placed, open_points, position, normal, extension.mates,
            extension.places,
        )  # fmt: skip


def _one_to_one(costs: Float[np.ndarray, "m n"]) -> tuple[Int[np.ndarray, "r"], Int[np.ndarray, "r"]]:
    """Return the rows and columns of pairs of finite cost, the cheapest first, with no row or column twice."""
    rows: list[int] = []
    columns: list[int] = []
    finite = np.flatnonzero(np.isfinite(costs))
    for flat in finite[np.argsort(costs.ravel()[finite], kind="stable")].tolist():
        row, column = divmod(flat, costs.shape[1])
        if row not in rows and column not in columns:
            rows.append(row)
            columns.append(column)
    return np.array(rows, int), np.array(columns, int)
