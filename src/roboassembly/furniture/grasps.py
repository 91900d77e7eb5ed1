"""Grasp regions of a part for the Franka hand: two regions with four approach directions each.

Rays through the part find pairs of opposite sides that fit the jaw. At each such place, collision tests check that the
open hand can approach and close, and that only its pads touch the part. The part is alone in these tests.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from roboassembly.furniture.model import GRASP_REGIONS, GraspRegion
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.robots.gripper import MAX_OPENING, PALM_DEPTH, HandAgainst

APPROACHES = 4
"""Approach directions per region, as in the paper."""
MIN_WIDTH, MAX_WIDTH = 0.001, MAX_OPENING - 0.004
"""Smallest and largest width of a part between the pads; the open hand has 2 mm on either side [m]."""
FRICTION = 0.2
"""Coefficient of friction that a grasp relies on, so sides may lean by 11°. Rubber on wood has 0.5 or more."""
CLEARANCE = 2e-4
"""Distance between pad and part in tests of the closed hand, where touching counts as collision [m]."""
PAD = 0.008
"""Distance from the middle of a pad to just within its rim (the pad is 17.5 by 18.5 mm) [m]."""
_PAD_SLACK = 0.002
"""Largest distance at which the part covers a place of the pad [m]."""
ANGLES = 24
"""Number of directions tried around the closing axis: those of a region differ by at least 15°."""
_EASED = (0.0, 0.0006, 0.0013, 0.0022, 0.003)
"""Allowances for sides that lean or bend and touch a pad's rim before its middle [m]."""
_OPENINGS = (0.25, 0.5, 0.75)
"""Fractions of the opening at which the moving fingers are tested: fingers are thicker than the steps."""
_SAMPLES, _AXES = 384, 48
"""Numbers of surface points and of axes through the centre of mass at which opposite sides are sought."""
_FIRST_BLOCK, _BLOCK = 2, 16
"""Numbers of places tested in the first batch and, at most, in a later one; the first usually contains a solution."""
_EVENNESS = 0.75
"""Exponent of the area by which faces are sampled: with 1, a peg on a seat would be missed."""
_UNCOVERED = 0.05
"""Cost of a pad that touches along a line only, as distance from the centre of mass [m]."""
_MAX_USEFUL_DISTANCE = 0.15
"""Distance between the two regions up to which more is better [m]."""
_CENTRAL = 0.25
"""Weight of nearness to the centre of mass, and of lying beyond it, against distance between the regions."""
_DISTINCT = 0.02
"""Distance between regions below which their closing axes must differ by at least 45° [m]."""
_CROSSWISE = 0.2
"""Bonus for closing along another axis, as distance: a slat among others can only be held by its edges from the front,
a rail on a board only by its sides [m]."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Places between opposite sides of a part."""

    middle: Float[np.ndarray, "n 3"]
    closing: Float[np.ndarray, "n 3"]
    width: Float[np.ndarray, "n"]
    cover: Float[np.ndarray, "n"]
    """Share of eight places around the rim at which both pads lie on the part."""

    def __getitem__(self, which: Int[np.ndarray, "m"] | Bool[np.ndarray, "n"]) -> _Places:
        return _Places(self.middle[which], self.closing[which], self.width[which], self.cover[which])


