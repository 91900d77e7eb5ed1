"""Where a Franka hand can hold a part: two regions, four directions to come to each.

Rays through the part find where two sides face each other within the jaw. Of these places the hand must be able to
take: come to open, close, and touch nothing but what its pads are to touch. The part is alone here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from roboassembly.furniture.model import GRASP_REGIONS, GraspRegion
from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.robots.gripper import MAX_OPENING, PALM_DEPTH, HandAgainst

APPROACHES = 4
"""A region, as in the paper."""
MIN_WIDTH, MAX_WIDTH = 0.001, MAX_OPENING - 0.004
"""Metres: the open hand has 2 mm on either side."""
FRICTION = 0.2
"""Coefficient that must suffice, so sides may lean by 11°. Rubber on wood has 0.5 or more."""
CLEARANCE = 2e-4
"""Metres between pad and part when the closed hand is tested: touching counts as collision."""
PAD = 0.008
"""Metres from the middle of a pad to nearly its rim (it is 17.5 by 18.5 mm)."""
_PAD_SLACK = 0.002
"""Metres: the part covers a place of the pad if it lies within this of it."""
ANGLES = 24
"""Directions tried around the closing axis: those of a region differ by 15° at least."""
_EASED = (0.0, 0.0006, 0.0013, 0.0022, 0.003)
"""Metres wider than at its middle that a hand may close on sides that lean or bend and meet a pad's rim first."""
_OPENINGS = (0.25, 0.5, 0.75)
"""Of the way from closed to open, where the moving fingers are tested: they are thicker than the steps."""
_SAMPLES, _AXES = 384, 48
"""Points on the surface, and axes through the centre of mass, where opposite sides are looked for."""
_BLOCK = 12
"""Places tested in one batch; mostly the first holds one that will do."""
_EVENNESS = 0.75
"""Power of a face's area that it is sampled by: by area alone a peg on a seat would be missed."""
_UNCOVERED = 0.05
"""Metres farther from the centre of mass that a fully covered pad is worth, against a bare line."""
_SPREAD = 0.15
"""Metres: up to this far apart regions are better the farther they are."""
_CENTRAL = 0.25
"""Of that, how much a metre nearer to the centre of mass is worth, and one more to the other side of it."""
_DISTINCT = 0.02
"""Metres: regions nearer than this must close along axes 45° apart or more."""
_CROSSWISE = 0.2
"""Metres of all that is above that closing along another axis is worth: a slat among others can only be held by its
edges from the front, a rail on a board only by its sides."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Pairs of opposite sides."""

    middle: Float[np.ndarray, "n 3"]
    closing: Float[np.ndarray, "n 3"]
    width: Float[np.ndarray, "n"]
    cover: Float[np.ndarray, "n"]
    """Share of eight places around the rim at which both pads lie on the part."""

    def __getitem__(self, which: Int[np.ndarray, "m"] | Bool[np.ndarray, "n"]) -> _Places:
        return _Places(self.middle[which], self.closing[which], self.width[which], self.cover[which])


