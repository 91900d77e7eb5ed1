"""Places of a part where two sides face each other within the jaw, found by rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from roboassembly.furniture.rays import Rays
from roboassembly.robots.gripper import MAX_OPENING, PALM_DEPTH, WIDER

MIN_WIDTH, MAX_WIDTH = 0.001, MAX_OPENING - 0.004
"""Smallest and largest width of a part between the pads; the open hand has 2 mm on either side [m]."""
FRICTION = 0.2
"""Coefficient of friction that a grasp relies on, so sides may lean by 11°. Rubber on wood has 0.5 or more."""
LEAST_COSINE = float(np.cos(np.arctan(FRICTION)))
"""Cosine between the closing axis and the normal of a side that leans as far as friction allows."""
PAD = 0.008
"""Distance from the middle of a pad to just within its rim (the pad is 17.5 by 18.5 mm) [m]."""
ANGLES = 24
"""Number of directions tried around the closing axis: those of a region differ by at least 15°."""
_PAD_SLACK = 0.002
"""Largest distance at which the part covers a place of the pad [m]."""
_SAMPLES, _AXES = 384, 48
"""Numbers of surface points and of axes through the centre of mass at which opposite sides are sought."""
_DENSE_SAMPLES = 6_000
"""Number of surface points where few opposite sides are found."""
_THINNEST = 3e-4
"""Smallest width of a sheet that is sought there [m]."""
_ALIKE, _PARALLEL = 0.008, 0.1
"""Sizes of cells of positions [m] and of axes; of the places in one cell of both, only the best covered one counts."""
_EVENNESS = 0.75
"""Exponent of the area by which faces are sampled: with 1, a peg on a seat would be missed."""


@dataclass(frozen=True, eq=False)
class Places:
    """Places between opposite sides of a part."""

    middle: Float[np.ndarray, "n 3"]
    closing: Float[np.ndarray, "n 3"]
    width: Float[np.ndarray, "n"]
    cover: Float[np.ndarray, "n"]
    """Share of eight places around the rim at which both pads lie on the part."""

    def __getitem__(self, which: Int[np.ndarray, "m"] | Bool[np.ndarray, "n"]) -> Places:
        return Places(self.middle[which], self.closing[which], self.width[which], self.cover[which])


def opposite_sides(solid: trimesh.Trimesh, rays: Rays) -> Places:
    """Return the places where both pads of the open hand would lie on the part."""
    points, normals = _surface_points(solid, _SAMPLES)
    middle, closing, _ = _across(rays, points, normals, MIN_WIDTH)
    # Axes through the centre of mass are added because samples seldom lie beside it.
    axes = np.unique(np.round(normals, 3) * np.where(normals @ [1.0, 1e-3, 1e-6] < 0, -1.0, 1.0)[:, None], axis=0)
    axes = axes[np.linspace(0, len(axes) - 1, min(_AXES, len(axes))).astype(int)]
    middle, closing = np.concatenate([np.zeros_like(axes), middle]), np.concatenate([axes, closing])
    closing /= np.linalg.norm(closing, axis=1, keepdims=True)
    return _between_fingers(rays, middle, closing, np.full(len(middle), 0.5 * MAX_OPENING), MIN_WIDTH)


def opposite_sides_anywhere(solid: trimesh.Trimesh, rays: Rays) -> Places:
    """Return many more places, also on sheets and beside grooves that are too narrow for the open hand.

    The fingers start only as far from the part as robots open them. Each place comes twice: along the normals at its
    middle, and along the mean normals under the pads, as on curved sides the two differ.
    """
    middle, closing, depth = _across(rays, *_surface_points(solid, _DENSE_SAMPLES), _THINNEST)
    closing /= np.linalg.norm(closing, axis=1, keepdims=True)
    there = _between_fingers(rays, middle, closing, 0.5 * np.minimum(MAX_OPENING, depth + WIDER), _THINNEST)
    half = 0.5 * np.minimum(MAX_OPENING, there.width + WIDER)
    settled = _between_fingers(rays, there.middle, _mean_closing(rays, there), half, _THINNEST)
    # Places along the mean normals come first.
    columns = ("middle", "closing", "width", "cover")
    both = Places(*(np.concatenate([getattr(settled, name), getattr(there, name)]) for name in columns))
    return both[_unlike(both)]


def _unlike(places: Places) -> Int[np.ndarray, "m"]:
    """Return the indices of the best covered one of each few places that are alike."""
    order = np.argsort(-places.cover, kind="stable")
    turned = places.closing * np.where(places.closing @ [1.0, 1e-3, 1e-6] < 0, -1.0, 1.0)[:, None]
    cells = np.concatenate([places.middle / _ALIKE, turned / _PARALLEL, places.width[:, None] / _ALIKE], axis=1)
    _, first = np.unique(np.round(cells[order]).astype(int), axis=0, return_index=True)
    return np.sort(order[first])


def _mean_closing(rays: Rays, places: Places) -> Float[np.ndarray, "n 3"]:
    """Return the axes along the mean normals of the sides beneath both pads."""
    n, total = len(places.width), np.zeros_like(places.closing)
    rim = directions_around(places.closing, 8)
    spots = np.concatenate([np.zeros((n, 1, 3)), 0.5 * PAD * rim, PAD * rim], axis=1)
    count = spots.shape[1]
    for side in (1.0, -1.0):
        off = side * ((0.5 * places.width + _PAD_SLACK)[:, None] * places.closing)[:, None]
        inward = np.repeat(-side * places.closing, count, axis=0)
        reach, normals = rays.first_hits((places.middle[:, None] + spots + off).reshape(-1, 3), inward)
        normals[reach > 2.0 * _PAD_SLACK] = 0.0
        total += side * normals.reshape(n, count, 3).sum(axis=1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def _surface_points(solid: trimesh.Trimesh, count: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return random points of the surface with their outward normals."""
    sampled = trimesh.sample.sample_surface(
        solid, count, face_weight=np.maximum(solid.area_faces, 0.0) ** _EVENNESS, seed=np.random.default_rng(0)
    )
    points, normals = np.asarray(sampled[0]), np.asarray(solid.face_normals[sampled[1]])
    sound = np.linalg.norm(normals, axis=1) > 0.5
    return points[sound], normals[sound]


