"""Things in a browser's scene, moved and coloured frame by frame; what did not change is not sent again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from viser import MeshHandle, SceneApi

from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.rendering.colors import FLOOR_LINES, Color, to_bytes
from roboassembly.rendering.shading import shade
from roboassembly.viewer.timeline import Thing

EXPOSURE = 0.76
"""viser's own lights are strong, and what faces up would come out white."""


class Tableau:
    """The things of a film as meshes of a viser scene.

    Args:
        scene: of a server, or of one of its clients.
    """

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self.meshes: list[MeshHandle] = []
        """In the order of the things."""
        self._shown: list[SE3 | None] = []

    def add(self, things: Sequence[Thing], poses: Sequence[SE3 | None], colors: Sequence[Color]) -> None:
        """Add things behind those that are there, at `world_from_thing`; one without a pose is not seen."""
        for thing, pose, color in zip(things, poses, colors, strict=True):
            shaded = shade(thing.mesh)
            seven = _rounded(pose or SE3.Identity())
            self.meshes.append(
                self._scene.add_mesh_simple(
                    f"/{thing.name}",
                    shaded.vertices.astype(np.float32),
                    shaded.faces.astype(np.uint32),
                    color=lit(color),
                    side="front" if thing.mesh.is_solid else "double",
                    position=seven[:3],
                    wxyz=seven[3:],
                    visible=pose is not None,
                )
            )
            self._shown.append(pose)

    def show(self, poses: Sequence[SE3 | None], colors: Sequence[Color]) -> None:
        """Move and colour all things; any beyond the last pose are not seen."""
        missing = len(self.meshes) - len(poses)
        for index, pose in enumerate([*poses, *[None] * missing]):
            handle, before = self.meshes[index], self._shown[index]
            if index < len(colors):
                handle.color = lit(colors[index])  # sent only where it changes
            if pose is before:
                continue
            if (pose is None) != (before is None):
                handle.visible = pose is not None
            if pose is not None:
                seven = _rounded(pose)
                handle.position, handle.wxyz = seven[:3], seven[3:]
            self._shown[index] = pose

    def clear(self) -> None:
        """Take all things away, and what hangs on them."""
        for handle in self.meshes:
            handle.remove()
        self.meshes, self._shown = [], []


def set_the_scene(scene: SceneApi, points: Float[np.ndarray, "n 3"]) -> None:
    """Light, and a ruled floor that reaches past all of the world points given."""
    scene.set_up_direction("+z")
    scene.configure_default_lights(enabled=True, cast_shadow=True)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
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


def lit(color: Color) -> tuple[int, int, int]:
    """The colour, darker by `EXPOSURE`."""
    r, g, b = (EXPOSURE * c for c in color)
    return to_bytes((r, g, b))


def _rounded(pose: SE3) -> np.ndarray:
    """`x, y, z, qw, qx, qy, qz` as 32-bit floats hold them: a recording then packs into half the size."""
    return np.asarray(pose_to_seven(pose), dtype=np.float32).astype(float)
