"""Repair: turns overlapping triangle soup into solid parts with a small real gap at every mating face.

1. Each part is cleaned, made solid by the gentlest method that works (as delivered, holes filled, convex hull,
   wrapped) and simplified.
2. If any parts overlap or touch, all faces of all parts move inward by less than the gap.
3. If two parts still do, one is trimmed by the other grown by the gap: the one that loses the least volume and
   lets the other be pulled away in the most directions. A cut that reduces a part's size by more than a few
   millimetres, or takes a tenon out of its socket or the walls off a socket, is the last choice, and is refused above
   the limit `shortening`. If all neighbours together would take too much of one part, trimming restarts with a higher
   weight for that part, and overlaps may be shared.
4. Parts without contact are moved to the rest.
5. Joints that no part can leave in a direction that a planner tries are cut open.
6. Parts that are delivered alike get each other's cuts, so that they stay alike.
7. Joints in which a part of nearly the same shape as the one that belongs there would be stuck are cut open.

Repair refuses furniture that needs more than `RepairLimits` allows. What is too short after the first four steps is
refused there: the fifth takes longest, and takes only more away. What would be refused is repaired without the second
step, then with the remedies of `remedies`, then with these and without that step. What needs none is repaired without
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import RawPart, check_part_count
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair.alike import keep_alike, likenesses
from roboassembly.repair.cached import forget
from roboassembly.repair.doubles import share_out
from roboassembly.repair.insertion import box_axes, extents
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.panels import move_panels
from roboassembly.repair.piece import Piece
from roboassembly.repair.remedies import REMEDIES, ShapeError, Treatment
from roboassembly.repair.separation import check_sizes, overlapping, separate
from roboassembly.repair.solid import solidify
from roboassembly.repair.surface import clean, to_surface
from roboassembly.repair.trim import deflate
from roboassembly.repair.twins import open_for_twins

__all__ = ["GAP", "PartRepair", "RepairLimits", "RepairResult", "repair"]

GAP = 0.0002
"""Distance between mating faces [m]."""
_SET_BACK_SHARE = 0.75
"""Distance that all faces move inward before parts are separated, as a share of the gap.

Faces that only touched are then one and a half gaps apart and need no cut. A cut would end in a rim, on which the
neighbour catches when it slides along the face.
"""
REPORT_THRESHOLD = 0.001
"""Change of size, or loss of depth, above which a part is reported by name [m]."""
_TOUCHING_SHARE = 0.1
"""Share of the gap within half of which parts of the result count as touching."""
_TIDY_SHARE = 0.2
"""Distance that surfaces may move to have fewer triangles, as a share of the gap."""
_SOLID_FACE_SHARE = 0.8
"""Share of the allowed triangles that a part has before trimming; cuts add triangles."""


@dataclass(frozen=True)
class PartRepair:
    """Changes that repair made to one part."""

    name: str
    shift: tuple[float, float, float]
    """Translation of the part in the furniture's frame [m]."""
    trimmed: float
    """Trimmed share of the part's volume."""
    how: str
    """Method that made the part solid: `as delivered`, `holes filled`, `convex hull`, `sheet thickened`, `wrapped`."""
    shape_error: float
    """Distance that the delivered surface sticks out of the untrimmed solid, 99th percentile [m]."""
    shape_added: float
    """Distance of the solid's skin from the delivered surface, as at caps over open ends, 99th percentile [m]."""
    size_change: float = 0.0
    """Change from the delivered size, along the axis of the smallest box with the largest change; negative if the part
    became smaller [m]."""
    depth_losses: tuple[tuple[str, float], ...] = ()
    """Neighbours in which the part sits less deep than before trimming, with the loss [m] if above
    `REPORT_THRESHOLD`."""
    notes: tuple[str, ...] = ()
    """All other changes, one line each."""

    @property
    def displacement(self) -> float:
        """Distance that the part was moved [m]."""
        return float(np.linalg.norm(self.shift))

    def __str__(self) -> str:
        """Return one line for the provenance notes."""
        text = (
            f"{self.name}: {self.how}, shape error {self.shape_error * 1e3:.2f} mm, "
            f"trimmed {self.trimmed:.2%}, moved {self.displacement * 1e3:.2f} mm"
        )
        off = f"skin up to {self.shape_added * 1e3:.0f} mm off the delivered surface"
        filled = [off] if self.shape_added > 0.001 else []
        return "; ".join([text, *filled, *self.changes, *self.notes])

    @property
    def changes(self) -> tuple[str, ...]:
        """Changes of size and losses of depth above `REPORT_THRESHOLD`, one line each."""
        lines: list[str] = []
        if abs(self.size_change) > REPORT_THRESHOLD:
            how = "smaller" if self.size_change < 0.0 else "larger"
            lines.append(f"{abs(self.size_change) * 1e3:.1f} mm {how} than delivered")
        lines += [f"sits {loss * 1e3:.1f} mm less deep in '{other}'" for other, loss in self.depth_losses]
        return tuple(lines)


