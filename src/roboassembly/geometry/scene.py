"""The one description of what is where, from which the planning model and the physics model are both built."""

from __future__ import annotations

from dataclasses import dataclass

import coal

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh fixed in a body."""

    mesh: Mesh
    body_from_mesh: SE3
    convex: bool = False
    """It is known to be convex, so its inside counts too."""

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """What collision checks take."""
        return self.mesh.convex if self.convex else self.mesh.bvh


@dataclass(frozen=True, eq=False)
class Body:
    """Shapes that move as one, or do not move at all."""

    name: str
    shapes: tuple[Shape, ...]
    pose: SE3
    """`world_from_body`; where it starts if it moves."""
    moves: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies above the ground, which is the plane z = 0 of the world."""

    bodies: tuple[Body, ...]
    ground: bool = True