def find_grasps(mesh: Mesh, around: Sequence[Mesh] = ()) -> tuple[GraspRegion, ...]:
    """Return up to two regions where the hand can hold a part, the one nearer to its centre of mass first.

    The first region is the nearest to the centre of mass with good contact of the pads. The second one preferably
    closes along an axis at least 45° away, lies up to 150 mm away and beyond the centre of mass. If the assembled
    furniture blocks the first region, the second one is chosen where the furniture leaves the hand free. Approach
    directions that the furniture leaves free come first. Equal meshes give equal grasps.

    Args:
        mesh: the part, in its own frame [m]; the origin is the centre of mass.
        around: surroundings of the part, or of each part of its shape, in the assembled furniture; in its frame.
    """
    others = [HandAgainst(m) for m in around]
    rays = Rays(mesh)
    places = _opposite_sides(mesh.trimesh, rays)
    places = places[_within_reach(rays, places)]
    if not len(places.width):
        return ()
    hand = HandAgainst(mesh)
    bare = _UNCOVERED * (1.0 - places.cover)
    off = np.linalg.norm(places.middle, axis=1)
    first = _first_holdable(hand, _blocks(places[np.argsort(off + bare, kind="stable")]), others)
    if first is None:
        return ()
    locked = [other for other in others if not _free_directions(other, first).any()]
    distance = np.linalg.norm(places.middle - first.position, axis=1)
    crosswise = np.abs(places.closing @ first.closing) < np.cos(np.pi / 4.0)
    beyond = distance - off
    cost = _CENTRAL * (off - beyond) + bare - np.minimum(distance, _MAX_USEFUL_DISTANCE) - _CROSSWISE * crosswise
    order = np.argsort(cost, kind="stable")
    distinct = places[order[((distance > _DISTINCT) | crosswise)[order]]]
    second = _first_holdable(hand, _freest_first(distinct, locked) if locked else _blocks(distinct), others)
    found = (first,) if second is None else (first, second)
    return tuple(sorted(found, key=lambda region: float(np.linalg.norm(region.position))))[:GRASP_REGIONS]


def _opposite_sides(solid: trimesh.Trimesh, rays: Rays) -> _Places:
    """Return the places where both pads would lie on the part."""
    sampled = trimesh.sample.sample_surface(
        solid, _SAMPLES, face_weight=np.maximum(solid.area_faces, 0.0) ** _EVENNESS, seed=np.random.default_rng(0)
    )
    points, normals = np.asarray(sampled[0]), np.asarray(solid.face_normals[sampled[1]])
    sound = np.linalg.norm(normals, axis=1) > 0.5
    points, normals = points[sound], normals[sound]
    n = len(points)
    # The far side is where a ray first leaves the part, or where it finally leaves it: across a hollow part.
    inward = np.tile(-normals, (2, 1))
    starts = np.concatenate([points - 1e-5 * normals, points - MAX_WIDTH * normals])
    reach, opposite = rays.first_hits(starts, np.concatenate([-normals, normals]))
    depth = np.concatenate([reach[:n], MAX_WIDTH - reach[n:]])
    out = (np.einsum("ij,ij->i", opposite, inward) > 0) & (depth > 0) & (depth < MAX_WIDTH)
    out[n:] &= np.abs(depth[n:] - depth[:n]) > MIN_WIDTH
    middle = np.tile(points, (2, 1))[out] + 0.5 * depth[out, None] * inward[out]
    # The fingers close along the mean normal of sides that lean.
    closing = opposite[out] + inward[out]
    # Axes through the centre of mass are added because samples seldom lie beside it.
    axes = np.unique(np.round(normals, 3) * np.where(normals @ [1.0, 1e-3, 1e-6] < 0, -1.0, 1.0)[:, None], axis=0)
    axes = axes[np.linspace(0, len(axes) - 1, min(_AXES, len(axes))).astype(int)]
    middle, closing = np.concatenate([np.zeros_like(axes), middle]), np.concatenate([axes, closing])
    closing /= np.linalg.norm(closing, axis=1, keepdims=True)
    return _between_fingers(rays, middle, closing)


