"""Scenes: rigid bodies and the ground, from which the planning model and the physics model are built."""

from __future__ import annotations

from dataclasses import dataclass

import coal

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True, eq=False)
class Shape:
    """Mesh fixed in a body."""

    mesh: Mesh
    body_from_mesh: SE3
    convex: bool = False
    """Whether the mesh is known to be convex, so that its inside counts as solid."""

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """Geometry for collision checks."""
        return self.mesh.convex if self.convex else self.mesh.bvh


@dataclass(frozen=True, eq=False)
class Body:
    """Rigid body of one or several shapes, moving or still."""

    name: str
    shapes: tuple[Shape, ...]
    pose: SE3
    """Pose `world_from_body`; the initial one of a moving body."""
    moves: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies above the ground, which is the plane z = 0 of the world."""

    bodies: tuple[Body, ...]
    ground: bool = True
