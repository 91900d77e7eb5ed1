"""Opening of sockets: parts that lock each other in place are cut open along the cheapest exit path.

Only directions that are natural to the joint count as exits.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from itertools import combinations

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import CONTACT_DISTANCE
from roboassembly.geometry.poses import align_axis
from roboassembly.geometry.triangles import scaled_normals
from roboassembly.repair.cached import cached
from roboassembly.repair.exits import Blocking, BlockingCache, Exits, Parts, blocking, overlap_span
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.piece import HARM_LIMIT, Piece, harm
from roboassembly.repair.proximity import shell_of
from roboassembly.repair.surface import to_surface
from roboassembly.repair.trim import Cut, cut_with, inflate

MAX_FULL_SEARCH = 7
"""Largest captive set of which every subset is tried; of a larger set, only single parts and pairs are tried."""
MAX_ESTIMATED = 24
"""Number of exits whose cost is estimated."""
MAX_TRIED = 6
"""Number of exits whose cuts are made and compared."""
LOCAL = 0.03
"""Depth of a socket that is opened if a straight exit costs too much [m]."""
MAX_PRISMS = 120
"""Largest number of faces that are swept one by one."""
LAYER = 0.0005
"""Smallest thickness of a layer of a swept body [m]."""
MAX_OPENINGS = 6
"""Largest number of openings of one captive set; more free nothing."""
MAX_TRIANGLES = 2
"""Largest number of triangles of a part that is cut open, as a multiple of the limit `faces`."""
MAX_LAYERS = 40
"""Largest number of layers of a swept body."""
GROWTH = 0.01
"""Growth of the outline, as a share of its area, above which a new layer begins."""
_STEPS = (0.002, 0.006, 0.015, 0.03, 0.06, 0.12)
"""Distances along an exit at which the overlap is measured [m]."""
_SURE = 0.9
"""Share of the overlap on the way that a cut removes in any case; the tool is simplified a little."""
_SPLIT_COST = 0.5
"""Cost of a cut through a part, as a share of its volume."""
_LOOSE_COST = 0.2
"""Cost of a lost contact, as a share of a part's volume."""
_HARM_COST = 1.0
"""Cost of a lost joint, as a share of a part's volume."""


@dataclass(frozen=True)
class _ExitCandidate:
    """Subset of captive parts, and the direction in which it leaves the rest."""

    leaving: Parts
    staying: Parts
    index: int = field(compare=False)
    """Index of the direction in the present graph."""
    direction: tuple[float, float, float]
    """Unit vector, rounded."""


@dataclass(frozen=True, eq=False)
class _Opening:
    """Cut that lets one part pass another; `trimmed` becomes `cut.body`."""

    trimmed: int
    other: int
    cut: Cut


def open_up(pieces: list[Piece], gap: float, limits: RepairLimits) -> None:
    """Cut sockets open, in place, until the parts can be disassembled along straight lines, or at least come loose.

    Raises:
        FurnitureError: some parts lock each other in place, and opening them exceeds the limits.
    """
    everything = frozenset(range(len(pieces)))
    given_up: set[Parts] = set()
    tried: set[_ExitCandidate] = set()
    cache = BlockingCache()
    openings = Counter[Parts]()
    for _ in range(limits.openings):
        shells = [piece.shell for piece in pieces]
        graph = blocking(shells, cache)
        exits = Exits(shells, graph, cache)
        tight = [core for core in graph.captives(everything) if core not in given_up]
        stuck = tight or [core for core in exits.captives(everything) if core not in given_up]
        if not stuck:
            break
        core = min(stuck, key=lambda parts: (len(parts), sorted(parts)))
        openings[core] += 1
        if openings[core] > MAX_OPENINGS or not _open(pieces, core, graph, exits, tried, gap, limits):
            given_up.add(core)
    else:
        given_up = set()
    left = blocking([piece.shell for piece in pieces], cache).captives(everything)
    if left and not limits.captive:
        stuck_names = [pieces[p].name for p in sorted(left[0])]
        names = ", ".join(f"'{name}'" for name in stuck_names)
        raise FurnitureError(
            f"parts {names} lock each other in place: none can leave in any direction, and an opening would take more "
            f"than {limits.trimmed:.1%} of a part's volume (limits `trimmed`, `captive`)",
            stuck_names,
        )