def _between_fingers(rays: Rays, middle: Float[np.ndarray, "n 3"], closing: Float[np.ndarray, "n 3"]) -> _Places:
    """Return the holdable places between fingers that close about given points along given axes."""
    n, half = len(middle), 0.5 * MAX_OPENING
    reach, facing = rays.first_hits(
        np.concatenate([middle + half * closing, middle - half * closing]),
        np.concatenate([-closing, closing]),
    )
    right, left = half - reach[:n], half - reach[n:]
    lean = np.minimum((facing[:n] * closing).sum(axis=1), -(facing[n:] * closing).sum(axis=1))
    width = right + left
    holdable = (lean > np.cos(np.arctan(FRICTION))) & (width > MIN_WIDTH) & (width < MAX_WIDTH)
    middle = middle[holdable] + 0.5 * (right[holdable] - left[holdable])[:, None] * closing[holdable]
    closing, width = closing[holdable], width[holdable]
    covered = _covered(rays, middle, closing, width)
    # A rod touches a pad along a line; with less than a line it would swing.
    line = (covered[:, :4] & covered[:, 4:]).any(axis=1)
    return _Places(middle[line], closing[line], width[line], covered[line].mean(axis=1))


def _covered(
    rays: Rays,
    middle: Float[np.ndarray, "n 3"],
    closing: Float[np.ndarray, "n 3"],
    width: Float[np.ndarray, "n"],
) -> Bool[np.ndarray, "n 8"]:
    """Return whether the part lies under both pads, for eight places around their rims."""
    n = len(middle)
    around = PAD * _around(closing, 8)
    off = ((0.5 * width + _PAD_SLACK)[:, None] * closing)[:, None]
    origins = np.concatenate([(middle[:, None] + around + side * off).reshape(-1, 3) for side in (1, -1)])
    inward = np.repeat(closing, 8, axis=0)
    reach, _ = rays.first_hits(origins, np.concatenate([-inward, inward]))
    return np.asarray((reach < 2.0 * _PAD_SLACK).reshape(2, n, 8).all(axis=0))


def _within_reach(rays: Rays, places: _Places) -> Bool[np.ndarray, "n"]:
    """Return whether the part ends before the palm in some direction: a cheap test that excludes most of a board."""
    n, tried = len(places.width), ANGLES // 2
    directions = _around(places.closing, tried)
    reach, _ = rays.first_hits(np.repeat(places.middle, tried, axis=0), directions.reshape(-1, 3))
    return np.asarray((reach.reshape(n, tried) < PALM_DEPTH).any(axis=1))


def _around(closing: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "n count 3"]:
    """Return unit vectors all around each axis; the first is the one nearest to an axis of the part's frame."""
    first = np.eye(3)[np.argmin(np.abs(closing), axis=1)]
    first = first - np.einsum("ni,ni->n", first, closing)[:, None] * closing
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(closing, first)
    angles = np.arange(count) * 2.0 * np.pi / count
    return np.cos(angles)[None, :, None] * first[:, None] + np.sin(angles)[None, :, None] * second[:, None]


def _blocks(places: _Places) -> Iterator[_Places]:
    """Yield the places in batches for tests of collision, small ones first: one of the first usually is a solution."""
    start, size = 0, _FIRST_BLOCK
    while start < len(places.width):
        yield places[np.arange(start, min(start + size, len(places.width)))]
        start, size = start + size, min(2 * size, _BLOCK)


