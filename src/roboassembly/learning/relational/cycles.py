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

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from roboassembly.geometry.mating import FACE_TO_FACE, mating_poses

_FLIP = FACE_TO_FACE.diagonal()
"""Diagonal of the rotation between the frames of two mated points."""
_MAX_CHAINS = 3_000
"""Largest number of chains between two groups that are compared; more are thinned out evenly."""
_POSITION_TOLERANCE = 0.004
"""Distance up to which two positions are the same [m]; gaps at mates add up to 2 mm in a cycle."""
_DIRECTION_TOLERANCE = 0.05
"""Norm of the difference up to which two unit vectors are the same."""


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
    end = np.concatenate(ends) if ends else np.zeros((0, 2), int)
    owner = np.repeat(np.arange(len(groups)), [len(e) for e in ends])
    alike = list(_pairs_by_type(len(groups), group_types))
    places = [_places(groups[a], groups[b], position, frame, plausible) for (a, b), _ in alike]
    place_points = np.concatenate([g[0] for g in places]) if places else np.zeros((0, 4), int)
    if not len(place_points) or not len(end):
        return count
    first, second = end.T
    back = frame[first].transpose(0, 2, 1)
    end_poses = _in_tolerances(np.einsum("nij,nj->ni", back, position[second] - position[first]), back @ frame[second])
    found = KDTree(np.concatenate([g[1] for g in places])).sparse_distance_matrix(
        KDTree(end_poses), 1.0, output_type="ndarray"
    )
    k, l, other_k, other_l = place_points[found["i"]].T  # noqa: E741
    m, other_m = end[found["j"]].T
    fits = plausible[other_k, m] & plausible[other_l, other_m]
    closed = np.unique(np.stack([k, l, owner[found["j"]]], axis=1)[fits], axis=0)
    np.add.at(count, (closed[:, 0], closed[:, 1]), 1)
    for (a, b), others in alike:
        for other_a, other_b in others:
            count[np.ix_(groups[other_a], groups[other_b])] = count[np.ix_(groups[a], groups[b])]
    return count + count.T


def _pairs_by_type(
    groups: int, group_types: Sequence[int] | None
) -> Iterator[tuple[tuple[int, int], list[tuple[int, int]]]]:
    """Yield the first pair of groups of each two types, and the other pairs of these types, each in the same order."""
    of_type = list(range(groups)) if group_types is None else group_types
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for a in range(groups):
        for b in range(a):
            first, second = (a, b) if of_type[a] >= of_type[b] else (b, a)
            pairs.setdefault((of_type[first], of_type[second]), []).append((first, second))
    for alike in pairs.values():
        yield alike[0], alike[1:]


def _places(
    a: Int[np.ndarray, "a"],
    b: Int[np.ndarray, "b"],
    position: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    plausible: Bool[np.ndarray, "n n"],
) -> tuple[Int[np.ndarray, "s 4"], Float[np.ndarray, "s 9"]]:
    """Places that a third group would fill: for each pair that may mate, another point of each of the two groups.

    Returns:
        Points (k, l, other k, other l), and the pose of the mate of `other l` in the frame of the mate of `other k`, in
        tolerances.
    """
    rows, columns = np.nonzero(plausible[np.ix_(a, b)])
    k, l = a[rows], b[columns]  # noqa: E741
    rotations, translations = mating_poses(frame[b], position[b], frame[a], position[a])
    rotation, translation = rotations[columns, rows], translations[columns, rows]
    mated = np.einsum("pij,bj->pbi", rotation, position[b]) + translation[:, None]
    back = (frame[a] * _FLIP).transpose(0, 2, 1)[None, :, None]
    offset = (back @ (mated[:, None] - position[a][None, :, None])[..., None])[..., 0]
    turn = back @ (rotation[:, None] @ (frame[b] * _FLIP))[:, None]
    p, i, j = np.nonzero(np.ones(offset.shape[:3], bool))
    points = np.stack([k[p], l[p], a[i], b[j]], axis=1)
    others = (points[:, 0] != points[:, 2]) & (points[:, 1] != points[:, 3])
    return points[others], _in_tolerances(offset.reshape(-1, 3), turn.reshape(-1, 3, 3))[others]


