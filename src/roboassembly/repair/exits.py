"""Directional blocking graphs among neighbouring parts, from the meshes alone: can the parts be disassembled?

For each direction, an arc leads from a part to every part that it hits when it moves a little. A set of parts can leave
if no arc leads out of it (Wilson and Latombe 1994, "Geometric Reasoning about Mechanical Assembly"). A set that can
leave the whole can also leave any subset, so the order of removal does not matter: the parts that remain together at
the end are captive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import CONTACT_DISTANCE
from roboassembly.geometry.triangles import triple_products, unit_normals
from roboassembly.repair.proximity import Shell
from roboassembly.repair.surface import Surface

Parts = frozenset[int]
ContactDirections = tuple[tuple[Float[np.ndarray, "3"], bool], ...]
STEPS = (0.0015, 0.004, 0.01)
"""Distances that a part is moved to find what it hits: above any clearance, below any depth of a joint [m]."""
_SAME = 0.99
"""Cosine of the angle above which two directions count as one."""
_EQUAL = 0.9998
"""Cosine of the angle above which two directions also share their owners: the tolerance of a loose joint."""
_MAX_DIRECTIONS = 60
FACING = -0.7
"""Cosine of the angle between normals below which two triangles face each other: within 45° of opposite."""
FACING_MARGIN = 0.0005
"""Distance beyond the nearest one within which triangles count for the contact normal [m]."""


@dataclass(frozen=True, eq=False)
class Blocking:
    """Blocking graph of an assembly for several directions."""

    directions: Float[np.ndarray, "d 3"]
    """Unit vectors."""
    arcs: tuple[dict[int, set[int]], ...]
    """Parts that each part hits, by part, for each direction."""
    near: frozenset[Parts]
    """Pairs of parts closer than the contact distance."""
    owners: tuple[tuple[Parts, ...] | None, ...]
    """Contacts, or parts whose long axis it is, for each direction; None for an axis of the furniture."""

    def is_natural(self, index: int, moving: Parts, still: Parts) -> bool:
        """Return whether a planner would try this direction to move one set of parts away from the other.

        A planner tries the furniture's axes, the normals of contacts between the two sets, and the long axes of the
        parts in contact.
        """
        owners = self.owners[index]
        if owners is None:
            return True
        across = [pair for pair in self.near if pair & moving and pair & still]
        return any(owner <= pair for owner in owners for pair in across)

    def captives(self, among: Parts) -> list[Parts]:
        """Return the sets of two or more parts that no subset can leave along any of the directions."""
        if len(among) < 2:
            return []
        for arcs in self.arcs:
            for part in sorted(among):
                leaving = closure(part, arcs, among)
                if len(leaving) < len(among):
                    return self.captives(leaving) + self.captives(among - leaving)
        return [among]


Move = tuple[Shell, Shell, tuple[float, ...]]
"""Shell that moves, shell that stays, and the direction."""


@dataclass(eq=False)
class BlockingCache:
    """Cache of results for pairs of shells, shared by successive openings, which change few shells."""

    contacts: dict[tuple[Shell, Shell], tuple[float, ContactDirections]] = field(
        default_factory=dict[tuple[Shell, Shell], tuple[float, ContactDirections]]
    )
    blocked: dict[Move, bool] = field(default_factory=dict[Move, bool])
    exits: dict[Move, bool] = field(default_factory=dict[Move, bool])

    def contact(self, shell: Shell, other: Shell) -> tuple[float, ContactDirections]:
        """Return the distance of two shells [m] and contact normals, each with whether it holds throughout."""
        if (shell, other) not in self.contacts:
            self.contacts[shell, other] = _contact(shell, other)
        return self.contacts[shell, other]

    def blocks(self, shell: Shell, other: Shell, direction: Float[np.ndarray, "3"]) -> bool:
        """Return whether `shell` hits `other` when it moves a little along the direction."""
        key = (shell, other, tuple(direction.tolist()))
        if key not in self.blocked:
            self.blocked[key] = any(shell.touches(other, step * direction) for step in STEPS)
        return self.blocked[key]


def closure(part: int, arcs: dict[int, set[int]], among: Parts) -> Parts:
    """Return the part and all parts that must move with it."""
    closed, stack = {part}, [part]
    while stack:
        more = arcs[stack.pop()] & among - closed
        closed |= more
        stack += sorted(more)
    return frozenset(closed)


def blocking(shells: Sequence[Shell], cache: BlockingCache | None = None) -> Blocking:
    """Return the blocking graph of all parts in contact, along the axes, the parts' main axes and contact normals.

    Args:
        shells: assembled parts.
        cache: results of earlier calls; new results are added.
    """
    cache = cache or BlockingCache()
    near: list[tuple[int, int]] = []
    candidates: list[tuple[Float[np.ndarray, "3"], tuple[Parts, ...] | None]] = [
        (direction, None) for direction in (*np.eye(3), *-np.eye(3))
    ]
    for a, b in combinations(range(len(shells)), 2):
        if shells[a].box_distance(shells[b]) < CONTACT_DISTANCE:
            distance, across = cache.contact(shells[a], shells[b])
            if distance < CONTACT_DISTANCE:
                near.append((a, b))
                pair = (frozenset((a, b)),)
                candidates += [
                    (sign * direction, pair if whole else ()) for direction, whole in across for sign in (1.0, -1.0)
                ]
    for part, shell in enumerate(shells):
        long, *others = main_axes(shell.surface)
        candidates += [(sign * long, (frozenset((part,)),)) for sign in (1.0, -1.0)]
        candidates += [(sign * axis, ()) for axis in others for sign in (1.0, -1.0)]
    kept: list[tuple[Float[np.ndarray, "3"], tuple[Parts, ...] | None]] = []
    for direction, owner in candidates:
        if np.linalg.norm(direction) < 0.5:
            continue
        alike = [k for k, (other, _) in enumerate(kept) if float(direction @ other) > _SAME]
        if not alike and len(kept) < _MAX_DIRECTIONS:
            kept.append((direction, owner))
        for k in alike:
            other, owners = kept[k]
            if owner is not None and owners is not None and float(direction @ other) > _EQUAL:
                kept[k] = (other, (*owners, *owner))
    directions = np.array([direction for direction, _ in kept])
    arcs: tuple[dict[int, set[int]], ...] = tuple({p: set() for p in range(len(shells))} for _ in directions)
    for a, b in near:
        blocked = [cache.blocks(shells[a], shells[b], direction) for direction in directions]
        for index, direction in enumerate(directions):
            if blocked[index]:
                arcs[index][a].add(b)
            # A move of b along a direction is a move of a along the opposite direction.
            opposite = int(np.argmin(directions @ direction))
            if float(directions[opposite] @ direction) < -_EQUAL:
                hits = blocked[opposite]
            else:
                hits = cache.blocks(shells[b], shells[a], direction)
            if hits:
                arcs[index][b].add(a)
    return Blocking(directions, arcs, frozenset(map(frozenset, near)), tuple(owners for _, owners in kept))


def _contact(shell: Shell, other: Shell) -> tuple[float, ContactDirections]:
    distance, here, there = shell.nearest(other)
    if distance >= CONTACT_DISTANCE:
        return distance, ()
    across, facing = (there - here) / max(distance, 1e-9), _facing(shell, other, distance)
    return distance, ((across, facing is None), *(() if facing is None else ((facing, True),)))


def _facing(shell: Shell, other: Shell, distance: float) -> Float[np.ndarray, "3"] | None:
    """Return the mean unit normal of the triangles that face each other; None if they cancel out, as around a dowel.

    The nearest two points of rough surfaces are a poor estimate of the joint's normal.
    """
    pairs = shell.pairs_near(other, distance + FACING_MARGIN)
    normals: list[Float[np.ndarray, "n 3"]] = []
    areas: list[Float[np.ndarray, "n"]] = []
    for side, which in ((shell, pairs[:, 0]), (other, pairs[:, 1])):
        normal, area = unit_normals(side.surface.corners[which])
        normals.append(normal)
        areas.append(area)
    opposed = np.einsum("ij,ij->i", *normals) < FACING
    mean = ((normals[0] - normals[1]) * np.minimum(*areas)[:, None])[opposed].sum(axis=0)
    total = 2.0 * np.minimum(*areas)[opposed].sum()
    length = float(np.linalg.norm(mean))
    return mean / length if length > 0.3 * total > 0.0 else None


def main_axes(surface: Surface) -> list[Float[np.ndarray, "3"]]:
    """Return unit vectors along the solid's principal axes of inertia, the longest side first."""
    corners = surface.corners - surface.vertices.mean(axis=0)
    a, b, c = np.swapaxes(corners, 0, 1)
    weight = triple_products(corners)
    total = a + b + c
    second = sum(np.einsum("i,ij,ik->jk", weight, x, x) for x in (a, b, c, total)) / 20.0
    first = (weight[:, None] * total).sum(axis=0) / 4.0
    covariance = second - np.outer(first, first) / weight.sum()
    return list(np.linalg.eigh(covariance)[1].T[::-1])