def _across(
    rays: Rays, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], least: float
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m"]]:
    """Return middles, closing axes (not of unit length) and depths from points to the sides that face them.

    Args:
        rays: of the part.
        points: points of its surface.
        normals: outward normals there.
        least: smallest distance between the two far sides that a point may have [m].
    """
    n = len(points)
    # The far side is where a ray first leaves the part, or where it finally leaves it: across a hollow part.
    inward = np.tile(-normals, (2, 1))
    starts = np.concatenate([points - 1e-5 * normals, points - MAX_WIDTH * normals])
    reach, opposite = rays.first_hits(starts, np.concatenate([-normals, normals]))
    depth = np.concatenate([reach[:n], MAX_WIDTH - reach[n:]])
    out = (np.einsum("ij,ij->i", opposite, inward) > 0) & (depth > 0) & (depth < MAX_WIDTH)
    out[n:] &= np.abs(depth[n:] - depth[:n]) > least
    # The fingers close along the mean normal of sides that lean.
    return np.tile(points, (2, 1))[out] + 0.5 * depth[out, None] * inward[out], opposite[out] + inward[out], depth[out]


def _between_fingers(
    rays: Rays,
    middle: Float[np.ndarray, "n 3"],
    closing: Float[np.ndarray, "n 3"],
    half: Float[np.ndarray, "n"],
    least: float,
) -> Places:
    """Return the holdable places between fingers that close about given points along given axes.

    Args:
        rays: of the part.
        middle: points.
        closing: unit vectors.
        half: distance of each finger from the point when the hand is open [m].
        least: smallest width [m].
    """
    n = len(middle)
    reach, facing = rays.first_hits(
        np.concatenate([middle + half[:, None] * closing, middle - half[:, None] * closing]),
        np.concatenate([-closing, closing]),
    )
    right, left = half - reach[:n], half - reach[n:]
    lean = np.minimum((facing[:n] * closing).sum(axis=1), -(facing[n:] * closing).sum(axis=1))
    width = right + left
    holdable = (lean > LEAST_COSINE) & (width > least) & (width < MAX_WIDTH)
    middle = middle[holdable] + 0.5 * (right[holdable] - left[holdable])[:, None] * closing[holdable]
    closing, width = closing[holdable], width[holdable]
    covered = _covered(rays, middle, closing, width)
    # A rod touches a pad along a line; with less than a line it would swing.
    line = (covered[:, :4] & covered[:, 4:]).any(axis=1)
    return Places(middle[line], closing[line], width[line], covered[line].mean(axis=1))


def _covered(
    rays: Rays,
    middle: Float[np.ndarray, "n 3"],
    closing: Float[np.ndarray, "n 3"],
    width: Float[np.ndarray, "n"],
) -> Bool[np.ndarray, "n 8"]:
    """Return whether the part lies under both pads, for eight places around their rims."""
    n = len(middle)
    rim = PAD * directions_around(closing, 8)
    off = ((0.5 * width + _PAD_SLACK)[:, None] * closing)[:, None]
    origins = np.concatenate([(middle[:, None] + rim + side * off).reshape(-1, 3) for side in (1, -1)])
    inward = np.repeat(closing, 8, axis=0)
    reach, _ = rays.first_hits(origins, np.concatenate([-inward, inward]))
    return np.asarray((reach < 2.0 * _PAD_SLACK).reshape(2, n, 8).all(axis=0))


def within_reach(rays: Rays, places: Places) -> Bool[np.ndarray, "n"]:
    """Return whether the part ends before the palm in some direction: a cheap test that excludes most of a board."""
    n, tried = len(places.width), ANGLES // 2
    directions = directions_around(places.closing, tried)
    reach, _ = rays.first_hits(np.repeat(places.middle, tried, axis=0), directions.reshape(-1, 3))
    return np.asarray((reach.reshape(n, tried) < PALM_DEPTH).any(axis=1))


def directions_around(closing: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "n count 3"]:
    """Return unit vectors all around each axis; the first is the one nearest to an axis of the part's frame."""
    first = np.eye(3)[np.argmin(np.abs(closing), axis=1)]
    first = first - np.einsum("ni,ni->n", first, closing)[:, None] * closing
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(closing, first)
    angles = np.arange(count) * 2.0 * np.pi / count
    return np.cos(angles)[None, :, None] * first[:, None] + np.sin(angles)[None, :, None] * second[:, None]
