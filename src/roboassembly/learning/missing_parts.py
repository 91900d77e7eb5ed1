"""Data augmentation: furniture that lacks some of its parts is assembled in the same way, as far as it goes.

A chair without its armrests or one of its rungs is a chair, too. Leaving parts out of a training chair gives states of
other structures, with other numbers of parts and points: the ones that the chair without them would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from roboassembly.learning.datasets import LabeledState, Structure

_FEWEST_PARTS = 3
"""Least number of parts that are left."""
_SECOND_LABEL = 0.4
"""Chance that parts of two labels are left out in place of one."""
_WHOLE_LABEL = 0.5
"""Chance that all parts of a label are left out, not each with a chance of one half."""


@dataclass(frozen=True, eq=False)
class RemainingParts:
    """Parts and points that are left."""

    parts: Int[np.ndarray, "R"]
    """Numbers of the parts."""
    points: tuple[Int[np.ndarray, "k"], ...]
    """Numbers of the points of each."""
    structure: Structure
    """Structure of what is left, in its own numbers."""


def without_some(structure: Structure, rng: np.random.Generator) -> RemainingParts | None:
    """Leave random parts out that such furniture may lack; None if it would fall apart, or if there are none.

    A point remains if it joins two parts that are left, on this part or on another one of its class, because equal
    parts have equal points.
    """
    labels = sorted({structure.labels[i] for i in np.flatnonzero(structure.optional)})
    if not labels:
        return None
    count = min(len(labels), 1 + int(rng.random() < _SECOND_LABEL))
    missing = np.zeros(len(structure.labels), bool)
    for label in rng.choice(labels, count, replace=False).tolist():
        members = np.array([own == label for own in structure.labels]) & structure.optional
        missing |= members if rng.random() < _WHOLE_LABEL else members & (rng.random(len(members)) < 0.5)
    left = ~missing
    if not missing.any() or left.sum() < _FEWEST_PARTS or not is_connected(structure, np.flatnonzero(left)):
        return None
    a, k, b, l = structure.connections.T  # noqa: E741
    both = left[a] & left[b]
    joins = np.zeros((int(structure.classes.max()) + 1, int(structure.connections[:, 1::2].max()) + 1), bool)
    joins[structure.classes[a[both]], k[both]] = joins[structure.classes[b[both]], l[both]] = True
    parts = np.flatnonzero(left)
    points = tuple(np.flatnonzero(joins[structure.classes[p]]) for p in parts)
    number, place = np.cumsum(left) - 1, np.cumsum(joins, axis=1) - 1
    connections = np.stack(
        [number[a], place[structure.classes[a], k], number[b], place[structure.classes[b], l]], axis=1
    )[both]
    labels_left = tuple(structure.labels[p] for p in parts)
    rest = Structure(connections, structure.classes[parts], labels_left, structure.optional[parts])
    return RemainingParts(parts, points, rest)


def is_connected(structure: Structure, parts: Sequence[int] | np.ndarray) -> bool:
    """Return whether connections among some parts hold them together."""
    reached, rest = {int(parts[0])}, {int(p) for p in parts[1:]}
    pairs: list[tuple[int, int]] = structure.connections[:, ::2].tolist()
    while rest:
        more = {b for a, b in pairs if a in reached} | {a for a, b in pairs if b in reached}
        more &= rest
        if not more:
            return False
        reached |= more
        rest -= more
    return True


def reduced(sample: LabeledState, left: RemainingParts, structure: Structure) -> LabeledState | None:
    """Return a state of the furniture without the missing parts, with its labels.

    None if everything that is left is joined, if a group would fall apart, or if no label is left.

    Args:
        sample: state of the whole furniture.
        left: parts and points that are left.
        structure: structure of the whole furniture.
    """
    group = sample.group
    own = group[left.parts]
    groups = np.unique(own)
    # Parts of a group may have taken each other's places; whether they touch is then not known from their numbers.
    if len(groups) < 2 or any(not is_connected(structure, left.parts[own == g]) for g in groups):
        return None
    count = len(left.parts)
    points = np.zeros((count, *sample.points.shape[1:]), sample.points.dtype)
    free = np.zeros((count, *sample.free.shape[1:]), bool)
    number = np.full(sample.free.shape, -1)
    for row, (part, own_points) in enumerate(zip(left.parts, left.points, strict=True)):
        points[row, : len(own_points)] = sample.points[part, own_points]
        free[row, : len(own_points)] = sample.free[part, own_points]
        number[part, own_points] = np.arange(len(own_points))
    part_number = np.full(len(group), -1)
    part_number[left.parts] = np.arange(count)
    u, k, v, l = sample.mates[:, :4].T  # noqa: E741
    some = (number[u, k] >= 0) & (number[v, l] >= 0)
    mates = np.concatenate(
        [np.stack([part_number[u], number[u, k], part_number[v], number[v, l]], axis=1), sample.mates[:, 4:]], axis=1
    )[some].astype(np.int16)
    q_values = sample.q_values
    if q_values is not None:
        kept: Bool[np.ndarray, "n"] = number[sample.free] >= 0
        q_values = q_values[kept][:, kept]
    elif not len(mates):
        return None
    among = np.ix_(left.parts, left.parts)
    return LabeledState(points, sample.connections[among], free, sample.poses[left.parts], mates, q_values)