STRIDE = 0.004
"""Distance between tested positions along a straight exit path [m]."""


class Exits:
    """Straight exit paths along the directions of a blocking graph, with cached tests."""

    def __init__(self, shells: Sequence[Shell], graph: Blocking, cache: BlockingCache | None = None) -> None:
        self._shells, self._graph = shells, graph
        self._cache = cache or BlockingCache()

    def captives(self, among: Parts) -> list[Parts]:
        """Return the sets of two or more parts that no subset can leave straight in a natural direction."""
        if len(among) < 2:
            return []
        for index, arcs in enumerate(self._graph.arcs):
            for part in sorted(among):
                leaving = closure(part, arcs, among)
                if len(leaving) == len(among) or not self._graph.is_natural(index, leaving, among - leaving):
                    continue
                if self.free(leaving, among - leaving, index):
                    return self.captives(leaving) + self.captives(among - leaving)
        return [among]

    def free(self, moving: Parts, still: Parts, index: int) -> bool:
        """Return whether `moving` can leave `still` straight along the direction of that index."""
        return not any(self.hits(a, b, index) for a in sorted(moving) for b in sorted(still))

    def hits(self, a: int, b: int, index: int) -> bool:
        """Return whether part `a` hits part `b` on its straight path along the direction of that index."""
        if b in self._graph.arcs[index][a]:
            return True
        shell, other, direction = self._shells[a], self._shells[b], self._graph.directions[index]
        key, known = (shell, other, tuple(direction.tolist())), self._cache.exits
        if key not in known:
            known[key] = _touches_on_the_way(shell, other, direction)
        return known[key]


