"""Triangles as files have them, and their conversion to parts at their places: z up, metres, on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import RawPart, check_part_count
from roboassembly.geometry.meshes import MAX_FACES, Mesh
from roboassembly.geometry.triangles import scaled_normals

MAX_COORDINATE = 1e9
"""Largest coordinate, in a file's own units."""
SMALLEST, LARGEST = 0.02, 10.0
"""Bounds of the longest side of a piece of furniture [m]."""
TYPICAL_SIZE = {
    "bench": (0.80, 1.60),
    "chair": (0.85, 1.20),
    "desk": (0.74, 1.50),
    "misc": (0.75, 1.20),
    "shelf": (1.50, 1.90),
    "table": (0.70, 1.50),
}
"""Height and longest side by category [m]. Normalised files have no unit: a piece gets the largest scale that exceeds
neither, so that a tall chair is 0.85 m high and a long bench does not grow to 2 m."""
DEFAULT_SIZE = (0.85, 1.20)

Up = Literal["x", "y", "z", "-x", "-y", "-z"]
UP_ROTATIONS: dict[str, Float[np.ndarray, "3 3"]] = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
"""Rotation that turns a file's up axis to z."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Surface in a file's own frame and units.

    Raises:
        FurnitureError: no faces, too many, no area, indices out of range, coordinates that are not finite or
            beyond `MAX_COORDINATE`.
    """

    points: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=float).reshape(-1, 3)
        faces = np.asarray(self.faces, dtype=np.int64).reshape(-1, 3)
        if not len(faces):
            raise FurnitureError("has no faces; a part needs at least four triangles")
        if len(faces) > MAX_FACES:
            raise FurnitureError(f"has {len(faces)} faces; at most {MAX_FACES} are accepted, simplify it first")
        bad = ~np.isfinite(points).all(axis=1)
        if bad.any():
            raise FurnitureError(f"mesh vertex {int(np.flatnonzero(bad)[0])} is not finite (NaN or infinity)")
        if np.abs(points).max(initial=0.0) > MAX_COORDINATE:
            raise FurnitureError(f"has a coordinate beyond {MAX_COORDINATE:g}; no furniture is that large in any unit")
        if faces.min() < 0 or faces.max() >= len(points):
            wrong = int(faces.min() if faces.min() < 0 else faces.max())
            raise FurnitureError(f"mesh face refers to vertex {wrong}, but there are {len(points)} vertices")
        if not scaled_normals(points[faces]).any():
            raise FurnitureError("mesh has zero area: all its triangles are degenerate")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "faces", faces)

    def merged(self) -> Triangles:
        """Return the triangles with coincident vertices merged and unused vertices removed."""
        used, corners = np.unique(self.faces, return_inverse=True)
        unique, inverse = np.unique(self.points[used], axis=0, return_inverse=True)
        return Triangles(unique, inverse.reshape(-1)[corners].reshape(-1, 3))

    def moved(self, matrix: Float[np.ndarray, "4 4"]) -> Triangles:
        """Return the triangles under an affine map; mirroring reverses the faces, so that outside stays outside."""
        linear = matrix[:3, :3]
        faces = self.faces[:, ::-1] if np.linalg.det(linear) < 0 else self.faces
        return Triangles(self.points @ linear.T + matrix[:3, 3], faces)


@dataclass(frozen=True, eq=False)
class NamedTriangles:
    """Part before it is scaled and turned upright."""

    name: str
    triangles: Triangles
    label: str = ""


def combine(pieces: Sequence[Triangles]) -> Triangles:
    """Return several surfaces as one, with coincident vertices merged.

    Raises:
        FurnitureError: more than `MAX_FACES` faces together, or none.
    """
    total = sum(len(piece.faces) for piece in pieces)
    if total > MAX_FACES:
        raise FurnitureError(f"has {total} faces; at most {MAX_FACES} are accepted, simplify it first")
    if not pieces:
        raise FurnitureError("has no faces; a part needs at least four triangles")
    offsets = np.cumsum([0, *(len(piece.points) for piece in pieces[:-1])])
    return Triangles(
        np.concatenate([piece.points for piece in pieces]),
        np.concatenate([piece.faces + offset for piece, offset in zip(pieces, offsets, strict=True)]),
    ).merged()


def unique_names(names: Sequence[str]) -> list[str]:
    """Return the names with repetitions numbered: `leg`, `leg_2`, `leg_3`."""
    out: list[str] = []
    originals = set(names)
    seen: set[str] = set()
    for name in names:
        fresh, number = name, 1
        while fresh in seen or (number > 1 and fresh in originals):
            number += 1
            fresh = f"{name}_{number}"
        seen.add(fresh)
        out.append(fresh)
    return out


def check_scale(scale: float | None) -> None:
    """Raise `FurnitureError` unless `scale` is None or a positive finite number."""
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise FurnitureError(
            f"scale {scale!r} is not a positive number of metres per unit; leave it out for a typical size"
        )


def bounds(parts: Sequence[NamedTriangles], rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and highest corner of all parts together, after `rotation`, in the files' units."""
    corners = [part.triangles.points @ rotation.T for part in parts]
    return np.array([np.min([c.min(axis=0) for c in corners], 0), np.max([c.max(axis=0) for c in corners], 0)])


def typical_scale(category: str, height: float, longest: float) -> float:
    """Return the scale [m per unit] that gives a piece of this height and longest side (file units) a typical size."""
    tall, long = TYPICAL_SIZE.get(category.lower(), DEFAULT_SIZE)
    return min(tall / max(height, 1e-12), long / max(longest, 1e-12))


def stand(
    parts: Sequence[NamedTriangles], rotation: Float[np.ndarray, "3 3"], scale: float, where: str
) -> tuple[RawPart, ...]:
    """Return parts turned by `rotation` to z up, scaled to metres, lowest point at z = 0, centred on the z axis.

    Raises:
        FurnitureError: fewer than 2 parts or more than 1000, an absurd size, a part without area.
    """
    check_part_count(len(parts), where)
    check_scale(scale)
    low, high = bounds(parts, rotation)
    longest = float((high - low).max()) * scale
    if not SMALLEST <= longest <= LARGEST:
        raise FurnitureError(
            f"{where}: would be {longest:.3g} m long at {scale:.3g} metres per unit; furniture has {SMALLEST} to "
            f"{LARGEST:g} m; name the unit of the files (--unit or --scale)"
        )
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    out: list[RawPart] = []
    for part in parts:
        vertices = (part.triangles.points @ rotation.T - middle) * scale
        try:
            mesh = Mesh(vertices, part.triangles.faces)
        except FurnitureError as problem:
            raise FurnitureError(f"{where}: part '{part.name}': {problem}") from None
        out.append(RawPart(part.name, mesh, part.label))
    return tuple(out)
