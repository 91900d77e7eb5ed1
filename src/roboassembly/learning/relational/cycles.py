"""3-cycles and 4-cycles of groups: mates that fit together speak for each other.

In a jigsaw a piece is known to be right when a third one fits both of its neighbours. Mating point k of group A with
point l of group B fixes how all other points of the two groups lie to each other. If two points of a third group C lie
to each other just as a free point of A and one of B then do, C could mate with both at once: the three mates close a
3-cycle, and that speaks for the pair (k, l).

A group between two others, as a rod between two legs, fixes how these lie to each other. If another group between the
same two fixes the same, the four mates close a 4-cycle, and each speaks for the others.

Both functions take the n free points of a state in their groups' frames and the pairs that may mate; all other pairs
neither count nor close a cycle. Their results are symmetric.

Equal groups, such as four legs, may change places without a change of the state. So cycles are looked for between one
pair of groups of each two types; other pairs of these types have the same ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from roboassembly.geometry.mating import FACE_TO_FACE

_FLIP = FACE_TO_FACE.diagonal()
"""Diagonal of the rotation between the frames of two mated points."""
_MAX_CHAINS = 3_000
"""Largest number of chains between two groups that are compared; more are thinned out evenly."""
_POSITION_TOLERANCE = 0.004
"""Distance up to which two positions are the same [m]; gaps at mates add up to 2 mm in a cycle."""
_DIRECTION_TOLERANCE = 0.05
"""Norm of the difference up to which two unit vectors are the same."""
_LINE = np.array([0.48, 0.60, 0.64])
"""Direction of the line on which places are sorted."""
_BETWEEN_PAIRS = 10.0
"""Distance on that line between the places of two pairs of groups [m]."""


@dataclass(frozen=True, eq=False)
class _Mates:
    """The p ordered pairs of points that may mate: a point of group A, the row, and one of group B, the column."""

    rows: Int[np.ndarray, "p"]
    columns: Int[np.ndarray, "p"]
    rotation: Float[np.ndarray, "p 3 3"]
    """`a_from_b` rotation at each mate."""
    translation: Float[np.ndarray, "p 3"]
    """`a_from_b` translation at each mate [m]."""
    owner: Int[np.ndarray, "n"]
    """Group of each point."""

    @staticmethod
    def of(
        groups: Sequence[Int[np.ndarray, "_"]],
        position: Float[np.ndarray, "n 3"],
        frame: Float[np.ndarray, "n 3 3"],
        plausible: Bool[np.ndarray, "n n"],
    ) -> _Mates:
        """Return the mates of a state; for the arguments see `closed_3_cycles`."""
        owner = np.zeros(len(position), int)
        for group, points in enumerate(groups):
            owner[points] = group
        rows, columns = np.nonzero(plausible)
        # a_from_b = A F Bᵀ, and F is diagonal.
        rotation = (frame[rows] * _FLIP) @ frame[columns].transpose(0, 2, 1)
        return _Mates(rows, columns, rotation, position[rows] - _rotated(rotation, position[columns]), owner)


def closed_3_cycles(
    groups: Sequence[Int[np.ndarray, "_"]],
    position: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    plausible: Bool[np.ndarray, "n n"],
    group_types: Sequence[int] | None = None,
) -> Int[np.ndarray, "n n"]:
    """Count for each pair of points the third groups that close a 3-cycle with it.

    Args:
        groups: points of each group, as numbers in 0..n.
        position: position of each point in its group's frame [m].
        frame: `group_from_point` rotation of each point.
        plausible: pairs that may mate; symmetric.
        group_types: type of each group; groups of one type have the same points in the same order. All differ if None.
    """
    count = np.zeros(plausible.shape, int)
    # Two points of the third group, in the frame of the first: they have to fit a free point of A and one of B.
    ends = [np.array([(m, o) for m in group for o in group if m != o], int).reshape(-1, 2) for group in groups]
    first, second = (np.concatenate(ends) if ends else np.zeros((0, 2), int)).T
    alike = list(_pairs_by_type(len(groups), group_types))
    mates = _Mates.of(groups, position, frame, plausible)
    some = np.flatnonzero(_number_of_pair(len(groups), alike)[mates.owner[mates.rows], mates.owner[mates.columns]] >= 0)
    if not len(some) or not len(first):
        return count
    # The place of a third group: another point of A and another of B. The third has such points as far apart.
    place, i, j = _other_points(mates, some, groups)
    across = _rotated(mates.rotation[place], position[j]) + mates.translation[place] - position[i]
    reach = position[second] - position[first]
    near = _near_any(np.linalg.norm(across, axis=1), np.linalg.norm(reach, axis=1), _POSITION_TOLERANCE)
    place, i, j, across = place[near], i[near], j[near], across[near]
    if not len(place):
        return count
    back = (frame[i] * _FLIP).transpose(0, 2, 1)
    turn = back @ mates.rotation[place] @ (frame[j] * _FLIP)
    back_of_end = frame[first].transpose(0, 2, 1)
    end_poses = _in_tolerances(_rotated(back_of_end, reach), back_of_end @ frame[second])
    found = _tree(_in_tolerances(_rotated(back, across), turn)).sparse_distance_matrix(
        _tree(end_poses), 1.0, output_type="ndarray"
    )
    here, end = found["i"], found["j"]
    fits = plausible[i[here], first[end]] & plausible[j[here], second[end]]
    # Each group that closes a cycle counts once for a pair.
    closed = np.unique(place[here[fits]] * len(groups) + mates.owner[first[end[fits]]]) // len(groups)
    np.add.at(count, (mates.rows[closed], mates.columns[closed]), 1)
    for (a, b), others in alike:
        for other_a, other_b in others:
            count[np.ix_(groups[other_a], groups[other_b])] = count[np.ix_(groups[a], groups[b])]
    return count + count.T


def closed_4_cycles(
    groups: Sequence[Int[np.ndarray, "_"]],
    position: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    plausible: Bool[np.ndarray, "n n"],
    group_types: Sequence[int] | None = None,
) -> Int[np.ndarray, "n n"]:
    """Count for each pair of points the other groups that close a 4-cycle with it; see `closed_3_cycles`."""
    count = np.zeros(plausible.shape, int)
    mates, alike = _Mates.of(groups, position, frame, plausible), list(_pairs_by_type(len(groups), group_types))
    rows, columns, rotation, owner = mates.rows, mates.columns, mates.rotation, mates.owner
    # A chain: a point of A with one of a group between, another point of that group with one of B.
    first, second, pair = _chains(mates, _number_of_pair(len(groups), alike))
    end = _rotated(rotation[first], mates.translation[second]) + mates.translation[first]
    i, j = _near_chains(end, pair, rows[first])
    differ = (owner[columns[first[i]]] != owner[columns[first[j]]]) & (columns[second[i]] != columns[second[j]])
    i, j = i[differ], j[differ]
    if not len(i):
        return count
    used, compact = np.unique(np.concatenate([i, j]), return_inverse=True)
    turn = (rotation[first[used]] @ rotation[second[used]])[:, :, ::2]
    same = np.abs(turn[compact[: len(i)]] - turn[compact[len(i) :]]).max(axis=(1, 2)) < _DIRECTION_TOLERANCE
    i, j = i[same], j[same]
    # A group that closes a cycle counts once for a pair where its chain comes later, and once where it comes earlier.
    number = first * len(rows) + second
    i, j = np.where(number[i] < number[j], (i, j), (j, i))
    support: list[Int[np.ndarray, "_"]] = []
    for mate in (first, second):
        for here, there in ((i, j), (j, i)):
            key = (pair[here] * len(rows) + mate[here]) * len(groups) + owner[columns[first[there]]]
            support.append(np.unique(key) // len(groups))
    of_pair, supported = np.divmod(np.sort(np.concatenate(support)), len(rows))
    np.add.at(count, (rows[supported], columns[supported]), 1)
    bounds = np.searchsorted(of_pair, np.arange(len(alike) + 1))
    for number, (chosen, others) in enumerate(alike):
        here = supported[bounds[number] : bounds[number + 1]]
        for other in others if len(here) else ():
            moved = _exchanged(groups, chosen, other)
            np.add.at(count, (moved[rows[here]], moved[columns[here]]), 1)
    return count + count.T


_AlikePairs = tuple[tuple[int, int], list[tuple[int, int]]]
"""A pair of groups, and the other pairs of the same two types."""


def _pairs_by_type(groups: int, group_types: Sequence[int] | None) -> Iterator[_AlikePairs]:
    """Yield the first pair of groups of each two types, and the other pairs of these types, each in the same order."""
    of_type = list(range(groups)) if group_types is None else group_types
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for a in range(groups):
        for b in range(a):
            first, second = (a, b) if of_type[a] >= of_type[b] else (b, a)
            pairs.setdefault((of_type[first], of_type[second]), []).append((first, second))
    for alike in pairs.values():
        yield alike[0], alike[1:]


def _number_of_pair(groups: int, alike: Sequence[_AlikePairs]) -> Int[np.ndarray, "g g"]:
    """Return the number of each pair of groups that stands for its types; -1 for all others."""
    out = np.full((groups, groups), -1)
    for number, (pair, _) in enumerate(alike):
        out[pair] = number
    return out


def _other_points(
    mates: _Mates, some: Int[np.ndarray, "q"], groups: Sequence[Int[np.ndarray, "_"]]
) -> tuple[Int[np.ndarray, "s"], Int[np.ndarray, "s"], Int[np.ndarray, "s"]]:
    """Return for some mates every other point of the one group with every other point of the other.

    Returns:
        Number of the mate, point of the row's group and point of the column's group.
    """
    sizes, points = np.array([len(points) for points in groups]), np.concatenate(list(groups))
    a, b = mates.owner[mates.rows[some]], mates.owner[mates.columns[some]]
    number, i, j = _products(points, sizes, a, b)
    mate = some[number]
    others = (i != mates.rows[mate]) & (j != mates.columns[mate])
    return mate[others], i[others], j[others]


def _near_any(
    values: Float[np.ndarray, "n"], others: Float[np.ndarray, "m"], tolerance: float
) -> Bool[np.ndarray, "n"]:
    """Return which values are within a tolerance of any of the others."""
    # A little more than the tolerance: rounding must not decide.
    ordered = np.sort(others)
    low, high = (np.searchsorted(ordered, values + sign * 1.01 * tolerance) for sign in (-1.0, 1.0))
    return low < high


def _exchanged(
    groups: Sequence[Int[np.ndarray, "_"]], pair: tuple[int, int], other: tuple[int, int]
) -> Int[np.ndarray, "n"]:
    """Return where each point goes when two groups change places with two others of their types."""
    place = list(range(len(groups)))
    for index, target in zip(pair, other, strict=True):
        at = place.index(target)
        place[index], place[at] = place[at], place[index]
    moved = np.arange(sum(map(len, groups)))
    for group, to in enumerate(place):
        if to != group:
            moved[groups[group]] = groups[to]
    return moved


def _chains(
    mates: _Mates, number_of_pair: Int[np.ndarray, "g g"]
) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Int[np.ndarray, "c"]]:
    """Chains of two mates by way of a group between, `_MAX_CHAINS` at most for each pair of groups.

    Args:
        mates: all that there are.
        number_of_pair: number of each pair of groups that is looked at, from the first to the last of the chain; or -1.

    Returns:
        The first and the second mate of each, and the number of its pair of groups.
    """
    start, end = mates.owner[mates.rows], mates.owner[mates.columns]
    counted = number_of_pair >= 0
    begins, closes = np.any(counted, axis=1, keepdims=True)[start, 0], np.any(counted, axis=0, keepdims=True)[0, end]
    none = np.zeros(0, int)
    parts = [(none, none, none)]
    for between in range(len(number_of_pair)):
        to, on = np.flatnonzero((end == between) & begins), np.flatnonzero((start == between) & closes)
        number = number_of_pair[start[to][:, None], end[on][None]]
        i, j = np.nonzero((number >= 0) & (mates.columns[to][:, None] != mates.rows[on][None]))
        parts.append((to[i], on[j], number[i, j]))
    first, second, pair = (np.concatenate([part[axis] for part in parts]) for axis in range(3))
    counts = np.bincount(pair)
    if counts.max(initial=0) > _MAX_CHAINS:
        order = np.lexsort((second, first, pair))
        ends = np.cumsum(counts)
        kept: list[Int[np.ndarray, "_"]] = [
            np.array(np.linspace(last - count, last - 1, min(count, _MAX_CHAINS)), int)
            for count, last in zip(counts.tolist(), ends.tolist(), strict=True)
        ]
        order = order[np.concatenate(kept)]
        first, second, pair = first[order], second[order], pair[order]
    return first, second, pair


def _near_chains(
    end: Float[np.ndarray, "c 3"], pair: Int[np.ndarray, "c"], row: Int[np.ndarray, "c"]
) -> tuple[Int[np.ndarray, "q"], Int[np.ndarray, "q"]]:
    """Return any two chains of one pair of groups that begin at different points and end at the same place."""
    # Few places are near each other on a line that no edge of furniture is parallel to.
    on_line = end @ _LINE + _BETWEEN_PAIRS * pair
    order = np.argsort(on_line, kind="stable")
    on_line = on_line[order]
    near = np.searchsorted(on_line, on_line + 1.01 * _POSITION_TOLERANCE) - np.arange(1, len(order) + 1)
    i = np.repeat(np.arange(len(order), dtype=np.int32), near)
    j = (i + 1 + np.arange(len(i)) - np.repeat(np.cumsum(near) - near, near)).astype(np.int32)
    # Millions are left: single numbers along two axes settle most of them.
    for along in np.ascontiguousarray(end[order, :2].T, np.float32):
        close = np.abs(along[i] - along[j]) <= 1.01 * _POSITION_TOLERANCE
        i, j = i[close], j[close]
    i, j = order[i], order[j]
    kept = (row[i] != row[j]) & (pair[i] == pair[j])
    i, j = i[kept], j[kept]
    same = ((end[i] - end[j]) ** 2).sum(axis=1) <= _POSITION_TOLERANCE**2
    return i[same], j[same]


def _products(
    members: Int[np.ndarray, "n"], sizes: Int[np.ndarray, "g"], a: Int[np.ndarray, "q"], b: Int[np.ndarray, "q"]
) -> tuple[Int[np.ndarray, "s"], Int[np.ndarray, "s"], Int[np.ndarray, "s"]]:
    """Return for each of q pairs of sets every member of the first with every member of the second.

    Args:
        members: members of all sets, one set after the other.
        sizes: number of members of each set.
        a: number of the first set of each pair.
        b: number of the second set of each pair.

    Returns:
        Number of the pair, member of the first set and member of the second set.
    """
    starts, each = np.cumsum(sizes) - sizes, sizes[a] * sizes[b]
    pair = np.repeat(np.arange(len(a)), each)
    number = np.arange(len(pair)) - np.repeat(np.cumsum(each) - each, each)
    i, j = np.divmod(number, sizes[b][pair])
    return pair, members[starts[a][pair] + i], members[starts[b][pair] + j]


def _rotated(rotation: Float[np.ndarray, "n 3 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return each vector turned by its rotation."""
    return np.einsum("nij,nj->ni", rotation, vectors)


def _tree(points: Float[np.ndarray, "n d"]) -> KDTree:
    """Return a tree that is quick to build: it is asked only once."""
    return KDTree(points, compact_nodes=False, balanced_tree=False)


def _in_tolerances(
    translation: Float[np.ndarray, "s 3"], rotation: Float[np.ndarray, "s 3 3"]
) -> Float[np.ndarray, "s 9"]:
    """Poses as points; those nearer than 1 are the same."""
    normal, tangent = rotation[:, :, 2], rotation[:, :, 0]
    scaled = [translation / _POSITION_TOLERANCE, normal / _DIRECTION_TOLERANCE, tangent / _DIRECTION_TOLERANCE]
    return np.concatenate(scaled, axis=1)
