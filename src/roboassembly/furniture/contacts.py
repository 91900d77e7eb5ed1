"""Contacts of parts in assembled furniture: the patches over which their surfaces face each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import CONTACT_DISTANCE
from roboassembly.geometry.meshes import Mesh, Witness, nearest_points
from roboassembly.geometry.triangles import scaled_normals

PATCH_DEPTH = 0.001
"""Distance beyond the smallest one that still belongs to a patch, as the clearances of one joint differ [m]."""
_OPPOSED = -0.7
"""Cosine between normals below which faces count as opposed: within 45° of opposite."""
_WALL = 0.3
"""Cosine with the mean normal below which a face is a wall of the joint: less than 17° off."""
_WALL_SHARE = 0.02
"""Share of the area, weighted by the squared cosine, above which walls bar a direction."""
_LEAST_ALONG = 0.9
"""Least cosine between the mean normal and the direction along all walls."""
_CHUNK = 2_000_000


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact patch of parts `a` and `b`, in the furniture's frame."""

    a: int
    b: int
    center: Float[np.ndarray, "3"]
    """Area centroid of the patch, midway between the two surfaces [m]."""
    normal: Float[np.ndarray, "3"]
    """Unit vector out of `a` into `b`."""
    gap: float
    """Distance between the surfaces along the normal [m]."""
    area: float
    """Area of opposed faces; 0 where the parts meet at an edge or a corner [m²]."""


def find_contacts(meshes: Sequence[Mesh], names: Sequence[str]) -> tuple[Contact, ...]:
    """Return the contacts of all pairs nearer than `CONTACT_DISTANCE`; meshes are in the furniture's frame.

    Raises:
        FurnitureError: two parts touch or penetrate. Repair them first.
    """
    out: list[Contact] = []
    for a in range(len(meshes)):
        for b in range(a + 1, len(meshes)):
            low = np.maximum(meshes[a].bounds[0], meshes[b].bounds[0])
            high = np.minimum(meshes[a].bounds[1], meshes[b].bounds[1])
            if (low - high > CONTACT_DISTANCE).any():
                continue
            witness = nearest_points(meshes[a], meshes[b])
            if witness.distance > 0.0:
                _refuse_nested(a, b, meshes, names)
            if witness.distance >= CONTACT_DISTANCE:
                continue
            if witness.distance <= 0.0:
                raise FurnitureError(
                    f"parts '{names[a]}' and '{names[b]}' touch or penetrate in the assembled pose near "
                    f"{np.round(witness.point_a, 4).tolist()} m; leave a gap of 0.1 mm or more, or import with repair",
                    (names[a], names[b]),
                )
            out.append(_contact(a, b, meshes[a], meshes[b], witness))
    return tuple(out)


def _refuse_nested(a: int, b: int, meshes: Sequence[Mesh], names: Sequence[str]) -> None:
    """Raise an error if one part lies inside the other's solid, so that their surfaces do not meet."""
    for inner, outer in ((a, b), (b, a)):
        if meshes[outer].contains(meshes[inner].vertices[0]):
            raise FurnitureError(
                f"part '{names[inner]}' lies inside part '{names[outer]}'; take it out or hollow the other",
                (names[inner], names[outer]),
            )


def _contact(a: int, b: int, mesh_a: Mesh, mesh_b: Mesh, witness: Witness) -> Contact:
    reach = min(CONTACT_DISTANCE, witness.distance + PATCH_DEPTH)
    pieces = _facing_pieces_both_ways(mesh_a, mesh_b, reach)
    if pieces is not None:
        area, center, normal, height = pieces
        total = area.sum()
        mean = (area[:, None] * normal).sum(axis=0) / total
        strength = float(np.linalg.norm(mean))
        middle = (area[:, None] * center).sum(axis=0) / total
        # All around a dowel the normals cancel out; then the nearest points determine the joint's direction.
        if strength > 0.05:
            n = _along_walls(area, normal, mean / strength)
            along = normal @ n > 0.7
            weight = area[along].sum()
            gap = float((area[along] * height[along]).sum() / weight) if weight > 0 else witness.distance
            return Contact(a, b, middle, n, gap, float(total))
        return Contact(a, b, middle, _witness_normal(mesh_a, mesh_b, witness), witness.distance, float(total))
    middle = 0.5 * (witness.point_a + witness.point_b)
    return Contact(a, b, middle, _witness_normal(mesh_a, mesh_b, witness), witness.distance, 0.0)


