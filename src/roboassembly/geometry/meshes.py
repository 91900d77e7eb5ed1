"""Validated triangle meshes: finite, indexed, with area."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import coal
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from roboassembly.errors import FurnitureError
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.resting import stable_poses
from roboassembly.geometry.triangles import areas, longest_edges, scaled_normals, winding_number

if TYPE_CHECKING:
    import trimesh

MAX_FACES = 2_000_000
_GRAINS = (0.0, 1e-5, 1e-4)
"""Grids to which corners of a hull are rounded; the next one is used when no stable pose is found, since trimesh does
not close hulls with hundreds of nearly coplanar corners [m]."""
WOOD_DENSITY = 600.0
"""Density; beech and oak have 600 to 750, pine 500 [kg/m³]."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangle mesh in metres, compared and hashed by identity.

    Unused vertices are removed and the others rounded to 32-bit floats, so that a saved mesh loads back identical.

    Raises:
        FurnitureError: wrong shapes, non-finite vertices, face indices out of range, no faces, or no area.
    """

    vertices: Float[np.ndarray, "v 3"]
    """Vertices in the frame of the owner (for a part: at its centre of mass) [m]."""
    faces: Int[np.ndarray, "f 3"]
    """Vertex indices, counter-clockwise seen from outside."""

    def __post_init__(self) -> None:
        vertices = np.asarray(np.asarray(self.vertices, dtype=np.float32), dtype=np.float64)
        faces = np.array(self.faces, dtype=np.int64)
        if faces.size == 0:
            raise FurnitureError("mesh has no faces; a part needs at least four triangles")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise FurnitureError(
                f"mesh arrays have shapes {vertices.shape} and {faces.shape}; expected (v, 3) and (f, 3)"
            )
        if len(faces) > MAX_FACES:
            raise FurnitureError(f"mesh has {len(faces)} faces; at most {MAX_FACES} are accepted, simplify it first")
        bad = ~np.isfinite(vertices).all(axis=1)
        if bad.any():
            raise FurnitureError(f"mesh vertex {int(np.flatnonzero(bad)[0])} is not finite (NaN or infinity)")
        if faces.min() < 0 or faces.max() >= len(vertices):
            wrong = int(faces.min() if faces.min() < 0 else faces.max())
            raise FurnitureError(f"mesh face refers to vertex {wrong}, but there are {len(vertices)} vertices")
        used, renumbered = np.unique(faces, return_inverse=True)
        if len(used) < len(vertices):
            vertices, faces = vertices[used], renumbered.reshape(faces.shape)
        area = areas(vertices[faces]).sum()
        if not area > 1e-10:
            raise FurnitureError(f"mesh has zero area ({area:.3g} m²)")
        vertices.setflags(write=False)
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh) -> Mesh:
        """Copy the vertices and faces of a `trimesh.Trimesh`."""
        return cls(np.array(mesh.vertices), np.array(mesh.faces))

    @cached_property
    def trimesh(self) -> trimesh.Trimesh:
        """The same triangles as a `trimesh.Trimesh`, unprocessed; not to be changed."""
        import trimesh  # takes 0.3 s, which cached imports do not need

        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @cached_property
    def is_solid(self) -> bool:
        """Whether the mesh is closed, consistently wound and facing outward, so that volume integrals are valid."""
        return bool(self.trimesh.is_volume and self.trimesh.volume > 0)

    @cached_property
    def hull(self) -> trimesh.Trimesh:
        """Convex hull.

        Raises:
            FurnitureError: the mesh is flat, so that it has no hull with volume.
        """
        import trimesh

        try:
            hull = ConvexHull(self.vertices)
        except QhullError:
            raise FurnitureError("mesh is flat: it encloses no volume; give the part a thickness") from None
        normals = scaled_normals(self.vertices[hull.simplices])
        inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
        simplices = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
        used, faces = np.unique(simplices, return_inverse=True)
        return trimesh.Trimesh(self.vertices[used], faces.reshape(-1, 3), process=False)

    @cached_property
    def hull_vertices(self) -> Float[np.ndarray, "h 3"]:
        """Corners of the convex hull, which include the lowest point in any orientation."""
        return np.array(self.hull.vertices)

    @cached_property
    def _mass_source(self) -> trimesh.Trimesh:
        return self.trimesh if self.is_solid else self.hull

    @cached_property
    def volume(self) -> float:
        """Volume, of the convex hull if the mesh is not solid [m³]."""
        return float(self._mass_source.volume)

    @cached_property
    def center_of_mass(self) -> Float[np.ndarray, "3"]:
        """Centre of mass at uniform density, of the convex hull if the mesh is not solid [m]."""
        return np.array(self._mass_source.center_mass)

    @cached_property
    def inertia(self) -> Float[np.ndarray, "3 3"]:
        """Inertia about the centre of mass at unit density, of the convex hull if the mesh is not solid [m⁵]."""
        return np.array(self._mass_source.moment_inertia)

    @cached_property
    def long_axis(self) -> Float[np.ndarray, "3"]:
        """Unit vector about which the moment of inertia is smallest."""
        return np.linalg.eigh(self.inertia)[1][:, 0]

    @cached_property
    def thickness(self) -> float:
        """Distance between the two nearest parallel planes that enclose the mesh, one along a face of its hull [m]."""
        # Slivers of the hull have no normal.
        normals = self.hull.face_normals[np.linalg.norm(self.hull.face_normals, axis=1) > 0.5]
        heights = self.hull_vertices @ normals.T
        return float((heights.max(axis=0) - heights.min(axis=0)).min())

    @cached_property
    def resting_rotations(self) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n"]]:
        """Orientations in which the mesh rests on the ground, and their probabilities after a random drop.

        Quasi-static tumbling of the convex hull (`resting.stable_poses`).
        """
        import trimesh

        for grain in _GRAINS:
            hull = trimesh.Trimesh(np.round(self.hull_vertices / grain) * grain).convex_hull if grain else self.hull
            # Slivers of a hull make it divide by zero; their poses come out as NaN and are dropped here.
            with np.errstate(invalid="ignore", divide="ignore"):
                found, likely = stable_poses(hull.convex_hull, self.center_of_mass)
            usable = np.isfinite(found).all(axis=(1, 2)) & np.isfinite(likely) & (likely > 0)
            if usable.any():
                # They are orthonormal to about 1e-6 only, as the normals of the hull are.
                rotations = Rotation.from_matrix(found[usable]).as_matrix()
                return rotations, likely[usable] / likely[usable].sum()
        return np.eye(3)[None], np.ones(1)

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Axis-aligned bounding box: lowest and highest corner [m]."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def radius(self) -> float:
        """Distance of the farthest vertex from the origin of the mesh's frame [m]."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @cached_property
    def content_hash(self) -> str:
        """Hash of vertices and faces, for caches and manifests."""
        digest = hashlib.sha256(self.vertices.astype("<f4").tobytes())
        digest.update(self.faces.astype("<i4").tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def bvh(self) -> coal.BVHModelOBBRSS:
        """Bounding-volume hierarchy of the exact triangles: a surface without an inside."""
        return hierarchy(self.vertices, self.faces[have_area(self.vertices, self.faces)])

    @cached_property
    def convex(self) -> coal.ConvexBase:
        """Convex hull as a solid."""
        model = Mesh.from_trimesh(self.hull).bvh
        model.buildConvexHull(True, "Qt")
        return model.convex

    def contains(self, point: Float[np.ndarray, "3"]) -> bool:
        """Return whether a point of the mesh's frame, not on the surface, lies inside.

        The criterion is the solid angle of the surface as seen from the point (Van Oosterom and Strackee 1983); an
        open surface counts as closed where it fills more than half.
        """
        if (point < self.bounds[0]).any() or (point > self.bounds[1]).any():
            return False
        return abs(winding_number(self.vertices[self.faces] - point)) > 0.5

    def transformed(self, pose: SE3) -> Mesh:
        """Return the mesh with every vertex moved by `pose`."""
        return Mesh(transform_points(pose, self.vertices), self.faces)

    def stretched(self, matrix: Float[np.ndarray, "3 3"]) -> Mesh:
        """Return the mesh with every vertex multiplied by a matrix of positive determinant."""
        return Mesh(self.vertices @ matrix.T, self.faces)


@dataclass(frozen=True, eq=False)
class Witness:
    """Nearest points of two meshes."""

    distance: float
    """Distance; 0 when they touch or penetrate [m]."""
    point_a: Float[np.ndarray, "3"]
    point_b: Float[np.ndarray, "3"]


_POINT = coal.Sphere(1e-9)
_LINE = 1e-9
"""Ratio of height to longest edge below which a triangle counts as a line."""


def have_area(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, "f"]:
    """Return which triangles have area; cuts and rounding leave some degenerate ones between longer neighbours."""
    triangles = vertices[faces]
    return np.linalg.norm(scaled_normals(triangles), axis=1) > _LINE * longest_edges(triangles) ** 2


def hierarchy(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> coal.BVHModelOBBRSS:
    """Return triangles as a bounding-volume hierarchy."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(vertices)
    model.addTriangles(faces)
    model.endModel()
    return model


def distance_to(model: coal.BVHModelOBBRSS, point: Float[np.ndarray, "3"]) -> float:
    """Return the unsigned distance from a point to the nearest triangle [m].

    All triangles must have area: coal 3.0.3 reports a triangle without area as touching every sphere.
    """
    return float(distances_to(model, np.asarray(point)[None])[0])


def distances_to(model: coal.BVHModelOBBRSS, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Return the unsigned distance from each point to the nearest triangle, as `distance_to` does [m]."""
    return np.fromiter(_distances(model, points), dtype=float, count=len(points))


def all_within(model: coal.BVHModelOBBRSS, points: Float[np.ndarray, "n 3"], limit: float) -> bool:
    """Return whether no point is farther than `limit` from the nearest triangle, as `distance_to` measures it [m]."""
    return all(distance <= limit for distance in _distances(model, points))


def _distances(model: coal.BVHModelOBBRSS, points: Float[np.ndarray, "n 3"]) -> Iterator[float]:
    still, place = coal.Transform3s.Identity(), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for point in np.asarray(points, dtype=float):
        place.setTranslation(point)
        result.clear()
        yield abs(coal.distance(model, still, _POINT, place, request, result))


def collision_request() -> coal.CollisionRequest:
    """Return a request that only asks whether two shapes touch; by default Coal also measures nearby ones."""
    request = coal.CollisionRequest()
    request.break_distance = 0.0
    return request


def nearest_points(a: Mesh, b: Mesh) -> Witness:
    """Return the exact distance between two surfaces in one frame, and the points that attain it."""
    here = coal.Transform3s.Identity()
    request, hit = collision_request(), coal.CollisionResult()
    if coal.collide(a.bvh, here, b.bvh, here, request, hit):
        point = np.array(hit.getContact(0).pos) if hit.numContacts() else np.array(a.center_of_mass)
        return Witness(0.0, point, point)
    result = coal.DistanceResult()
    distance = coal.distance(a.bvh, here, b.bvh, here, coal.DistanceRequest(), result)
    return Witness(float(distance), np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2()))
