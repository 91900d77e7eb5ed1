"""Ways in which sub-assemblies leave each other, and whether they stand by themselves; cached for one piece."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import align_axis
from roboassembly.geometry.support import tipping_angle
from roboassembly.manual.merge_tree import Halves, Parts
from roboassembly.solvers.disassembly import Disassembly
from roboassembly.solvers.exits import ExitPlanner
from roboassembly.task.object_centric.stability import StandCheck
from roboassembly.task.rules.connections import UP_AXES, Rules
from roboassembly.task.rules.groups import center_of_mass, group_in_place, hull_points

LEAST_TIPPING = float(np.deg2rad(6.0))
"""Angle by which a sub-assembly must tilt before it falls over, if it is to count as standing [rad]."""
_LEAN = float(np.cos(np.deg2rad(20.0)))
"""Cosine of the largest angle by which a sub-assembly may lean while it counts as lying on one of its sides."""
_SOLE = 0.003
"""Height above the lowest point up to which a sub-assembly touches the ground [m]."""


class Handling:
    """Geometry of the sub-assemblies of one piece.

    Args:
        furniture: the piece.
        seed: seed of the planner.
    """

    def __init__(self, furniture: Furniture, seed: int) -> None:
        self.furniture = furniture
        self.disassembly = Disassembly(furniture, lambda: False)
        self.exits = ExitPlanner(Rules(furniture), self.disassembly.graphs, seed)
        self.stand_check = StandCheck(furniture)
        """Stability of sub-assemblies by physics."""
        self._tipping: dict[tuple[Parts, int], float] = {}
        self._surfaces: dict[Parts, float] = {}
        self._hull_sides: dict[Parts, Float[np.ndarray, "n 3"]] = {}
        self._points: dict[Parts, Float[np.ndarray, "n 3"]] = {}

    def touch(self, a: Parts, b: Parts) -> bool:
        """Whether two sub-assemblies have a connection."""
        return any(self.furniture.neighbours[p] & b for p in a)

    def directions(self, halves: Halves) -> Float[np.ndarray, "n 3"]:
        """Return the directions along which the moving half leaves the other one straight, furniture frame."""
        return self.disassembly.graphs.straight_exits(halves.moving, halves.waiting)

    def points(self, parts: Parts) -> Float[np.ndarray, "n 3"]:
        """Return the corners of the parts' hulls, furniture frame [m]."""
        if parts not in self._points:
            self._points[parts] = hull_points(self.furniture, group_in_place(self.furniture, parts))
        return self._points[parts]

    def lowest(self, parts: Parts, up: int) -> float:
        """Return the height of the lowest point of parts while an axis is up, furniture frame [m]."""
        return float(self.disassembly.graphs.lowest(parts)[up])

    def size(self, parts: Parts) -> float:
        """Return the surface of the convex hull of parts [m²]."""
        if parts not in self._surfaces:
            try:
                self._surfaces[parts] = float(ConvexHull(self.points(parts)).area)
            except QhullError:
                self._surfaces[parts] = 0.0
        return self._surfaces[parts]

    def mass(self, parts: Parts) -> float:
        """Return the mass of parts made of wood [kg]."""
        return WOOD_DENSITY * sum(self.furniture.parts[p].mesh.volume for p in sorted(parts))

    def tipping(self, parts: Parts, up: int) -> float:
        """Return the angle by which parts must tilt before they fall over; negative if they do not stand at all.

        Args:
            parts: a sub-assembly.
            up: index of the axis that points up, up to a lean of 20 degrees in which they may rest.
        """
        if (parts, up) not in self._tipping:
            sides = self._sides(parts)
            near = sides[sides @ UP_AXES[up] > _LEAN]
            self._tipping[parts, up] = max(self._angle(parts, axis) for axis in (UP_AXES[up], *near))
        return self._tipping[parts, up]

    def _sides(self, parts: Parts) -> Float[np.ndarray, "n 3"]:
        """Return the directions that point up when the parts lie on a side of their hull, furniture frame."""
        if parts not in self._hull_sides:
            try:
                sides = -ConvexHull(self.points(parts)).equations[:, :3]
            except QhullError:
                sides = np.zeros((0, 3))
            self._hull_sides[parts] = np.unique(sides.round(3), axis=0)
        return self._hull_sides[parts]

    def stands(self, parts: Parts, up: int) -> bool:
        """Whether parts stand by themselves with an axis up."""
        return self.tipping(parts, up) >= LEAST_TIPPING

    def _angle(self, parts: Parts, up: Float[np.ndarray, "3"]) -> float:
        turn = align_axis(up / np.linalg.norm(up), UP_AXES[0])
        center = turn @ center_of_mass(self.furniture, group_in_place(self.furniture, parts))
        angle = tipping_angle(self.points(parts) @ turn.T, center, _SOLE)
        return -1.0 if angle is None else angle  # it stands on an edge or a corner