def _open(
    pieces: list[Piece],
    core: Parts,
    graph: Blocking,
    exits: Exits,
    tried: set[_ExitCandidate],
    gap: float,
    limits: RepairLimits,
) -> bool:
    """Cut the cheapest untried exit of a captive set; return whether there is one within the limits."""
    ranked = sorted(
        (candidate for candidate in _candidate_exits(core, graph) if candidate not in tried),
        key=lambda candidate: sum(len(graph.arcs[candidate.index][p] & candidate.staying) for p in candidate.leaving),
    )
    priced = _cheapest(pieces, ranked[:MAX_ESTIMATED], graph)
    best: tuple[float, list[_Opening], _ExitCandidate] | None = None
    for reach in (float("inf"), LOCAL):
        for price, n in priced:
            if best is not None and price >= best[0]:
                break
            most = float("inf") if best is None else best[0]
            made = _cuts(pieces, ranked[n], graph, exits, reach, gap, limits, most)
            if made is not None:
                best = (*made, ranked[n])
        if best is not None:
            break
    if best is None:
        return False
    tried.add(best[2])
    for opening in best[1]:
        piece, other = pieces[opening.trimmed], pieces[opening.other]
        piece.removed += opening.cut.removed
        piece.become(opening.cut.body)
        piece.notes.append(f"opened so that '{other.name}' can leave")
        if opening.cut.splits:
            piece.notes.append(f"cut through by '{other.name}', kept as one rigid part")
    return True


def _candidate_exits(core: Parts, graph: Blocking) -> list[_ExitCandidate]:
    members = sorted(core)
    most = len(members) - 1 if len(members) <= MAX_FULL_SEARCH else 2
    subsets = [frozenset(s) for size in range(1, most + 1) for s in combinations(members, size)]
    directions = [(x, y, z) for x, y, z in graph.directions.round(3).tolist()]
    return [
        _ExitCandidate(s, core - s, index, direction)
        for s in subsets
        for index, direction in enumerate(directions)
        if graph.is_natural(index, s, core - s)
    ]


def _cheapest(pieces: list[Piece], candidates: list[_ExitCandidate], graph: Blocking) -> list[tuple[float, int]]:
    """Return the `MAX_TRIED` exits with the lowest bounds of their cost, as a share of volumes, and their indices.

    Overlaps are added pair by pair, first where the sum is smallest, so that few are measured of expensive exits.
    """
    hits = [[(a, b) for a in sorted(c.leaving) for b in sorted(graph.arcs[c.index][a] & c.staying)] for c in candidates]
    queue = [(0.0, n, 0) for n in range(len(candidates))]
    heapify(queue)
    found: list[tuple[float, int]] = []
    while queue and len(found) < MAX_TRIED:
        total, n, count = heappop(queue)
        if count == len(hits[n]):
            found.append((total, n))
            continue
        first, second = (pieces[p] for p in hits[n][count])
        met = largest_overlap(first.body, second.body, graph.directions[candidates[n].index])
        heappush(queue, (total + met / max(first.whole, second.whole), n, count + 1))
    return found


@cached
def _largest_overlap(
    body: m3.Manifold, other: m3.Manifold, direction: tuple[float, ...], steps: tuple[float, ...]
) -> float:
    """Return the largest volume that a solid shares with another after each of some steps along a direction [m³]."""
    return max((body.translate(tuple(step * x for x in direction)) ^ other).volume() for step in steps)


