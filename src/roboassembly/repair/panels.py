"""Thin panels that lie in another part, moved out of it by no more than their thickness."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float

from roboassembly.repair.doubles import is_doubled
from roboassembly.repair.piece import Piece
from roboassembly.repair.surface import to_surface

MAX_THICKNESS = 0.012
"""Largest thickness of a panel [m]."""
MAX_RATIO = 0.1
"""Largest thickness of a panel as a share of its width."""
CLEARED = 1e-12
"""Volume of an overlap that counts as none [m³]."""


def move_panels(pieces: list[Piece], gap: float, most: float) -> bool:
    """Move panels that share much of their volume with another part out of it, in place; return whether there are any.

    A panel moves across its faces by the smallest distance that clears it, at most by its thickness and the gap, to the
    side where it overlaps less with all other parts. It stays where it is if that is more than it overlaps now.

    Args:
        pieces: parts as they were made solid.
        gap: distance left between the two [m].
        most: largest distance that a panel may move [m].
    """
    moved = False
    for a, b in combinations(range(len(pieces)), 2):
        if not is_doubled(pieces[a], pieces[b]):
            continue
        panels = sorted((p for p in (a, b) if _is_panel(pieces[p])), key=lambda p: float(pieces[p].size[2]))
        for panel in panels:
            other = b if panel == a else a
            if _move_out(pieces, panel, other, gap, most):
                moved = True
                break
    return moved


def _is_panel(piece: Piece) -> bool:
    return bool(piece.size[2] <= min(MAX_THICKNESS, MAX_RATIO * piece.size[1]))


def _move_out(pieces: list[Piece], panel: int, other: int, gap: float, most: float) -> bool:
    piece = pieces[panel]
    along = to_surface(piece.body ^ pieces[other].body).vertices @ piece.axes[2]
    depth = float(np.ptp(along)) + gap
    if depth > min(most, piece.size[2] + gap):
        return False
    sides: list[tuple[float, int, Float[np.ndarray, "3"]]] = []
    for number, sign in enumerate((1.0, -1.0)):
        shift = sign * depth * piece.axes[2]
        body = piece.body.translate(tuple(shift.tolist()))
        if (body ^ pieces[other].body).volume() <= CLEARED:
            rest = [p.body for k, p in enumerate(pieces) if k != panel]
            sides.append((sum((body ^ third).volume() for third in rest), number, shift))
    before = sum((piece.body ^ p.body).volume() for k, p in enumerate(pieces) if k != panel)
    if not sides or min(side[0] for side in sides) >= before:
        return False
    shift = min(sides, key=lambda side: side[:2])[2]
    piece.moved = piece.moved + shift
    piece.become(piece.body.translate(tuple(shift.tolist())))
    piece.notes.append(f"moved {depth * 1e3:.1f} mm across its faces, out of '{pieces[other].name}'")
    return True