def _freest_first(places: _Places, locked: Sequence[HandAgainst]) -> Iterator[_Places]:
    """Yield the places in batches, those first where most of the surroundings `locked` leave the hand a direction.

    Places with equally many come in the given order. Usually one of the first has all and is a solution, so that the
    rest need not be tested.
    """
    rest: list[tuple[int, _Places]] = []
    for some in _blocks(places):
        directions = _around(some.closing, ANGLES // 2)
        counts = np.zeros(len(some.width), dtype=int)
        for other in locked:
            counts += (~_touches(other, some, directions, MAX_OPENING, coming=True)).any(axis=1)
        freest = counts == len(locked)
        if freest.any():
            yield some[freest]
        rest += [(int(counts[i]), some[np.array([i])]) for i in np.flatnonzero(~freest)]
    for _, place in sorted(rest, key=lambda pair: -pair[0]):
        yield place


def _first_holdable(hand: HandAgainst, blocks: Iterable[_Places], others: Sequence[HandAgainst]) -> GraspRegion | None:
    """Return the region at the first place that the hand can hold from enough directions; None if there is none.

    Args:
        hand: collisions of the hand with the part.
        blocks: candidates in order of preference, in batches.
        others: collisions of the hand with surroundings of the part, which decide between directions.
    """
    for some in blocks:
        directions = _around(some.closing, ANGLES)
        free = ~_touches(hand, some, directions, MAX_OPENING, coming=True)
        for index in np.flatnonzero(free.sum(axis=1) >= APPROACHES):
            region = _closed_on(hand, some[np.array([index])], directions[index], free[index], others)
            if region is not None:
                return region
    return None


def _free_directions(other: HandAgainst, region: GraspRegion) -> Bool[np.ndarray, "4"]:
    """Return whether each direction of a region is free of collision with some surroundings."""
    n = len(region.approaches)
    middle, closing = np.tile(region.position, (n, 1)), np.tile(region.closing, (n, 1))
    return ~other.touches(middle, closing, region.approaches, MAX_OPENING, coming=True)


def _closed_on(
    hand: HandAgainst,
    place: _Places,
    directions: Float[np.ndarray, "a 3"],
    free: Bool[np.ndarray, "a"],
    others: Sequence[HandAgainst],
) -> GraspRegion | None:
    """Return the region at one place if the hand can close there in four `free` directions.

    Directions that most of the others leave free come first.
    """
    for eased in _EASED:
        opening = float(place.width[0]) + eased + 2.0 * CLEARANCE
        closable = _still_free(hand, place, directions, free, opening)
        for share in _OPENINGS:
            if closable.sum() >= APPROACHES:
                closable = _still_free(hand, place, directions, closable, opening + share * (MAX_OPENING - opening))
        if closable.sum() >= APPROACHES:
            liked = np.zeros(ANGLES)
            for other in others:
                liked += _still_free(other, place, directions, closable, MAX_OPENING, coming=True)
            chosen = directions[_four_of(closable, liked)]
            return GraspRegion(place.middle[0], place.closing[0], chosen, opening - 2.0 * CLEARANCE)
    return None


def _still_free(
    hand: HandAgainst,
    place: _Places,
    directions: Float[np.ndarray, "a 3"],
    free: Bool[np.ndarray, "a"],
    opening: float,
    *,
    coming: bool = False,
) -> Bool[np.ndarray, "a"]:
    """Return which of the `free` directions at one place leave the hand free of this collision, too."""
    out, tried = free.copy(), directions[None, free]
    out[free] = ~_touches(hand, place, tried, opening, coming=coming)[0]
    return out


def _touches(
    hand: HandAgainst, places: _Places, directions: Float[np.ndarray, "n a 3"], opening: float, *, coming: bool = False
) -> Bool[np.ndarray, "n a"]:
    n, a = directions.shape[:2]
    middle, closing = np.repeat(places.middle, a, axis=0), np.repeat(places.closing, a, axis=0)
    return hand.touches(middle, closing, directions.reshape(-1, 3), opening, coming=coming).reshape(n, a)


def _four_of(free: Bool[np.ndarray, "a"], liked: Float[np.ndarray, "a"]) -> list[int]:
    """Return four free directions.

    The first is the middle of the widest free fan among the most liked; each next one is the farthest from those
    chosen. A direction that all surroundings leave free gains as much as half a turn of distance.
    """
    n = len(free)
    separations = np.abs((np.arange(n)[:, None] - np.arange(n) + n // 2) % n - n // 2)
    blocked = np.flatnonzero(~free)
    fan = separations[:, blocked].min(axis=1) if len(blocked) else np.full(n, n)
    most = liked[free].max()
    preference = 0.5 * n * liked / most if most > 0 else np.zeros(n)
    chosen = [int(np.argmax(np.where(free, fan + 2.0 * preference, -1)))]
    while len(chosen) < APPROACHES:
        separation = separations[:, chosen].min(axis=1)
        chosen.append(int(np.argmax(np.where(free & (separation > 0), separation + preference, -1))))
    return chosen