def closed_4_cycles(
    groups: Sequence[Int[np.ndarray, "_"]],
    position: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    plausible: Bool[np.ndarray, "n n"],
    group_types: Sequence[int] | None = None,
) -> Int[np.ndarray, "n n"]:
    """Count for each pair of points the other groups that close a 4-cycle with it; see `closed_3_cycles`."""
    count = np.zeros(plausible.shape, int)
    owner = np.zeros(len(position), int)
    for group, points in enumerate(groups):
        owner[points] = group
    rows, columns = np.nonzero(plausible)
    rotations, translations = mating_poses(frame, position, frame, position)
    rotation, translation = rotations[columns, rows], translations[columns, rows]
    by_row = [np.flatnonzero(owner[rows] == group) for group in range(len(groups))]
    by_column = [np.flatnonzero(owner[columns] == group) for group in range(len(groups))]
    for (a, b), others in _pairs_by_type(len(groups), group_types):
        # A chain: a point of A with one of a group between, another point of that group with one of B.
        first, second = _chains(by_row[a], by_column[b], rows, columns, owner)
        if len(first) < 2:
            continue
        end = (rotation[first] @ translation[second][:, :, None])[..., 0] + translation[first]
        near: Int[np.ndarray, "q 2"] = KDTree(end).query_pairs(_POSITION_TOLERANCE, output_type="ndarray")
        i, j = near.T
        differ = (owner[columns[first[i]]] != owner[columns[first[j]]]) & (rows[first[i]] != rows[first[j]])
        differ &= columns[second[i]] != columns[second[j]]
        i, j = i[differ], j[differ]
        if not len(i):
            continue
        turn = (rotation[first] @ rotation[second])[:, :, ::2]
        same = np.abs(turn[i] - turn[j]).max(axis=(1, 2)) < _DIRECTION_TOLERANCE
        i, j = i[same], j[same]
        support: list[Int[np.ndarray, "_"]] = []
        for mate in (first, second):
            for here, there in ((i, j), (j, i)):
                # Each group that closes a cycle counts once for a pair.
                support.append(np.unique(mate[here] * len(groups) + owner[columns[first[there]]]) // len(groups))
        supported = np.concatenate(support)
        np.add.at(count, (rows[supported], columns[supported]), 1)
        for other in others:
            moved = _exchanged(groups, (a, b), other)
            np.add.at(count, (moved[rows[supported]], moved[columns[supported]]), 1)
    return count + count.T


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
    from_a: Int[np.ndarray, "i"],
    to_b: Int[np.ndarray, "j"],
    rows: Int[np.ndarray, "p"],
    columns: Int[np.ndarray, "p"],
    owner: Int[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"]]:
    """Chains of two mates by way of a group between, `_MAX_CHAINS` at most: the first and the second pair of each."""
    i, j = np.nonzero(owner[columns[from_a]][:, None] == owner[rows[to_b]][None])
    first, second = from_a[i], to_b[j]
    through = columns[first] != rows[second]
    first, second = first[through], second[through]
    if len(first) > _MAX_CHAINS:
        kept = np.linspace(0, len(first) - 1, _MAX_CHAINS).astype(int)
        first, second = first[kept], second[kept]
    return first, second


def _in_tolerances(
    translation: Float[np.ndarray, "s 3"], rotation: Float[np.ndarray, "s 3 3"]
) -> Float[np.ndarray, "s 9"]:
    """Poses as points; those nearer than 1 are the same."""
    normal, tangent = rotation[:, :, 2], rotation[:, :, 0]
    scaled = [translation / _POSITION_TOLERANCE, normal / _DIRECTION_TOLERANCE, tangent / _DIRECTION_TOLERANCE]
    return np.concatenate(scaled, axis=1)
