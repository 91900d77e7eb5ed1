"""Solids that furniture is cut from, as `manifold3d.Manifold`: closed and wound outward by construction.

Everything is in metres. A *section* is a convex outline in its own plane; a solid is a pile of sections along a path,
capped at both ends. Holes are cut afterwards, by subtraction.
"""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from roboassembly.generate.outlines import Outline, circle, inset, rectangles
from roboassembly.generate.vectors import Points, Vector, X, Y, unit, vector
from roboassembly.geometry.poses import SE3
from roboassembly.geometry.triangles import triple_products

Solid = manifold3d.Manifold


def placed(solid: Solid, pose: SE3) -> Solid:
    """Return the solid moved by `pose`."""
    return solid.transform(np.column_stack([pose.rotation, pose.translation]))


def mirrored_x(solid: Solid) -> Solid:
    """Return the mirror image across the plane x = 0."""
    return solid.mirror((1.0, 0.0, 0.0))


def from_triangles(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Solid:
    """Return a closed triangle mesh as a solid; one of negative volume is turned inside out."""
    if triple_products(vertices[faces]).sum() < 0:
        faces = faces[:, ::-1]
    # Copies: the library takes no arrays that must not be written to.
    return Solid(manifold3d.Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C")))


def triangles(solid: Solid) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Return vertices and faces of a solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], dtype=float), np.array(mesh.tri_verts, dtype=np.int64)


def loft(rings: Float[np.ndarray, "k n 3"]) -> Solid:
    """Return the skin over a row of rings with equally many points; the first and the last are plane and convex."""
    k, n = len(rings), int(rings.shape[1])
    here = np.arange(n)
    there = (here + 1) % n
    faces: list[Int[np.ndarray, "f 3"]] = []
    for row in range(k - 1):
        low, high = row * n, (row + 1) * n
        faces.append(np.column_stack([low + here, low + there, high + there]))
        faces.append(np.column_stack([low + here, high + there, high + here]))
    fan = np.column_stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)])
    faces += [fan[:, ::-1], (k - 1) * n + fan]
    return from_triangles(rings.reshape(-1, 3), np.concatenate(faces))


def polyline(origin: Vector, *offsets: tuple[Float[np.ndarray, "k"], Vector]) -> Points:
    """Return points that leave the origin by amounts along directions: `polyline(at, (x, X), (rise, up))`."""
    points = origin
    for amount, direction in offsets:
        points = points + amount[:, None] * direction
    return points


def sweep(
    path: Points | Sequence[Vector], u: Vector, v: Vector, sections: Float[np.ndarray, "*k n 2"] | Sequence[Outline]
) -> Solid:
    """Return sections along a path, all parallel to the plane of `u` and `v`: one for all, or one for each point."""
    points = np.asarray(path, dtype=float)
    outline = np.asarray(sections, dtype=float)
    outlines = np.broadcast_to(outline, (len(points), *outline.shape[-2:]))
    return loft(points[:, None, :] + outlines[..., :1] * u + outlines[..., 1:] * v)


def bar(
    x: ArrayLike, y: ArrayLike, z: ArrayLike, u: Vector, v: Vector, wide: ArrayLike, high: ArrayLike, chamfer: ArrayLike
) -> Solid:
    """Return a bar of rectangular sections, `wide` along `u` and `high` along `v`, through points.

    Single numbers stand for all sections.
    """
    return sweep(np.stack(np.broadcast_arrays(x, y, z), axis=-1), u, v, rectangles(wide, high, chamfer))


def block(low: Sequence[float] | Vector, high: Sequence[float] | Vector) -> Solid:
    """Return an axis-aligned box between two corners."""
    low_corner, high_corner = np.asarray(low, float), np.asarray(high, float)
    return Solid.cube(tuple(high_corner - low_corner)).translate(tuple(low_corner))


