"""Separation of overlapping solids, with a small real gap between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush
from itertools import chain, combinations, permutations

import manifold3d as m3
import numpy as np

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import CONTACT_DISTANCE
from roboassembly.repair.cached import cached
from roboassembly.repair.insertion import REACH
from roboassembly.repair.limits import RepairLimits
from roboassembly.repair.opening import open_up
from roboassembly.repair.piece import HARM_LIMIT, Piece, harm
from roboassembly.repair.proximity import shell_of
from roboassembly.repair.share import shared_cuts
from roboassembly.repair.trim import Cut, cut, flush_cut, inflate, near, plane_cut

ROUNDS = 8
"""Largest number of rounds of trimming."""
MAX_MOVES = 40
"""Largest number of moves of parts without contact."""
RESTARTS = 2
"""Largest number of restarts with other weights."""
HEAVIER = 4.0
"""Factor on the weight of a part that would lose too much."""
TRAPPED = 0.1
"""Share of directions in which the cutter can leave, below which a cut is a socket."""
MAX_PLANE_SHARE = 0.01
"""Largest volume of a flat cut, as a share of the part."""
MAX_PLANE_RATIO = 3.0
"""Largest volume of a flat cut, as a multiple of a cut along the neighbour's surface."""
KEPT = 0.001
"""Margin around a neighbour in which a cut is harmless [m]."""
BEYOND = 1e-8
"""Volume outside that margin up to which a cut is harmless [m³]."""
HARM_COST = 1.0
"""Cost of a loss of size or depth of `HARM_LIMIT`."""
HARMFUL = 10.0
"""Cost of a cut with a larger loss."""


class _TooMuchTrimmedError(FurnitureError):
    """Error for a part that would lose more volume than allowed."""

    def __init__(self, piece: Piece, other: Piece, message: str) -> None:
        super().__init__(message, (piece.name, other.name))
        self.piece = piece


class _ShortenedError(FurnitureError):
    """Error for a part that would become too small, or a joint too shallow."""


def separate(pieces: list[Piece], gap: float, limits: RepairLimits, diagonal: float) -> None:
    """Trim and move the pieces, in place, until no two touch and all are connected.

    If all neighbours together take too much of a part, its weight rises and trimming restarts: then neighbours are
    trimmed instead.

    Raises:
        FurnitureError: separation is not possible within the limits.
    """
    for piece, other in permutations(pieces, 2):
        if piece.shell.box_distance(other.shell) <= REACH:
            piece.measure_depth(other)
    start = list(pieces)
    problems: list[FurnitureError] = []
    for careful in (True, False):
        try:
            _separate(pieces, start, gap, limits, diagonal, careful)
            check_sizes(pieces, limits)
        except FurnitureError as problem:
            problems.append(problem)
        else:
            return
    # The user can lift the limit `shortening`, so that failure is reported first.
    raise next((p for p in problems if isinstance(p, _ShortenedError)), problems[0])


def _separate(
    pieces: list[Piece], start: list[Piece], gap: float, limits: RepairLimits, diagonal: float, careful: bool
) -> None:
    """Separate the pieces, with a restart for each part that would lose too much.

    Args:
        pieces: pieces to replace by the result.
        start: pieces before any trimming.
        gap: distance left at mating faces [m].
        limits: limits above which to refuse.
        diagonal: diagonal of the furniture [m].
        careful: whether to prefer sockets to loss of size or of depth in joints.
    """
    weights = [1.0] * len(start)
    first: _TooMuchTrimmedError | None = None
    for _ in range(1 + RESTARTS):
        pieces[:] = [
            replace(piece, notes=list(piece.notes), weight=weight) for piece, weight in zip(start, weights, strict=True)
        ]
        try:
            _attempt(pieces, gap, limits, diagonal, careful)
        except _TooMuchTrimmedError as problem:
            first = first or problem
            weights[pieces.index(problem.piece)] *= HEAVIER
        except _ShortenedError:
            raise
        except FurnitureError:
            if first is None:
                raise
            break
        else:
            return
    if first is not None:
        raise first


