"""Finished piece on a turntable: the poses that the opening view shows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.rendering.camera import box_corners

SECONDS_PER_TURN = 30.0
_CORNER_ANGLES = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)


class Turntable:
    """Finished piece that stands on the ground and turns about the vertical axis through its middle.

    Args:
        furniture: the piece.
    """

    def __init__(self, furniture: Furniture) -> None:
        parts = list(zip(furniture.parts, furniture.assembled, strict=True))
        corners = np.concatenate([box_corners(part.mesh, pose) for part, pose in parts])
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        lowest = min(float(transform_points(pose, part.mesh.vertices)[:, 2].min()) for part, pose in parts)
        ground = SE3(np.eye(3), np.array([-middle[0], -middle[1], -lowest]))
        self._poses = [ground * pose for pose in furniture.assembled]
        self._corners = corners + ground.translation

    def poses(self, angle: float) -> list[SE3]:
        """Return `world_from_part` of each part.

        Args:
            angle: angle of the turntable [rad].
        """
        turn = SE3(_about_z(angle), np.zeros(3))
        return [turn * pose for pose in self._poses]

    @property
    def extent(self) -> Float[np.ndarray, "n 3"]:
        """World points [m] around all that the piece covers in a turn."""
        return np.concatenate([self._corners @ _about_z(angle).T for angle in _CORNER_ANGLES])


def _about_z(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
