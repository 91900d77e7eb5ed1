"""Repair: from triangle soup that overlaps to solid parts with a small real gap at every mating face.

Each part is cleaned and made a solid by the gentlest means that works (as delivered, holes filled, convex hull,
wrapped) and simplified. Then, of any two parts that overlap or touch, one is trimmed by the other grown by the gap:
the one for which the other can still be pulled away in the most directions, at the least loss of volume. A cut that
would take more than a few millimetres off a part's size, a tenon out of its socket, or the walls of a socket, is made
only where nothing else does, and refused above the limit `shortening`. Where one part would lose too much to all its
neighbours together, all is trimmed anew with that part weighing more, and overlaps may be shared. Parts that hang in
the air are moved to the rest, joints out of which nothing could go in a direction that a planner would try are cut
open, and parts that are delivered alike get each other's cuts, so that they stay alike. What cannot be done within
`RepairLimits` is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import RawPart, check_part_count
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair.alike import keep_alike, likenesses
from roboassembly.repair.insertion import box_axes, extents
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.piece import Piece
from roboassembly.repair.separation import check_sizes, separate
from roboassembly.repair.solid import solidify
from roboassembly.repair.surface import clean, to_surface

__all__ = ["GAP", "PartRepair", "RepairLimits", "RepairResult", "repair"]

GAP = 0.0002
"""Metres between mating faces."""
REPORT_THRESHOLD = 0.001
"""Metres of changed size, or of lost depth, above which a part is reported by name."""
_TIDY_SHARE = 0.2
"""Share of the gap by which surfaces may be moved to have fewer triangles."""
_SOLID_FACE_SHARE = 0.8
"""Share of the triangles allowed that a part has before it is trimmed: cuts add some."""


@dataclass(frozen=True)
class PartRepair:
    """What repair did to one part."""

    name: str
    shift: tuple[float, float, float]
    """Metres that the part was moved, in the furniture's frame."""
    trimmed: float
    """Share of its volume that was trimmed."""
    how: str
    """How it was made solid: `as delivered`, `holes filled`, `convex hull`, `sheet thickened`, `wrapped`."""
    shape_error: float
    """Metres that the delivered surface sticks out of the solid made of it (99th percentile), before trimming."""
    shape_added: float
    """Metres that the solid's skin lies off the delivered surface (99th percentile): caps over open ends."""
    size_change: float = 0.0
    """Metres by which the part's size differs from the delivered one, along the axis of its smallest box that differs
    most; negative where the part became smaller."""
    depth_losses: tuple[tuple[str, float], ...] = ()
    """Neighbours in which the part sits less deep than before trimming, by name, and metres less; only those above
    `WORTH_REPORTING`."""
    notes: tuple[str, ...] = ()
    """All else that was changed, one line each."""

    @property
    def displacement(self) -> float:
        """Metres that the part was moved."""
        return float(np.linalg.norm(self.shift))

    def __str__(self) -> str:
        """One line, for provenance notes."""
        text = (
            f"{self.name}: {self.how}, shape error {self.shape_error * 1e3:.2f} mm, "
            f"trimmed {self.trimmed:.2%}, moved {self.displacement * 1e3:.2f} mm"
        )
        off = f"skin up to {self.shape_added * 1e3:.0f} mm off the delivered surface"
        filled = [off] if self.shape_added > 0.001 else []
        return "; ".join([text, *filled, *self.changes, *self.notes])

    @property
    def changes(self) -> tuple[str, ...]:
        """Changes of size, and losses of depth, above `WORTH_REPORTING`: one line each."""
        lines = []
        if abs(self.size_change) > REPORT_THRESHOLD:
            how = "smaller" if self.size_change < 0.0 else "larger"
            lines.append(f"{abs(self.size_change) * 1e3:.1f} mm {how} than delivered")
        lines += [f"sits {loss * 1e3:.1f} mm less deep in '{other}'" for other, loss in self.depth_losses]
        return tuple(lines)


@dataclass(frozen=True)
class RepairResult:
    """Repaired parts, in the order and with the names given, and what was done to each."""

    parts: tuple[RawPart, ...]
    report: tuple[PartRepair, ...]


def repair(parts: Sequence[RawPart], *, gap: float = GAP, limits: RepairLimits | None = None) -> RepairResult:
    """Make parts solid and clear of one another in their assembled poses.

    In the result no two meshes touch, mating faces are about `gap` metres apart (never less than half of it), and
    every part is within 5 mm of another, all of them connected. The same input gives the same output.

    Args:
        parts: in the furniture's frame, at real size.
        gap: metres left at mating faces.
        limits: where to refuse.

    Raises:
        FurnitureError: fewer than 2 or more than 20 parts, two of one name, a limit exceeded, or parts that hold each
            other fast; the message names the part, the figure and the limit.
    """
    limits = limits or RepairLimits()
    check_part_count(len(parts), "repair")
    if not 1e-5 <= gap <= 1e-3:
        raise FurnitureError(f"gap {gap!r} is not between 0.00001 and 0.001 m; 0.0002 would do")
    names = [part.name for part in parts]
    if len(set(names)) < len(names):
        raise FurnitureError(f"part names {names} are not all different; rename the parts")
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
        if solid.shape_error > limits.shape_error:
            raise FurnitureError(
                f"part '{part.name}' could only be made solid ({solid.how}) with its surface "
                f"{solid.shape_error * 1e3:.1f} mm off; at most {limits.shape_error * 1e3:.1f} mm is allowed (limit "
                "`shape_error`)"
            )
        pieces.append(Piece.of(part.name, solid))
    separate(pieces, gap, limits, diagonal)
    tidy = _TIDY_SHARE * gap
    keep_alike(pieces, alike, limits, tidy)
    for piece in pieces:
        if piece.body.num_tri() > limits.faces:
            piece.become(piece.body.simplify(tidy))
    check_sizes(pieces, limits)
    bodies = {piece.name: piece.body for piece in pieces}
    out, report = [], []
    for part, piece in zip(parts, pieces, strict=True):
        skin = to_surface(piece.body)
        change = _size_change(part.mesh, skin.vertices)
        if change < -limits.shortening:
            raise FurnitureError(
                f"part '{part.name}' would become {-1e3 * change:.1f} mm smaller than delivered; at most "
                f"{1e3 * limits.shortening:.1f} mm is allowed (limit `shortening`, lifted by --allow-shortening)"
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
                notes=(*piece.solid.notes, *dict.fromkeys(piece.notes)),
            )
        )
    return RepairResult(tuple(out), tuple(report))


def _size_change(delivered: Mesh, points: Float[np.ndarray, "n 3"]) -> float:
    """Metres by which the points' size differs from the mesh's, along the axis that differs most."""
    before = clean(delivered.vertices, delivered.faces)[0].vertices
    axes = box_axes(before)
    change = extents(points, axes) - extents(before, axes)
    return float(change[np.argmax(np.abs(change))])
