"""Doubled material: surfaces and volumes that two parts both have, left to one of them.

Parts of real models are cut out of one mesh, and some cuts leave the same triangles, or the same solid, in two parts.
What one part gives away here the other one has, so the finished furniture keeps its shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import manifold3d as m3
import numpy as np
from jaxtyping import Float, Int

from roboassembly.furniture.model import CONTACT_DISTANCE, RawPart
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair.edges import half_edges, numbered
from roboassembly.repair.piece import Piece
from roboassembly.repair.proximity import Shell, shell_of
from roboassembly.repair.solid import is_flat
from roboassembly.repair.surface import Surface, clean, components, sample, to_surface
from roboassembly.repair.trim import SLIVER, inflate, near

SAME_SURFACE = 2e-4
"""Distance from another part's surface below which a surface is the same [m]."""
SPACING = 0.002
"""Distance between the points of a surface that are compared [m]."""
MAX_POINTS = 2_000
DOUBLED = 0.1
"""Share of the volume of both parts above which their overlap is doubled material."""
MAX_DEPTH = 0.008
"""Largest depth at which the skin of doubled material lies below the other part's surface: 90th percentile [m]."""
LEAST_REST = 0.05
"""Smallest share of its volume that a part keeps."""
LEAST_THICKNESS = 0.001
"""Smallest thickness (volume over half the area) of what a part keeps [m]."""
MAX_LOST = 0.02
"""Largest share of its volume that a part loses and the other part does not have: slivers."""
MARGIN = 0.004
"""Margin around a part in which its neighbour is cropped before it is grown [m]."""


def without_doubled_surfaces(parts: Sequence[RawPart]) -> tuple[list[RawPart], list[tuple[str, ...]]] | None:
    """Drop sheets and fins of a part that lie on another part's surface; None if there are none.

    A sheet is a flat piece of its own, without thickness. A fin is a triangle that hangs on the part by one edge, or
    that is left of a side that the other part lacks: then its corners are as near to that part as parts in contact.

    Returns:
        The parts, and notes on each.
    """
    surfaces = [clean(part.mesh.vertices, part.mesh.faces)[0] for part in parts]
    shells = [Shell(surface) for surface in surfaces]
    out: list[RawPart] = []
    notes: list[tuple[str, ...]] = []
    for index, (part, surface) in enumerate(zip(parts, surfaces, strict=True)):
        others = [(p.name, s) for k, (p, s) in enumerate(zip(parts, shells, strict=True)) if k != index]
        kept = _without_fins(_without_sheets(surface, others), others)
        lost = surface.area - kept.area
        if len(kept.faces) in (0, len(surface.faces)):
            out.append(part)
            notes.append(())
            continue
        out.append(RawPart(part.name, Mesh(kept.vertices, kept.faces), part.label))
        notes.append((f"{lost * 1e4:.3g} cm² of sheets and fins dropped that lie on other parts",))
    return (out, notes) if any(notes) else None


def _without_sheets(surface: Surface, others: Sequence[tuple[str, Shell]]) -> Surface:
    pieces = components(surface)
    kept = [piece for piece in pieces if not (is_flat(piece) and _owner(piece, others) is not None)]
    if len(kept) in (0, len(pieces)):
        return surface
    starts = np.cumsum([0, *(len(piece.vertices) for piece in kept[:-1])])
    faces = np.concatenate([piece.faces + start for piece, start in zip(kept, starts, strict=True)])
    return Surface(np.concatenate([piece.vertices for piece in kept]), faces)


def _without_fins(surface: Surface, others: Sequence[tuple[str, Shell]]) -> Surface:
    while len(surface.faces) > 1:
        fins = [
            face for face in np.flatnonzero(_shared_edges(surface) == 1).tolist() if _lies_on(surface, face, others)
        ]
        if not fins:
            break
        surface = _without(surface, fins)
    shared = _shared_edges(surface)
    # A fin may be all that is left of a side that the other part lacks; then only its corners are near that part.
    loose = [face for face in np.flatnonzero(shared == 1).tolist() if shared[_neighbor(surface, face)] == 3]
    return _without(surface, [face for face in loose if _is_side_of_other(surface.corners[face], others)])


def _without(surface: Surface, faces: Sequence[int]) -> Surface:
    return Surface(surface.vertices, np.delete(surface.faces, faces, axis=0)).compact() if len(faces) else surface


def _lies_on(surface: Surface, face: int, others: Sequence[tuple[str, Shell]]) -> bool:
    return _owner(Surface(surface.vertices, surface.faces[[face]]).compact(), others) is not None


def _is_side_of_other(corners: Float[np.ndarray, "3 3"], others: Sequence[tuple[str, Shell]]) -> bool:
    return any((shell.distances_to(corners) < CONTACT_DISTANCE).all() for _, shell in others)


