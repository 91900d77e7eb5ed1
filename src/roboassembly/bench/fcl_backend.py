"""Peer: python-fcl, the binding of FCL (Pan, Chitta and Manocha 2012, "FCL: A General Purpose Library for Collision
and Proximity Queries"), with exact triangle meshes.

Still parts are `BVHModel`s in a `DynamicAABBTreeCollisionManager`, kept across merges and only placed anew; the moving
group's parts are `BVHModel`s with their vertices in the body's frame, so that one transform serves them all and no
pose is composed in Python. The ground is a box.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from roboassembly.bench.peers import IsFree, SE3State
from roboassembly.errors import MissingExtraError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import transform_points
from roboassembly.geometry.scene import Scene

_GROUND = (200.0, 200.0, 1.0)
"""Size of the box that stands for the ground, whose top is z = 0 [m]."""


class FclPeer:
    """FCL with exact meshes."""

    name = "fcl"
    description = (
        "python-fcl: exact triangle meshes (BVHModel); still parts and the ground in a DynamicAABBTreeCollisionManager"
    )

    def __init__(self) -> None:
        try:
            self._fcl: Any = importlib.import_module("fcl")
        except ImportError:
            raise MissingExtraError("python-fcl", "bench") from None
        self._models: dict[Mesh, Any] = {}

    def _model(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Any:
        model = self._fcl.BVHModel()
        model.beginModel(len(vertices), len(faces))
        model.addSubModel(vertices, faces)
        model.endModel()
        return model

    def set_up(self, scene: Scene) -> IsFree:
        """Replace the scene."""
        fcl = self._fcl
        moving: list[Any] = []
        still: list[Any] = []
        for body in scene.bodies:
            for shape in body.shapes:
                mesh = shape.mesh
                if body.moves:
                    points = transform_points(shape.body_from_mesh, mesh.vertices)
                    moving.append(fcl.CollisionObject(self._model(points, mesh.faces)))
                    continue
                if mesh not in self._models:
                    self._models[mesh] = self._model(mesh.vertices, mesh.faces)
                pose = body.pose * shape.body_from_mesh
                placed = fcl.Transform(pose.rotation, pose.translation)
                still.append(fcl.CollisionObject(self._models[mesh], placed))
        if scene.ground:
            below = fcl.Transform(np.array([0.0, 0.0, -0.5 * _GROUND[2]]))
            still.append(fcl.CollisionObject(fcl.Box(*_GROUND), below))
        manager = fcl.DynamicAABBTreeCollisionManager()
        manager.registerObjects(still)
        manager.setup()
        transform, callback, data_of = fcl.Transform, fcl.defaultCollisionCallback, fcl.CollisionData

        def is_free(state: SE3State) -> bool:
            q = state.rotation()
            # FCL takes a quaternion with w first.
            pose = transform([q.w, q.x, q.y, q.z], [state.getX(), state.getY(), state.getZ()])
            for part in moving:
                part.setTransform(pose)
                data = data_of()
                manager.collide(part, data, callback)
                if data.result.is_collision:
                    return False
            return True

        return is_free

    def close(self) -> None:
        """Drop the cached meshes."""
        self._models.clear()
