"""Order of merges that a layout allows: which groups can still be joined after which.

A layout and the depth images of its mates give an estimate of a directional blocking graph (Wilson and Latombe 1994,
"Geometric Reasoning about Mechanical Assembly"): along a direction, a group is blocked by each mate's partner that is
in its way. A merge locks somebody out if the rest cannot be taken apart any more without splitting it. Groups that do
not touch are taken to pass each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from roboassembly.geometry.mating import distinct_directions
from roboassembly.learning.relational.features import exit_states
from roboassembly.learning.relational.layout_search import Layout
from roboassembly.learning.relational.mesh_tests import GroupMeshes
from roboassembly.learning.relational.tokens import Tokens

_SAME = 0.999
"""Cosine above which two directions count as one."""
_ON_AXIS = 0.99
"""Cosine above which a direction counts as an axis of a point's frame."""
_MOST_DOUBTED, _MOST_FREED = 0.8, 16
"""Largest share of blocked pixels of an exit that may be free after all, and number of such exits that are tried."""
_INTO_MATE = 0.3
"""Cosine between a direction and a mate's normal above which the mate itself is in the way."""
_MOST_GROUPS = 24
"""Largest number of groups that are examined."""


@dataclass(frozen=True, eq=False)
class JoiningOrder:
    """Estimated blocking graph of a layout of g groups."""

    arcs: list[list[int]]
    """Bit mask, for each direction and group, of the groups that are in its way."""
    near: list[int]
    """Bit mask, for each group, of the groups that it mates with."""
    _solvable: dict[frozenset[int], bool] = field(default_factory=dict[frozenset[int], bool])
    _obstacles: dict[int, list[int]] = field(default_factory=dict[int, list[int]])

    @cached_property
    def _distinct_arcs(self) -> list[list[int]]:
        """Rows of `arcs` without repetitions."""
        return [list(row) for row in dict.fromkeys(map(tuple, self.arcs))]

    @staticmethod
    def of_layout(tokens: Tokens, layout: Layout, meshes: GroupMeshes | None = None) -> JoiningOrder | None:
        """Return the order that a layout allows; None for too many groups.

        Args:
            tokens: the state.
            layout: layout of its groups.
            meshes: meshes of the groups, if they are known. If by them nothing can be joined, the layout is not exact
                enough, and the images decide.
        """
        groups = len(tokens.types)
        if groups > _MOST_GROUPS:
            return None
        frames = layout.rotation[tokens.group] @ tokens.frame.astype(float)
        mates = np.array([pair for mate in layout.mates for pair in (mate, mate[::-1])], int).reshape(-1, 2)
        moving, waiting = mates.T
        axes = frames[moving].swapaxes(1, 2).reshape(-1, 3)
        directions = np.array(distinct_directions(np.stack([axes, -axes], axis=1).reshape(-1, 3), _SAME)).reshape(-1, 3)
        if meshes is not None:
            order = _by_meshes(meshes, layout, tokens.group[mates], frames[moving, :, 2], directions)
            if order.whole_is_solvable():
                return order
        free, shares = _along(directions, frames[waiting], *exit_states(tokens.exits[moving, waiting]))
        arcs = [[0] * groups for _ in directions]
        near = [0] * groups
        doubts: dict[tuple[int, int, int], float] = {}
        owners: list[tuple[int, int]] = tokens.group[mates].tolist()
        for (a, b), is_free, blocked in zip(owners, free, shares.tolist(), strict=True):
            near[a] |= 1 << b
            for index in np.flatnonzero(~is_free).tolist():
                arcs[index][a] |= 1 << b
                doubts[index, a, b] = max(blocked[index], doubts.get((index, a, b), 0.0))
        order = JoiningOrder(arcs, near)
        return order if order.whole_is_solvable() else order.with_likely_exits(doubts)

    def with_likely_exits(self, doubts: dict[tuple[int, int, int], float]) -> JoiningOrder:
        """Return the order with further exits, so that all groups can be joined.

        One exit that is wrongly seen as blocked locks everything. The one with the fewest blocked pixels may be it. If
        no single exit is enough, as many open as are needed, those with the fewest blocked pixels first.

        Args:
            doubts: share of blocked pixels of each exit: direction, moving group and waiting group.
        """
        exits = sorted(doubts, key=doubts.__getitem__)
        for likely in exits[:_MOST_FREED]:
            if doubts[likely] < _MOST_DOUBTED:
                other = self._with([likely])
                if other.whole_is_solvable():
                    return other
        few, many = 0, len(exits)
        while few + 1 < many:
            middle = (few + many) // 2
            few, many = (few, middle) if self._with(exits[:middle]).whole_is_solvable() else (middle, many)
        return self._with(exits[:many])

    def _with(self, exits: list[tuple[int, int, int]]) -> JoiningOrder:
        """Return the order with some exits open."""
        other = JoiningOrder([[*row] for row in self.arcs], self.near)
        for index, a, b in exits:
            other.arcs[index][a] &= ~(1 << b)
        return other

    def whole_is_solvable(self) -> bool:
        """Return whether all groups can be joined into one."""
        return self.solvable(frozenset(1 << g for g in range(len(self.near))))

    def separable(self, a: int, b: int) -> bool:
        """Return whether two groups can be separated along any direction."""
        return any(not arcs[a] >> b & 1 for arcs in self._distinct_arcs)

    def allows(self, a: int, b: int) -> bool:
        """Return whether all groups can still be joined once groups `a` and `b` are one."""
        units = [1 << g for g in range(len(self.near)) if g not in (a, b)]
        return self.separable(a, b) and self.solvable(frozenset([*units, 1 << a | 1 << b]))

    def solvable(self, units: frozenset[int]) -> bool:
        """Return whether some units, sets of groups as bit masks, can be joined into one.

        Groups that can leave others can leave some of them, so the first two halves decide: if one of them cannot be
        taken apart, neither can any other set that holds it.
        """
        if len(units) == 1:
            return True
        if units not in self._solvable:
            half = self._half(units)
            self._solvable[units] = half is not None and self.solvable(half) and self.solvable(units - half)
        return self._solvable[units]

    def _half(self, units: frozenset[int]) -> frozenset[int] | None:
        """Return units that can leave the others, both in one piece; None if there are none. One unit comes first."""
        everything = sum(units)
        ordered = sorted(units)
        obstacles = {unit: self._in_way_of(unit) for unit in ordered}
        for unit in ordered:
            rest = everything & ~unit
            if not all(way & rest for way in obstacles[unit]) and self._whole(rest):
                return frozenset((unit,))
        unit_of = {1 << g: unit for unit in ordered for g in range(unit.bit_length()) if unit >> g & 1}
        given: set[int] = set()
        for direction in range(len(self._distinct_arcs)):
            in_way = {unit: obstacles[unit][direction] & everything & ~unit for unit in ordered}
            for start in ordered:
                closed = _closure(start, in_way, unit_of)
                if closed != everything and closed not in given:
                    given.update((closed, everything & ~closed))
                    if self._whole(closed) and self._whole(everything & ~closed):
                        return frozenset(unit for unit in ordered if unit & closed)
        return None

    def _in_way_of(self, unit: int) -> list[int]:
        """Return the groups that are in a unit's way, for each distinct direction. Results are cached."""
        if unit not in self._obstacles:
            self._obstacles[unit] = [_union(arcs, unit) for arcs in self._distinct_arcs]
        return self._obstacles[unit]

    def _whole(self, groups: int) -> bool:
        """Return whether some groups hang together."""
        reached = fresh = groups & -groups
        while fresh:
            fresh = _union(self.near, fresh) & groups & ~reached
            reached |= fresh
        return reached == groups


