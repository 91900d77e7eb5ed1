"""Where the camera stands, and what it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

AZIMUTH = float(np.radians(130.0))
ELEVATION = float(np.radians(-24.0))
FIELD_OF_VIEW = float(np.radians(36.0))
"""Vertical, radians."""
MARGIN = 1.06
"""Size of the view over the size of what it has to show."""


@dataclass(frozen=True, eq=False)
class View:
    """A camera that looks at `target` from `distance` metres, z up.

    It looks along `(cos e cos a, cos e sin a, sin e)` for azimuth a and elevation e: a negative elevation looks down.
    """

    target: Float[np.ndarray, "3"]
    distance: float
    azimuth: float = AZIMUTH
    elevation: float = ELEVATION

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """Metres, in the world."""
        return self.target - self.distance * view_axes(self.azimuth, self.elevation)[2]


def view_axes(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Rows: right, up and forward of the camera, in the world."""
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def project(
    points: Float[np.ndarray, "n 3"], view: View, width: int, height: int, field_of_view: float = FIELD_OF_VIEW
) -> Float[np.ndarray, "n 2"]:
    """Pixel coordinates (x right, y down, the origin at the picture's upper left corner) of world points."""
    across, up, depth = view_axes(view.azimuth, view.elevation) @ (points - view.position).T
    scale = 0.5 * height / np.tan(0.5 * field_of_view)
    return np.column_stack([0.5 * width + scale * across / depth, 0.5 * height - scale * up / depth])


def fit(
    points: Float[np.ndarray, "n 3"],
    aspect: float,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    target: Float[np.ndarray, "3"] | None = None,
) -> View:
    """The nearest view that holds all points. `aspect` is width over height; `target` is their middle if not given."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0)) if target is None else target
    across, up, depth = view_axes(azimuth, elevation) @ (points - middle).T
    slope = np.tan(0.5 * FIELD_OF_VIEW) / MARGIN
    distance = np.maximum(np.abs(across) / (slope * aspect), np.abs(up) / slope) - depth
    return View(middle, max(float(distance.max()), 1e-3), azimuth, elevation)


def box_corners(mesh: Mesh, pose: SE3) -> Float[np.ndarray, "8 3"]:
    """Corners of the mesh's own bounding box, moved by `pose`."""
    return transform_points(pose, boxes_corners(mesh.bounds[:1], mesh.bounds[1:]))


def boxes_corners(lows: Float[np.ndarray, "n 3"], highs: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Eight corners of each box, given its lowest and its highest corner."""
    return np.where(_CORNERS[None], highs[:, None], lows[:, None]).reshape(-1, 3)


_CORNERS = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
