"""What is seen first along a ray, by trying all triangles: without the package's own code for rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roboassembly.furniture.model import Furniture

MARGIN = 0.35
"""Share of a ball's radius that no other thing may come near, for a point to count as visible."""


@dataclass(frozen=True)
class Sight:
    """Parts and balls on their connection points, in the world."""

    triangles: list[np.ndarray]
    """Of each part, (n, 3, 3)."""
    centers: np.ndarray
    """Of each ball, (n, 3)."""
    radii: np.ndarray
    owners: list[tuple[int, int]]
    """Part and point of each ball."""

    def first(self, origin: np.ndarray, direction: np.ndarray) -> tuple[int, int | None] | None:
        """Part, and point if it is a ball, that the ray meets first."""
        near, found = np.inf, None
        for part, triangles in enumerate(self.triangles):
            reach = _triangles_reach(triangles, origin, direction)
            if reach < near:
                near, found = reach, (part, None)
        for center, radius, owner in zip(self.centers, self.radii, self.owners, strict=True):
            reach = _ball_reach(center, radius, origin, direction)
            if reach < near:
                near, found = reach, owner
        return found

    def visible(self, eye: np.ndarray) -> list[int]:
        """Balls whose middle, and what is around it, nothing hides."""
        seen = []
        for ball, (center, owner) in enumerate(zip(self.centers, self.owners, strict=True)):
            ahead = (center - eye) / np.linalg.norm(center - eye)
            side = np.cross(ahead, [0.0, 0.0, 1.0])
            side /= np.linalg.norm(side)
            up = np.cross(side, ahead)
            around = MARGIN * self.radii[ball] * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
            targets = [center + a * side + b * up for a, b in around]
            if all(self.first(eye, (t - eye) / np.linalg.norm(t - eye)) == owner for t in targets):
                seen.append(ball)
        return seen


def _ball_reach(center: np.ndarray, radius: float, origin: np.ndarray, direction: np.ndarray) -> float:
    roots = np.roots([1.0, 2.0 * direction @ (origin - center), (origin - center) @ (origin - center) - radius**2])
    ahead = [float(r.real) for r in roots if abs(r.imag) < 1e-12 and r.real > 0.0]
    return min(ahead, default=np.inf)


def _triangles_reach(triangles: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """Where the ray crosses each plane, and whether that lies on the inner side of all three edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normals = np.cross(b - a, c - a)
    slope = normals @ direction
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.einsum("ij,ij->i", normals, a - origin) / slope
        at = origin + reach[:, None] * direction
    inside = np.ones(len(triangles), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(end - start, at - start), normals) >= 0.0
    ahead = reach[inside & (reach > 1e-9) & np.isfinite(reach)]
    return float(ahead.min()) if len(ahead) else np.inf


def sight(furniture: Furniture, poses: Sequence, centers: np.ndarray, radii: np.ndarray) -> Sight:
    """Everything at `world_from_part`.

    Args:
        furniture: whose parts are seen.
        poses: of its parts.
        centers: of balls in their parts' frames, (parts, points, 3).
        radii: of balls, (parts, points); 0 where none is shown.
    """
    triangles = []
    for part, pose in zip(furniture.parts, poses, strict=True):
        world = part.mesh.vertices @ pose.rotation.T + pose.translation
        triangles.append(world[part.mesh.faces])
    owners = [(int(part), int(point)) for part, point in np.argwhere(radii > 0.0)]
    placed = [poses[part].rotation @ centers[part, point] + poses[part].translation for part, point in owners]
    return Sight(triangles, np.array(placed).reshape(-1, 3), np.array([radii[o] for o in owners]), owners)
