"""Exact contact and distance queries between two triangle meshes."""

from __future__ import annotations

import coal
import numpy as np
from jaxtyping import Float, Int

from roboassembly.geometry.meshes import distance_to, have_area, hierarchy
from roboassembly.repair.surface import Surface

_STILL = coal.Transform3s.Identity()


class Shell:
    """Triangles of a part in a bounding-volume tree, rounded to 32-bit floats as in storage."""

    def __init__(self, surface: Surface) -> None:
        vertices = surface.vertices.astype(np.float32).astype(float)
        self.model = hierarchy(vertices, surface.faces)
        whole = have_area(vertices, surface.faces)
        self._with_area = self.model if whole.all() else hierarchy(vertices, surface.faces[whole])
        self.surface = surface
        self.low, self.high = vertices.min(axis=0), vertices.max(axis=0)

    def box_distance(self, other: Shell) -> float:
        """Return the distance of the axis-aligned boxes, a lower bound of the distance of the meshes [m]."""
        separation = np.maximum(0.0, np.maximum(self.low - other.high, other.low - self.high))
        return float(np.linalg.norm(separation))

    def touches(self, other: Shell, shift: Float[np.ndarray, "3"] | None = None) -> bool:
        """Return whether any two triangles intersect, with this shell moved by `shift` [m]."""
        moved = _STILL if shift is None else coal.Transform3s(np.eye(3), np.asarray(shift, dtype=float))
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        return bool(coal.collide(self.model, moved, other.model, _STILL, request, result))

    def nearest(self, other: Shell) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Return the distance of the surfaces (0 if they touch), and the nearest points on this and the other [m]."""
        if self.touches(other):
            return 0.0, np.zeros(3), np.zeros(3)
        request, result = coal.DistanceRequest(True), coal.DistanceResult()
        distance = float(coal.distance(self.model, _STILL, other.model, _STILL, request, result))
        return max(distance, 0.0), np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def pairs_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n 2"]:
        """Return all pairs of a triangle of this shell and one of the other that are closer than `margin` [m]."""
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        request.num_max_contacts, request.security_margin = 1_000_000, margin
        coal.collide(self.model, _STILL, other.model, _STILL, request, result)
        return np.array([(c.b1, c.b2) for c in result.getContacts()], dtype=np.int64).reshape(-1, 2)

    def triangles_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n"]:
        """Return the indices of this shell's triangles that are closer than `margin` to the other's surface [m]."""
        return np.unique(self.pairs_near(other, margin)[:, 0])

    def distance_to(self, point: Float[np.ndarray, "3"]) -> float:
        """Return the distance from a point to the nearest triangle [m]."""
        return distance_to(self._with_area, point)
