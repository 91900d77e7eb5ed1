"""Pictures of an episode's states, drawn off screen; `render` returns them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import box_corners, fit_camera
from roboassembly.rendering.colors import Role, finishes, part_colors
from roboassembly.rendering.offscreen import check_size
from roboassembly.rendering.renderer import OffscreenRenderer


@dataclass(frozen=True, eq=False)
class Item:
    """A mesh in a picture."""

    mesh: Mesh
    pose: SE3 | None
    """Pose `world_from_mesh`; None hides the mesh."""
    role: Role
    """Role that decides the color."""
    framed: bool = True
    """Whether the camera keeps it in the picture."""


class EpisodePictures:
    """Draws the states of one episode after another.

    The camera looks from the same side in all pictures of an episode. It shows every state so far, so it moves
    back only if something leaves the picture. A picture depends on the states before it, not on which were drawn.

    Args:
        width: width of the pictures [pixels].
        height: height of the pictures [pixels].

    Raises:
        ArgumentError: a size that no picture can have.
    """

    def __init__(self, width: int, height: int) -> None:
        check_size(width, height)
        self._size = (width, height)
        self._corners: list[Float[np.ndarray, "n 3"]] = []
        self._renderer: OffscreenRenderer | None = None
        self._meshes: tuple[Mesh, ...] = ()

    def start(self) -> None:
        """Begin an episode."""
        self.close()
        self._corners = []

    def add(self, items: Sequence[Item]) -> None:
        """Add a state of the episode."""
        boxes = [box_corners(i.mesh, i.pose) for i in items if i.framed and i.pose is not None]
        self._corners.append(np.concatenate(boxes))

    def draw(self, items: Sequence[Item]) -> UInt8[np.ndarray, "height width 3"]:
        """Return the picture of the state that was added last.

        Raises:
            RenderingUnavailableError: this machine cannot draw off screen.
        """
        width, height = self._size
        meshes = tuple(item.mesh for item in items)
        if self._renderer is None or meshes != self._meshes:
            self.close()
            first = self._corners[0]
            center = 0.5 * (first.min(axis=0) + first.max(axis=0))
            radius = float(np.linalg.norm(first - center, axis=1).max())
            self._renderer = OffscreenRenderer(
                meshes, width, height, center=center, radius=radius, quality=None,
                finishes=finishes([item.role for item in items]),
            )  # fmt: skip
            self._meshes = meshes
        view = fit_camera(np.concatenate(self._corners), width / height)
        return self._renderer.picture([i.pose for i in items], part_colors([i.role for i in items]), view)

    def close(self) -> None:
        """Free the graphics resources; `draw` allocates them again."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
