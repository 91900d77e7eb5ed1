"""One solid for each part, by the gentlest means that works."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import manifold3d as m3
import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from roboassembly.errors import FurnitureError
from roboassembly.furniture.repair.proximity import Shell
from roboassembly.furniture.repair.surface import Surface, clean, components, fill_holes, orient, sample, thicken
from roboassembly.furniture.repair.wrap import wrap
from roboassembly.meshes import Mesh

SHEET_THICKNESS = 1e-4
"""A closed piece whose volume over half its area is under this, in metres, is a sheet."""
HULL_TOLERANCE = 0.0015
"""The convex hull may stand in for a piece when 99 % of the hull is this near to the piece, in metres."""
PLATE_THICKNESS = 0.001
"""What a sheet that lies on nothing is made, in metres."""
NEAR_SOLID = 0.002
"""A sheet this near to a solid piece of the same part, in metres, is its paint."""
SPACING = 0.004


@dataclass(frozen=True, eq=False)
class Solid:
    """A part as a closed manifold."""

    body: m3.Manifold
    how: str
    """`as delivered`, `holes filled`, `convex hull`, `wrapped`, or several joined by ` + `."""
    shape_error: float
    """Metres: 99th percentile of the distance from the delivered surface to the solid, where it lies outside."""
    notes: tuple[str, ...]


def to_manifold(surface: Surface) -> m3.Manifold | None:
    """The solid that a closed surface bounds, or None if it is not closed and wound one way."""
    if surface.volume < 0:
        surface = surface.flipped()
    surface = surface.compact()
    body = m3.Manifold(
        m3.Mesh64(np.ascontiguousarray(surface.vertices), np.ascontiguousarray(surface.faces.astype(np.uint64)))
    )
    return body if body.status() == m3.Error.NoError and not body.is_empty() else None


def to_surface(body: m3.Manifold) -> Surface:
    """The triangles of a solid."""
    mesh = body.to_mesh64()
    return Surface(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts).astype(np.int64))


def solidify(name: str, mesh: Mesh, max_faces: int) -> Solid:
    """Clean a part's mesh and make it one solid of at most about `max_faces` triangles.

    Raises:
        FurnitureError: the part is flat.
    """
    surface, removed = clean(mesh.vertices, mesh.faces)
    notes = []
    if removed.duplicates:
        notes.append(f"{removed.duplicates} duplicate triangles removed")
    if removed.degenerate:
        notes.append(f"{removed.degenerate} degenerate triangles removed")
    if not len(surface.faces) or _is_flat(surface):
        raise FurnitureError(
            f"part '{name}' is flat: it encloses no volume; give it a thickness of a millimetre or more"
        )
    bodies: list[m3.Manifold] = []
    ways: list[str] = []
    sheets: list[Surface] = []
    stubborn: list[Surface] = []
    for piece in components(surface):
        body, way = _close(piece)
        if body is None and _is_flat(piece):
            sheets.append(piece)
        elif body is None:
            stubborn.append(piece)
        elif body.volume() < SHEET_THICKNESS * 0.5 * body.surface_area():
            sheets.append(piece)
        else:
            bodies.append(body)
            ways.append(way)
    if bodies and sheets:
        solid_points = np.concatenate([sample(to_surface(b), SPACING, 60_000)[0] for b in bodies])
        tree = KDTree(solid_points)
        paint = [tree.query(sample(s, SPACING, 20_000)[0])[0].max() < NEAR_SOLID + SPACING for s in sheets]
        if any(paint):
            notes.append(f"{sum(paint)} sheets without thickness, lying on the solid, dropped")
        sheets = [s for s, is_paint in zip(sheets, paint, strict=True) if not is_paint]
    for sheet in sheets:
        wound = orient(sheet)
        plate = to_manifold(thicken(wound, PLATE_THICKNESS)) if wound is not None else None
        if plate is None:
            stubborn.append(sheet)
            continue
        bodies.append(plate)
        ways.append("sheet thickened")
        notes.append(f"a sheet of {sheet.area * 1e4:.3g} cm² without thickness made {PLATE_THICKNESS * 1e3:g} mm thick")
    left = _join(stubborn)
    if left is not None:
        body, way = _hull(left), "convex hull"
        if body is None:
            body, step = wrap(left)
            way = "wrapped"
            notes.append(f"{len(left.faces)} triangles that do not close wrapped on a grid of {step * 1e3:.1f} mm")
        bodies.append(body)
        ways.append(way)
    body = bodies[0] if len(bodies) == 1 else m3.Manifold.batch_boolean(bodies, m3.OpType.Add)
    body = simplify(body, max_faces)
    return Solid(body, " + ".join(dict.fromkeys(ways)), _lost(surface, body), tuple(notes))


def _close(piece: Surface) -> tuple[m3.Manifold | None, str]:
    wound = orient(piece)
    if wound is not None:
        body = to_manifold(wound)
        if body is not None:
            return body, "as delivered"
        filled = fill_holes(wound)
        if filled is None:
            body = to_manifold(thicken(wound, PLATE_THICKNESS))
            if body is not None:
                return body, "sheet thickened"
        body = to_manifold(filled) if filled is not None else None
        if body is not None:
            return body, "holes filled"
    body = _hull(piece)
    return body, "convex hull"


def _is_flat(piece: Surface) -> bool:
    spread = piece.vertices - piece.vertices.mean(axis=0)
    return bool(np.abs(spread @ np.linalg.svd(spread, full_matrices=False)[2][2]).max() < SHEET_THICKNESS)


def _hull(piece: Surface) -> m3.Manifold | None:
    """The convex hull, if the piece fills it."""
    try:
        ConvexHull(piece.vertices)
    except QhullError:
        return None
    hull = m3.Manifold.hull_points(piece.vertices)
    points, _ = sample(to_surface(hull), SPACING, 40_000)
    own, _ = sample(piece, 0.5 * SPACING, 80_000)
    far = KDTree(own).query(points)[0] > HULL_TOLERANCE + 0.5 * SPACING
    return hull if far.mean() < 0.01 else None


def _join(pieces: list[Surface]) -> Surface | None:
    if not pieces:
        return None
    starts = np.cumsum([0, *(len(p.vertices) for p in pieces[:-1])])
    faces = np.concatenate([p.faces + s for p, s in zip(pieces, starts, strict=True)])
    return Surface(np.concatenate([p.vertices for p in pieces]), faces)


def simplify(body: m3.Manifold, max_faces: int) -> m3.Manifold:
    """Fewer triangles: first those that change nothing (20 µm), then, where there are still too many, by quadrics."""
    out = body.simplify(2e-5)
    for share in (1.0, 1.4, 2.0):
        if out.num_tri() <= max_faces * share:
            return out
        skin = to_surface(out)
        points, faces, *_ = fast_simplification.simplify(
            skin.vertices, skin.faces, target_count=int(max_faces * share), agg=2
        )
        fewer = to_manifold(Surface(np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64)))
        if fewer is not None and abs(fewer.volume() - out.volume()) < 0.1 * out.volume():
            return fewer
    return out


def _lost(surface: Surface, body: m3.Manifold) -> float:
    """How far the delivered surface sticks out of the solid, in metres: 99th percentile of evenly spread points."""
    points, _ = sample(surface, 4 * SPACING, 3_000)
    points = points[np.linspace(0, len(points) - 1, min(len(points), 3_000)).astype(int)]
    shell = Shell(to_surface(body))
    distance = np.array([shell.distance_to(point) for point in points])
    deep = np.flatnonzero(distance > 5e-4)
    out = body.bounding_box()
    beyond = np.array([out[3] + 0.1, out[4] + 0.137, out[5] + 0.0713])
    for k in deep[np.argsort(-distance[deep], kind="stable")].tolist():
        if len(body.ray_cast(points[k], beyond)) % 2 == 0:
            break
        distance[k] = 0.0
    return float(np.quantile(distance, 0.99))