def _attempt(pieces: list[Piece], gap: float, limits: RepairLimits, diagonal: float, careful: bool) -> None:
    were_touching = [(a, b) for a, b in combinations(pieces, 2) if _distance(a, b, gap) <= gap]
    _clear_all(pieces, gap, limits, careful)
    for _ in range(MAX_MOVES):
        islands = _islands(pieces)
        if len(islands) == 1:
            break
        _bring_closer(pieces, islands, gap, limits, diagonal)
        _clear_all(pieces, gap, limits, careful)
    else:
        message = f"parts are still not connected after {MAX_MOVES} moves; check the assembled poses"
        raise FurnitureError(message, _loose_names(pieces))
    # Openings only take more away, and they are the slowest step.
    check_sizes(pieces, limits)
    open_up(pieces, gap, limits)
    if len(_islands(pieces)) > 1:
        message = "parts came apart when their sockets were opened; check the assembled poses"
        raise FurnitureError(message, _loose_names(pieces))
    for a, b in were_touching:
        if not a.shell.is_within(b.shell, CONTACT_DISTANCE):
            for piece, other in ((a, b), (b, a)):
                piece.notes.append(f"no longer within {CONTACT_DISTANCE * 1e3:g} mm of '{other.name}'")


def check_sizes(pieces: list[Piece], limits: RepairLimits) -> None:
    """Check that no part became too small and no joint too shallow.

    Raises:
        FurnitureError: a part or joint exceeds the limit `shortening`; the message names the part.
    """
    bodies = {piece.name: piece.body for piece in pieces}
    worst: list[tuple[float, str, tuple[str, ...]]] = []
    for piece in pieces:
        worst.append((piece.shrinkage(piece.body), f"part '{piece.name}' would become {{}} mm smaller", (piece.name,)))
        for other, loss in piece.depth_losses(bodies, limits.shortening):
            text = f"part '{piece.name}' would sit {{}} mm less deep in '{other}'"
            worst.append((loss, text, (piece.name, other)))
    loss, text, names = max(worst)
    if loss > limits.shortening:
        raise _ShortenedError(
            f"{text.format(f'{1e3 * loss:.1f}')} for the parts to clear each other; at most "
            f"{1e3 * limits.shortening:.1f} mm is allowed (limit `shortening`, lifted by --allow-shortening)",
            names,
        )


def _distance(a: Piece, b: Piece, enough: float) -> float:
    """Return the distance of two pieces, 0 if they touch; `inf` if their boxes are more than `enough` apart [m]."""
    return a.shell.nearest(b.shell)[0] if a.shell.box_distance(b.shell) <= enough else float("inf")


@cached
def _shared_volume(first: m3.Manifold, second: m3.Manifold) -> float:
    return (first ^ second).volume()


def overlapping(pieces: Sequence[Piece], gap: float) -> list[tuple[int, int]]:
    """Return the pairs of pieces that overlap or are closer than half the gap, those that share most first."""
    found: list[tuple[float, int, int]] = []
    for i, j in combinations(range(len(pieces)), 2):
        a, b = pieces[i], pieces[j]
        if a.shell.box_distance(b.shell) > gap:
            continue
        shared = _shared_volume(a.body, b.body)
        if shared > 1e-12 or a.shell.is_within(b.shell, 0.5 * gap):
            found.append((-shared, i, j))
    return [(i, j) for _, i, j in sorted(found)]


def _clear_all(pieces: list[Piece], gap: float, limits: RepairLimits, careful: bool) -> None:
    close: list[tuple[Piece, Piece]] = []
    for attempt in range(ROUNDS):
        width = gap * (1.0 + 0.25 * attempt)
        overlaps = overlapping(pieces, gap)
        if not overlaps:
            return
        close = [(pieces[i], pieces[j]) for i, j in overlaps]
        for a, b in close:
            _clear_pair(a, b, width, limits, careful)
    a, b = close[0]
    raise FurnitureError(
        f"parts '{a.name}' and '{b.name}' still touch after {ROUNDS} rounds of trimming", (a.name, b.name)
    )


