"""Which pairs of points could belong to one whole: loops of three groups that close.

In a jigsaw a piece is known to be right when a third one fits in with both. Joining point k of group A to point l of
group B fixes how all other points of the two lie to each other. If any two points of a third group C lie to each other
just as a point of A and one of B then do, C could be joined to both at once, and that speaks for the pair.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from roboassembly.learning.mating import FLIP

_MOST_BRIDGES = 3_000
"""Ways from one group to another by way of a third, that are compared with each other; more are thinned out."""
_POSITION, _DIRECTION = 0.004, 0.05
"""Metres, and norm of the difference of directions: what counts as the same. Gaps at joints add up to 2 mm a loop."""


def closing_groups(
    groups: Sequence[Int[np.ndarray, "_"]],
    at: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    possible: Bool[np.ndarray, "n n"],
) -> Int[np.ndarray, "n n"]:
    """For two points of different groups, how many third groups could be joined to both once they are; symmetric.

    Args:
        groups: points of each group.
        at: where each point is, in its group's frame, metres.
        frame: `group_from_point` rotation of each point.
        possible: pairs that may be joined; symmetric. All others neither count nor close a loop.
    """
    out = np.zeros(possible.shape, int)
    plugs = [np.array([(m, o) for m in group for o in group if m != o], int).reshape(-1, 2) for group in groups]
    plug = np.concatenate(plugs) if plugs else np.zeros((0, 2), int)
    owner = np.repeat(np.arange(len(groups)), [len(p) for p in plugs])
    sockets = [_sockets(one, two, at, frame, possible) for i, one in enumerate(groups) for two in groups[:i]]
    names = np.concatenate([s[0] for s in sockets]) if sockets else np.zeros((0, 4), int)
    if not len(names) or not len(plug):
        return out
    first, second = plug.T
    back = frame[first].transpose(0, 2, 1)
    plug_poses = _told(np.einsum("nij,nj->ni", back, at[second] - at[first]), back @ frame[second])
    found = KDTree(np.concatenate([s[1] for s in sockets])).sparse_distance_matrix(
        KDTree(plug_poses), 1.0, output_type="ndarray"
    )
    k, l, other_k, other_l = names[found["i"]].T  # noqa: E741
    m, other_m = plug[found["j"]].T
    fits = possible[other_k, m] & possible[other_l, other_m]
    closed = np.unique(np.stack([k, l, owner[found["j"]]], axis=1)[fits], axis=0)
    np.add.at(out, (closed[:, 0], closed[:, 1]), 1)
    return out + out.T


def _sockets(
    one: Int[np.ndarray, "a"],
    two: Int[np.ndarray, "b"],
    at: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    possible: Bool[np.ndarray, "n n"],
) -> tuple[Int[np.ndarray, "s 4"], Float[np.ndarray, "s 9"]]:
    """How a second point of one group and one of another lie to each other, as a plug would, for each possible pair."""
    rows, columns = np.nonzero(possible[np.ix_(one, two)])
    k, l = one[rows], two[columns]  # noqa: E741
    turn, origin = _laid(k, l, at, frame)
    there = np.einsum("pij,bj->pbi", turn, at[two]) + origin[:, None]
    back = (frame[one] * FLIP).transpose(0, 2, 1)[None, :, None]
    shift = (back @ (there[:, None] - at[one][None, :, None])[..., None])[..., 0]
    turned = back @ (turn[:, None] @ (frame[two] * FLIP))[:, None]
    p, a, b = (i.ravel() for i in np.indices(shift.shape[:3]))
    names = np.stack([k[p], l[p], one[a], two[b]], axis=1)
    second = (names[:, 0] != names[:, 2]) & (names[:, 1] != names[:, 3])
    return names[second], _told(shift.reshape(-1, 3), turned.reshape(-1, 3, 3))[second]


def _laid(
    k: Int[np.ndarray, "p"],
    l: Int[np.ndarray, "p"],  # noqa: E741
    at: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
) -> tuple[Float[np.ndarray, "p 3 3"], Float[np.ndarray, "p 3"]]:
    """Poses of the groups of points `l` in those of points `k` once each two are joined."""
    turn = (frame[k] * FLIP) @ frame[l].transpose(0, 2, 1)
    return turn, at[k] - np.einsum("pij,pj->pi", turn, at[l])


def _told(shift: Float[np.ndarray, "s 3"], turn: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, "s 9"]:
    """A relative pose in tolerances."""
    return np.concatenate([shift / _POSITION, turn[:, :, 2] / _DIRECTION, turn[:, :, 0] / _DIRECTION], axis=1)


def closing_bridges(
    groups: Sequence[Int[np.ndarray, "_"]],
    at: Float[np.ndarray, "n 3"],
    frame: Float[np.ndarray, "n 3 3"],
    possible: Bool[np.ndarray, "n n"],
) -> Int[np.ndarray, "n n"]:
    """For two points of different groups, how many other groups close a loop of four with theirs; symmetric.

    A group that lies between two others, as a rod between two legs, fixes how these lie to each other. Where another
    group between the same two fixes the same, each of the four joints speaks for the others.

    Args:
        groups: points of each group.
        at: where each point is, in its group's frame, metres.
        frame: `group_from_point` rotation of each point.
        possible: pairs that may be joined; symmetric. All others neither count nor close a loop.
    """
    out = np.zeros(possible.shape, int)
    owner = np.zeros(len(at), int)
    for name, tokens in enumerate(groups):
        owner[tokens] = name
    rows, columns = np.nonzero(possible)
    by_row = [np.flatnonzero(owner[rows] == name) for name in range(len(groups))]
    by_column = [np.flatnonzero(owner[columns] == name) for name in range(len(groups))]
    turn, shift = _laid(rows, columns, at, frame)
    for one in range(len(groups)):
        for two in range(one):
            first, second = by_row[one], by_column[two]
            i, j = np.nonzero(owner[columns[first]][:, None] == owner[rows[second]][None])
            first, second = first[i], second[j]
            through = columns[first] != rows[second]
            first, second = first[through], second[through]
            if len(first) > _MOST_BRIDGES:
                kept = np.linspace(0, len(first) - 1, _MOST_BRIDGES).astype(int)
                first, second = first[kept], second[kept]
            if len(first) < 2:
                continue
            moved = (turn[first] @ shift[second][:, :, None])[..., 0] + shift[first]
            a, b = KDTree(moved).query_pairs(_POSITION, output_type="ndarray").T
            apart = (owner[columns[first[a]]] != owner[columns[first[b]]]) & (rows[first[a]] != rows[first[b]])
            apart &= columns[second[a]] != columns[second[b]]
            a, b = a[apart], b[apart]
            turned = (turn[first] @ turn[second])[:, :, ::2]
            alike = np.abs(turned[a] - turned[b]).max(axis=(1, 2)) < _DIRECTION
            a, b = a[alike], b[alike]
            for joint in (first, second):
                for here, there in ((a, b), (b, a)):
                    # Each witness counts once for a pair.
                    support = np.unique(joint[here] * len(groups) + owner[columns[first[there]]]) // len(groups)
                    np.add.at(out, (rows[support], columns[support]), 1)
    return out + out.T