def find_grasps(mesh: Mesh, around: Sequence[Mesh] = ()) -> tuple[GraspRegion, ...]:
    """Two regions where the hand can hold a part, the one nearer to its centre of mass first; fewer if need be.

    One is the nearest to the centre of mass where the pads lie well; the other closes along an axis 45° or more away
    where there is such a place, is up to 150 mm away, and beyond the centre of mass where it can be. Where the
    assembled furniture leaves no hand at the first, the other one is where it does. Of the directions to come from,
    those that the furniture leaves come first. The same meshes give the same grasps.

    Args:
        mesh: a part's, in its frame: metres, the origin at the centre of mass.
        around: what surrounds the part, or each part of its shape, in the assembled furniture; in its frame.
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
    one = _first_held(hand, places[np.argsort(off + bare, kind="stable")], others)
    if one is None:
        return ()
    locked = [other for other in others if not _left_free(other, one).any()]
    apart = np.linalg.norm(places.middle - one.position, axis=1)
    crosswise = np.abs(places.closing @ one.closing) < np.cos(np.pi / 4.0)
    beyond = apart - off
    cost = _CENTRAL * (off - beyond) + bare - np.minimum(apart, _SPREAD) - _CROSSWISE * crosswise
    order = np.argsort(cost, kind="stable")
    distinct = places[order[((apart > _DISTINCT) | crosswise)[order]]]
    if locked:
        ways = _around(distinct.closing, ANGLES // 2)
        room = sum((~_touches(other, distinct, ways, MAX_OPENING, coming=True)).any(axis=1) for other in locked)
        distinct = distinct[np.argsort(-np.asarray(room), kind="stable")]
    two = _first_held(hand, distinct, others)
    found = (one,) if two is None else (one, two)
    return tuple(sorted(found, key=lambda region: float(np.linalg.norm(region.position))))[:GRASP_REGIONS]


def _opposite_sides(solid: trimesh.Trimesh, rays: Rays) -> _Places:
    """Places where both pads would lie on the part."""
    sampled = trimesh.sample.sample_surface(
        solid, _SAMPLES, face_weight=np.maximum(solid.area_faces, 0.0) ** _EVENNESS, seed=np.random.default_rng(0)
    )
    points, normals = np.asarray(sampled[0]), np.asarray(solid.face_normals[sampled[1]])
    sound = np.linalg.norm(normals, axis=1) > 0.5
    points, normals = points[sound], normals[sound]
    n = len(points)
    # The far side is where a ray first leaves the part, and where it leaves it for good: across a hollow part.
    inward = np.tile(-normals, (2, 1))
    starts = np.concatenate([points - 1e-5 * normals, points - MAX_WIDTH * normals])
    reach, opposite = rays.first_hits(starts, np.concatenate([-normals, normals]))
    depth = np.concatenate([reach[:n], MAX_WIDTH - reach[n:]])
    out = (np.einsum("ij,ij->i", opposite, inward) > 0) & (depth > 0) & (depth < MAX_WIDTH)
    out[n:] &= np.abs(depth[n:] - depth[:n]) > MIN_WIDTH
    middle = np.tile(points, (2, 1))[out] + 0.5 * depth[out, None] * inward[out]
    # Between two sides that lean, the fingers close along the mean.
    closing = opposite[out] + inward[out]
    # Samples seldom lie right beside the centre of mass.
    axes = np.unique(np.round(normals, 3) * np.where(normals @ [1.0, 1e-3, 1e-6] < 0, -1.0, 1.0)[:, None], axis=0)
    axes = axes[np.linspace(0, len(axes) - 1, min(_AXES, len(axes))).astype(int)]
    middle, closing = np.concatenate([np.zeros_like(axes), middle]), np.concatenate([axes, closing])
    closing /= np.linalg.norm(closing, axis=1, keepdims=True)
    return _between_fingers(rays, middle, closing)


def _between_fingers(rays: Rays, middle: Float[np.ndarray, "n 3"], closing: Float[np.ndarray, "n 3"]) -> _Places:
    """What fingers that close about a point along an axis would meet, where that can be held."""
    n, half = len(middle), 0.5 * MAX_OPENING
    reach, facing = rays.first_hits(
        np.concatenate([middle + half * closing, middle - half * closing]),
        np.concatenate([-closing, closing]),
    )
    right, left = half - reach[:n], half - reach[n:]
    lean = np.minimum((facing[:n] * closing).sum(axis=1), -(facing[n:] * closing).sum(axis=1))
    width = right + left
    held = (lean > np.cos(np.arctan(FRICTION))) & (width > MIN_WIDTH) & (width < MAX_WIDTH)
    middle = middle[held] + 0.5 * (right[held] - left[held])[:, None] * closing[held]
    closing, width = closing[held], width[held]
    covered = _covered(rays, middle, closing, width)
    # A rod touches a pad along a line, and less than a line would let it swing.
    line = (covered[:, :4] & covered[:, 4:]).any(axis=1)
    return _Places(middle[line], closing[line], width[line], covered[line].mean(axis=1))


def _covered(
    rays: Rays,
    middle: Float[np.ndarray, "n 3"],
    closing: Float[np.ndarray, "n 3"],
    width: Float[np.ndarray, "n"],
) -> Bool[np.ndarray, "n 8"]:
    """Whether the part lies under both pads, at eight places around their rims."""
    n = len(middle)
    around = PAD * _around(closing, 8)
    off = ((0.5 * width + _PAD_SLACK)[:, None] * closing)[:, None]
    origins = np.concatenate([(middle[:, None] + around + side * off).reshape(-1, 3) for side in (1, -1)])
    inward = np.repeat(closing, 8, axis=0)
    reach, _ = rays.first_hits(origins, np.concatenate([-inward, inward]))
    return np.asarray((reach < 2.0 * _PAD_SLACK).reshape(2, n, 8).all(axis=0))


def _within_reach(rays: Rays, places: _Places) -> Bool[np.ndarray, "n"]:
    """Whether the part ends before the palm in some direction: a cheap test that spares most of a wide board."""
    n, tried = len(places.width), ANGLES // 2
    ways = _around(places.closing, tried)
    reach, _ = rays.first_hits(np.repeat(places.middle, tried, axis=0), ways.reshape(-1, 3))
    return np.asarray((reach.reshape(n, tried) < PALM_DEPTH).any(axis=1))


def _around(closing: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "n count 3"]:
    """Unit vectors all around each axis; the first as near to an axis of the part's frame as can be."""
    first = np.eye(3)[np.argmin(np.abs(closing), axis=1)]
    first = first - np.einsum("ni,ni->n", first, closing)[:, None] * closing
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(closing, first)
    angles = np.arange(count) * 2.0 * np.pi / count
    return np.cos(angles)[None, :, None] * first[:, None] + np.sin(angles)[None, :, None] * second[:, None]


