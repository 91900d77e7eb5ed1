"""Peer: Bullet through PyBullet, without a display (`DIRECT`).

How the bodies are represented. Still parts are Bullet's concave triangle meshes: exact. Between two concave meshes
Bullet finds no contacts at all, so that the moving body must be made of convex pieces. One hull per part, the usual
thing, does not do for furniture: at the mating pose the hull of a part with tenons stands 4 to 22 mm deep in the part
that it mates with, and Bullet's V-HACD leaves the same depths, so that no merge could ever be solved. The moving body
is therefore a compound with one flat convex piece for every triangle of its parts: exact too, and up to twice as slow
as hulls. `pieces="hulls"` gives the hulls, to time them. Collision margins are zero. A state counts as
in collision when a contact is deeper than `DEPTH`.

Which query. `performCollisionDetection` with `getContactPoints` keeps contacts from one state to the next, and answers
wrongly (one state in a thousand) where a body jumps, as in planning. `getClosestPoints` against every body is right
and slow. What is used: Bullet's own broad phase (`getOverlappingObjects`), then `getClosestPoints` against those bodies
only, which is right and as fast as the first.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from roboassembly.bench.peers import IsFree, SE3State
from roboassembly.errors import MissingExtraError
from roboassembly.meshes import Mesh
from roboassembly.poses import SE3, transform_points
from roboassembly.scene import Body, Scene

DEPTH = 0.0
"""Metres that a contact must be deep to count. Exact pieces need no tolerance."""
_DISTANCE = 8
"""Index of the signed distance in a contact that PyBullet reports."""
_GROUND_SIZE = 100.0
_GROUND_THICKNESS = 1.0

Pieces = Literal["triangles", "hulls"]


class PyBulletPeer:
    """Bullet, one instance of its world for all scenes."""

    name = "pybullet"
    description = (
        "PyBullet DIRECT: still parts as exact concave triangle meshes, moving parts as a compound of one flat convex "
        "piece per triangle (Bullet does not collide two concave meshes, and the hull of a moving part is in collision "
        "at every mating pose), margins 0; AABB query, then getClosestPoints; no tolerance in depth"
    )

    def __init__(self, pieces: Pieces = "triangles") -> None:
        self._pieces: Pieces = pieces
        with quiet():
            try:
                self._bullet: Any = importlib.import_module("pybullet")
            except ImportError:
                raise MissingExtraError("pybullet", "bench") from None
            self._client: int = self._bullet.connect(self._bullet.DIRECT)
        self._shapes: dict[Mesh, int] = {}
        self._ground: int = self._bullet.createCollisionShape(
            self._bullet.GEOM_BOX,
            halfExtents=[_GROUND_SIZE, _GROUND_SIZE, 0.5 * _GROUND_THICKNESS],
            physicsClientId=self._client,
        )
        self._bodies: list[int] = []
        self._mover = -1
        self._folder = tempfile.TemporaryDirectory(prefix="roboassembly-bench-")

    def set_up(self, scene: Scene) -> IsFree:
        """Build the scene in place of the one before."""
        bullet, client = self._bullet, self._client
        self._clear()
        for body in scene.bodies:
            if body.moves:
                self._mover = self._add_mover(body)
                continue
            for shape in body.shapes:
                numbers = pin.SE3ToXYZQUAT(body.pose * shape.body_from_mesh).tolist()
                self._add(0.0, self._concave(shape.mesh), numbers)
        if scene.ground:
            self._add(0.0, self._ground, [0.0, 0.0, -0.5 * _GROUND_THICKNESS, 0.0, 0.0, 0.0, 1.0])
        mover = self._mover
        place, box = bullet.resetBasePositionAndOrientation, bullet.getAABB
        overlapping, closest = bullet.getOverlappingObjects, bullet.getClosestPoints

        def is_free(state: SE3State) -> bool:
            q = state.rotation()
            place(mover, (state.getX(), state.getY(), state.getZ()), (q.x, q.y, q.z, q.w), physicsClientId=client)
            low, high = box(mover, physicsClientId=client)
            for other, _ in overlapping(low, high, physicsClientId=client) or ():
                if other == mover:
                    continue
                for contact in closest(mover, other, 0.0, physicsClientId=client):
                    if contact[_DISTANCE] < -DEPTH:
                        return False
            return True

        return is_free

    def depth(self, pose: SE3) -> float:
        """Deepest contact of the moving body at `world_from_body` in the scene set up last, metres."""
        bullet, client = self._bullet, self._client
        mover, others = self._mover, [b for b in self._bodies if b != self._mover]
        numbers = pin.SE3ToXYZQUAT(pose).tolist()
        bullet.resetBasePositionAndOrientation(mover, numbers[:3], numbers[3:], physicsClientId=client)
        distances = [
            contact[_DISTANCE]
            for other in others
            for contact in bullet.getClosestPoints(mover, other, 0.0, physicsClientId=client)
        ]
        return max(0.0, -min(distances, default=0.0))

    def close(self) -> None:
        """Disconnect, and remove the files through which pieces were handed over."""
        with quiet():
            self._bullet.disconnect(physicsClientId=self._client)
        self._folder.cleanup()

    def _add(self, mass: float, shape: int, numbers: list[float]) -> int:
        body = self._bullet.createMultiBody(mass, shape, -1, numbers[:3], numbers[3:], physicsClientId=self._client)
        self._bullet.changeDynamics(body, -1, collisionMargin=0.0, physicsClientId=self._client)
        self._bodies.append(body)
        return body

    def _clear(self) -> None:
        for body in self._bodies:
            self._bullet.removeBody(body, physicsClientId=self._client)
        self._bodies.clear()

    def _concave(self, mesh: Mesh) -> int:
        if mesh not in self._shapes:
            self._shapes[mesh] = self._bullet.createCollisionShape(
                self._bullet.GEOM_MESH,
                vertices=mesh.vertices.tolist(),
                indices=mesh.faces.ravel().tolist(),
                flags=self._bullet.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._client,
            )
        return self._shapes[mesh]

    def _add_mover(self, body: Body) -> int:
        """One body with all pieces. Bullet takes several convex pieces from a file only, one per object in it."""
        path = Path(self._folder.name) / "moving.obj"
        path.write_text(_objects(body, self._pieces))
        # Bullet keeps what it has read by file name, which would hand out the last merge's body.
        self._bullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._client)
        shape = self._bullet.createCollisionShape(
            self._bullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client
        )
        return self._add(1.0, shape, pin.SE3ToXYZQUAT(body.pose).tolist())


def _objects(body: Body, pieces: Pieces) -> str:
    """Wavefront text of the body's convex pieces, in the body's frame."""
    lines: list[str] = []
    start = 1
    for shape in body.shapes:
        mesh = shape.mesh
        if pieces == "hulls":
            sets = [(transform_points(shape.body_from_mesh, mesh.hull_vertices), mesh.hull.faces)]
        else:
            corners = transform_points(shape.body_from_mesh, mesh.vertices)[mesh.faces]
            sets = [(triangle, np.array([[0, 1, 2]])) for triangle in corners]
        for points, faces in sets:
            lines.append(f"o piece{start}")
            lines.extend(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points.tolist())
            lines.extend(f"f {a} {b} {c}" for a, b, c in (faces + start).tolist())
            start += len(points)
    return "\n".join(lines) + "\n"


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Send what native code prints to nowhere: Bullet announces itself past Python's own streams."""
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
