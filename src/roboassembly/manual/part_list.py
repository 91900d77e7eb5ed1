"""List of parts: equal parts together, with a letter, a number, sizes and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.manual.line_drawing import MILLIMETRES, Figure, Projection

_SIDES = 40
"""Number of sides of a hull that are tried."""


@dataclass(frozen=True, eq=False)
class PartKind:
    """Equal parts."""

    letter: str
    members: tuple[int, ...]
    """Indices of the parts; of fasteners, those after all parts."""
    mesh: Mesh
    name: str
    size: tuple[int, int, int]
    """Length, width and thickness of the smallest box around it [mm]."""
    axes: Float[np.ndarray, "3 3"]
    """Directions of length, width and thickness in the part's frame, one a row."""

    @property
    def camera(self) -> Projection:
        """Projection that shows the length, the width and some of the thickness."""
        length, width, thickness = self.axes
        return Projection.looking(-0.42 * length - 0.5 * width + 0.76 * thickness, width)


def letter_of(index: int) -> str:
    """Return A to Z, then AA, AB and so on."""
    letters = ""
    index += 1
    while index:
        index, rest = divmod(index - 1, len(ascii_uppercase))
        letters = ascii_uppercase[rest] + letters
    return letters


def part_kinds(furniture: Furniture) -> list[PartKind]:
    """Return the kinds of parts, the largest first, and then those of fasteners."""
    count = len(furniture.parts)
    meshes = [furniture.parts[shape.members[0]].mesh for shape in furniture.classes]
    parts = _sized([shape.members for shape in furniture.classes], meshes)
    classes = furniture.fastener_classes
    meshes = [furniture.fasteners[members[0]].mesh for members in classes]
    fasteners = _sized([tuple(count + index for index in members) for members in classes], meshes)
    names = [part.name for part in furniture.parts]
    names += [f"{fastener.kind} {fastener.name}" for fastener in furniture.fasteners]
    return [
        PartKind(letter_of(i), members, mesh, names[members[0]], size, axes)
        for i, (_, members, size, axes, mesh) in enumerate((*parts, *fasteners))
    ]


_Sized = tuple[float, tuple[int, ...], tuple[int, int, int], Float[np.ndarray, "3 3"], Mesh]
"""Negative volume of the box around a kind, its members, its sizes, axes and mesh."""


def _sized(groups: Sequence[tuple[int, ...]], meshes: Sequence[Mesh]) -> list[_Sized]:
    """Return kinds with the box around each, the largest first."""
    found: list[_Sized] = []
    for members, mesh in zip(groups, meshes, strict=True):
        axes, extents = box_around(mesh.hull_vertices, mesh.hull.face_normals, mesh.hull.area_faces)
        length, width, thickness = (max(1, round(MILLIMETRES * x)) for x in extents.tolist())
        found.append((-float(np.prod(extents)), members, (length, width, thickness), axes, mesh))
    return sorted(found, key=lambda item: (item[0], item[1]))


def box_around(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "f 3"], areas: Float[np.ndarray, "f"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return the smallest box around a convex body with one side along one of its faces.

    Args:
        points: corners of the body [m].
        normals: of its faces.
        areas: of its faces [m²]; only the largest of many sides are tried.

    Returns:
        Its axes, one a row, and its extents, both by falling extent [m].
    """
    best: tuple[float, Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]] | None = None
    keys, which = np.unique(np.abs(normals).round(2), axis=0, return_inverse=True)
    weights = np.bincount(which.reshape(-1), weights=areas, minlength=len(keys))
    for side in np.argsort(-weights, kind="stable")[:_SIDES].tolist():
        n = normals[int(np.flatnonzero(which.reshape(-1) == side)[0])]
        if np.linalg.norm(n) < 0.5:
            continue  # a sliver of the hull has no normal
        a = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
        a /= np.linalg.norm(a)
        b = np.cross(n, a)
        flat = points @ np.column_stack([a, b])
        corners = flat[ConvexHull(flat).vertices]
        edges = np.roll(corners, -1, axis=0) - corners
        angles = np.arctan2(edges[:, 1], edges[:, 0])
        along = flat @ np.array([np.cos(angles), np.sin(angles)])
        across = flat @ np.array([-np.sin(angles), np.cos(angles)])
        around = np.ptp(along, axis=0) * np.ptp(across, axis=0)
        k = int(np.argmin(around))
        height = float(np.ptp(points @ n))
        volume = float(around[k]) * height
        if best is None or volume < best[0] * 0.999:
            cosine, sine = np.cos(angles[k]), np.sin(angles[k])
            axes = np.array([cosine * a + sine * b, cosine * b - sine * a, n])
            best = (volume, axes, np.array([np.ptp(along[:, k]), np.ptp(across[:, k]), height]))
    if best is None:
        return np.eye(3), np.ptp(points, axis=0)
    order = np.argsort(-best[2], kind="stable")
    axes = best[1][order]
    axes[2] *= np.sign(np.linalg.det(axes))
    return axes, best[2][order]


def kind_figure(kind: PartKind) -> Figure:
    """Return one of the parts as a figure."""
    return Figure(kind.mesh, SE3.Identity(), kind.members[0])