def _cuts(
    pieces: list[Piece],
    candidate: _ExitCandidate,
    graph: Blocking,
    exits: Exits,
    reach: float,
    gap: float,
    limits: RepairLimits,
    most: float,
) -> tuple[float, list[_Opening]] | None:
    """Return the cost of an exit, as a share of volumes, and its cuts.

    Returns None if a limit forbids the cuts, or if they cost `most` or more.
    """
    direction = graph.directions[candidate.index]
    bodies = {p: pieces[p].body for p in candidate.leaving | candidate.staying}
    removed = {p: pieces[p].removed for p in bodies}
    out: list[_Opening] = []
    total = 0.0
    for a in sorted(candidate.leaving):
        for b in sorted(candidate.staying):
            if not (exits.hits(a, b, candidate.index) if reach > LOCAL else b in graph.arcs[candidate.index][a]):
                continue
            length = min(reach, overlap_span(pieces[a].shell, pieces[b].shell, direction)[1])
            # The overlap on the way is a lower bound of what a cut removes.
            steps = tuple(step for step in _STEPS if step <= reach)
            overlap = _SURE * _largest_overlap(bodies[a], bodies[b], tuple(direction.tolist()), steps)
            options = [(b, a, direction), (a, b, -direction)]
            options.sort(key=lambda option: overlap / pieces[option[0]].whole)
            if total + overlap / pieces[options[0][0]].whole >= most:
                return None
            choices: list[tuple[float, _Opening]] = []
            for trimmed, other, along in options:
                if choices and choices[0][0] < overlap / pieces[trimmed].whole:
                    break
                made = _passage(bodies[trimmed], bodies[other], tuple(along.tolist()), length + gap, gap)
                share = made.removed / pieces[trimmed].whole
                too_much = removed[trimmed] + made.removed > limits.trimmed * pieces[trimmed].whole
                # Cuts that leave ever more triangles open nothing.
                if too_much or made.body.is_empty() or made.body.num_tri() > MAX_TRIANGLES * limits.faces:
                    continue
                loose = loses_contact(made.body, bodies[other])
                lost = harm(pieces[trimmed], pieces[other], made.body, bodies[other])
                cost = share + _SPLIT_COST * made.splits + _LOOSE_COST * loose + _HARM_COST * (lost > HARM_LIMIT)
                choices.append((cost, _Opening(trimmed, other, made)))
            if not choices:
                return None
            # The part that stays is cut if costs are equal.
            cost, opening = min(choices, key=lambda choice: (choice[0], choice[1].trimmed == a))
            bodies[opening.trimmed] = opening.cut.body
            removed[opening.trimmed] += opening.cut.removed
            out.append(opening)
            total += cost
            if total >= most:
                return None
    return (total, out) if total < most else None


@cached
def _passage(
    body: m3.Manifold, other: m3.Manifold, direction: tuple[float, float, float], length: float, gap: float
) -> Cut:
    """Remove from `body` what is in the way of the other solid while it moves `length` metres."""
    return cut_with(body, sweep(other, np.array(direction), length, body, gap), other, gap)


def largest_overlap(body: m3.Manifold, other: m3.Manifold, direction: Float[np.ndarray, "3"]) -> float:
    """Return the largest volume that a solid shares with another on its way along a unit vector [m³]."""
    return _largest_overlap(body, other, tuple(direction.tolist()), _STEPS)


def passage(body: m3.Manifold, other: m3.Manifold, direction: Float[np.ndarray, "3"], gap: float) -> Cut:
    """Remove from `body` what is in the way of the other solid until it has left along the direction.

    Args:
        body: solid that is cut.
        other: solid that moves.
        direction: unit vector.
        gap: distance left between the two [m].
    """
    length = overlap_span(shell_of(other), shell_of(body), direction)[1] + gap
    return _passage(body, other, tuple(direction.tolist()), length, gap)


def loses_contact(first: m3.Manifold, second: m3.Manifold) -> bool:
    """Return whether two solids are too far apart to count as connected."""
    return not shell_of(first).is_within(shell_of(second), CONTACT_DISTANCE)


def sweep(
    body: m3.Manifold, direction: Float[np.ndarray, "3"], length: float, target: m3.Manifold, gap: float
) -> m3.Manifold:
    """Return the volume that `body`, grown by `gap`, sweeps near the target while it moves `length` metres.

    A body with many faces towards the direction is swept layer by layer.
    """
    up = align_axis(direction, np.array([0.0, 0.0, 1.0]))
    across = target.transform(np.column_stack([up, np.zeros(3)])).bounding_box()
    return _swept(body, tuple(direction.tolist()), length, tuple(target.bounding_box()), tuple(across), gap)


