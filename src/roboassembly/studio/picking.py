"""Picking: the part or connection point under the pointer, computed from the ray of a click.

viser also reports the clicked object, and the clicked ball of a batch of balls. That report is not used: for batches,
viser tests an invisible sphere of 1 m around the part, and so reports clicks on the floor as clicks on a point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

PickedItem = tuple[int, int | None]
"""Part, and connection point of that part if the click is on a point."""


@dataclass(frozen=True, eq=False)
class VisibleItems:
    """Poses and balls that the scene shows."""

    poses: Sequence[SE3 | None]
    """`world_from_mesh` of each mesh; None if it is hidden."""
    centers: Float[np.ndarray, "parts points 3"]
    """Centre of each connection point's ball in its part's frame [m]."""
    radii: Float[np.ndarray, "parts points"]
    """Radius of each ball [m]; 0 if it is hidden."""


class Picker:
    """Finds the first part or connection point along a ray. It caches ray-casting structures of meshes."""

    def __init__(self) -> None:
        self._rays: dict[Mesh, Rays] = {}

    def first(
        self,
        items: VisibleItems,
        meshes: Sequence[Mesh],
        origin: Float[np.ndarray, "3"],
        direction: Float[np.ndarray, "3"],
    ) -> PickedItem | None:
        """Return the part or connection point that a ray meets first.

        Args:
            items: visible meshes and balls.
            meshes: meshes of the parts, then other meshes, such as those of robots.
            origin: world position of the start of the ray [m].
            direction: direction of the ray, of any length.

        Returns:
            The part or point; None if the ray meets nothing, or another mesh first.
        """
        direction = direction / np.linalg.norm(direction)
        parts = len(items.radii)
        nearest, found = np.inf, None
        for number, (mesh, pose) in enumerate(zip(meshes, items.poses, strict=False)):
            if pose is None:
                continue
            reach = self._reach(mesh, pose, origin, direction)
            if reach < nearest:
                nearest, found = reach, (number, None) if number < parts else None
        for part in range(parts):
            pose = items.poses[part]
            if pose is None:
                continue
            centers = transform_points(pose, items.centers[part])
            for point in np.flatnonzero(items.radii[part] > 0.0).tolist():
                reach = _ball_reach(centers[point] - origin, items.radii[part, point], direction)
                if reach < nearest:
                    nearest, found = reach, (part, point)
        return found

    def _reach(self, mesh: Mesh, pose: SE3, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> float:
        """Return the distance along a ray to a mesh [m]; infinity if the ray misses it."""
        if mesh not in self._rays:
            self._rays[mesh] = Rays(mesh)
        back = pose.inverse()
        ahead, _ = self._rays[mesh].first_hits(back.act(origin)[None], (back.rotation @ direction)[None])
        return float(ahead[0]) if ahead[0] > 0.0 else np.inf


def _ball_reach(center: Float[np.ndarray, "3"], radius: float, direction: Float[np.ndarray, "3"]) -> float:
    """Return the distance [m] from the origin to a ball along a ray; infinity if the ray misses it."""
    along = float(center @ direction)
    inside = radius**2 - (float(center @ center) - along**2)
    if inside < 0.0 or along <= 0.0:
        return np.inf
    return along - float(np.sqrt(inside))
