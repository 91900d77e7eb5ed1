"""Split a mesh into its separate bodies, for files that hold several parts in one mesh.

Faces that share an edge belong to one body. Where two bodies touch along a whole edge, four faces meet at that edge;
faces that enclose the same material are linked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from roboassembly.errors import FurnitureError
from roboassembly.furniture.triangles import NamedTriangles, Triangles
from roboassembly.geometry.triangles import triple_products

WELD = 1e-6
"""Distance below which vertices are merged, as a share of the longest side."""
FRAGMENT = 0.005
"""Size below which a body is a scrap of the export: longest side as a share of the piece's (5 mm of 1 m)."""
MAX_BODIES = 2_000
"""Largest number of bodies in one mesh."""
_SAME_ANGLE = 1e-3
"""Angle below which two faces around an edge coincide [rad]."""


def bodies(surface: Triangles) -> list[Triangles]:
    """Return the separate bodies of a surface, in the order of their first faces; a cavity stays with its body."""
    welded = _welded(surface)
    links = _links(surface.points, surface.faces, welded)
    graph = coo_array((np.ones(len(links), dtype=bool), (links[:, 0], links[:, 1])), shape=(len(welded), len(welded)))
    count, number = connected_components(graph, directed=False)
    if count == 1:
        return [surface]
    if count > MAX_BODIES:
        raise FurnitureError(f"it falls into {count} separate bodies; at most {MAX_BODIES} are looked at")
    pieces = np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])
    out: list[Triangles] = []
    for faces in _with_hollows(surface, welded, pieces):
        try:
            out.append(Triangles(surface.points, surface.faces[faces]).merged())
        except FurnitureError:
            continue  # slivers have no area and enclose nothing
    return out


def count_closed(surface: Triangles) -> int:
    """Count the separate bodies that enclose a volume; 1 if that cannot be determined."""
    try:
        return max(1, sum(_is_closed(body) for body in bodies(surface)))
    except FurnitureError:
        return 1


def _is_closed(body: Triangles) -> bool:
    return _enclosed(body, _welded(body), np.arange(len(body.faces))) > 0


def split(parts: Sequence[NamedTriangles]) -> tuple[list[NamedTriangles], list[str]]:
    """Make each body a part, named `leg_1`, `leg_2`, ... if a part has several; return the parts and remarks.

    Scraps smaller than `FRAGMENT` are left out; a remark counts them.
    """
    found = [(part, bodies(part.triangles)) for part in parts]
    longest = max(_longest(part.triangles) for part in parts)
    out: list[NamedTriangles] = []
    remarks: list[str] = []
    for part, pieces in found:
        whole = [piece for piece in pieces if _longest(piece) >= FRAGMENT * longest]
        if len(whole) < len(pieces):
            scraps = len(pieces) - len(whole)
            remarks.append(
                f"{part.name}: {scraps} fragment{'s' if scraps > 1 else ''} smaller than {FRAGMENT:.1%} of the piece "
                f"left out"
            )
        if len(whole) > 1:
            remarks.append(f"{part.name}: split into {len(whole)} bodies")
            out += [NamedTriangles(f"{part.name}_{k}", piece, part.label) for k, piece in enumerate(whole, start=1)]
        else:
            out += [NamedTriangles(part.name, piece, part.label) for piece in whole]
    return out, remarks


def _longest(surface: Triangles) -> float:
    return float(np.ptp(surface.points, axis=0).max())


def _welded(surface: Triangles) -> Int[np.ndarray, "f 3"]:
    """Return the faces with nearly coincident vertices merged."""
    size = WELD * _longest(surface)
    _, number = np.unique(np.round(surface.points / size), axis=0, return_inverse=True)
    return number.reshape(-1)[surface.faces]


def _links(
    points: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], welded: Int[np.ndarray, "f 3"]
) -> Int[np.ndarray, "n 2"]:
    """Return pairs of faces that bound the same body."""
    thin = (welded == welded[:, [1, 2, 0]]).any(axis=1)
    # A sliver has no edges of its own; it is linked to a face that shares one of its corners.
    owner = np.full(int(welded.max()) + 1, -1)
    owner[welded[~thin].ravel()] = np.repeat(np.flatnonzero(~thin), 3)
    slivers = np.flatnonzero(thin & (owner[welded[:, 0]] >= 0))
    links = [np.column_stack([slivers, owner[welded[slivers, 0]]])]

    face, sign, edge = _half_edges(welded, np.flatnonzero(~thin))
    order = np.argsort(edge, kind="stable")
    face, sign, edge = face[order], sign[order], edge[order]
    corner = order % 3
    starts = np.flatnonzero(np.diff(edge, prepend=-1))
    counts = np.diff(starts, append=len(edge))
    pairs = starts[counts == 2]
    links.append(np.column_stack([face[pairs], face[pairs + 1]]))
    crowded = np.repeat(counts > 2, counts)
    if crowded.any():
        links.append(_crowded(points, faces, face[crowded], corner[crowded], sign[crowded], edge[crowded]))
    return np.concatenate(links)


