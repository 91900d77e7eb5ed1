"""How well a tenon fits where it would go, measured on the clouds of two parts.

A tenon is what a part has beyond the plane of a connection point. Points on its sides give its section to a fraction of
a millimetre, as do points on the walls of the pocket, so that joints of different sizes can be told apart. Without a
pocket, the face of the other part lies inside the tenon. Where two faces meet flat, the outlines of the parts in the
plane say whether they were made for each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int8
from scipy.spatial import ConvexHull, QhullError

from roboassembly.learning.layers import Array

FIT_FEATURES = 23
"""Number of features of the fit of a mate."""
CLEARANCES = slice(1, 7), slice(9, 15)
"""Places of the clearances of the moving and of the waiting part's tenon."""
_TENON_FEATURES = 8
"""Number of features of one tenon in another part."""
_EXCHANGED = np.array([*range(8, 16), *range(8), 17, 16, 19, 18, 21, 20, 22])
"""Place of each feature where the other part moves."""
_REACH = 0.048
"""Distance from a connection point along any axis of its frame up to which its joint is looked at [m]."""
_PLANE = 0.0006
"""Half the thickness of the plane of a joint [m]."""
_SECTION = 0.015
"""Distance beyond the plane up to which the sides of a tenon are measured [m]."""
_FEWEST = 6
"""Number of points beyond the plane from which on they are a tenon."""
_MARGIN = 0.001
"""Distance from the surface of a tenon up to which points are not inside [m]."""
_FARTHEST = 0.010
"""Largest clearance [m]."""
_ON_AXIS = 5
"""Number of points nearest to the normal of a connection point that say how high the surface is there."""
_UNIT = 0.001
"""Unit of the features [m]."""
_FINEST = 0.05
"""Number below which codes are linear."""
_CODES = 127.0 / np.arcsinh(_FARTHEST / _UNIT / _FINEST)
"""Codes for each unit of the inverse hyperbolic sine."""
_SIDES = 16
"""Number of sides of the polygon around a tenon's section."""
_ANGLES = np.arange(_SIDES) * 2.0 * np.pi / _SIDES


@dataclass(frozen=True, eq=False)
class PartJoints:
    """Surface of one part around each of its k connection points, in the frames of the points."""

    near: Sequence[Float[np.ndarray, "m 3"]]
    """Points of the surface around each connection point, as the mate sees them: y and z are opposite [m]."""
    axis: Float[np.ndarray, "k"]
    """Height of the surface above the plane at the connection point: positive on a tenon, negative in a pocket [m]."""
    tenon: Bool[np.ndarray, "k"]
    """Whether there is a tenon."""
    sides: Float[np.ndarray, "k s 2"]
    """Outward normals of the polygon around the tenon's section; the first points along the longer side."""
    offset: Float[np.ndarray, "k s"]
    """Distances of the polygon's sides from the connection point [m]."""
    length: Float[np.ndarray, "k"]
    """Distance from the plane to the tip of the tenon [m]."""
    outline: Float[np.ndarray, "k 4"]
    """Least x and y, greatest x and y of the surface in the plane [m]."""

    @staticmethod
    def of_part(
        cloud: Float[np.ndarray, "c 3"], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"]
    ) -> PartJoints:
        """Measure a part.

        Args:
            cloud: points of its surface [m].
            position: its connection points [m].
            frame: `part_from_point` of each connection point.
        """
        k = len(position)
        near: list[Float[np.ndarray, "m 3"]] = []
        tenon, axis, length, outline = np.zeros(k, bool), np.zeros(k), np.zeros(k), np.zeros((k, 4))
        sides, offset = np.zeros((k, _SIDES, 2)), np.zeros((k, _SIDES))
        for i, (origin, axes) in enumerate(zip(position, frame, strict=True)):
            local = cloud[(np.abs(cloud - origin) < 1.75 * _REACH).all(axis=1)] - origin
            local = local @ axes
            local = local[(np.abs(local) < _REACH).all(axis=1)]
            near.append(local * (1.0, -1.0, -1.0))
            if len(local):
                nearest = np.argsort(np.abs(local[:, :2]).max(axis=1), kind="stable")[:_ON_AXIS]
                axis[i] = np.median(local[nearest, 2])
            beyond = local[local[:, 2] > _PLANE]
            section = beyond[beyond[:, 2] < _SECTION, :2]
            if len(section) >= _FEWEST:
                tenon[i], length[i] = True, beyond[:, 2].max()
                sides[i] = _directions(section)
                offset[i] = (sides[i] @ section.T).max(axis=1)
            plane = local[np.abs(local[:, 2]) <= _PLANE, :2]
            if len(plane):
                outline[i] = [*plane.min(axis=0), *plane.max(axis=0)]
        return PartJoints(near, axis, tenon, sides, offset, length, outline)


def _directions(section: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "s 2"]:
    """Normals of the sides of a polygon, turned as the smallest rectangle around the points."""
    try:
        hull = section[ConvexHull(section).vertices]
    except QhullError:  # all points on a line
        hull = section[[0, -1]]
    # The smallest rectangle has a side along one of the hull (Freeman and Shapira 1975).
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    cosine, sine = np.cos(angles), np.sin(angles)
    width = np.ptp(hull @ np.array([cosine, sine]), axis=0)
    height = np.ptp(hull @ np.array([-sine, cosine]), axis=0)
    best = int(np.argmin(width * height))
    first = angles[best] + (0.0 if width[best] >= height[best] else 0.5 * np.pi)
    return np.array([np.cos(_ANGLES + first), np.sin(_ANGLES + first)]).T