def _along_walls(
    area: Float[np.ndarray, "n"], normal: Float[np.ndarray, "n 3"], mean: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction nearest to a mean normal along which the walls of a joint slide past each other.

    The walls of a deep tenon have many times the area of its shoulder. Where they do not cancel exactly, they tilt the
    mean by a fraction of a degree, and the tenon would bind.

    Args:
        area: area of each piece [m²].
        normal: unit normal of each piece.
        mean: unit vector, their mean.
    """
    wall = np.abs(normal @ mean) < _WALL
    share, axes = np.linalg.eigh((area[wall, None] * normal[wall]).T @ normal[wall] / area.sum())
    across = axes[:, share > _WALL_SHARE]
    along = mean - across @ (across.T @ mean)
    length = float(np.linalg.norm(along))
    return along / length if length > _LEAST_ALONG else mean


def _witness_normal(mesh_a: Mesh, mesh_b: Mesh, witness: Witness) -> Float[np.ndarray, "3"]:
    across = witness.point_b - witness.point_a
    if np.linalg.norm(across) > 1e-7:
        return across / np.linalg.norm(across)
    between = mesh_b.center_of_mass - mesh_a.center_of_mass
    return between / max(float(np.linalg.norm(between)), 1e-12)


_Pieces = tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]
"""Area [m²], centroid midway between the surfaces [m], unit normal from a to b, and height [m] of each piece."""


def _facing_pieces_both_ways(mesh_a: Mesh, mesh_b: Mesh, reach: float) -> _Pieces | None:
    """Return the pieces of `a` over `b` and of `b` over `a`, each with half its area; None where no faces are opposed.

    On bent surfaces the two differ a little. Both together do not depend on which part is `a`.
    """
    forward, backward = _facing_pieces(mesh_a, mesh_b, reach), _facing_pieces(mesh_b, mesh_a, reach)
    if backward is not None:
        area, center, normal, height = backward
        backward = area, center, -normal, height
    if forward is None or backward is None:
        return forward or backward
    area, center, normal, height = (np.concatenate(both) for both in zip(forward, backward, strict=True))
    return 0.5 * area, center, normal, height


def _facing_pieces(mesh_a: Mesh, mesh_b: Mesh, reach: float) -> _Pieces | None:
    """Clip every triangle of `a` to the prism that each opposed triangle of `b` sweeps outward by `reach`.

    Returns None where no faces are opposed.
    """
    ta, na = _triangles_near(mesh_a, mesh_b.bounds, reach)
    tb, nb = _triangles_near(mesh_b, mesh_a.bounds, reach)
    if not len(ta) or not len(tb):
        return None
    i, j = _overlapping_pairs(ta, na, tb, nb, reach)
    if not len(i):
        return None
    polygon, alive = ta[i], np.ones((len(i), 3), dtype=bool)
    corner, outward = tb[j], nb[j]
    for e in range(3):
        edge = corner[:, (e + 1) % 3] - corner[:, e]
        polygon, alive = _clip(polygon, alive, corner[:, e], np.cross(outward, edge))
    polygon, alive = _clip(polygon, alive, corner[:, 0] - 1e-9 * outward, outward)
    polygon, alive = _clip(polygon, alive, corner[:, 0] + reach * outward, -outward)
    area, center = _area_and_centroid(polygon, alive)
    keep = area > 1e-12
    if not keep.any():
        return None
    area, center, outward = area[keep], center[keep], outward[keep]
    height = np.einsum("ij,ij->i", center - corner[keep][:, 0], outward)
    normal = na[i[keep]] - outward
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return area, center - 0.5 * height[:, None] * outward, normal, height


def _triangles_near(
    mesh: Mesh, bounds: Float[np.ndarray, "2 3"], reach: float
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3"]]:
    triangles = mesh.vertices[mesh.faces]
    near = ((triangles.min(axis=1) <= bounds[1] + reach) & (triangles.max(axis=1) >= bounds[0] - reach)).all(axis=1)
    triangles = triangles[near]
    normals = scaled_normals(triangles)
    length = np.linalg.norm(normals, axis=1)
    keep = length > 1e-12
    return triangles[keep], normals[keep] / length[keep, None]


def _overlapping_pairs(
    ta: Float[np.ndarray, "n 3 3"],
    na: Float[np.ndarray, "n 3"],
    tb: Float[np.ndarray, "m 3 3"],
    nb: Float[np.ndarray, "m 3"],
    reach: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of triangle pairs with opposed normals whose boxes come within `reach` of each other."""
    low_b, high_b = tb.min(axis=1) - reach, tb.max(axis=1) + reach
    rows = max(1, _CHUNK // len(tb))
    first: list[np.ndarray] = []
    second: list[np.ndarray] = []
    for start in range(0, len(ta), rows):
        part = slice(start, start + rows)
        near: Bool[np.ndarray, "r m"] = na[part] @ nb.T < _OPPOSED
        for axis in range(3):
            near &= ta[part, :, axis].min(axis=1)[:, None] <= high_b[None, :, axis]
            near &= ta[part, :, axis].max(axis=1)[:, None] >= low_b[None, :, axis]
        i, j = np.nonzero(near)
        first.append(i + start)
        second.append(j)
    return np.concatenate(first), np.concatenate(second)


def _clip(
    polygon: Float[np.ndarray, "n k 3"],
    alive: Bool[np.ndarray, "n k"],
    origin: Float[np.ndarray, "n 3"],
    inward: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n k1 3"], Bool[np.ndarray, "n k1"]]:
    """Clip each polygon by a half-space (Sutherland and Hodgman); `alive` marks the leading corners that count."""
    n, k = len(polygon), int(polygon.shape[1])
    count = alive.sum(axis=1)
    index = np.arange(k)
    following = np.where(index[None, :] + 1 < count[:, None], index[None, :] + 1, 0)
    depth = np.einsum("nki,ni->nk", polygon - origin[:, None], inward)
    next_depth = np.take_along_axis(depth, following, axis=1)
    next_corner = np.take_along_axis(polygon, following[:, :, None], axis=1)
    inside = (depth >= 0) & alive
    crossing = alive & ((depth >= 0) != (next_depth >= 0))
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(crossing, depth / (depth - next_depth), 0.0)
    cut = polygon + fraction[:, :, None] * (next_corner - polygon)
    # Each corner yields itself if inside, then the cut of the edge that starts there.
    corners = np.stack([polygon, cut], axis=2).reshape(n, 2 * k, 3)
    kept = np.stack([inside, crossing], axis=2).reshape(n, 2 * k)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : k + 1]
    return np.take_along_axis(corners, order[:, :, None], axis=1), np.take_along_axis(kept, order, axis=1)


def _area_and_centroid(
    polygon: Float[np.ndarray, "n k 3"], alive: Bool[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
    """Return areas [m²] and centroids [m] of planar polygons, by fans from their first corner."""
    valid = alive[:, 1:-1] & alive[:, 2:]
    first, second, third = polygon[:, :1], polygon[:, 1:-1], polygon[:, 2:]
    area = 0.5 * np.linalg.norm(np.cross(second - first, third - first), axis=2) * valid
    total = area.sum(axis=1)
    center = (area[:, :, None] * (first + second + third) / 3).sum(axis=1) / np.maximum(total, 1e-300)[:, None]
    return total, center