@dataclass(frozen=True)
class RepairResult:
    """Repaired parts, in the order and with the names given, and a report on each."""

    parts: tuple[RawPart, ...]
    report: tuple[PartRepair, ...]


def repair(
    parts: Sequence[RawPart], *, gap: float = GAP, limits: RepairLimits | None = None, with_remedies: bool = True
) -> RepairResult:
    """Make parts solid and clear of one another in their assembled poses.

    In the result no two meshes touch, mating faces are about `gap` metres apart (never less than half of it), and
    every part is within 5 mm of another, all of them connected. The same input gives the same output.

    Args:
        parts: parts in the furniture's frame, at real size.
        gap: distance left at mating faces [m].
        limits: limits above which repair refuses; the defaults if None.
        with_remedies: whether `remedies` are tried before a refusal.

    Raises:
        FurnitureError: there are not 2 to 1000 parts, two have the same name, a limit is exceeded, or parts lock each
            other in place; the message names the part, the figure and the limit.
    """
    check_part_count(len(parts), "repair")
    if not 1e-5 <= gap <= 1e-3:
        raise FurnitureError(f"gap {gap!r} m; expected a number between 0.00001 and 0.001 m")
    names = [part.name for part in parts]
    if len(set(names)) < len(names):
        raise FurnitureError(f"part names {names} are not all different; rename the parts")
    limits = limits or RepairLimits()
    faces_kept = Treatment.none(parts, sets_back=False)
    try:
        return _repair(Treatment.none(parts), gap, limits)
    except FurnitureError as refusal:
        if not with_remedies:
            raise
        forget()
        # A joint that is a little too shallow after its faces are set back may not be without. Shapes are made before.
        if not isinstance(refusal, ShapeError):
            with suppress(FurnitureError):
                return _repair(faces_kept, gap, limits)
        for treatment in (Treatment.none(parts), faces_kept):
            remedied = _remedied(treatment, gap, limits, refusal)
            if remedied is not None:
                return remedied
        raise
    finally:
        forget()


def _remedied(treatment: Treatment, gap: float, limits: RepairLimits, refusal: FurnitureError) -> RepairResult | None:
    """Repair again with one remedy after another; None if none helps."""
    latest = refusal
    for remedy in REMEDIES:
        more = remedy(treatment, latest)
        if more is None:
            continue
        treatment = more
        forget()
        try:
            return _repair(treatment, gap, limits)
        except FurnitureError as problem:
            latest = problem
    return None


