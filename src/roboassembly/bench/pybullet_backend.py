"""Peer: Bullet through PyBullet, without a display (`DIRECT`).

Representation: still parts are Bullet's concave triangle meshes, which are exact. Bullet finds no contacts between two
concave meshes, so the moving body consists of convex pieces. One hull per part, the usual choice, fails for furniture:
at the mating pose the hull of a part with tenons is 4 to 22 mm deep in its mate, and Bullet's V-HACD leaves the same
depths, so no merge could be solved. The moving body is therefore a compound with one flat convex piece for every
triangle of its parts. This is exact and up to twice as slow as hulls. `pieces="hulls"` gives the hulls, to time them.
Collision margins are zero. A state is in collision if a contact is deeper than `DEPTH`.

Query: `performCollisionDetection` with `getContactPoints` keeps contacts from one state to the next and is wrong for
one state in a thousand if a body jumps, as in planning. `getClosestPoints` with every body is right and slow. This
backend calls Bullet's broad phase (`getOverlappingObjects`), then `getClosestPoints` with those bodies only, which is
right and as fast as the first.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

import numpy as np

from roboassembly.bench.bullet import Bullet
from roboassembly.bench.peers import IsFree, SE3State
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.scene import Body, Scene

DEPTH = 0.0
"""Depth from which a contact counts [m]. Exact pieces need no tolerance."""
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
        self._world = Bullet()
        self._ground: int = self._world.api.createCollisionShape(
            self._world.api.GEOM_BOX,
            halfExtents=[_GROUND_SIZE, _GROUND_SIZE, 0.5 * _GROUND_THICKNESS],
            physicsClientId=self._world.client,
        )
        self._bodies: list[int] = []
        self._mover = -1
        self._folder = tempfile.TemporaryDirectory(prefix="roboassembly-bench-")

    def set_up(self, scene: Scene) -> IsFree:
        """Replace the scene."""
        bullet, client = self._world.api, self._world.client
        self._clear()
        for body in scene.bodies:
            if body.moves:
                self._mover = self._add_mover(body)
                continue
            for shape in body.shapes:
                self._add(self._world.concave(shape.mesh), body.pose * shape.body_from_mesh)
        if scene.ground:
            self._add(self._ground, SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * _GROUND_THICKNESS])))
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
        """Return the depth of the moving body's deepest contact at `world_from_body` in the present scene [m]."""
        bullet, client = self._world.api, self._world.client
        mover, others = self._mover, [b for b in self._bodies if b != self._mover]
        self._world.put(mover, pose)
        distances = [
            contact[_DISTANCE]
            for other in others
            for contact in bullet.getClosestPoints(mover, other, 0.0, physicsClientId=client)
        ]
        return max(0.0, -min(distances, default=0.0))

    def close(self) -> None:
        """Disconnect, and remove the files of the pieces."""
        self._world.close()
        self._folder.cleanup()

    def _add(self, shape: int, pose: SE3, mass: float = 0.0) -> int:
        self._bodies.append(self._world.add(shape, pose, mass))
        return self._bodies[-1]

    def _clear(self) -> None:
        for body in self._bodies:
            self._world.api.removeBody(body, physicsClientId=self._world.client)
        self._bodies.clear()

    def _add_mover(self, body: Body) -> int:
        """Return one body of all pieces. Bullet reads several convex pieces only from a file, one per object in it."""
        path = Path(self._folder.name) / "moving.obj"
        path.write_text(_objects(body, self._pieces))
        # Bullet keeps what it has read by file name, which would hand out the last merge's body.
        self._world.api.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._world.client)
        shape = self._world.api.createCollisionShape(
            self._world.api.GEOM_MESH, fileName=str(path), physicsClientId=self._world.client
        )
        return self._add(shape, body.pose, 1.0)


def _objects(body: Body, pieces: Pieces) -> str:
    """Return the body's convex pieces as Wavefront text, in the body's frame."""
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
