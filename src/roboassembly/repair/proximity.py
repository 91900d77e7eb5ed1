"""Exact questions about two triangle meshes: do they touch, and how far apart are they?"""

from __future__ import annotations

import coal  # pyright: ignore[reportMissingImports]
import numpy as np
from jaxtyping import Float, Int

from roboassembly.geometry.meshes import distance_to, have_area, hierarchy
from roboassembly.repair.surface import Surface

_STILL = coal.Transform3s.Identity()


class Shell:
    """A part's triangles in a bounding-volume tree, rounded to 32-bit floats as they will be stored."""

    def __init__(self, surface: Surface) -> None:
        vertices = surface.vertices.astype(np.float32).astype(float)
        self.model = hierarchy(vertices, surface.faces)
        whole = have_area(vertices, surface.faces)
        self._with_area = self.model if whole.all() else hierarchy(vertices, surface.faces[whole])
        self.surface = surface
        self.low, self.high = vertices.min(axis=0), vertices.max(axis=0)

    def box_distance(self, other: Shell) -> float:
        """Metres between the axis-aligned boxes: never more than the distance between the meshes."""
        separation = np.maximum(0.0, np.maximum(self.low - other.high, other.low - self.high))
        return float(np.linalg.norm(separation))

    def touches(self, other: Shell, shift: Float[np.ndarray, "3"] | None = None) -> bool:
        """Whether any two triangles meet, with this shell moved by `shift` metres."""
        moved = _STILL if shift is None else coal.Transform3s(np.eye(3), np.asarray(shift, dtype=float))
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        return bool(coal.collide(self.model, moved, other.model, _STILL, request, result))

    def nearest(self, other: Shell) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Metres between the surfaces (zero when they touch), and the nearest points on this one and the other."""
        if self.touches(other):
            return 0.0, np.zeros(3), np.zeros(3)
        request, result = coal.DistanceRequest(True), coal.DistanceResult()
        distance = float(coal.distance(self.model, _STILL, other.model, _STILL, request, result))
        return max(distance, 0.0), np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def pairs_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n 2"]:
        """A triangle of this shell and one of the other's, for each two that are nearer than `margin` metres."""
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.num_max_contacts, request.security_margin = 1_000_000, margin
        coal.collide(self.model, _STILL, other.model, _STILL, request, result)
        return np.array([(c.b1, c.b2) for c in result.getContacts()], dtype=np.int64).reshape(-1, 2)

    def triangles_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n"]:
        """Indices of this shell's triangles that come nearer than `margin` metres to the other's surface."""
        return np.unique(self.pairs_near(other, margin)[:, 0])

    def distance_to(self, point: Float[np.ndarray, "3"]) -> float:
        """Metres from a point to the nearest triangle."""
        return distance_to(self._with_area, point)
