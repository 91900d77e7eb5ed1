"""Support polygon of a rigid body on level ground: whether its centre of mass lies above what it stands on.

The polygon is the convex hull of the points of contact, seen from above. A body at rest on level ground keeps standing
if its centre of mass projects into the polygon, and tips over an edge of it otherwise. This is exact where it is clear
which points touch the ground; `SupportHull.rests` says when it is not.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from roboassembly.geometry.poses import align_axis

_SOLE = 2e-4
"""Height above the lowest point up to which a point certainly touches the ground [m]."""
_ROUNDING = 1e-6
"""Distance outside of a triangle that counts as inside [m]."""
_SIDES = 32
"""Number of sides to which a body is tilted."""
_UP = np.array([0.0, 0.0, 1.0])
_MARGIN = float(np.deg2rad(1.0))
"""Angle by which both verdicts are on the safe side [rad]."""


def tipping_angle(points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, "3"], sole: float) -> float | None:
    """Return the angle by which a body must tilt before it falls over; negative if its centre is beyond its support.

    Args:
        points: corners of the body, z up [m].
        center: its centre of mass [m].
        sole: height above the lowest point up to which points count as touching the ground [m].

    Returns:
        The angle [rad]; None if the body stands on an edge or a corner, so that there is no polygon.
    """
    low = float(points[:, 2].min())
    touching = points[points[:, 2] < low + sole, :2]
    try:
        sides = ConvexHull(touching).equations
    except (QhullError, ValueError):
        return None
    inside = -float((sides[:, :2] @ center[:2] + sides[:, 2]).max())
    return float(np.arctan2(inside, center[2] - low))


class SupportHull:
    """Convex hull of a body with its centre of mass: whether the body rests with some axis up.

    Args:
        points: corners of the body [m].
        center: its centre of mass, in the same frame [m].
    """

    def __init__(self, points: Float[np.ndarray, "n 3"], center: Float[np.ndarray, "3"]) -> None:
        self._points, self._center = points, center
        try:
            hull = ConvexHull(points)
        except QhullError:
            hull = None
        self._normals = np.zeros((0, 3)) if hull is None else np.asarray(hull.equations)[:, :3]
        self._faces = np.zeros((0, 3, 3)) if hull is None else points[hull.simplices]

    def rests(
        self, up: Float[np.ndarray, "3"], nudge: float, drop: float, largest_tilt: float, largest_shift: float
    ) -> bool | None:
        """Return whether the body stays as it is once it is nudged and released; None if the polygon cannot tell.

        A body comes to rest on a face of its hull below its centre of mass. It does not stay if no such face is within
        the largest tilt. It stays if one is so near to level that neither bound is reached on the way to it, and if its
        centre of mass would have to rise higher to fall off that face than it is when the body is released.

        Args:
            up: unit vector that points up, in the frame of the body.
            nudge: angle by which the body is tilted before it is released [rad].
            drop: height above the ground from which it is released [m].
            largest_tilt: angle from its first pose up to which it counts as staying [rad].
            largest_shift: level motion of its centre of mass up to which it counts as staying [m].
        """
        near = -self._normals @ up > np.cos(largest_tilt + _MARGIN)
        below = [n for n, face in zip(self._normals[near], self._faces[near], strict=True) if self._above(face, n)]
        if not below:
            return False if len(self._normals) else None
        for normal in below:
            lean = float(np.arccos(np.clip(-normal @ up, -1.0, 1.0)))
            turn = align_axis(-normal, _UP)
            turned, center = self._points @ turn.T, turn @ self._center
            reach = float(np.linalg.norm(turned - center, axis=1).max())
            angle = tipping_angle(turned, center, _SOLE)
            level = lean + _MARGIN < largest_tilt and 2.0 * lean * reach < largest_shift
            if level and angle is not None and angle > 0.0:
                height = float(center[2] - turned[:, 2].min())
                if height / np.cos(angle) > _highest(turned - center, lean + nudge) + drop:
                    return True
        return None

    def _above(self, face: Float[np.ndarray, "3 3"], normal: Float[np.ndarray, "3"]) -> bool:
        """Return whether the centre of mass lies above a triangle that is on the ground, up to rounding."""
        edges = np.roll(face, -1, axis=0) - face
        sides = np.cross(edges, self._center - face) @ normal
        # Corners of a facet are in either order.
        sides = sides * np.sign(np.cross(edges[0], edges[1]) @ normal)
        return bool((sides > -_ROUNDING * np.linalg.norm(edges, axis=1)).all())


def _highest(corners: Float[np.ndarray, "n 3"], tilt: float) -> float:
    """Return the greatest height of a body's centre above its lowest corner when it is tilted to any side [m].

    Args:
        corners: of the body, from its centre, z up [m].
        tilt: angle by which it is tilted [rad].
    """
    around = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    downhill = np.sin(tilt) * np.column_stack([np.cos(around), np.sin(around)])
    return float(-(np.cos(tilt) * corners[:, 2:] + corners[:, :2] @ downhill.T).min())
