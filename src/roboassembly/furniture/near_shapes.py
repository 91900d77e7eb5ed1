"""Rigid motions that lay one shape on another of nearly the same shape, equal but for marks and millimetres."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import coal
import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from roboassembly.furniture.model import NEAR
from roboassembly.geometry.meshes import Mesh, all_within, distances_to
from roboassembly.geometry.poses import BOX_ROTATIONS, SE3, transform_points

NEAR_SHARE = 0.05
"""Largest distance between the surfaces of small shapes that count as nearly equal, as a share of the longest side."""
_SAMPLES = 300
"""Number of surface points in a fit."""
_ROUNDS = 8
"""Largest number of rounds of a fit."""
_KEPT = 0.8
"""Share of the points, the nearest ones, that a round fits: marks are left out."""
_HOPEFUL = 3.0
"""Median distance before the fit, in multiples of the limit, above which a candidate is dropped."""
_SAME = 2e-5
"""Largest difference of the places of the corners of a box at which two motions count as one [m]."""
_PROBES = 24
"""Number of surface points that sort out hopeless candidates."""


class NearShape:
    """Shape to be compared with others: its box, and points on its surface."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    @cached_property
    def _box(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Axes of the smallest box in rows, its centre and its size [m]."""
        into_box, size = trimesh.bounds.oriented_bounds(self.mesh.hull_vertices)
        axes = np.asarray(into_box)[:3, :3]
        return axes, -axes.T @ np.asarray(into_box)[:3, 3], np.asarray(size, dtype=float)

    @cached_property
    def limit(self) -> float:
        """Largest distance at which another surface counts as nearly the same [m]."""
        return min(NEAR, NEAR_SHARE * float(self._box[2].max()))

    @cached_property
    def samples(self) -> Float[np.ndarray, "n 3"]:
        """Points on the surface, evenly spread by area [m]."""
        return np.asarray(trimesh.sample.sample_surface(self.mesh.trimesh, _SAMPLES, seed=0)[0])

    def motions_onto(self, other: NearShape) -> list[SE3]:
        """Return the motions that lay this shape on another within the limit, the nearest first.

        They lay the axes of one smallest box on those of the other, and then follow from a fit of the surfaces.
        """
        limit = min(self.limit, other.limit)
        found: list[tuple[float, SE3]] = []
        for candidate in self._candidates(other, limit):
            probes = transform_points(candidate, self.samples[:: max(1, len(self.samples) // _PROBES)])
            if np.median(distances_to(other.mesh.bvh, probes)) > _HOPEFUL * limit:
                continue
            # Marks leave the box as it is; a fit of all points turns two bars of different width a little.
            for motion in (candidate, self._fitted(other, candidate)):
                if any(self.is_same(motion, m, _SAME) for _, m in found) or not self._lies_on(other, motion, limit):
                    continue
                away = distances_to(other.mesh.bvh, transform_points(motion, self.samples))
                found.append((round(float(away.mean()), 6), motion))
        found.sort(key=lambda entry: entry[0])
        return [motion for _, motion in found]

    def is_same(self, first: SE3, second: SE3, limit: float) -> bool:
        """Return whether two motions of this shape differ by no more than `limit` anywhere on its box [m]."""
        low, high = self.mesh.bounds
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        return bool(
            np.linalg.norm(transform_points(first, corners) - transform_points(second, corners), axis=1).max() < limit
        )

    def _candidates(self, other: NearShape, limit: float) -> Iterator[SE3]:
        axes, center, size = self._box
        other_axes, other_center, other_size = other._box
        for turn in BOX_ROTATIONS:
            if np.abs(np.abs(turn) @ size - other_size).max() < 2.0 * limit:
                rotation = other_axes.T @ turn @ axes
                yield SE3(rotation, other_center - rotation @ center)

    def _fitted(self, other: NearShape, motion: SE3) -> SE3:
        """Return the motion refined by iterated closest points, without the farthest ones."""
        for _ in range(_ROUNDS):
            moved = transform_points(motion, self.samples)
            there = _closest(other.mesh, moved)
            away = np.linalg.norm(there - moved, axis=1)
            kept = away <= max(float(np.quantile(away, _KEPT)), 1e-6)
            source, target = self.samples[kept].mean(axis=0), there[kept].mean(axis=0)
            rotation = Rotation.align_vectors(there[kept] - target, self.samples[kept] - source)[0].as_matrix()
            refined = SE3(rotation, target - rotation @ source)
            settled = self.is_same(motion, refined, 1e-6)
            motion = refined
            if settled:
                break
        return motion

    def _lies_on(self, other: NearShape, motion: SE3, limit: float) -> bool:
        """Return whether the surface points and corners of either shape lie on the other within the limit."""
        for shape, there, way in ((self, other, motion), (other, self, motion.inverse())):
            for points in (shape.samples, shape.mesh.vertices):
                if not all_within(there.mesh.bvh, transform_points(way, points), limit):
                    return False
        return True


_POINT = coal.Sphere(1e-9)


def _closest(mesh: Mesh, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the nearest point of a surface for each point [m]."""
    still, place = coal.Transform3s.Identity(), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    out = np.empty_like(points)
    for index, point in enumerate(points):
        place.setTranslation(point)
        result.clear()
        coal.distance(mesh.bvh, still, _POINT, place, request, result)
        out[index] = result.getNearestPoint1()
    return out