@dataclass(frozen=True, eq=False)
class _Choice:
    """Candidate cut that makes two pieces clear each other."""

    cost: float
    """Cost without the harm to sizes and joints."""
    trimmed: Piece
    cutter: Piece
    cut: Cut
    tip: Cut | None = None
    """Cut of the cutter that comes first, if the two share the loss."""
    may_go_beyond: bool = False
    """Whether the cut may take more than the overlap."""

    def harm_cost(self) -> float:
        """Return the cost of the loss of size, or of depth in joints."""
        if self.tip is not None:
            lost = harm(self.cutter, self.trimmed, self.tip.body, self.cut.body)
        else:
            lost = harm(self.trimmed, self.cutter, self.cut.body)
        beyond = lost <= HARM_LIMIT and self.may_go_beyond and _goes_beyond(self.trimmed, self.cutter, self.cut)
        return HARMFUL if beyond or lost > HARM_LIMIT else HARM_COST * lost / HARM_LIMIT

    def clears(self, gap: float) -> bool:
        """Return whether the cut leaves at least half of `gap`."""
        other = self.cutter.shell if self.tip is None else shell_of(self.tip.body)
        return not shell_of(self.cut.body).is_within(other, 0.5 * gap)

    def apply(self) -> None:
        """Apply the cut to the pieces."""
        piece, other, made = self.trimmed, self.cutter, self.cut
        if self.tip is not None:
            other.removed += self.tip.removed
            other.become(self.tip.body)
            other.notes.append(f"cut short where it sat too deep in '{piece.name}'")
        piece.removed += made.removed
        piece.become(made.body)
        if made.dropped:
            piece.notes.append(f"{made.dropped} slivers dropped where '{other.name}' cut it")
        if made.splits:
            piece.notes.append(f"cut through by '{other.name}', kept as one rigid part")
        if made.freedom < TRAPPED:
            piece.notes.append(f"has a socket for '{other.name}'")


def _clear_pair(a: Piece, b: Piece, gap: float, limits: RepairLimits, careful: bool) -> None:
    """Make two pieces clear each other with the cheapest cut of either."""
    choices: list[_Choice] = []
    worst: list[tuple[float, Piece]] = []
    for trimmed, cutter in ((a, b), (b, a)):
        for n, candidate in enumerate(_cuts(trimmed, cutter, gap)):
            share = (trimmed.removed + candidate.removed) / trimmed.whole
            if candidate.body.is_empty() or share > limits.trimmed:
                worst.append((share, trimmed))
                continue
            # The first cut takes only what is in the way, apart from plugs that come loose.
            choices.append(_Choice(_cost(trimmed, candidate, limits), trimmed, cutter, candidate, may_go_beyond=n > 0))
    # A shared cut changes both parts: it is tried only after a restart raised the weight of one.
    if max(a.weight, b.weight) > 1.0:
        choices += [choice for pair in ((a, b), (b, a)) for choice in _shared(*pair, gap, limits)]
    if not choices:
        share, piece = min(worst, key=lambda w: w[0])
        other = b if piece is a else a
        raise _TooMuchTrimmedError(
            piece,
            other,
            f"part '{piece.name}' would lose {share:.1%} of its volume to clear '{other.name}'; "
            f"at most {limits.trimmed:.1%} is allowed (limit `trimmed`)",
        )
    # A cut can fail to clear if a surface crosses itself, because no cut removes an inside-out region. Then the next
    # candidate is tried.
    ordered = _by_cost(choices, careful)
    first = next(ordered)
    next((choice for choice in chain((first,), ordered) if choice.clears(gap)), first).apply()


def _by_cost(choices: list[_Choice], careful: bool) -> Iterator[_Choice]:
    """Yield the cheapest choice first. If `careful`, harm adds to the cost; it is measured only when it may matter."""
    queue = [(choice.cost, n, not careful) for n, choice in enumerate(choices)]
    heapify(queue)
    while queue:
        cost, n, is_final = heappop(queue)
        if is_final:
            yield choices[n]
        else:
            heappush(queue, (cost + choices[n].harm_cost(), n, True))


def _cuts(trimmed: Piece, cutter: Piece, gap: float) -> list[Cut]:
    """Return candidate cuts of one piece alone."""
    cuts = [cut(trimmed.body, cutter.body, gap)]
    if cuts[0].freedom < 0.3:
        most = min(MAX_PLANE_SHARE * trimmed.whole, MAX_PLANE_RATIO * cuts[0].removed)
        flat = plane_cut(trimmed.body, cutter.body, gap)
        cuts += [candidate for candidate in flat if candidate.removed <= most and not candidate.splits]
    if max(candidate.freedom for candidate in cuts) < TRAPPED:
        flush = flush_cut(trimmed.body, cutter.body, gap)
        cuts += [flush] if flush is not None else []
    return cuts


