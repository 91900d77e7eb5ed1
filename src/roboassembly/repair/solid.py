"""One solid for each part, by the gentlest means that works."""

from __future__ import annotations

from dataclasses import dataclass

import fast_simplification
import manifold3d as m3
import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from roboassembly.errors import FurnitureError
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair.fidelity import added, lost
from roboassembly.repair.surface import (
    Surface,
    clean,
    components,
    fill_holes,
    orient,
    patches,
    plate,
    sample,
    thicken,
    to_manifold,
    to_surface,
)
from roboassembly.repair.wrap import wrap

SHEET_THICKNESS = 1e-4
"""A closed piece whose volume over half its area is under this, in metres, is a sheet."""
HULL_TOLERANCE = 0.0015
"""The convex hull may stand in for a piece when 99 % of the hull is this near to the piece, in metres."""
PLATE_THICKNESS = 0.001
"""What a sheet that lies on nothing is made, in metres."""
NEAR_SOLID = 0.002
"""A sheet this near to a solid piece of the same part, in metres, is its paint."""
SPACING = 0.004
ACCEPTED_ERROR = 0.0015
"""With a shape error below this, in metres, no other way is tried."""
_QUADRICS = ((1.0, 2.0), (0.95, 4.0), (0.9, 1.0), (0.8, 6.0))
"""Shares of the triangles wanted, and how eagerly they are merged: tried until what comes out is closed."""
_TOLERANCES = (2e-5, 4e-5, 8e-5)
"""Metres by which the surface may move without a look at what that does to the shape."""
_FINE = 20
"""Times as many triangles as wanted make a body too fine to go gently."""
_FACE_FACTORS = (1, 2)
"""Times as many triangles as asked for, where with fewer the shape would suffer."""
_UNSOUND = 0.01
"""Share of its volume by which a solid may differ from the two halves of it; more, and it is folded inside out."""
_ADDED_WEIGHT = 0.1
"""What a metre of the solid's skin off the delivered surface counts beside a metre of surface lost."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A part as a closed manifold."""

    body: m3.Manifold
    how: str
    """`as delivered`, `holes filled`, `convex hull`, `sheet thickened`, `wrapped`, or several joined by ` + `."""
    shape_error: float
    """Metres: 99th percentile of the distance from the delivered surface to the solid, where it lies outside."""
    shape_added: float
    """Metres: 99th percentile of the distance from the solid's skin to the delivered surface (caps over openings)."""
    notes: tuple[str, ...]


def solidify(name: str, mesh: Mesh, max_faces: int) -> Solid:
    """Clean a part's mesh and make it one solid of at most about `max_faces` triangles.

    Piece by piece first. Where that loses some of the shape (surfaces that cross themselves, or many plates that
    meet at common edges), patch by patch, then by wrapping the whole; the best of them is taken.

    Raises:
        FurnitureError: the part has no area.
    """
    surface, removed = clean(mesh.vertices, mesh.faces)
    notes = []
    if removed.duplicates:
        notes.append(f"{removed.duplicates} duplicate triangles removed")
    if removed.degenerate:
        notes.append(f"{removed.degenerate} degenerate triangles removed")
    if not len(surface.faces):
        raise FurnitureError(f"part '{name}' has no triangles with area; export it again")
    if is_flat(surface):
        flat = _Build(plate(surface, PLATE_THICKNESS), ("sheet thickened",), (_plate_note(surface),))
        return _measured(flat, surface, max_faces, notes)
    pieces = components(surface)
    best = _measured(_by_pieces(pieces), surface, max_faces, notes)
    if best.shape_error <= ACCEPTED_ERROR:
        return best
    found = [best]
    finer = [patch for piece in pieces for patch in patches(piece)]
    if len(finer) > len(pieces):
        found.append(_measured(_by_pieces(finer), surface, max_faces, notes))
    if min(solid.shape_error for solid in found) > ACCEPTED_ERROR:
        body, step = wrap(surface, _closed(pieces))
        note = f"crosses itself or does not close: wrapped on a grid of {step * 1e3:.1f} mm"
        found.append(_measured(_Build(body, ("wrapped",), (note,)), surface, max_faces, notes))
    return min(found, key=lambda solid: max(ACCEPTED_ERROR, solid.shape_error) + _ADDED_WEIGHT * solid.shape_added)


@dataclass(frozen=True, eq=False)
class _Build:
    """One way to make a part solid, not yet simplified and measured."""

    body: m3.Manifold
    methods: tuple[str, ...]
    notes: tuple[str, ...]


def _measured(build: _Build, surface: Surface, max_faces: int, notes: list[str]) -> Solid:
    how = " + ".join(dict.fromkeys(build.methods))
    notes = [*notes, *build.notes]
    body, error = build.body, float("inf")
    # Each pass over a fine grid's half a million triangles takes a second: there is one only.
    start = body if body.num_tri() <= _FINE * max_faces else body.simplify(_TOLERANCES[-1])
    for factor in _FACE_FACTORS:
        body = simplify(start, max_faces * factor)
        if body.is_empty():
            return Solid(body, how, float("inf"), float("inf"), tuple(notes))
        error = lost(surface, body) if _is_sound(body) else float("inf")
        if error <= ACCEPTED_ERROR or start.num_tri() <= max_faces * factor:
            break
    return Solid(body, how, error, added(surface, body), tuple(notes))