def leaves(shell: Shell, other: Shell, direction: Float[np.ndarray, "3"]) -> bool:
    """Return whether a part leaves another one straight along a direction, without touching it where it starts."""
    near = any(shell.touches(other, step * direction) for step in (0.0, *STEPS))
    return not near and not _touches_on_the_way(shell, other, direction)


def _touches_on_the_way(shell: Shell, other: Shell, direction: Float[np.ndarray, "3"]) -> bool:
    start, stop = overlap_span(shell, other, direction)
    steps = np.arange(max(start, 0.0005), stop, STRIDE)
    return any(shell.touches(other, step * direction) for step in steps)


def overlap_span(shell: Shell, other: Shell, direction: Float[np.ndarray, "3"]) -> tuple[float, float]:
    """Return the interval along the direction in which the box of the moved shell overlaps the other's [m].

    The interval is (0, 0) if they never overlap.
    """
    start, stop = 0.0, float("inf")
    for axis in range(3):
        before, after = other.low[axis] - shell.high[axis], other.high[axis] - shell.low[axis]
        if abs(direction[axis]) < 1e-9:
            if before > 0.0 or after < 0.0:
                return 0.0, 0.0
            continue
        ends = sorted((before / direction[axis], after / direction[axis]))
        start, stop = max(start, ends[0]), min(stop, ends[1])
    return (start, stop) if stop > start else (0.0, 0.0)
