"""Parts of a picture: what a moved object and its shadow can have changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from roboassembly.rendering.camera import FIELD_OF_VIEW, Camera, project, view_axes
from roboassembly.rendering.offscreen import LIGHT_DIRECTION

_EDGE = 2
"""Pixels around a change that antialiasing can touch."""
_NEAREST = 0.05
"""Least distance along the viewing direction of what is projected [m]."""


@dataclass(frozen=True)
class Rectangle:
    """Part of a picture, in pixels from the upper left corner."""

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """First column to the right of the rectangle."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """First row below the rectangle."""
        return self.top + self.height

    def grown(self, edge: int, width: int, height: int) -> Rectangle:
        """Return the rectangle and the pixels around it, up to the borders of a picture of this width and height."""
        left, top = max(0, self.left - edge), max(0, self.top - edge)
        right, bottom = min(width, self.right + edge), min(height, self.bottom + edge)
        return Rectangle(left, top, right - left, bottom - top)


def changed_rectangle(
    boxes: Float[np.ndarray, "n 8 3"],
    before: Float[np.ndarray, "n 7"],
    after: Float[np.ndarray, "n 7"],
    changed: Bool[np.ndarray, "n"],
    camera: Camera,
    size: tuple[int, int],
    softness: float,
) -> Rectangle:
    """Return the part of a picture that moved objects can have changed; the whole if one is too near to tell.

    Args:
        boxes: corners of each mesh's bounding box, in its own frame [m].
        before: placement of each mesh in the picture before.
        after: placement of each mesh now.
        changed: which meshes have moved or have another colour.
        camera: camera of both pictures.
        size: width and height of the picture [pixels].
        softness: distance by which shadows go beyond their objects [m].
    """
    width, height = size
    rows = np.concatenate([before[changed], after[changed]])
    shown = rows[:, 2] > -50.0
    turns = Rotation.from_quat(rows[shown][:, [4, 5, 6, 3]]).as_matrix()
    local = np.concatenate([boxes[changed]] * 2)[shown]
    corners = (np.einsum("nij,ncj->nci", turns, local) + rows[shown, None, :3]).reshape(-1, 3)
    if len(corners) == 0:
        return Rectangle(0, 0, 0, 0)
    # A shadow falls somewhere between its object and the ground.
    on_ground = corners - np.maximum(corners[:, 2:], 0.0) / LIGHT_DIRECTION[2] * LIGHT_DIRECTION
    points = np.concatenate([corners, on_ground])
    depth = (points - camera.position) @ view_axes(camera.azimuth, camera.elevation)[2]
    if depth.min() < _NEAREST:
        return Rectangle(0, 0, width, height)
    pixels = project(points, camera, width, height)
    margin = (softness * 0.5 * height / np.tan(0.5 * FIELD_OF_VIEW) / depth + _EDGE)[:, None]
    limits = np.array([width, height])
    low = np.clip(np.floor((pixels - margin).min(axis=0)), 0, limits).astype(int)
    high = np.clip(np.ceil((pixels + margin).max(axis=0)), 0, limits).astype(int)
    return Rectangle(int(low[0]), int(low[1]), *(int(x) for x in np.maximum(high - low, 0)))