def _half_edges(welded: Int[np.ndarray, "f 3"], of: Int[np.ndarray, "g"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for each side of these faces, its face, its sign (1: to the higher vertex number) and its edge."""
    tail = welded[of].ravel()
    head = welded[of][:, [1, 2, 0]].ravel()
    ends = np.sort(np.column_stack([tail, head]), axis=1)
    _, edge = np.unique(ends, axis=0, return_inverse=True)
    return np.repeat(of, 3), np.where(tail < head, 1, -1), edge.reshape(-1)


def _crowded(
    points: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    face: Int[np.ndarray, "h"],
    corner: Int[np.ndarray, "h"],
    sign: Int[np.ndarray, "h"],
    edge: Int[np.ndarray, "h"],
) -> Int[np.ndarray, "n 2"]:
    """Return pairs of faces to link at edges where more than two meet; the sides are sorted by edge.

    The faces are ordered by angle around the edge. Material lies between a face that runs down the edge (sign -1) and
    the next face, which runs up.
    """
    tail, head, third = (points[faces[face, (corner + k) % 3]] for k in range(3))
    # Every side of an edge is viewed in the same direction, towards the higher vertex number.
    along = (head - tail) * sign[:, None]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    across = third - tail
    across -= along * np.einsum("ij,ij->i", across, along)[:, None]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    starts = np.flatnonzero(np.diff(edge, prepend=-1))
    counts = np.diff(starts, append=len(edge))
    first = np.repeat(starts, counts)
    u, v = across[first], np.cross(along[first], across[first])
    angle = np.arctan2(np.einsum("ij,ij->i", across, v), np.einsum("ij,ij->i", across, u)) % (2 * np.pi)
    angle[angle > 2 * np.pi - _SAME_ANGLE] = 0.0

    order = np.lexsort((angle, edge))
    step = np.diff(angle[order], prepend=0.0) > _SAME_ANGLE
    step[starts] = True
    place = np.empty(len(order), dtype=int)
    place[order] = np.cumsum(step)
    # The end of a body sorts before the start of the next where their faces coincide.
    order = np.lexsort((-sign, place, edge))
    face, sign = face[order], sign[order]
    following = np.arange(len(order)) + 1
    following[starts + counts - 1] = starts
    begins = sign < 0
    proper = np.where(begins, sign[following] > 0, sign[following] < 0)
    alternates = np.repeat(np.logical_and.reduceat(proper, starts), counts)
    # If faces do not alternate, the bodies cannot be told apart: all faces of the edge are linked.
    linked = np.where(alternates, begins, True)
    return np.column_stack([face[linked], face[following[linked]]])


def _with_hollows(
    surface: Triangles, welded: Int[np.ndarray, "f 3"], pieces: list[Int[np.ndarray, "_"]]
) -> list[Int[np.ndarray, "_"]]:
    """Join each closed surface that faces inwards to the body around it; return the remaining pieces."""
    volumes = [_enclosed(surface, welded, faces) for faces in pieces]
    solids = [k for k, volume in enumerate(volumes) if volume > 0]
    joined = dict(enumerate(pieces))
    for k, volume in enumerate(volumes):
        if volume >= 0:
            continue
        inside = surface.points[surface.faces[pieces[k][0], 0]]
        around = [s for s in solids if volumes[s] > -volume and _contains(surface, pieces[s], inside)]
        if around:
            host = min(around, key=lambda s: volumes[s])
            joined[host] = np.concatenate([joined[host], joined.pop(k)])
    return list(joined.values())


def _enclosed(surface: Triangles, welded: Int[np.ndarray, "f 3"], faces: Int[np.ndarray, "_"]) -> float:
    """Return the volume that closed faces enclose, negative if they face inwards; 0 if they are open."""
    _, sign, edge = _half_edges(welded, faces)
    if np.bincount(edge, weights=sign).any():
        return 0.0
    corners = surface.points[surface.faces[faces]]
    return float(triple_products(corners - corners[0, 0]).sum() / 6.0)


def _contains(surface: Triangles, faces: Int[np.ndarray, "_"], point: Float[np.ndarray, "3"]) -> bool:
    corners = surface.points[surface.faces[faces]].reshape(-1, 3)
    if (point <= corners.min(axis=0)).any() or (point >= corners.max(axis=0)).any():
        return False
    import trimesh  # the import takes 0.3 s, and few surfaces have cavities

    solid = trimesh.Trimesh(surface.points, surface.faces[faces], process=False)
    return bool(solid.contains(point[None])[0])