def _is_sound(body: m3.Manifold) -> bool:
    """Whether cutting the solid in two keeps its volume: where a closed surface is folded inside out it does not.

    What is inside out counts as a hole to every later cut, and could never be made to clear its neighbours.
    """
    low, high = np.reshape(body.bounding_box(), (2, 3))
    whole = body.volume()
    for axis in np.eye(3):
        for share in (0.37, 0.61):
            above, below = body.split_by_plane(tuple(axis), float(axis @ (low + share * (high - low))))
            if abs(above.volume() + below.volume() - whole) > _UNSOUND * abs(whole):
                return False
    return True


def _closed(pieces: list[Surface]) -> Surface | None:
    """All pieces wound and with their holes filled where that can be done; None if some cannot be wound."""
    out = []
    for piece in pieces:
        wound = orient(piece)
        if wound is None:
            return None
        out.append(wound if is_flat(wound) else fill_holes(wound) or wound)
    return _join(out)


def _by_pieces(pieces: list[Surface]) -> _Build:
    """The union of the solids that the pieces make, each closed by itself."""
    notes: list[str] = []
    bodies: list[m3.Manifold] = []
    methods: list[str] = []
    sheets: list[Surface] = []
    unclosed: list[Surface] = []
    for piece in pieces:
        body, method = _close(piece)
        if body is None and is_flat(piece):
            sheets.append(piece)
        elif body is None:
            unclosed.append(piece)
        elif body.volume() < SHEET_THICKNESS * 0.5 * body.surface_area():
            sheets.append(piece)
        else:
            bodies.append(body)
            methods.append(method)
    if bodies and sheets:
        solid_points = np.concatenate([sample(to_surface(b), SPACING, 60_000)[0] for b in bodies])
        tree = KDTree(solid_points)
        paint = [tree.query(sample(s, SPACING, 20_000)[0])[0].max() < NEAR_SOLID + SPACING for s in sheets]
        if any(paint):
            notes.append(f"{sum(paint)} sheets without thickness, lying on the solid, dropped")
        sheets = [s for s, is_paint in zip(sheets, paint, strict=True) if not is_paint]
    for sheet in sheets:
        made = _plate(sheet)
        if made is None:
            unclosed.append(sheet)
            continue
        bodies.append(made)
        methods.append("sheet thickened")
        notes.append(_plate_note(sheet))
    left = _join(unclosed)
    if left is not None:
        body, method = _hull(left), "convex hull"
        if body is None:
            body, step = wrap(left)
            method = "wrapped"
            notes.append(f"{len(left.faces)} triangles that do not close wrapped on a grid of {step * 1e3:.1f} mm")
        bodies.append(body)
        methods.append(method)
    body = bodies[0] if len(bodies) == 1 else m3.Manifold.batch_boolean(bodies, m3.OpType.Add)
    return _Build(body, tuple(methods), tuple(notes))


def _plate(sheet: Surface) -> m3.Manifold | None:
    if is_flat(sheet):
        return plate(sheet, PLATE_THICKNESS)
    wound = orient(sheet)
    return None if wound is None else to_manifold(thicken(wound, PLATE_THICKNESS))


def _plate_note(sheet: Surface) -> str:
    return f"a sheet of {sheet.area * 1e4:.3g} cm² without thickness made {PLATE_THICKNESS * 1e3:g} mm thick"


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


def is_flat(piece: Surface) -> bool:
    """Whether all vertices lie in one plane."""
    centred = piece.vertices - piece.vertices.mean(axis=0)
    return bool(np.abs(centred @ np.linalg.svd(centred, full_matrices=False)[2][2]).max() < SHEET_THICKNESS)


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
    """At most about `max_faces` triangles, where that leaves the volume and keeps the solid closed.

    First those go that change little (20 to 80 µm), then, where there are still too many, by quadrics, and last by
    larger tolerances (0.15 to 1.2 mm).
    """
    out = body
    for tolerance in _TOLERANCES:
        out = body.simplify(tolerance)
        if out.num_tri() <= max_faces:
            return out
    skin = to_surface(out)
    fewest = out
    for share, aggression in _QUADRICS:
        points, faces, *_ = fast_simplification.simplify(
            skin.vertices, skin.faces, target_count=int(share * max_faces), agg=aggression
        )
        fewer = to_manifold(Surface(np.asarray(points, dtype=float), np.asarray(faces, dtype=np.int64)))
        if fewer is None or abs(fewer.volume() - out.volume()) > 0.05 * out.volume():
            continue
        if fewer.num_tri() <= max_faces:
            return fewer
        fewest = min(fewest, fewer, key=lambda candidate: candidate.num_tri())
    for tolerance in (1.5e-4, 3e-4, 6e-4, 1.2e-3):
        out = fewest.simplify(tolerance)
        if out.num_tri() <= max_faces:
            break
    return out