def column(stations: Sequence[tuple[float, float, float]], chamfer: float) -> Solid:
    """Return a bar about the z axis from `(z, width along x, width along y)` in rising z."""
    z, wide, deep = np.array(stations, dtype=float).T
    return bar(0.0, 0.0, z, X, Y, wide, deep, chamfer)


def turned(profile: Sequence[tuple[float, float]], sides: int = 12) -> Solid:
    """Return a body of revolution about z from `(z, radius)` pairs in rising z."""
    return sweep([vector(0, 0, z) for z, _ in profile], X, Y, [circle(r, sides) for _, r in profile])


def turned_along(start: Vector, run: Vector, up: Vector, profile: Sequence[tuple[float, float]], sides: int) -> Solid:
    """Return a body of revolution about a line, from `(distance from its start, radius)` pairs; `up` clocks it."""
    path = [start + distance * run for distance, _ in profile]
    return sweep(path, up, np.cross(run, up), [circle(radius, sides) for _, radius in profile])


def pad(outline: Outline, low: float, high: float, edge: float, crown: float = 0.0, under: float = 0.0) -> Solid:
    """Return a level slab between two heights with its upper edge eased by `edge` (and its lower one by `under`).

    `crown` raises the middle of the top above `high` (an upholstered seat), or, negative, hollows it (a saddled one).
    """
    rings: list[tuple[Outline, float]] = []
    if under > 0:
        rings.append((inset(outline, under), low))
    rings += [(outline, low + under), (outline, high - edge), (inset(outline, 0.3 * edge), high - 0.3 * edge)]
    rings.append((inset(outline, edge), high))
    if crown != 0.0:
        centre = outline.mean(axis=0)
        top = inset(outline, edge) - centre
        rings += [(centre + s * top, high + crown * (1 - s**3) / (1 - 0.3**3)) for s in (0.85, 0.6, 0.3)]
    return loft(np.array([np.column_stack([ring, np.full(len(ring), z)]) for ring, z in rings]))


def bent(corners: Sequence[Vector], radius: float, steps: int = 5) -> tuple[Points, Points]:
    """Return a line from corner to corner, its inner corners rounded to `radius` metres: points and unit tangents."""
    points, tangents = [corners[0]], [unit(corners[1] - corners[0])]
    for before, here, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        come, go = unit(here - before), unit(after - here)
        angle = float(np.arccos(np.clip(come @ go, -1, 1)))
        start = here - radius * np.tan(angle / 2) * come
        inward = unit(go - (go @ come) * come)
        for t in np.linspace(0.0, angle, steps + 1):
            points.append(start + radius * (np.sin(t) * come + (1 - np.cos(t)) * inward))
            tangents.append(np.cos(t) * come + np.sin(t) * inward)
    return np.array([*points, corners[-1]]), np.array([*tangents, unit(corners[-1] - corners[-2])])


def ribbon(
    points: Points | Sequence[Vector],
    tangents: Points | Sequence[Vector],
    side: Vector,
    sections: Float[np.ndarray, "*k n 2"],
) -> Solid:
    """Return sections square to a line in the plane square to `side`; their first coordinate is along `side`."""
    outlines = np.broadcast_to(sections, (len(points), *sections.shape[-2:]))
    rings = [
        at + section[:, :1] * side + section[:, 1:] * np.cross(tangent, side)
        for at, tangent, section in zip(points, tangents, outlines, strict=True)
    ]
    return loft(np.array(rings))


def cut_out(
    outline: Outline, origin: Vector, u: Vector, v: Vector, thickness: float, holes: Sequence[Outline] = ()
) -> Solid:
    """Return a board of any outline in the plane of unit vectors `u` and `v`, its middle plane through `origin`.

    The outline and its holes are in metres along `u` and `v` from `origin`.
    """
    section = manifold3d.CrossSection([np.asarray(outline, dtype=float)])
    for hole in holes:
        section = section - manifold3d.CrossSection([np.asarray(hole, dtype=float)])
    normal = np.cross(u, v)
    return section.extrude(thickness).transform(np.column_stack([u, v, normal, origin - thickness / 2 * normal]))
