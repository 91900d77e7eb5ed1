"""Solids that furniture is cut from, as `manifold3d.Manifold`: closed and wound outward by construction.

Everything is in metres. A *section* is a convex outline in its own plane, counter-clockwise, `(n, 2)`; a solid is
a pile of sections along a path, capped at both ends. Holes are cut afterwards, by subtraction.
"""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
from jaxtyping import Float, Int

from roboassembly.geometry.poses import SE3

Solid = manifold3d.Manifold

X, Y, Z = np.eye(3)


def vector(x: float, y: float, z: float) -> Float[np.ndarray, "3"]:
    """Three numbers as an array."""
    return np.array([x, y, z], dtype=float)


def unit(direction: Sequence[float] | Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The direction at length one."""
    array = np.asarray(direction, dtype=float)
    return array / np.linalg.norm(array)


def turn(axis: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation by `angle` radians about the unit vector `axis` (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def placed(solid: Solid, pose: SE3) -> Solid:
    """The solid moved by `pose`."""
    return solid.transform(np.column_stack([pose.rotation, pose.translation]))


def mirrored_x(solid: Solid) -> Solid:
    """The mirror image across the plane x = 0."""
    return solid.mirror((1.0, 0.0, 0.0))


def rectangle(width: float, height: float, chamfer: float = 0.0) -> Float[np.ndarray, "n 2"]:
    """A rectangle about the origin with its corners cut off at 45 degrees; eight corners, or four without chamfer."""
    a, b, c = width / 2, height / 2, chamfer
    if c <= 0:
        return np.array([[-a, -b], [a, -b], [a, b], [-a, b]])
    return np.array(
        [[-a + c, -b], [a - c, -b], [a, -b + c], [a, b - c], [a - c, b], [-a + c, b], [-a, b - c], [-a, -b + c]]
    )


def circle(radius: float, sides: int = 12) -> Float[np.ndarray, "n 2"]:
    """A regular polygon of that many sides with its corners on the circle; the first corner on the first axis."""
    angle = 2 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def rounded_trapezoid(
    bottom: float, top: float, height: float, radius: float, steps: int = 3
) -> Float[np.ndarray, "n 2"]:
    """An isosceles trapezoid about the origin with rounded corners.

    `bottom` is its width at the second coordinate `-height / 2`, `top` at `+height / 2`.
    """
    corners = np.array(
        [[-bottom / 2, -height / 2], [bottom / 2, -height / 2], [top / 2, height / 2], [-top / 2, height / 2]]
    )
    points: list[np.ndarray] = []
    for k in range(4):
        here = corners[k]
        back, forth = corners[k - 1] - here, corners[(k + 1) % 4] - here
        back, forth = back / np.linalg.norm(back), forth / np.linalg.norm(forth)
        half = np.arccos(np.clip(back @ forth, -1, 1)) / 2
        centre = here + (back + forth) / np.linalg.norm(back + forth) * radius / np.sin(half)
        start = centre + (here + back * radius / np.tan(half) - centre)
        spread = np.pi - 2 * half
        for t in np.linspace(0.0, spread, steps + 1):
            c, s = np.cos(t), np.sin(t)
            points.append(centre + np.array([[c, -s], [s, c]]) @ (start - centre))
    return np.array(points)


def from_triangles(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Solid:
    """A closed triangle mesh as a solid; turned inside out first if it has negative volume."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        faces = faces[:, ::-1]
    # Copies: the library takes no arrays that must not be written to.
    mesh = manifold3d.Mesh64(
        np.array(vertices, dtype=np.float64, order="C"),
        np.array(faces, dtype=np.uint64, order="C"),
    )
    return Solid(mesh)


def triangles(solid: Solid) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and faces of a solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], dtype=float), np.array(mesh.tri_verts, dtype=np.int64)


def loft(rings: Float[np.ndarray, "k n 3"]) -> Solid:
    """Skin over a row of rings with equally many points each; the first and the last ring are plane and convex."""
    k, n, _ = rings.shape
    here = np.arange(n)
    there = (here + 1) % n
    faces: list[np.ndarray] = []
    for row in range(k - 1):
        low, high = row * n, (row + 1) * n
        faces.append(np.column_stack([low + here, low + there, high + there]))
        faces.append(np.column_stack([low + here, high + there, high + here]))
    fan = np.column_stack([np.zeros(n - 2, int), np.arange(1, n - 1), np.arange(2, n)])
    faces.append(fan[:, ::-1])
    faces.append((k - 1) * n + fan)
    return from_triangles(rings.reshape(-1, 3), np.concatenate(faces))


def sweep(
    path: Float[np.ndarray, "k 3"] | Sequence[Float[np.ndarray, "3"]],
    u: Float[np.ndarray, "3"],
    v: Float[np.ndarray, "3"],
    sections: Float[np.ndarray, "n 2"] | Sequence[Float[np.ndarray, "n 2"]],
) -> Solid:
    """Sections along a path, all parallel to the plane of `u` and `v`: one section for all, or one for each point."""
    points = np.asarray(path, dtype=float)
    outline = np.asarray(sections, dtype=float)
    outlines = np.broadcast_to(outline, (len(points), *outline.shape[-2:]))
    return loft(points[:, None, :] + outlines[..., :1] * u + outlines[..., 1:] * v)


def block(low: Sequence[float], high: Sequence[float]) -> Solid:
    """An axis-aligned box between two corners."""
    low_corner, high_corner = np.asarray(low, float), np.asarray(high, float)
    return Solid.cube(tuple(high_corner - low_corner)).translate(tuple(low_corner))


def turned(profile: Sequence[tuple[float, float]], sides: int = 12) -> Solid:
    """A body of revolution about z from `(z, radius)` pairs in rising z."""
    return sweep([vector(0, 0, z) for z, _ in profile], X, Y, [circle(r, sides) for _, r in profile])


def pad(
    outline: Float[np.ndarray, "n 2"], low: float, high: float, edge: float, crown: float = 0.0, under: float = 0.0
) -> Solid:
    """A horizontal slab between two heights with its upper edge eased by `edge` (and its lower one by `under`).

    `crown` raises the middle of the top above `high` (an upholstered seat), or, negative, hollows it (a saddled one).
    """
    rings: list[tuple[Float[np.ndarray, "n 2"], float]] = []
    if under > 0:
        rings.append((inset(outline, under), low))
    rings += [(outline, low + under), (outline, high - edge), (inset(outline, 0.3 * edge), high - 0.3 * edge)]
    rings.append((inset(outline, edge), high))
    if crown != 0.0:
        centre = outline.mean(axis=0)
        top = inset(outline, edge) - centre
        rings += [(centre + s * top, high + crown * (1 - s**3) / (1 - 0.3**3)) for s in (0.85, 0.6, 0.3)]
    return loft(np.array([np.column_stack([ring, np.full(len(ring), z)]) for ring, z in rings]))


def inset(outline: Float[np.ndarray, "n 2"], distance: float) -> Float[np.ndarray, "n 2"]:
    """The convex outline with every edge moved inward by `distance` (outward where it is negative)."""
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
    before = np.roll(normal, 1, axis=0)
    return outline + distance * (before + normal) / (1.0 + np.einsum("ij,ij->i", before, normal))[:, None]
