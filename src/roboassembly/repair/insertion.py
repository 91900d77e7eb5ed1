"""Sizes of parts, and depths of their insertion in one another."""

from __future__ import annotations

import manifold3d as m3
import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import QhullError

from roboassembly.repair.cached import cached
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import inflate, near

REACH = 0.001
"""Distance within which two parts engage, above any clearance that repair leaves [m]."""
MAX_SHARE = 0.6
"""Largest insertion as a share of the part's size; a part that engages further lies along its neighbour."""
MAX_DEPTH = 0.12
"""Largest insertion [m]; a part that engages further lies along its neighbour."""

SKIN = 0.0025
"""Smallest width of the engaged portion of a part that sits in another and does not lie on it [m]."""


def box_axes(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the axes of the smallest box around the points: unit vectors in rows, the longest side first."""
    try:
        into_box, size = trimesh.bounds.oriented_bounds(points)
    except (QhullError, ValueError):
        # The points lie in one plane.
        return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    return into_box[:3, :3][np.argsort(-np.asarray(size), kind="stable")]


def extents(points: Float[np.ndarray, "n 3"], axes: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return the size of the points along each axis; zeros if there are none [m]."""
    return np.ptp(points @ axes.T, axis=0) if len(points) else np.zeros(3)


@cached
def engaged(body: m3.Manifold, other: m3.Manifold) -> Float[np.ndarray, "n 3"]:
    """Return the vertices of the portion of `body` inside `other` or within `REACH` of it; none without contact."""
    cropped = near(other, body, 20.0 * REACH)
    grown = inflate(cropped, REACH)
    if grown is cropped:
        # The inflated surface would cross itself. Shifted copies reach as far along the axes, and more than half as
        # far between them.
        shifts = [tuple(sign * REACH * axis) for axis in np.eye(3) for sign in (1.0, -1.0)]
        grown = m3.Manifold.batch_boolean([cropped, *(cropped.translate(s) for s in shifts)], m3.OpType.Add)
    portion = grown ^ body
    return np.empty((0, 3)) if portion.is_empty() else to_surface(portion).vertices


def insertion_depth(body: m3.Manifold, other: m3.Manifold, axes: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return how deep an end of `body` sits in `other` along each axis [m].

    The depth of a tenon includes `REACH`. It is 0 along an axis if no end of `body` is near `other`, or if the two
    only lie on each other.
    """
    corners = engaged(body, other)
    if not len(corners):
        return np.zeros(3)
    whole, portion = to_surface(body).vertices @ axes.T, corners @ axes.T
    size, depth = np.ptp(whole, axis=0), np.ptp(portion, axis=0)
    at_end = np.minimum(portion.min(axis=0) - whole.min(axis=0), whole.max(axis=0) - portion.max(axis=0)) < REACH
    # A part that lies on a face engages only with a thin layer.
    across = np.array([np.delete(depth, axis).min() for axis in range(3)])
    return np.where(at_end & (depth <= np.minimum(MAX_SHARE * size, MAX_DEPTH)) & (across > SKIN), depth, 0.0)
