"""Camera of one browser: where it looks at first, and the rays of its pixels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from viser import ClientHandle

from roboassembly.rendering.camera import ELEVATION, FIELD_OF_VIEW, fit_camera, view_axes

_NARROW = 600
"""Width of a window [pixels] up to which the panel lies below the scene, not beside it."""
_PANEL = 330.0
"""Width of the panel beside the scene [pixels]. A browser reports its size without the panel at first."""
_COVERED_ABOVE, _COVERED_BELOW = 50.0, 125.0
"""Heights of the scene that the title, and the start buttons or the time line, cover [pixels]."""


class CameraAim:
    """Camera of one browser.

    Args:
        client: the browser.
    """

    def __init__(self, client: ClientHandle) -> None:
        self._camera = client.camera
        self._first_width = float(client.camera.image_width)

    @property
    def is_narrow(self) -> bool:
        """Whether the panel lies below the scene, as on a telephone."""
        return self._first_width <= _NARROW

    def at(self, points: Float[np.ndarray, "n 3"], elevation: float = ELEVATION) -> None:
        """Show all points, in what the panel and the buttons leave of the scene.

        Args:
            points: world points [m].
            elevation: elevation of the viewing direction [rad].
        """
        camera = self._camera
        width, height = float(camera.image_width), float(camera.image_height)
        beside = _PANEL if width == self._first_width and not self.is_narrow else 0.0
        free_width = max(width - beside, 0.4 * width)
        free_height = max(height - _COVERED_ABOVE - _COVERED_BELOW, 0.5 * height)
        fitted = fit_camera(points, free_width / free_height, elevation=elevation)
        # The camera is farther away than for the free part alone, and looks lower.
        distance = fitted.distance * height / free_height
        _, up, forward = view_axes(fitted.azimuth, fitted.elevation)
        pixel = 2.0 * distance * np.tan(0.5 * FIELD_OF_VIEW) / height
        target = fitted.target - 0.5 * (_COVERED_BELOW - _COVERED_ABOVE) * pixel * up
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.fov = FIELD_OF_VIEW
        camera.position = target - distance * forward
        camera.look_at = target  # after the position, which would move it too

    def ray(self, x: float, y: float) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Return the origin [m] and the direction, of any length, of the ray through a place of the picture.

        Args:
            x: place from the left edge over the width.
            y: place from the upper edge over the height.
        """
        camera = self._camera
        slope = np.tan(0.5 * camera.fov)
        direction = np.array([(2.0 * x - 1.0) * slope * camera.aspect, (2.0 * y - 1.0) * slope, 1.0])
        w, *vector = camera.wxyz
        return np.array(camera.position), Rotation.from_quat([*vector, w]).apply(direction)
