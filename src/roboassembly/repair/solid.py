"""One solid for each part, by the gentlest method that works."""

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
"""Mean thickness (volume over half the area) below which a closed piece is a sheet [m]."""
HULL_TOLERANCE = 0.0015
"""Distance from the piece of 99 % of its convex hull, below which the hull replaces it [m]."""
PLATE_THICKNESS = 0.001
"""Thickness given to a sheet that does not lie on a solid [m]."""
NEAR_SOLID = 0.002
"""Distance to a solid piece of the same part below which a sheet is its coating [m]."""
SPACING = 0.004
"""Distance between sample points [m]."""
ACCEPTED_ERROR = 0.0015
"""Shape error below which no other method is tried [m]."""
_QUADRICS = ((1.0, 2.0), (0.95, 4.0), (0.9, 1.0), (0.8, 6.0))
"""Target share of the allowed triangles and aggressiveness, tried in order until the result is closed."""
_TOLERANCES = (2e-5, 4e-5, 8e-5)
"""Tolerances of simplification that need no check of the shape [m]."""
_FINE = 20
"""Multiple of the allowed triangles above which a body is simplified at once."""
_FACE_FACTORS = (1, 2)
"""Multiples of the allowed triangles; the larger one is used if the shape suffers."""
_UNSOUND = 0.01
"""Difference in volume from its two halves above which a solid is folded inside out, as a share."""
_ADDED_WEIGHT = 0.1
"""Weight of the added shape against the shape error."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Part as a closed manifold."""

    body: m3.Manifold
    how: str
    """Method: `as delivered`, `holes filled`, `convex hull`, `sheet thickened`, `wrapped`, or several with ` + `."""
    shape_error: float
    """Distance that the delivered surface sticks out of the solid, 99th percentile [m]."""
    shape_added: float
    """Distance from the solid's skin to the delivered surface, as at caps, 99th percentile [m]."""
    notes: tuple[str, ...]


def solidify(name: str, mesh: Mesh, max_faces: int) -> Solid:
    """Clean a part's mesh and make it one solid of at most about `max_faces` triangles.

    The pieces are closed one by one first. If that loses some of the shape (surfaces that cross themselves, or many
    plates that meet at common edges), patches are closed one by one, and then the whole is wrapped; the best result
    is returned.

    Raises:
        FurnitureError: the part has no area.
    """
    surface, removed = clean(mesh.vertices, mesh.faces)
    notes: list[str] = []
    if removed.duplicates:
        notes.append(f"{removed.duplicates} duplicate triangles removed")
    if removed.degenerate:
        notes.append(f"{removed.degenerate} degenerate triangles removed")
    if not len(surface.faces):
        raise FurnitureError(f"part '{name}' has no triangles with area; export it again", (name,))
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
    """Candidate solid of a part, before simplification and measurement."""

    body: m3.Manifold
    methods: tuple[str, ...]
    notes: tuple[str, ...]


def _measured(build: _Build, surface: Surface, max_faces: int, notes: list[str]) -> Solid:
    how = " + ".join(dict.fromkeys(build.methods))
    notes = [*notes, *build.notes]
    body, error = build.body, float("inf")
    # A pass over the half million triangles of a fine grid takes a second: such a body gets only one.
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
    """Return whether a cut in two preserves the volume, which fails if the surface is folded inside out.

    Later cuts treat an inside-out region as a hole, so that it could never clear its neighbours.
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
    """Return all pieces oriented, with holes filled where possible; None if a piece cannot be oriented."""
    out: list[Surface] = []
    for piece in pieces:
        wound = orient(piece)
        if wound is None:
            return None
        out.append(wound if is_flat(wound) else fill_holes(wound) or wound)
    return _join(out)


def _by_pieces(pieces: list[Surface]) -> _Build:
    """Return the union of the pieces, each closed by itself."""
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
        paint = [np.max(tree.query(sample(s, SPACING, 20_000)[0])[0]) < NEAR_SOLID + SPACING for s in sheets]
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
    """Return whether all vertices lie in one plane."""
    centred = piece.vertices - piece.vertices.mean(axis=0)
    return bool(np.abs(centred @ np.linalg.svd(centred, full_matrices=False)[2][2]).max() < SHEET_THICKNESS)


def _hull(piece: Surface) -> m3.Manifold | None:
    """Return the convex hull if the piece fills it; None otherwise."""
    try:
        ConvexHull(piece.vertices)
    except QhullError:
        return None
    hull = m3.Manifold.hull_points(piece.vertices)
    points, _ = sample(to_surface(hull), SPACING, 40_000)
    own, _ = sample(piece, 0.5 * SPACING, 80_000)
    far = np.asarray(KDTree(own).query(points)[0]) > HULL_TOLERANCE + 0.5 * SPACING
    return hull if far.mean() < 0.01 else None


def _join(pieces: list[Surface]) -> Surface | None:
    if not pieces:
        return None
    starts = np.cumsum([0, *(len(p.vertices) for p in pieces[:-1])])
    faces = np.concatenate([p.faces + s for p, s in zip(pieces, starts, strict=True)])
    return Surface(np.concatenate([p.vertices for p in pieces]), faces)


def simplify(body: m3.Manifold, max_faces: int) -> m3.Manifold:
    """Reduce a solid to about `max_faces` triangles, if that preserves the volume and keeps it closed.

    Small tolerances (20 to 80 µm) are tried first, then quadric error decimation, then larger tolerances (0.15 to
    1.2 mm).
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