def _by_meshes(
    meshes: GroupMeshes, layout: Layout, owners: Int[np.ndarray, "m 2"], normals: Float[np.ndarray, "m 3"],
    directions: Float[np.ndarray, "d 3"],
) -> JoiningOrder:  # fmt: skip
    """Return the order that a layout allows by the meshes of its groups.

    Args:
        meshes: meshes of the groups.
        layout: the layout.
        owners: groups of each mate, the moving one first; each mate both ways.
        normals: normal of each moving point in the layout.
        directions: unit vectors in the layout.
    """
    groups = len(layout.rotation)
    poses = list(zip(layout.rotation, layout.translation, strict=True))
    toward = np.full((groups, groups, len(directions)), -1.0)
    np.maximum.at(toward, tuple(owners.T), normals @ directions.T)
    near = [0] * groups
    for a, b in owners.tolist():
        near[a] |= 1 << b
    opposite: list[int] = np.argmin(directions @ directions.T, axis=1).tolist()
    arcs = [[0] * groups for _ in directions]
    for a, b in combinations(range(groups), 2):
        # Moving b along a direction is the same as moving a against it.
        blocked = np.maximum(toward[a, b], toward[b, a, opposite]) > _INTO_MATE
        rest = np.flatnonzero(~blocked)
        blocked[rest] = meshes.blocked(a, poses[a], b, poses[b], directions[rest])
        for index in np.flatnonzero(blocked).tolist():
            arcs[index][a] |= 1 << b
            arcs[opposite[index]][b] |= 1 << a
    return JoiningOrder(arcs, near)


