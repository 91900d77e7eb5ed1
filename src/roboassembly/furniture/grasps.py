"""Grasp regions of a part for the Franka hand: two regions with four approach directions each.

Rays through the part find pairs of opposite sides that fit the jaw. At each such place, collision tests check that the
open hand can approach and close, and that only its pads touch the part. The part is alone in these tests. Where flat
sides give fewer than two regions, `jaws.UnevenJaw` looks at many more places.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.furniture.jaws import APPROACHES, EvenJaw, Jaw, UnevenJaw, touches
from roboassembly.furniture.model import GRASP_REGIONS, GraspRegion
from roboassembly.furniture.opposite_sides import (
    ANGLES,
    Places,
    directions_around,
    opposite_sides,
    opposite_sides_anywhere,
    within_reach,
)
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.robots.gripper import HandAgainst

_FIRST_BLOCK, _BLOCK = 2, 16
"""Numbers of places tested in the first batch and, at most, in a later one; the first usually contains a solution."""
_UNCOVERED = 0.05
"""Cost of a pad that touches along a line only, as distance from the centre of mass [m]."""
_MAX_USEFUL_DISTANCE = 0.15
"""Distance between the two regions up to which more is better [m]."""
_CENTRAL = 0.25
"""Weight of nearness to the centre of mass, and of lying beyond it, against distance between the regions."""
_DISTINCT = 0.02
"""Distance between regions below which their closing axes must differ by at least 45° [m]."""
_CANDIDATE_PLACES = 400
"""Number of places tried for candidates."""
_CROSSWISE = 0.2
"""Bonus for closing along another axis, as distance: a slat among others can only be held by its edges from the front,
a rail on a board only by its sides [m]."""


def find_grasps(mesh: Mesh, around: Sequence[Mesh] = ()) -> tuple[GraspRegion, ...]:
    """Return up to two regions where the hand can hold a part, the one nearer to its centre of mass first.

    The first region is the nearest to the centre of mass with good contact of the pads. The second one preferably
    closes along an axis at least 45° away, lies up to 150 mm away and beyond the centre of mass. If the assembled
    furniture blocks the first region, the second one is chosen where the furniture leaves the hand free. Approach
    directions that the furniture leaves free come first. Equal meshes give equal grasps.

    Regions between flat sides that the fully open hand reaches come first. Only if there are fewer than two, regions
    are sought by curved and leaning sides, on thin sheets and beside narrow grooves.

    Args:
        mesh: the part, in its own frame [m]; the origin is the centre of mass.
        around: surroundings of the part, or of each part of its shape, in the assembled furniture; in its frame.
    """
    found: tuple[GraspRegion, ...] = ()
    for jaw, places in _jaws(mesh, around):
        found = _regions(jaw, places, found)
        if len(found) >= GRASP_REGIONS:
            break
    return tuple(sorted(found, key=lambda region: float(np.linalg.norm(region.position))))


def candidate_grasps(mesh: Mesh, around: Sequence[Mesh], known: Sequence[GraspRegion], most: int) -> list[GraspRegion]:
    """Return regions all over a part, each as unlike those before it as possible; `known` ones come first.

    Args:
        mesh: the part, in its own frame [m].
        around: surroundings of the part; see `find_grasps`.
        known: regions of `find_grasps`.
        most: number of regions at most.
    """
    out = list(known)
    for jaw, places in _jaws(mesh, around):
        _fill(jaw, places, out, most)
        if len(out) >= most:
            break
    return out


def _jaws(mesh: Mesh, around: Sequence[Mesh]) -> Iterator[tuple[Jaw, Places]]:
    """Yield both ways of the hand to close, flat sides first, each with the places within its reach."""
    others = [HandAgainst(m) for m in around]
    rays, hand = Rays(mesh), HandAgainst(mesh)
    places = opposite_sides(mesh.trimesh, rays)
    yield EvenJaw(hand, others), places[within_reach(rays, places)]
    jaw, places = UnevenJaw(hand, others, rays), opposite_sides_anywhere(mesh.trimesh, rays)
    yield jaw, places[jaw.within_reach(places)]


def _fill(jaw: Jaw, places: Places, out: list[GraspRegion], most: int) -> None:
    """Append regions at places as unlike those of `out` as possible, until there are `most`."""

    def unlikeness(middle: Float[np.ndarray, "3"], closing: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n"]:
        turned = 1.0 - np.abs(places.closing @ closing)
        return np.linalg.norm(places.middle - middle, axis=1) + _CROSSWISE * turned

    left = np.full(len(places.width), np.inf)
    for region in out:
        left = np.minimum(left, unlikeness(region.position, region.closing))
    for _ in range(_CANDIDATE_PLACES):
        if len(out) >= most or not len(left) or left.max() < _DISTINCT:
            return
        index = np.argmax(left)
        left[index] = 0.0
        region = _first_holdable(jaw, [places[np.array([index])]])
        if region is not None:
            out.append(region)
            left = np.minimum(left, unlikeness(region.position, region.closing))


def _regions(jaw: Jaw, places: Places, found: tuple[GraspRegion, ...] = ()) -> tuple[GraspRegion, ...]:
    """Return the regions found so far and more of them at some places, two at most."""
    bare = _UNCOVERED * (1.0 - places.cover)
    off = np.linalg.norm(places.middle, axis=1)
    first = found[0] if found else _first_holdable(jaw, _blocks(places[np.argsort(off + bare, kind="stable")]))
    if first is None:
        return ()
    locked = [other for other in jaw.others if not _free_directions(jaw, other, first).any()]
    distance = np.linalg.norm(places.middle - first.position, axis=1)
    crosswise = np.abs(places.closing @ first.closing) < np.cos(np.pi / 4.0)
    beyond = distance - off
    cost = _CENTRAL * (off - beyond) + bare - np.minimum(distance, _MAX_USEFUL_DISTANCE) - _CROSSWISE * crosswise
    order = np.argsort(cost, kind="stable")
    distinct = places[order[((distance > _DISTINCT) | crosswise)[order]]]
    second = _first_holdable(jaw, _freest_first(jaw, distinct, locked) if locked else _blocks(distinct))
    return (first,) if second is None else (first, second)


def _blocks(places: Places) -> Iterator[Places]:
    """Yield the places in batches for tests of collision, small ones first: one of the first usually is a solution."""
    start, size = 0, _FIRST_BLOCK
    while start < len(places.width):
        yield places[np.arange(start, min(start + size, len(places.width)))]
        start, size = start + size, min(2 * size, _BLOCK)


def _freest_first(jaw: Jaw, places: Places, locked: Sequence[HandAgainst]) -> Iterator[Places]:
    """Yield the places in batches, those first where most of the surroundings `locked` leave the hand a direction.

    Places with equally many come in the given order. Usually one of the first has all and is a solution, so that the
    rest need not be tested.
    """
    rest: list[tuple[int, Places]] = []
    for some in _blocks(places):
        directions = directions_around(some.closing, ANGLES // 2)
        counts = np.zeros(len(some.width), dtype=int)
        for other in locked:
            counts += (~touches(other, some, directions, jaw.openings(some.width), coming=True)).any(axis=1)
        freest = counts == len(locked)
        if freest.any():
            yield some[freest]
        rest += [(int(counts[i]), some[np.array([i])]) for i in np.flatnonzero(~freest)]
    for _, place in sorted(rest, key=lambda pair: -pair[0]):
        yield place


def _first_holdable(jaw: Jaw, blocks: Iterable[Places]) -> GraspRegion | None:
    """Return the region at the first place that the hand can hold from enough directions; None if there is none.

    Args:
        jaw: how the hand opens and closes.
        blocks: candidates in order of preference, in batches.
    """
    attempts = 0
    for some in blocks:
        directions, free = jaw.approaches(some)
        for index in np.flatnonzero(free.sum(axis=1) >= APPROACHES):
            attempts += 1
            if attempts > jaw.attempts:
                return None
            region = jaw.closed_on(some[np.array([index])], directions[index], free[index])
            if region is not None:
                return region
    return None


def _free_directions(jaw: Jaw, other: HandAgainst, region: GraspRegion) -> Bool[np.ndarray, "4"]:
    """Return whether each direction of a region is free of collision with some surroundings."""
    n = len(region.approaches)
    middle, closing = np.tile(region.position, (n, 1)), np.tile(region.closing, (n, 1))
    opening = jaw.openings(np.array([region.width]))[0]
    return ~other.touches(middle, closing, region.approaches, opening, coming=True)