def _first_held(hand: HandAgainst, places: _Places, others: Sequence[HandAgainst]) -> GraspRegion | None:
    """The first of the places that the hand can take from enough directions.

    Args:
        hand: against the part.
        places: in order.
        others: against what surrounds the part, by which directions are chosen.
    """
    for start in range(0, len(places.width), _BLOCK):
        some = places[np.arange(start, min(start + _BLOCK, len(places.width)))]
        ways = _around(some.closing, ANGLES)
        free = ~_touches(hand, some, ways, MAX_OPENING, coming=True)
        for index in np.flatnonzero(free.sum(axis=1) >= APPROACHES):
            place, its_ways = some[np.array([index])], ways[[index]]
            liked = np.zeros(ANGLES)
            for other in others:
                liked += free[index] & ~_touches(other, place, its_ways, MAX_OPENING, coming=True)[0]
            region = _closed_on(hand, place, its_ways, free[index], liked)
            if region is not None:
                return region
    return None


def _left_free(other: HandAgainst, region: GraspRegion) -> Bool[np.ndarray, "4"]:
    """Directions of a region that something beside the part leaves free."""
    n = len(region.approaches)
    middle, closing = np.tile(region.position, (n, 1)), np.tile(region.closing, (n, 1))
    return ~other.touches(middle, closing, region.approaches, MAX_OPENING, coming=True)


def _closed_on(
    hand: HandAgainst,
    place: _Places,
    ways: Float[np.ndarray, "1 a 3"],
    free: Bool[np.ndarray, "a"],
    liked: Float[np.ndarray, "a"],
) -> GraspRegion | None:
    """The region at one place, if the hand can close there in four of the `free` directions; `liked` ones first."""
    for eased in _EASED:
        opening = float(place.width[0]) + eased + 2.0 * CLEARANCE
        held = free & ~_touches(hand, place, ways, opening)[0]
        for share in _OPENINGS if held.sum() >= APPROACHES else ():
            held &= ~_touches(hand, place, ways, opening + share * (MAX_OPENING - opening))[0]
        if held.sum() >= APPROACHES:
            directions = ways[0][_four_of(held, liked)]
            return GraspRegion(place.middle[0], place.closing[0], directions, opening - 2.0 * CLEARANCE)
    return None


def _touches(
    hand: HandAgainst, places: _Places, ways: Float[np.ndarray, "n a 3"], opening: float, *, coming: bool = False
) -> Bool[np.ndarray, "n a"]:
    n, a = ways.shape[:2]
    middle, closing = np.repeat(places.middle, a, axis=0), np.repeat(places.closing, a, axis=0)
    return hand.touches(middle, closing, ways.reshape(-1, 3), opening, coming=coming).reshape(n, a)


def _four_of(free: Bool[np.ndarray, "a"], liked: Float[np.ndarray, "a"]) -> list[int]:
    """Four free directions: of the most liked, the middle of the widest free fan; then always the one farthest from
    those chosen, where being liked by all counts as much as half a turn."""
    n = len(free)
    apart_of = np.abs((np.arange(n)[:, None] - np.arange(n) + n // 2) % n - n // 2)
    blocked = np.flatnonzero(~free)
    room = apart_of[:, blocked].min(axis=1) if len(blocked) else np.full(n, n)
    most = liked[free].max()
    worth = 0.5 * n * liked / most if most > 0 else np.zeros(n)
    chosen = [int(np.argmax(np.where(free, room + 2.0 * worth, -1)))]
    while len(chosen) < APPROACHES:
        apart = apart_of[:, chosen].min(axis=1)
        chosen.append(int(np.argmax(np.where(free & (apart > 0), apart + worth, -1))))
    return chosen