def locks_out(tokens: Tokens, layout: Layout, meshes: GroupMeshes | None = None) -> frozenset[tuple[int, int]]:
    """Return which mates that place groups of a layout seem to lock a group out; none if all do."""
    order = JoiningOrder.of_layout(tokens, layout, meshes)
    if order is None:
        return frozenset()
    allowed: dict[tuple[int, int], bool] = {}
    groups_of: dict[tuple[int, int], tuple[int, int]] = {}
    for k, l in layout.placed_by:  # noqa: E741
        a, b = sorted((int(tokens.group[k]), int(tokens.group[l])))
        groups_of[k, l] = a, b
        if (a, b) not in allowed:
            allowed[a, b] = order.allows(a, b)
    locked = frozenset(mate for mate, groups in groups_of.items() if not allowed[groups])
    return locked if any(allowed.values()) else frozenset()


def _along(
    directions: Float[np.ndarray, "d 3"], frames: Float[np.ndarray, "m 3 3"], free: Bool[np.ndarray, "m 6"],
    shares: Float[np.ndarray, "m 6"],
) -> tuple[Bool[np.ndarray, "m d"], Float[np.ndarray, "m d"]]:  # fmt: skip
    """Return for each mate and direction whether the exit is free, and its blocked share; off the axes none is.

    Args:
        directions: unit vectors in the layout.
        frames: `layout_from_point` of the waiting points.
        free: whether the exits along their axes are free: x, -x, y, -y, z, -z.
        shares: their blocked shares.
    """
    cosine = directions @ frames
    axis = np.argmax(np.abs(cosine), axis=2)
    along = np.take_along_axis(cosine, axis[..., None], axis=2)[..., 0]
    is_axis, exit_number = np.abs(along) > _ON_AXIS, 2 * axis + (along < 0)
    return (
        is_axis & np.take_along_axis(free, exit_number, axis=1),
        np.where(is_axis, np.take_along_axis(shares, exit_number, axis=1), 1.0),
    )


def _union(masks: list[int], members: int) -> int:
    """Return the union of the masks of some members."""
    out = 0
    while members:
        lowest = members & -members
        out |= masks[lowest.bit_length() - 1]
        members -= lowest
    return out


def _closure(start: int, in_way: dict[int, int], unit_of: dict[int, int]) -> int:
    """Return the groups of a unit and of all units in its way.

    Args:
        start: the unit.
        in_way: groups in the way of each unit.
        unit_of: unit of each group, by the group's bit.
    """
    closed, pending = start, [start]
    while pending:
        fresh = in_way[pending.pop()] & ~closed
        while fresh:
            unit = unit_of[fresh & -fresh]
            closed |= unit
            fresh &= ~unit
            pending.append(unit)
    return closed
