"""What is under the pointer: computed here from the ray of a click.

viser also says which object was clicked on, and which of several balls that are drawn together. That is not used: with
them viser tests an outline that is not seen, a ball of 1 m around the part, and so takes clicks on the floor for clicks
on a point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.rays import Rays
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

Picked = tuple[int, int | None]
"""Number of a part, and of its connection point if that was clicked on."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What can be seen at a time."""

    poses: Sequence[SE3 | None]
    """`world_from_mesh`, None where a mesh is not shown."""
    centers: Float[np.ndarray, "parts points 3"]
    """Middle of the balls on connection points, in their parts' frames."""
    radii: Float[np.ndarray, "parts points"]
    """Metres; 0 where a ball is not shown."""


class Picker:
    """Finds the first thing along a ray."""

    def __init__(self) -> None:
        self._rays: dict[Mesh, Rays] = {}

    def first(
        self, shown: Shown, meshes: Sequence[Mesh], origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
    ) -> Picked | None:
        """The part or the connection point that the ray meets first.

        Args:
            shown: what can be seen.
            meshes: parts, in their order, then what else stands in the way, robots for instance.
            origin: metres, in the world.
            direction: of any length.

        Returns:
            None if the ray meets nothing, or something that is no part.
        """
        direction = direction / np.linalg.norm(direction)
        parts = len(shown.radii)
        nearest, picked = np.inf, None
        for number, (mesh, pose) in enumerate(zip(meshes, shown.poses, strict=False)):
            if pose is None:
                continue
            reach = self._reach(mesh, pose, origin, direction)
            if reach < nearest:
                nearest, picked = reach, (number, None) if number < parts else None
        for part in range(parts):
            pose = shown.poses[part]
            if pose is None:
                continue
            centers = transform_points(pose, shown.centers[part])
            for point in np.flatnonzero(shown.radii[part] > 0.0).tolist():
                reach = _ball_reach(centers[point] - origin, shown.radii[part, point], direction)
                if reach < nearest:
                    nearest, picked = reach, (part, point)
        return picked

    def _reach(self, mesh: Mesh, pose: SE3, origin: np.ndarray, direction: np.ndarray) -> float:
        if mesh not in self._rays:
            self._rays[mesh] = Rays(mesh)
        back = pose.inverse()
        ahead, _ = self._rays[mesh].first_hits(back.act(origin)[None], (back.rotation @ direction)[None])
        return float(ahead[0]) if ahead[0] > 0.0 else np.inf


def _ball_reach(center: np.ndarray, radius: float, direction: np.ndarray) -> float:
    """Distance along the ray to a ball around `center`, seen from the ray's origin; infinite if it passes by."""
    along = float(center @ direction)
    inside = radius**2 - (float(center @ center) - along**2)
    if inside < 0.0 or along <= 0.0:
        return np.inf
    return along - float(np.sqrt(inside))