def _repair(treatment: Treatment, gap: float, limits: RepairLimits) -> RepairResult:
    parts = treatment.parts
    corners = np.concatenate([part.mesh.bounds for part in parts])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    alike = likenesses(parts)
    pieces: list[Piece] = []
    for part, like in zip(parts, alike, strict=True):
        if like.master < len(pieces):
            first = pieces[like.master]
            note = f"made like '{first.name}'"
            solid = replace(first.solid, body=like.placed(first.body), notes=(*first.solid.notes, note))
        else:
            solid = solidify(part.name, part.mesh, int(_SOLID_FACE_SHARE * limits.faces))
            if solid.shape_error > limits.shape_error and treatment.detail > 1:
                solid = solidify(part.name, part.mesh, int(treatment.detail * _SOLID_FACE_SHARE * limits.faces))
        if solid.shape_error > limits.shape_error:
            raise ShapeError(
                f"part '{part.name}' could only be made solid ({solid.how}) with its surface "
                f"{solid.shape_error * 1e3:.1f} mm off; at most {limits.shape_error * 1e3:.1f} mm is allowed (limit "
                "`shape_error`)",
                (part.name,),
            )
        pieces.append(Piece.of(part.name, solid))
    changed = treatment.moves_panels and move_panels(pieces, gap, limits.displacement * diagonal)
    changed = (treatment.shares_out and share_out(pieces, gap)) or changed
    if not changed and (treatment.moves_panels or treatment.shares_out):
        raise FurnitureError("no two parts have the same volume")
    if treatment.sets_back and overlapping(pieces, gap):
        for index, (piece, like) in enumerate(zip(pieces, alike, strict=True)):
            # Parts that are alike stay alike.
            is_copy = like.master < index and not changed
            inner = like.placed(pieces[like.master].body) if is_copy else deflate(piece.body, _SET_BACK_SHARE * gap)
            piece.become_whole(inner)
    separate(pieces, gap, limits, diagonal)
    tidy = _TIDY_SHARE * gap
    keep_alike(pieces, alike, limits, tidy)
    if open_for_twins(pieces, alike, gap, limits):
        keep_alike(pieces, alike, limits, tidy)
    for piece in pieces:
        if piece.body.num_tri() > limits.faces:
            piece.become(piece.body.simplify(tidy))
    # Openings and shared cuts are not separated again.
    for i, j in overlapping(pieces, _TOUCHING_SHARE * gap):
        names = pieces[i].name, pieces[j].name
        raise FurnitureError(f"parts '{names[0]}' and '{names[1]}' touch after their sockets were opened", names)
    check_sizes(pieces, limits)
    bodies = {piece.name: piece.body for piece in pieces}
    out: list[RawPart] = []
    report: list[PartRepair] = []
    for part, piece, notes in zip(parts, pieces, treatment.notes, strict=True):
        skin = to_surface(piece.body)
        change = _size_change(part.mesh, skin.vertices)
        if change < -limits.shortening and not piece.gave:
            raise FurnitureError(
                f"part '{part.name}' would become {-1e3 * change:.1f} mm smaller than delivered; at most "
                f"{1e3 * limits.shortening:.1f} mm is allowed (limit `shortening`, lifted by --allow-shortening)",
                (part.name,),
            )
        out.append(RawPart(part.name, Mesh(skin.vertices, skin.faces), part.label))
        report.append(
            PartRepair(
                name=part.name,
                shift=(float(piece.moved[0]), float(piece.moved[1]), float(piece.moved[2])),
                trimmed=max(0.0, piece.removed / piece.whole),
                how=piece.solid.how,
                shape_error=piece.solid.shape_error,
                shape_added=piece.solid.shape_added,
                size_change=change,
                depth_losses=piece.depth_losses(bodies, REPORT_THRESHOLD),
                notes=(*notes, *piece.solid.notes, *dict.fromkeys(piece.notes)),
            )
        )
    return RepairResult(tuple(out), tuple(report))


def _size_change(delivered: Mesh, points: Float[np.ndarray, "n 3"]) -> float:
    """Return the change of size from the mesh to the points, along the axis that changes most [m]."""
    before = clean(delivered.vertices, delivered.faces)[0].vertices
    axes = box_axes(before)
    change = extents(points, axes) - extents(before, axes)
    return float(change[np.argmax(np.abs(change))])
