"""Sockets for parts of nearly one shape: each of them can leave the sockets of the others.

Legs of one table often differ in a mark, or in where their threads begin. A socket that is cut after one of them then
holds another one fast, although either may stand there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import CONTACT_DISTANCE, NEAR
from roboassembly.furniture.near_shapes import NearShape
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.repair.alike import Likeness
from roboassembly.repair.exits import Exits, blocking, leaves
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.opening import largest_overlap, loses_contact, passage
from roboassembly.repair.piece import NOTHING, Piece
from roboassembly.repair.proximity import Shell, shell_of
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import Cut

_GRAZE = 2e-9
"""Largest volume that a part may share with a neighbour of another's place, as where two threads cross [m³]."""
_MOST_REMOVED = 0.01
"""Largest share of its volume that a neighbour loses to the opening at one place."""
_MOST_FITS = 80
"""Number of pairs of parts whose shapes are compared; each takes some tenths of a second."""


def open_for_twins(pieces: Sequence[Piece], alike: Sequence[Likeness], gap: float, limits: RepairLimits) -> bool:
    """Open sockets, in place, so that parts of nearly one shape can leave each other's places straight.

    Only neighbours that the place's own part can leave straight are cut, and only a little. Parts that were delivered
    alike share all cuts anyway.

    Args:
        pieces: parts that no longer overlap.
        alike: congruence of each part, as delivered, with an earlier one.
        gap: distance left at mating faces [m].
        limits: limits of repair.

    Returns:
        Whether any part was cut.
    """
    before = [piece.body for piece in pieces]
    motions = _Motions(before)
    for host, guests in _twins(pieces, alike).items():
        neighbors = [
            p
            for p in range(len(pieces))
            if p != host and pieces[p].shell.is_within(pieces[host].shell, CONTACT_DISTANCE)
        ]
        placed: dict[int, list[m3.Manifold]] = {}
        for guest in guests:
            at_host = [pieces[guest].body.transform(motion) for motion in motions.onto(guest, host)]
            placed[guest] = [body for body in at_host if _fits(body, pieces, guest, neighbors)]
        for p in neighbors:
            _open(pieces, p, host, {g: bodies for g, bodies in placed.items() if g != p}, gap, limits)
    return any(piece.body is not body for piece, body in zip(pieces, before, strict=True))


def _twins(pieces: Sequence[Piece], alike: Sequence[Likeness]) -> dict[int, list[int]]:
    """Return for parts those that are nearly as large, but for parts that were delivered alike."""
    sizes = [np.sort(piece.size) for piece in pieces]
    out: dict[int, list[int]] = {}
    for host, guest in permutations(range(len(pieces)), 2):
        nearly_as_large = np.abs(sizes[guest] - sizes[host]).max() < 2.0 * NEAR
        if nearly_as_large and alike[guest].master != alike[host].master:
            out.setdefault(host, []).append(guest)
    return out


class _Motions:
    """Motions that lay one part on another of nearly its shape.

    Args:
        bodies: the parts.
    """

    def __init__(self, bodies: Sequence[m3.Manifold]) -> None:
        self._bodies = bodies
        self._shapes: dict[int, NearShape] = {}
        self._known: dict[tuple[int, int], list[SE3]] = {}

    def onto(self, part: int, other: int) -> list[Float[np.ndarray, "3 4"]]:
        """Return the motions that lay a part on another one, as matrices; none after `_MOST_FITS` pairs."""
        first, second = sorted((part, other))
        if (first, second) not in self._known:
            if len(self._known) >= _MOST_FITS:
                return []
            self._known[first, second] = self._shape(first).motions_onto(self._shape(second))
        found = self._known[first, second]
        return [(m if part == first else m.inverse()).homogeneous[:3] for m in found]

    def _shape(self, part: int) -> NearShape:
        if part not in self._shapes:
            skin = to_surface(self._bodies[part])
            self._shapes[part] = NearShape(Mesh(skin.vertices, skin.faces))
        return self._shapes[part]


def _fits(placed: m3.Manifold, pieces: Sequence[Piece], guest: int, neighbors: Sequence[int]) -> bool:
    """Return whether a part in another place does no more than graze the neighbours there."""
    return all((placed ^ pieces[p].body).volume() <= _GRAZE for p in neighbors if p != guest)


def _open(
    pieces: Sequence[Piece], at: int, host: int, placed: dict[int, list[m3.Manifold]], gap: float, limits: RepairLimits
) -> None:
    """Cut a neighbour so that all parts placed where the host is can leave it as the host can, if that takes little."""
    neighbor, shell = pieces[at], pieces[at].shell
    directions = list(_exit_directions(pieces[host].shell, shell)) if any(placed.values()) else []
    if not directions:
        return
    stuck = [
        (guest, body)
        for guest, bodies in placed.items()
        for body in bodies
        if not any(leaves(shell_of(body), shell, direction) for direction in directions)
    ]
    if not stuck:
        return
    placed_bodies = m3.Manifold.batch_boolean([body for _, body in stuck], m3.OpType.Add)
    direction = min(directions, key=lambda along: largest_overlap(placed_bodies, neighbor.body, along))
    made = passage(neighbor.body, placed_bodies, direction, gap)
    if not _is_harmless(made, neighbor, pieces[host], limits):
        return
    neighbor.removed += made.removed
    neighbor.become(made.body)
    names = ", ".join(f"'{pieces[guest].name}'" for guest in dict.fromkeys(guest for guest, _ in stuck))
    neighbor.notes.append(f"opened for {names} in the place of '{pieces[host].name}'")


def _is_harmless(cut: Cut, neighbor: Piece, host: Piece, limits: RepairLimits) -> bool:
    removed = neighbor.removed + cut.removed
    return (
        not cut.body.is_empty()
        and not cut.splits
        and cut.removed <= _MOST_REMOVED * neighbor.whole
        and removed <= limits.trimmed * neighbor.whole
        and neighbor.shrinkage(cut.body) <= neighbor.shrinkage(neighbor.body) + NOTHING
        and not loses_contact(cut.body, host.body)
    )


def _exit_directions(shell: Shell, other: Shell) -> Iterator[Float[np.ndarray, "3"]]:
    """Yield the directions in which a part leaves another one straight, of those that a planner tries."""
    graph = blocking([shell, other])
    exits = Exits([shell, other], graph)
    moving, still = frozenset((0,)), frozenset((1,))
    for index, direction in enumerate(graph.directions):
        if graph.is_natural(index, moving, still) and exits.free(moving, still, index):
            yield direction
