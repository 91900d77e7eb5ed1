"""Geometry ready for batches of collision tests, kept for later scenes with the same shapes.

Setting a pool up takes a millisecond, moving its shapes a tenth of that.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

import coal
import numpy as np
import pinocchio as pin

from roboassembly.geometry.poses import SE3
from roboassembly.geometry.scene import Scene

GROUND = (200.0, 200.0, 1.0)
"""Dimensions of the box that models the ground [m]."""
WORLD_FROM_GROUND = SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * GROUND[2]]))
"""Pose of that box."""
Placements = tuple[SE3 | None, ...]
"""Placement of each shape in the frame of what carries it; None if it is not there."""
Pool = pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager
T = TypeVar("T")
_KEPT = 64
"""Number of pools of scenes that each thread keeps."""


class MovablePool:
    """Pool of shapes that can be placed elsewhere; tells hits, and no distances.

    Args:
        model: joints that carry shapes.
        geometry: shapes and the pairs that are tested.
        movable: shapes that can be placed.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, movable: Sequence[int]) -> None:
        self._pool = Pool(model, geometry, 1)
        for data in self._pool.getGeometryDatas():
            for request in data.collisionRequests:
                # Coal computes distances of meshes within 1 mm by default, and meshes are that near in every joint.
                request.break_distance = 0.0
        self._movable = movable
        self._placements: Placements | None = None

    def at(self, placements: Placements) -> Pool:
        """Return the pool with the movable shapes elsewhere."""
        if self._placements is not placements:
            for geometry in self._pool.getGeometryModels():
                shapes = geometry.geometryObjects
                for index, placement in zip(self._movable, placements, strict=True):
                    shape = shapes[index]
                    shape.disableCollision = placement is None
                    if placement is not None:
                        shape.placement = placement
            self._placements = placements
        return self._pool


class ScenePool:
    """Exact geometry of a scene.

    Each moving body has a free joint, in the scene's order: seven numbers `(x, y, z, qx, qy, qz, qw)`. Moving bodies
    are tested against still ones, the ground and each other.
    """

    def __init__(self, scene: Scene) -> None:
        self._placements = tuple(
            shape.body_from_mesh if body.moves else body.pose * shape.body_from_mesh
            for body in scene.bodies
            for shape in body.shapes
        )
        key = scene.ground, *((b.moves, *((s.mesh, s.convex) for s in b.shapes)) for b in scene.bodies)
        self._pool = kept(_THREAD.pools, key, lambda: _new_pool(scene), _KEPT)

    def ready(self) -> Pool:
        """Return the pool, with everything where the scene has it; to be used before any other scene's."""
        return self._pool.at(self._placements)


class _Thread(threading.local):
    def __init__(self) -> None:
        self.pools: dict[Hashable, MovablePool] = {}


_THREAD = _Thread()
"""Pools that each thread keeps."""


def kept(entries: dict[Hashable, T], key: Hashable, make: Callable[[], T], most: int) -> T:
    """Return the entry of a key, made if it is not there; the one not used for longest goes if there are too many.

    Args:
        entries: entries kept so far, the one used last at the end; changed here.
        key: key of the entry.
        make: makes the entry.
        most: largest number of entries.
    """
    found = entries.pop(key) if key in entries else make()
    entries[key] = found
    if len(entries) > most:
        del entries[next(iter(entries))]
    return found


def _new_pool(scene: Scene) -> MovablePool:
    model, geometry, nowhere = pin.Model(), pin.GeometryModel(), SE3.Identity()
    owners: list[list[int]] = []
    still: list[int] = []
    for b, body in enumerate(scene.bodies):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), nowhere, f"b{b}") if body.moves else 0
        own: list[int] = []
        for s, shape in enumerate(body.shapes):
            own.append(geometry.addGeometryObject(pin.GeometryObject(f"b{b}/{s}", joint, nowhere, shape.geometry)))
        (owners.append if body.moves else still.extend)(own)
    movable = list(range(len(geometry.geometryObjects)))
    if scene.ground:
        still.append(geometry.addGeometryObject(ground_object()))
    for index, own in enumerate(owners):
        others = [*still, *(g for other in owners[index + 1 :] for g in other)]
        for a in own:
            for b in others:
                geometry.addCollisionPair(pin.CollisionPair(a, b))
    return MovablePool(model, geometry, movable)


def ground_object() -> pin.GeometryObject:
    """Return the box that models the ground."""
    return pin.GeometryObject("ground", 0, WORLD_FROM_GROUND, coal.Box(*GROUND))
