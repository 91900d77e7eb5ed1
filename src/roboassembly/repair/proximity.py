"""Exact contact and distance queries between two triangle meshes."""

from __future__ import annotations

from functools import cached_property

import coal
import manifold3d as m3
import numpy as np
from jaxtyping import Float, Int

from roboassembly.geometry.meshes import collision_request, distances_to, have_area, hierarchy
from roboassembly.repair.cached import cached
from roboassembly.repair.surface import Surface, to_surface

_STILL = coal.Transform3s.Identity()
_ROUNDING = 1e-5
"""Allowance for the tolerance of Coal's distances in tests that only exclude pairs [m]."""


class Shell:
    """Triangles of a part in a bounding-volume tree, rounded to 32-bit floats as in storage."""

    def __init__(self, surface: Surface) -> None:
        vertices = surface.vertices.astype(np.float32).astype(float)
        self.surface = surface
        self.low, self.high = vertices.min(axis=0), vertices.max(axis=0)
        self._vertices = vertices

    @cached_property
    def model(self) -> coal.BVHModelOBBRSS:
        """All triangles."""
        return hierarchy(self._vertices, self.surface.faces)

    @cached_property
    def _with_area(self) -> coal.BVHModelOBBRSS:
        whole = have_area(self._vertices, self.surface.faces)
        return self.model if whole.all() else hierarchy(self._vertices, self.surface.faces[whole])

    def box_distance(self, other: Shell) -> float:
        """Return the distance of the axis-aligned boxes, a lower bound of the distance of the meshes [m]."""
        separation = np.maximum(0.0, np.maximum(self.low - other.high, other.low - self.high))
        return float(np.linalg.norm(separation))

    def touches(self, other: Shell, shift: Float[np.ndarray, "3"] | None = None) -> bool:
        """Return whether any two triangles intersect, with this shell moved by `shift` [m]."""
        moved = _STILL if shift is None else coal.Transform3s(np.eye(3), np.asarray(shift, dtype=float))
        return bool(coal.collide(self.model, moved, other.model, _STILL, collision_request(), coal.CollisionResult()))

    def is_within(self, other: Shell, margin: float) -> bool:
        """Return whether the surfaces are closer than `margin` [m]; quicker than `nearest`."""
        if self.box_distance(other) > margin:
            return False
        request = collision_request()
        request.security_margin = margin + _ROUNDING
        near = coal.collide(self.model, _STILL, other.model, _STILL, request, coal.CollisionResult())
        return bool(near) and self.nearest(other)[0] < margin

    @cached
    def nearest(self, other: Shell) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Return the distance of the surfaces (0 if they touch), and the nearest points on this and the other [m]."""
        if self.touches(other):
            return 0.0, np.zeros(3), np.zeros(3)
        request, result = coal.DistanceRequest(True), coal.DistanceResult()
        distance = float(coal.distance(self.model, _STILL, other.model, _STILL, request, result))
        return max(distance, 0.0), np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def pairs_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n 2"]:
        """Return all pairs of a triangle of this shell and one of the other that are closer than `margin` [m]."""
        return _pairs_near(self.model, other.model, margin)

    def triangles_near(self, other: Shell, margin: float) -> Int[np.ndarray, "n"]:
        """Return the indices of this shell's triangles that are closer than `margin` to the other's surface [m]."""
        own, others = self._in_box_of(other, margin), other._in_box_of(self, margin)
        if not len(own) or not len(others):
            return own[:0]
        # A tree of the few triangles that matter is built much faster than one of all.
        model = hierarchy(self._vertices, self.surface.faces[own])
        pairs = _pairs_near(model, hierarchy(other._vertices, other.surface.faces[others]), margin)
        return own[np.unique(pairs[:, 0])]

    def _in_box_of(self, other: Shell, margin: float) -> Int[np.ndarray, "n"]:
        """Return the triangles whose boxes come within `margin` of the other's box [m]."""
        reach = margin + _ROUNDING
        below, above = self._vertices < other.low - reach, self._vertices > other.high + reach
        faces = self.surface.faces
        return np.flatnonzero(~(below[faces].all(axis=1) | above[faces].all(axis=1)).any(axis=1))

    def distances_to(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Return the distance from each point to the nearest triangle [m]."""
        return distances_to(self._with_area, points)


def _pairs_near(first: coal.BVHModelOBBRSS, second: coal.BVHModelOBBRSS, margin: float) -> Int[np.ndarray, "n 2"]:
    request, result = collision_request(), coal.CollisionResult()
    request.num_max_contacts, request.security_margin = 1_000_000, margin
    coal.collide(first, _STILL, second, _STILL, request, result)
    return np.array([(c.b1, c.b2) for c in result.getContacts()], dtype=np.int64).reshape(-1, 2)


@cached
def shell_of(body: m3.Manifold) -> Shell:
    """Return the triangles of a solid as a collision model."""
    return Shell(to_surface(body))