@cached
def _swept(
    body: m3.Manifold,
    along: tuple[float, ...],
    length: float,
    box: tuple[float, ...],
    across: tuple[float, ...],
    gap: float,
) -> m3.Manifold:
    """Return the volume that `sweep` describes, which depends on the target only by its boxes.

    Args:
        body: solid that moves.
        along: unit vector.
        length: distance [m].
        box: box of the target: lowest and highest corner [m].
        across: the same, turned so that the direction is the z axis [m].
        gap: distance left between the two [m].
    """
    direction = np.array(along)
    low, high = np.reshape(box, (2, 3))
    shift = length * direction
    start, stop = low - np.maximum(shift, 0.0) - 20.0 * gap, high - np.minimum(shift, 0.0) + 20.0 * gap
    close = body ^ m3.Manifold.cube(tuple(stop - start)).translate(tuple(start))
    grown = inflate(close.simplify(0.3 * gap), 1.3 * gap)
    corners = to_surface(grown).corners
    normal = scaled_normals(corners)
    reach_low = corners.min(axis=1) + np.minimum(shift, 0.0)
    reach_high = corners.max(axis=1) + np.maximum(shift, 0.0)
    ahead = normal @ direction > 1e-9 * np.linalg.norm(normal, axis=1)
    ahead &= (reach_low < high).all(axis=1) & (reach_high > low).all(axis=1)
    if ahead.sum() <= MAX_PRISMS:
        prisms = [m3.Manifold.hull_points(np.concatenate([t, t + shift])) for t in corners[ahead]]
        return m3.Manifold.batch_boolean([grown, *prisms], m3.OpType.Add)
    return _layered(close.simplify(0.3 * gap), direction, length, across, 1.3 * gap)


def _layered(
    body: m3.Manifold, direction: Float[np.ndarray, "3"], length: float, across: tuple[float, ...], margin: float
) -> m3.Manifold:
    """Return the volume that a body of many faces sweeps, in layers across the direction.

    Each layer covers the outlines of all layers behind it, grown by the margin. Space that the body does not reach
    stays, such as the core of a screw when its nut moves off.
    """
    up = align_axis(direction, np.array([0.0, 0.0, 1.0]))
    turned = body.transform(np.column_stack([up, np.zeros(3)]))
    bottom, top = turned.bounding_box()[2], turned.bounding_box()[5]
    first, last = max(bottom, across[2] - margin), min(top, across[5] + margin)
    if last <= first:
        first = last = min(max(first, bottom), top)
    levels = np.linspace(first, last, 2 + int(min(MAX_LAYERS, (last - first) / LAYER)))
    (x0, y0), (x1, y1) = np.array(across[:2]) - 2.0 * margin, np.array(across[3:5]) + 2.0 * margin
    window = m3.CrossSection.square((x1 - x0, y1 - y0)).translate((x0, y0))

    def shadow(slab: m3.Manifold) -> m3.CrossSection:
        return (slab.project() ^ window).offset(margin, m3.JoinType.Miter).simplify(0.3 * margin)

    outline, area = m3.CrossSection(), 0.0
    layers: list[m3.Manifold] = []
    begun = bottom - margin
    for low, high in zip([bottom, *levels[:-1]], levels, strict=True):
        slab = turned.trim_by_plane((0.0, 0.0, 1.0), low).trim_by_plane((0.0, 0.0, -1.0), -high)
        if slab.is_empty():
            continue
        wider = outline + shadow(slab)
        # The margin also counts along the direction: a layer begins that much earlier. A small growth is added to the
        # layer before.
        if wider.area() > (1.0 + GROWTH) * area:
            if low - margin > begun:
                layers.append(_slab(outline, begun, low - margin))
                begun = low - margin
            area = wider.area()
        outline = wider
    rest = turned.trim_by_plane((0.0, 0.0, 1.0), last)
    layers.append(_slab(outline, begun, last + margin))
    outline = outline if rest.is_empty() else outline + shadow(rest)
    layers.append(_slab(outline, last - margin, top + margin + length))
    swept = m3.Manifold.batch_boolean([layer for layer in layers if not layer.is_empty()], m3.OpType.Add)
    return swept.transform(np.column_stack([up.T, np.zeros(3)]))


def _slab(outline: m3.CrossSection, low: float, high: float) -> m3.Manifold:
    return m3.Manifold.extrude(outline, high - low).translate((0.0, 0.0, low)) if high > low else m3.Manifold()