def _shared(trimmed: Piece, cutter: Piece, gap: float, limits: RepairLimits) -> list[_Choice]:
    """Return candidates in which the cutter is shortened before it cuts."""
    out: list[_Choice] = []
    most = limits.trimmed * cutter.whole - cutter.removed
    for shared in shared_cuts(cutter.body, trimmed.body, gap, most):
        shares = [
            (piece.removed + candidate.removed) / piece.whole
            for piece, candidate in ((cutter, shared.tip), (trimmed, shared.socket))
        ]
        if max(shares) <= limits.trimmed and not shared.socket.body.is_empty():
            cost = cutter.weight * shares[0] / limits.trimmed + _cost(trimmed, shared.socket, limits)
            out.append(_Choice(cost, trimmed, cutter, shared.socket, shared.tip))
    return out


def _cost(piece: Piece, made: Cut, limits: RepairLimits) -> float:
    share = (piece.removed + made.removed) / piece.whole
    return piece.weight * share / limits.trimmed + 4.0 * (0.5 - min(0.5, made.freedom)) + 6.0 * made.splits


def _goes_beyond(trimmed: Piece, cutter: Piece, made: Cut) -> bool:
    """Return whether a cut takes more than the overlap: a tenon out of its socket, or the walls of a socket."""
    cut_volume = trimmed.body - made.body
    return (cut_volume - inflate(near(cutter.body, cut_volume, 20.0 * KEPT), KEPT)).volume() > BEYOND


def _islands(pieces: list[Piece]) -> list[list[int]]:
    left = set(range(len(pieces)))
    out: list[list[int]] = []
    while left:
        stack = [min(left)]
        island: list[int] = []
        left.discard(stack[0])
        while stack:
            p = stack.pop()
            island.append(p)
            joined = [q for q in sorted(left) if pieces[p].shell.is_within(pieces[q].shell, CONTACT_DISTANCE)]
            left -= set(joined)
            stack += joined
        out.append(sorted(island))
    return out


def _smallest(pieces: list[Piece], islands: list[list[int]]) -> list[int]:
    """Return the island with the least volume."""
    return min(islands, key=lambda island: (sum(pieces[p].whole for p in island), island))


def _loose_names(pieces: list[Piece]) -> list[str]:
    """Return the names of the pieces of the smallest island."""
    return [pieces[p].name for p in _smallest(pieces, _islands(pieces))]


def _bring_closer(
    pieces: list[Piece], islands: list[list[int]], gap: float, limits: RepairLimits, diagonal: float
) -> None:
    """Move the smallest island along the shortest line to the rest, up to the gap."""
    loose = _smallest(pieces, islands)
    best: tuple[float, np.ndarray, int, int] | None = None
    for p in loose:
        for q in sorted(set(range(len(pieces))) - set(loose)):
            if best is not None and pieces[p].shell.box_distance(pieces[q].shell) >= best[0]:
                continue
            distance, here, there = pieces[p].shell.nearest(pieces[q].shell)
            if best is None or distance < best[0]:
                best = (distance, there - here, p, q)
    if best is None:
        raise FurnitureError("there is nothing to bring the loose parts to; furniture has at least two parts")
    distance, way, p, q = best
    shift = way * (1.0 - gap / distance)
    for index in loose:
        piece = pieces[index]
        piece.moved = piece.moved + shift
        length = float(np.linalg.norm(piece.moved))
        if length > limits.displacement * diagonal:
            raise FurnitureError(
                f"part '{piece.name}' hangs {distance * 1e3:.1f} mm off '{pieces[q].name}'; to move it "
                f"{length * 1e3:.1f} mm is more than {limits.displacement:.1%} of the furniture's diagonal "
                "(limit `displacement`); move it in the files, or leave it out",
                (piece.name, pieces[q].name),
            )
        piece.become(piece.body.translate(tuple(shift.tolist())))
        piece.notes.append(f"moved {np.linalg.norm(shift) * 1e3:.1f} mm toward '{pieces[q].name}'")
