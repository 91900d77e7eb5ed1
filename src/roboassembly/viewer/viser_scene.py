"""Meshes in a viser scene, moved and coloured frame by frame. Only changes are sent to the browser."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from viser import MeshHandle, SceneApi

from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.rendering.colors import FLOOR_LINES, Color, to_bytes
from roboassembly.rendering.shading import shade
from roboassembly.viewer.timeline import SceneObject

EXPOSURE = 0.76
"""Factor on colours. viser's lights are strong: without it, surfaces that face up would be white."""


class ViserScene:
    """Objects of a film as meshes of a viser scene.

    Args:
        scene: scene of a server, or of one of its clients.
    """

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self.meshes: list[MeshHandle] = []
        """Meshes in the order of the objects."""
        self._shown: list[SE3 | None] = []
        self._colors: list[Color] = []

    def add(self, objects: Sequence[SceneObject], poses: Sequence[SE3 | None], colors: Sequence[Color]) -> None:
        """Add objects at their `world_from_mesh`; an object without a pose is hidden."""
        for item, pose, color in zip(objects, poses, colors, strict=True):
            shaded = shade(item.mesh)
            seven = _as_float32(pose or SE3.Identity())
            self.meshes.append(
                self._scene.add_mesh_simple(
                    f"/{item.name}",
                    shaded.vertices.astype(np.float32),
                    shaded.faces.astype(np.uint32),
                    color=exposed(color),
                    side="front" if item.mesh.is_solid else "double",
                    position=seven[:3],
                    wxyz=seven[3:],
                    visible=pose is not None,
                )
            )
            self._shown.append(pose)
            self._colors.append(color)

    def show(self, poses: Sequence[SE3 | None], colors: Sequence[Color]) -> None:
        """Move and colour all objects; objects beyond the last pose are hidden."""
        missing = len(self.meshes) - len(poses)
        for index, pose in enumerate([*poses, *[None] * missing]):
            handle, before = self.meshes[index], self._shown[index]
            if index < len(colors) and colors[index] != self._colors[index]:
                handle.color = exposed(colors[index])
                self._colors[index] = colors[index]
            if pose is before:
                continue
            if (pose is None) != (before is None):
                handle.visible = pose is not None
            if pose is not None:
                self._move(index, _as_float32(pose))
            self._shown[index] = pose

    def _move(self, index: int, seven: Float[np.ndarray, "7"]) -> None:
        """Move an object to `x, y, z, qw, qx, qy, qz`."""
        handle = self.meshes[index]
        handle.position, handle.wxyz = seven[:3], seven[3:]

    def clear(self) -> None:
        """Remove all objects, and whatever is attached to them."""
        for handle in self.meshes:
            handle.remove()
        self.meshes, self._shown, self._colors = [], [], []


def set_up_scene(scene: SceneApi, points: Float[np.ndarray, "n 3"]) -> None:
    """Add lights and a ruled floor that extends beyond all of these world points [m]."""
    scene.set_up_direction("+z")
    scene.configure_default_lights(enabled=True, cast_shadow=True)
    low: Float[np.ndarray, "2"] = points[:, :2].min(axis=0)
    high: Float[np.ndarray, "2"] = points[:, :2].max(axis=0)
    reach = float((high - low).max())
    middle = np.round(low + high) / 2.0
    scene.add_grid(
        "/floor",
        infinite_grid=True,
        cell_size=0.25,
        cell_color=(228, 231, 235),
        section_size=1.0,
        section_color=to_bytes(FLOOR_LINES),
        shadow_opacity=0.3,
        fade_distance=8.0 * reach + 4.0,
        position=(float(middle[0]), float(middle[1]), 0.0),
    )


def exposed(color: Color) -> tuple[int, int, int]:
    """Return the colour times `EXPOSURE`, with 0 to 255 per channel."""
    r, g, b = (EXPOSURE * c for c in color)
    return to_bytes((r, g, b))


def _as_float32(pose: SE3) -> Float[np.ndarray, "7"]:
    """Return `x, y, z, qw, qx, qy, qz`, rounded to 32 bits so that a recording compresses to half the size."""
    return np.asarray(pose_to_seven(pose), dtype=np.float32).astype(float)