def _shared_edges(surface: Surface) -> Int[np.ndarray, "f"]:
    """Return the number of edges that each triangle shares with others."""
    directed, owner = half_edges(surface.faces)
    edge, count = numbered(directed)
    shared = np.zeros(len(surface.faces), dtype=np.int64)
    np.add.at(shared, owner, (count[edge] > 1).astype(np.int64))
    return shared


def _neighbor(surface: Surface, face: int) -> int:
    """Return the triangle that shares an edge with a triangle that shares only one."""
    common = np.isin(surface.faces, surface.faces[face]).sum(axis=1)
    common[face] = 0
    return int(np.argmax(common))


def _owner(piece: Surface, others: Sequence[tuple[str, Shell]]) -> str | None:
    """Return the part on whose surface a piece lies; None if there is none."""
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    points = np.concatenate([piece.vertices, sample(piece, SPACING, MAX_POINTS)[0]])
    for name, shell in others:
        if (low < shell.low - SAME_SURFACE).any() or (high > shell.high + SAME_SURFACE).any():
            continue
        if all((shell.distances_to(some) < SAME_SURFACE).all() for some in (points[:1], points)):
            return name
    return None


def share_out(pieces: list[Piece], gap: float) -> bool:
    """Leave doubled volumes to one of the two parts, in place, before any trimming; return whether there are any.

    Material is doubled where the surface of one part follows that of the other. The part whose rest is thicker gives it
    away: the other one's would be a shell. A part does not give so much that less than `LEAST_REST` of it is left, or a
    rest thinner than `LEAST_THICKNESS`.

    Args:
        pieces: parts as they were made solid.
        gap: distance left between the two [m].
    """
    pairs = [(a, b) for a, b in combinations(range(len(pieces)), 2) if is_doubled(pieces[a], pieces[b])]
    partners = {p: [b if p == a else a for a, b in pairs if p in (a, b)] for pair in pairs for p in pair}
    rests = {p: _rest(pieces[p], [pieces[q] for q in others], gap) for p, others in partners.items()}
    given: dict[int, list[int]] = {}
    for a, b in pairs:
        ends = ((a, b), (b, a)) if _thickness(rests[a]) >= _thickness(rests[b]) else ((b, a), (a, b))
        for giver, other in ends:
            if rests[giver] is not None and _follows(pieces[giver].body, pieces[other].body):
                given.setdefault(giver, []).append(other)
                break
    for giver, others in given.items():
        piece = pieces[giver]
        rest = _rest(piece, [pieces[q] for q in others], gap)
        if rest is None:
            continue
        piece.give(rest, [pieces[q].name for q in others])
    return any(piece.gave for piece in pieces)


def is_doubled(first: Piece, second: Piece) -> bool:
    """Return whether the overlap of two parts is a large share of both."""
    if first.shell.box_distance(second.shell) > 0.0:
        return False
    return (first.body ^ second.body).volume() > DOUBLED * max(first.whole, second.whole)


def _follows(body: m3.Manifold, other: m3.Manifold) -> bool:
    """Return whether the skin of a solid inside another one follows the other's: else the parts are only misplaced."""
    points = sample(to_surface(body ^ other), SPACING, MAX_POINTS)[0]
    own = points[shell_of(body).distances_to(points) < SAME_SURFACE]
    return bool(len(own)) and float(np.quantile(shell_of(other).distances_to(own), 0.9)) < MAX_DEPTH


def _rest(piece: Piece, others: Sequence[Piece], gap: float) -> m3.Manifold | None:
    """Return what is left of a part without the others; None if that is too little or too thin."""
    tools = [inflate(near(other.body, piece.body, MARGIN), gap) for other in others]
    pieces = (piece.body - m3.Manifold.batch_boolean(tools, m3.OpType.Add)).decompose()
    # A solid that was filled from an open surface may be inside out in places.
    pieces = [_turned(part) if part.volume() < 0.0 else part for part in pieces]
    kept = [part for part in pieces if part.volume() >= SLIVER * piece.whole]
    lost = sum(part.volume() for part in pieces) - sum(part.volume() for part in kept)
    if not kept or lost > MAX_LOST * piece.whole:
        return None
    rest = m3.Manifold.batch_boolean(kept, m3.OpType.Add)
    return rest if rest.volume() > LEAST_REST * piece.whole and _thickness(rest) > LEAST_THICKNESS else None


def _turned(body: m3.Manifold) -> m3.Manifold:
    """Return a solid with its inside out."""
    skin = to_surface(body).flipped()
    return m3.Manifold(m3.Mesh64(skin.vertices, np.ascontiguousarray(skin.faces.astype(np.uint64))))


def _thickness(body: m3.Manifold | None) -> float:
    return 0.0 if body is None else 2.0 * body.volume() / body.surface_area()