def joint_fit(moving: PartJoints, waiting: PartJoints) -> Int8[np.ndarray, "k l 23"]:
    """Return codes of how each of k points of a moving part fits each of l points of a waiting one.

    `decoded` turns codes into these numbers:

    | index | feature | unit |
    |---|---|---|
    | 0 | 1 if the moving part has a tenon | |
    | 1 | least clearance of the tenon to the other part, 10 mm at most | mm |
    | 2, 3 | clearances at both ends of the tenon's longer side, the smaller first | mm |
    | 4, 5 | clearances at both ends of its shorter side, the smaller first | mm |
    | 6 | clearance of its tip, 10 mm at most; minus its length where it meets a face | mm |
    | 7 | log(1 + number of the other part's points inside the tenon) | |
    | 8–15 | the same of the waiting part's tenon | |
    | 16–19 | reach of the moving part's outline beyond the other's, along x and along y, the smaller first | mm |
    | 20–22 | heights of the moving and of the waiting part's surface above the plane, and their sum | mm |

    All numbers are the same for mirrored parts.
    """
    first, second = _tenons(moving, waiting), _tenons(waiting, moving).transpose(1, 0, 2)
    heights = np.stack(np.broadcast_arrays(moving.axis[:, None], waiting.axis), axis=2)
    heights = np.concatenate([heights, heights.sum(axis=2, keepdims=True)], axis=2)
    lengths = np.concatenate([_outlines(moving, waiting), heights], axis=2)
    return _encoded(np.concatenate([first, second, lengths / _UNIT], axis=2))


def exchanged(fit: Int8[np.ndarray, "k l 23"]) -> Int8[np.ndarray, "l k 23"]:
    """Return the codes of `joint_fit` where the other part moves."""
    back = fit.transpose(1, 0, 2)[..., _EXCHANGED]
    # A reach beyond the other part's outline is a lack for the other part.
    back[..., 16:20] = -back[..., 16:20]
    return back


def _encoded(numbers: Float[np.ndarray, "*n"]) -> Int8[np.ndarray, "*n"]:
    """Codes of some numbers, small ones the most exact: 0.4 mm to 0.02 mm, 10 mm to 0.5 mm."""
    limit = _FARTHEST / _UNIT
    return np.rint(_CODES * np.arcsinh(np.clip(numbers, -limit, limit) / _FINEST)).astype(np.int8)


def decoded(codes: Array) -> Array:
    """Return the numbers of some codes; works on NumPy and on JAX arrays."""
    return _FINEST * codes.__array_namespace__().sinh(codes / _CODES)


def _tenons(of: PartJoints, into: PartJoints) -> Float[np.ndarray, "k l 8"]:
    """Features of the tenons of one part in another part."""
    out = np.zeros((len(of.tenon), len(into.tenon), _TENON_FEATURES))
    have = np.flatnonzero(of.tenon)
    if not len(have):
        return out
    sides, offset, length = of.sides[have], of.offset[have], of.length[have]
    for l, near in enumerate(into.near):  # noqa: E741
        values = np.full((len(have), _TENON_FEATURES), _FARTHEST / _UNIT)
        values[:, 0], values[:, 7] = 1.0, 0.0
        points = near[near[:, 2] > -_PLANE]
        if len(points):
            values[:, 1:7], values[:, 7] = _clearances(sides, offset, length, points)
        out[have, l] = values
    return out


def _clearances(
    sides: Float[np.ndarray, "t s 2"], offset: Float[np.ndarray, "t s"], length: Float[np.ndarray, "t"],
    points: Float[np.ndarray, "m 3"],
) -> tuple[Float[np.ndarray, "t 6"], Float[np.ndarray, "t"]]:  # fmt: skip
    """Return features 1 to 6 of `joint_fit` of t tenons among the points of another part, and feature 7."""
    distance = sides @ points[:, :2].T - offset[..., None]
    clearance, side = distance.max(axis=1), distance.argmax(axis=1)
    z = points[:, 2]
    beside = (z > _PLANE) & (z < np.minimum(length - _PLANE, _SECTION)[:, None])
    least = np.where(beside, clearance, _FARTHEST)
    quarters = range(0, _SIDES, _SIDES // 4)
    ends = np.stack([np.where(side == s, least, _FARTHEST).min(axis=1) for s in quarters], axis=1)
    ends = np.sort(ends[:, [0, 2, 1, 3]].reshape(-1, 2, 2), axis=2).reshape(-1, 4)
    inside = clearance < -_MARGIN
    tip = np.clip(np.where(inside, z, np.inf).min(axis=1) - length, -_FARTHEST, _FARTHEST)
    count = (inside & (z < length[:, None] - _MARGIN)).sum(axis=1)
    return np.column_stack([least.min(axis=1), ends, tip]) / _UNIT, np.log1p(count)


def _outlines(moving: PartJoints, waiting: PartJoints) -> Float[np.ndarray, "k l 4"]:
    """How far the moving part's outline reaches beyond the waiting one's [m]."""
    low_x, low_y, high_x, high_y = moving.outline.T[:, :, None]
    other_low_x, other_low_y, other_high_x, other_high_y = waiting.outline.T[:, None]
    # The mate sees the other part's y axis opposite.
    along_x = np.sort(np.stack([other_low_x - low_x, high_x - other_high_x], axis=-1), axis=-1)
    along_y = np.sort(np.stack([-other_high_y - low_y, high_y + other_low_y], axis=-1), axis=-1)
    return np.concatenate([along_x, along_y], axis=-1)
