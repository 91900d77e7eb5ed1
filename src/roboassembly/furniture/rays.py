"""Ray casting against one mesh: the first triangle hit and its distance."""

from __future__ import annotations

from functools import cache

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float

from roboassembly.geometry.meshes import Mesh

_SIZE = 100.0
"""Size to which meshes are scaled, at which Embree's single precision works best."""


@cache
def _device() -> EmbreeDevice:
    """Return the device for all meshes: one per scene (as in trimesh) can crash after some hundreds of scenes."""
    return EmbreeDevice()


class Rays:
    """Mesh prepared for ray casting."""

    def __init__(self, mesh: Mesh) -> None:
        self._corners = mesh.vertices[mesh.faces]
        self._normals = mesh.trimesh.face_normals
        self._origin = mesh.bounds[0]
        self._scale = _SIZE / float(np.ptp(mesh.bounds, axis=0).max())
        self._scene = EmbreeScene(_device())
        # The scene refers to these triangles, which have to live as long as it does.
        self._triangles = TriangleMesh(self._scene, self._to_scene(self._corners))

    def _to_scene(self, points: Float[np.ndarray, "*n 3"]) -> np.ndarray:
        return ((points - self._origin) * self._scale).astype(np.float32)

    def first_hits(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
        """Return the distance along each ray to the surface and the outward normal there; infinity and 0 without a hit.

        Args:
            origins: in the mesh's frame [m].
            directions: unit vectors.
        """
        reach, normals = np.full(len(origins), np.inf), np.zeros((len(origins), 3))
        if not len(origins):
            return reach, normals
        first = self._scene.run(self._to_scene(origins), directions.astype(np.float32))
        hit = np.flatnonzero(first >= 0)
        normals[hit] = self._normals[first[hit]]
        # Distances are recomputed in double precision, to the plane of the face.
        ahead = np.einsum("ij,ij->i", normals[hit], directions[hit])
        hit, ahead = hit[np.abs(ahead) > 1e-6], ahead[np.abs(ahead) > 1e-6]
        corner = self._corners[first[hit], 0]
        reach[hit] = np.einsum("ij,ij->i", normals[hit], corner - origins[hit]) / ahead
        return reach, normals
