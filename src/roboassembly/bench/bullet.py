"""Bullet world through PyBullet, without a display (`DIRECT`); both Bullet peers use it."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
from collections.abc import Generator
from typing import Any

import pinocchio as pin

from roboassembly.errors import MissingExtraError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3


class Bullet:
    """Bullet world with cached shapes; collision margins are zero.

    Raises:
        MissingExtraError: PyBullet is not installed.
    """

    def __init__(self) -> None:
        with quiet():
            try:
                self.api: Any = importlib.import_module("pybullet")
            except ImportError:
                raise MissingExtraError("pybullet", "bench") from None
            self.client: int = self.api.connect(self.api.DIRECT)
        self._shapes: dict[tuple[Mesh, bool], int] = {}

    def concave(self, mesh: Mesh) -> int:
        """Return an exact triangle mesh, for static bodies. Bullet finds no contacts between two of these."""
        return self._mesh(mesh, concave=True)

    def hull(self, mesh: Mesh) -> int:
        """Return the convex hull of a mesh."""
        return self._mesh(mesh, concave=False)

    def _mesh(self, mesh: Mesh, *, concave: bool) -> int:
        if (mesh, concave) not in self._shapes:
            options: dict[str, Any] = {"vertices": mesh.vertices.tolist(), "physicsClientId": self.client}
            if concave:
                options |= {"indices": mesh.faces.ravel().tolist(), "flags": self.api.GEOM_FORCE_CONCAVE_TRIMESH}
            self._shapes[mesh, concave] = self.api.createCollisionShape(self.api.GEOM_MESH, **options)
        return self._shapes[mesh, concave]

    def add(self, shape: int, pose: SE3, mass: float = 0.0) -> int:
        """Add a body at `world_from_shape`; returns its index."""
        position, orientation = numbers(pose)
        body = self.api.createMultiBody(mass, shape, -1, position, orientation, physicsClientId=self.client)
        self.api.changeDynamics(body, -1, collisionMargin=0.0, physicsClientId=self.client)
        return body

    def put(self, body: int, pose: SE3) -> None:
        """Move a body to `world_from_body`."""
        self.api.resetBasePositionAndOrientation(body, *numbers(pose), physicsClientId=self.client)

    def empty(self) -> None:
        """Remove all bodies and shapes."""
        self.api.resetSimulation(physicsClientId=self.client)
        self._shapes.clear()

    def close(self) -> None:
        """Disconnect."""
        with quiet():
            self.api.disconnect(physicsClientId=self.client)


def numbers(pose: SE3) -> tuple[list[float], list[float]]:
    """Return position and quaternion `(x, y, z, w)` of a pose."""
    seven = pin.SE3ToXYZQUAT(pose).tolist()
    return seven[:3], seven[3:]


@contextlib.contextmanager
def quiet() -> Generator[None]:
    """Discard the output of native code: Bullet does not print through Python's streams."""
    library = ctypes.CDLL("msvcrt" if os.name == "nt" else None)
    sys.stdout.flush()
    sys.stderr.flush()
    library.fflush(None)
    kept, nowhere = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
        library.fflush(None)
    finally:
        for stream, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)
