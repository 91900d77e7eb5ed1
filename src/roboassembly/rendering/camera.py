"""Pinhole camera of pictures: its pose, the projection, and the fit to a set of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

AZIMUTH = float(np.radians(130.0))
ELEVATION = float(np.radians(-24.0))
FIELD_OF_VIEW = float(np.radians(36.0))
"""Vertical field of view [rad]."""
NEAREST = 0.02
"""Distance from which a camera sees, in distances to its target."""
MARGIN = 1.06
"""Size of the picture over the size of what it shows."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera that looks at a point, with the z axis up in the picture.

    It looks along `(cos e cos a, cos e sin a, sin e)` for azimuth a and elevation e: a negative elevation looks down.
    """

    target: Float[np.ndarray, "3"]
    """World point in the middle of the picture [m]."""
    distance: float
    """Distance from the camera to the target [m]."""
    azimuth: float = AZIMUTH
    """Azimuth of the viewing direction [rad]."""
    elevation: float = ELEVATION
    """Elevation of the viewing direction [rad]."""

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """World position of the camera [m]."""
        return self.target - self.distance * view_axes(self.azimuth, self.elevation)[2]


def view_axes(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Return the world directions right, up and forward of the camera, as rows."""
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def project(
    points: Float[np.ndarray, "n 3"], camera: Camera, width: int, height: int, field_of_view: float = FIELD_OF_VIEW
) -> Float[np.ndarray, "n 2"]:
    """Return the pixel coordinates of world points: x to the right, y down, from the upper left corner."""
    across, up, depth = view_axes(camera.azimuth, camera.elevation) @ (points - camera.position).T
    scale = 0.5 * height / np.tan(0.5 * field_of_view)
    return np.column_stack([0.5 * width + scale * across / depth, 0.5 * height - scale * up / depth])


def clip_from_world(
    camera: Camera, width: int, height: int, far: float, field_of_view: float = FIELD_OF_VIEW
) -> Float[np.ndarray, "4 4"]:
    """Return OpenGL's projection matrix of a camera.

    Args:
        camera: the camera.
        width: width of the picture [pixels].
        height: height of the picture [pixels].
        far: distance up to which it sees [m].
        field_of_view: vertical field of view [rad].
    """
    right, up, forward = view_axes(camera.azimuth, camera.elevation)
    near = NEAREST * camera.distance
    scale = 1.0 / np.tan(0.5 * field_of_view)
    view = np.eye(4)
    view[:3, :3] = right, up, -forward
    view[:3, 3] = -view[:3, :3] @ camera.position
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = scale * height / width, scale
    projection[2, 2:] = (far + near) / (near - far), 2.0 * far * near / (near - far)
    projection[3, 2] = -1.0
    return projection @ view


def fit_camera(
    points: Float[np.ndarray, "n 3"],
    aspect: float,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    target: Float[np.ndarray, "3"] | None = None,
) -> Camera:
    """Return the nearest camera that shows all points.

    Args:
        points: world points [m].
        aspect: width over height of the picture.
        azimuth: azimuth of the viewing direction [rad].
        elevation: elevation of the viewing direction [rad].
        target: world point in the middle of the picture [m]; the middle of the points if None.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0)) if target is None else target
    across, up, depth = view_axes(azimuth, elevation) @ (points - middle).T
    slope = np.tan(0.5 * FIELD_OF_VIEW) / MARGIN
    distance = np.maximum(np.abs(across) / (slope * aspect), np.abs(up) / slope) - depth
    return Camera(middle, max(float(distance.max()), 1e-3), azimuth, elevation)


def box_corners(mesh: Mesh, pose: SE3) -> Float[np.ndarray, "8 3"]:
    """Return the corners of a mesh's bounding box, moved by `pose`."""
    return transform_points(pose, boxes_corners(mesh.bounds[:1], mesh.bounds[1:]))


def boxes_corners(lows: Float[np.ndarray, "n 3"], highs: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Return the eight corners of each box from its lowest and its highest corner."""
    return np.where(_CORNERS[None], highs[:, None], lows[:, None]).reshape(-1, 3)


_CORNERS = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
