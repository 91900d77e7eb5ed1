"""Frames to practise on: posts on a grid, rails between them, spindles or panels between rails, boards on top.

Not furniture that anybody would buy, but every joint and every kind of being in each other's way that furniture has,
in combinations that no other family shows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.model import MAX_PARTS
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail, spindle
from roboassembly.generate.solids import Solid, X, Y, Z, block, placed, rectangle, sweep, turn, turned, vector
from roboassembly.geometry.poses import SE3

_LEVEL = 0.085
"""Metres between the heights at which rails may stand, so that those from two sides keep out of each other's way."""
_ROUND = RoundTenon(radius=0.0075, length=0.012, sides=10)
_PEG = RoundTenon(radius=0.006, length=0.010, sides=10)
_BUTT = RoundTenon(radius=0.0075, length=-CLEARANCE, sides=10)
"""For bars that end a clearance before the face."""
_NONE = Tenon(0.004, 0.004, -0.002, root=0.006)
"""A tongue that does not come out of its rail."""


@dataclass(frozen=True)
class LatticeStyle:
    """One frame, metres."""

    posts: tuple[int, int] = (2, 2)
    """Along x and y."""
    width: float = 0.40
    """Between neighbouring posts' axes along x."""
    depth: float = 0.34
    height: float = 0.55
    post: float = 0.036
    """Side of a square post, or diameter of a round one."""
    round_posts: bool = False
    edges: tuple[tuple[int, int, str, int, int, str], ...] = (
        (0, 0, "x", 2, 4, "spindles"), (0, 1, "x", 2, 4, "none"), (0, 0, "y", 1, 1, "none"), (1, 0, "y", 1, 1, "none"),
    )  # fmt: skip
    """Rows of rails: the post at which one begins, its axis, its lowest and highest level, and what fills it."""
    round_rails: bool = False
    rail: float = 0.036
    """Height of a square rail."""
    fill: int = 3
    """Spindles between two rails."""
    top: bool = True
    base: bool = False
    slats: int = 0
    """Laid across the lowest rails along x, if there are two rows of posts."""
    pegs: int = 0
    board: float = 0.022
    """Thickness of boards."""
    butted: bool = False
    """No tenons: rails, spindles and posts end at the face that they meet."""
    lean: tuple[float, float] = (0.0, 0.0)
    """Radians about x and y by which the whole leans."""


def sample(rng: np.random.Generator) -> LatticeStyle:
    """A frame of 4 to 18 parts."""
    while True:
        posts = ((2, 1), (2, 1), (2, 2), (2, 2), (3, 1), (3, 2))[rng.integers(6)]
        height = rng.uniform(0.3, 0.95)
        levels = int((height - 0.12) / _LEVEL)
        edges: list[tuple[int, int, str, int, int, str]] = []
        for axis in "xy":
            for i in range(posts[0] - (axis == "x")):
                for j in range(posts[1] - (axis == "y")):
                    if rng.random() < 0.85:
                        # Even levels along x, odd ones along y.
                        own = [k for k in range(levels) if k % 2 == (axis == "y")]
                        if not own:
                            continue
                        low, high = sorted(map(int, rng.choice(own, 2)))
                        edges.append((i, j, axis, low, high, str(rng.choice(["none", "none", "spindles", "panel"]))))
        if edges and rng.random() < 0.6:
            # Opposite sides are often alike.
            edges = [(i, j, a, *next(e[3:] for e in edges if e[2] == a)) for i, j, a, *_ in edges]
        style = LatticeStyle(
            posts=posts,
            width=rng.uniform(0.18, 0.55),
            depth=rng.uniform(0.18, 0.5),
            height=height,
            post=rng.uniform(0.032, 0.05),
            round_posts=bool(rng.random() < 0.3),
            edges=tuple(edges),
            round_rails=bool(rng.random() < 0.3),
            rail=rng.uniform(0.03, 0.06),
            fill=int(rng.integers(1, 5)),
            top=bool(rng.random() < 0.6),
            base=bool(rng.random() < 0.25),
            slats=int(rng.choice([0, 0, 1, 2, 3, 4])),
            pegs=int(rng.choice([0, 0, 0, 1, 2, 3])),
            board=rng.uniform(0.015, 0.035),
            butted=bool(rng.random() < 0.4),
            lean=(rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4)) if rng.random() < 0.35 else (0.0, 0.0),
        )
        pieces = assemble(style)
        if 4 <= len(pieces) <= min(18, MAX_PARTS) and abs(style.width - style.depth) > 0.02 and _held(style):
            return style


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A frame of the style drawn from `rng`, or the default one."""
    return assemble(LatticeStyle() if rng is None else sample(rng))


def _held(s: LatticeStyle) -> bool:
    """Whether everything hangs together."""
    if s.top or s.base:
        return True
    joined = {(0, 0)}
    for _ in s.edges:
        for i, j, axis, *_rest in s.edges:
            ends = {(i, j), (i + (axis == "x"), j + (axis == "y"))}
            if ends & joined:
                joined |= ends
    return len(joined) == s.posts[0] * s.posts[1]


@dataclass(eq=False)
class _Making:
    """What has been decided so far."""

    style: LatticeStyle
    cuts: dict[tuple[int, int], list[Solid]] = field(default_factory=dict)
    """Mortises of each post, in the furniture's frame."""
    pieces: list[Piece] = field(default_factory=list)
    shared: dict[tuple[object, ...], Solid] = field(default_factory=dict)
    """Solids about the place of their first use, by what they are."""

    def at(self, i: int, j: int) -> Float[np.ndarray, "3"]:
        """Foot of a post's axis."""
        return vector(i * self.style.width, j * self.style.depth, 0.0)

    def once(self, key: tuple[object, ...], solid: Solid) -> Solid:
        """The same solid for the same key: its parts are interchangeable."""
        return self.shared.setdefault(key, solid)


def assemble(style: LatticeStyle) -> list[Piece]:
    """All pieces of one style."""
    m = _Making(style, {(i, j): [] for i in range(style.posts[0]) for j in range(style.posts[1])})
    for edge in style.edges:
        _row(m, *edge)
    if style.slats and style.posts[1] == 2:
        _slats(m)
    for k in range(min(style.pegs, len(m.cuts))):
        _peg(m, k)
    _posts_and_boards(m)
    lean = SE3(turn(X, style.lean[0]) @ turn(Y, style.lean[1]), np.zeros(3))
    return [replace(piece, pose=lean * piece.pose) for piece in m.pieces]


def _height_of(level: int) -> float:
    return 0.08 + level * _LEVEL


def _row(m: _Making, i: int, j: int, axis: str, low: int, high: int, fill: str) -> None:
    """Rails between two posts at one or two heights, and what is between the rails."""
    s = m.style
    run = X if axis == "x" else Y
    here, there = (i, j), (i + (axis == "x"), j + (axis == "y"))
    # Tenons start inside a round post's rim; what is butted stops at its foremost line.
    half = 0.46 * s.post if s.round_posts and not s.butted else s.post / 2
    levels = sorted({low, high})
    filled = len(levels) == 2 and fill != "none" and not s.round_rails
    length = float((m.at(*there) - m.at(*here)) @ run) - 2 * half
    tenon = Tenon(0.6 * s.rail, 0.010, 0.28 * s.post)
    for index, level in enumerate(levels):
        z = _height_of(level)
        start, end = m.at(*here) + half * run + z * Z, m.at(*there) - half * run + z * Z
        shape = _ROUND if s.round_rails else tenon
        if not s.butted:
            for post, frame in zip((here, there), mouths(start, end, Z), strict=True):
                m.cuts[post].append(shape.pocket(frame, over=0.01))
        origin = vector(0, 0, 0)
        if s.round_rails:
            solid = spindle(origin, length * run, Z, 0.0105, _BUTT if s.butted else _ROUND, free=0.02)
        else:
            # Shoulders stand off a round post's rim.
            solid = rail(origin, length * run, Z, s.rail, 0.020, _NONE if s.butted else tenon)
            if s.round_posts and not s.butted:
                solid = _trimmed(solid, run, length, 0.5 * s.post - half + CLEARANCE)
            if filled and not s.butted:
                solid -= _fill_pockets(s, run, length, 1 if index == 0 else -1, fill)
        key = (axis, s.round_rails, filled and (fill, index))
        name = f"rail_{axis}{i}{j}_{level}"
        m.pieces.append(Piece(name, "bar_stretcher", m.once(key, solid), move(*start)))
    if filled:
        base = m.at(*here) + half * run
        _fill(m, run, length, base, _height_of(levels[0]), _height_of(levels[1]), fill, f"{axis}{i}{j}")


def _trimmed(solid: Solid, run: Float[np.ndarray, "3"], length: float, by: float) -> Solid:
    """A rail whose shoulders, not its tenons, end `by` metres earlier."""
    across = np.abs(np.cross(run, Z))
    out = solid
    for start in (0.0, length - by):
        ends = np.array([start * run, (start + by) * run])
        wide = np.array([[-1.0], [1.0]]) * (0.1 * across + 0.1 * Z)
        tenon = np.array([[-1.0], [1.0]]) * (0.005 * across + 0.009 * Z)
        collar = block(*(ends + wide).tolist()) - block(*(ends + tenon).tolist())
        out -= collar
    return out


def _places(s: LatticeStyle, length: float) -> list[float]:
    return [length * (k + 1) / (s.fill + 1) for k in range(s.fill)]


def _fill_pockets(s: LatticeStyle, run: Float[np.ndarray, "3"], length: float, side: int, fill: str) -> Solid:
    """What the filling takes out of a rail whose middle line begins at the origin; `side` 1 for its upper face."""
    face = side * (s.rail / 2) * Z
    if fill == "panel":
        groove = Tenon(0.7 * length, 0.007, 0.008)
        return groove.pocket(joint_frame(0.5 * length * run + face, side * Z, run))
    out = Solid()
    for d in _places(s, length):
        out += _PEG.pocket(joint_frame(d * run + face, side * Z, run))
    return out


def _fill(
    m: _Making, run: Float[np.ndarray, "3"], length: float, base: Float[np.ndarray, "3"], low: float, high: float,
    fill: str, name: str,
) -> None:  # fmt: skip
    s = m.style
    rise = high - low - s.rail
    bottom = base + (low + s.rail / 2) * Z
    key = (fill, tuple(run), round(rise, 6))
    if fill == "panel":
        groove = Tenon(0.7 * length, 0.007, 0.008)
        ends = [CLEARANCE * Z, (rise - CLEARANCE) * Z]
        solid = sweep(ends, run, np.cross(Z, run), rectangle(0.7 * length, 0.012))
        if not s.butted:
            solid += groove.tongue(joint_frame(vector(0, 0, 0), Z, run))
            solid += groove.tongue(joint_frame(rise * Z, -Z, run))
        middle = bottom + 0.5 * length * run
        m.pieces.append(Piece(f"panel_{name}", "back_single_surface", m.once(key, solid), move(*middle)))
        return
    solid = spindle(vector(0, 0, 0), rise * Z, run, 0.008, _BUTT if s.butted else _PEG)
    for k, d in enumerate(_places(s, length)):
        m.pieces.append(
            Piece(f"spindle_{name}_{k}", "back_surface_vertical_bar", m.once(key, solid), move(*(bottom + d * run)))
        )


def _slats(m: _Making) -> None:
    """Boards laid across two rails along x that stand at the same height at front and back."""
    s = m.style
    rows = {(i, j): low for i, j, axis, low, _, _ in s.edges if axis == "x"}
    if s.round_rails or rows.get((0, 0)) is None or rows.get((0, 0)) != rows.get((0, 1)):
        return
    own = [e for e in s.edges if e[2] == "x" and e[0] == 0]
    if any(e[5] != "none" and e[4] > e[3] for e in own):
        return
    room = s.width - s.post - 0.01
    each = room / s.slats
    z = _height_of(rows[0, 0]) + s.rail / 2 + CLEARANCE
    reach = 0.011
    solid = block((-0.4 * each, -reach, 0.0), (0.4 * each, s.depth + reach, 0.012))
    for k in range(s.slats):
        x = s.post / 2 + 0.005 + (k + 0.5) * each
        m.pieces.append(Piece(f"slat_{k}", "seat_frame_bar", solid, move(x, 0.0, z)))


def _peg(m: _Making, k: int) -> None:
    """A knob on the outer face of a post."""
    s = m.style
    post = sorted(m.cuts)[k % len(m.cuts)]
    half = s.post / 2 if not s.round_posts else 0.46 * s.post
    z = min(_height_of(2 * (k + 1)) + 0.5 * _LEVEL, s.height - 0.06)
    side = -1 if post[0] == 0 else 1
    at = m.at(*post) + side * half * X + z * Z
    m.cuts[post].append(_PEG.pocket(joint_frame(at, side * X, Z), over=0.01))
    solid = _PEG.tongue(joint_frame(vector(0, 0, 0), side * X, Z))
    solid += placed(turned([(0.0025, 0.006), (0.02, 0.012), (0.03, 0.010)]), joint_frame(vector(0, 0, 0), side * X, Z))
    m.pieces.append(Piece(f"peg_{k}", "arm_knob", m.once(("peg", side), solid), move(*at)))


def _posts_and_boards(m: _Making) -> None:
    s = m.style
    tenon = RoundTenon(radius=0.3 * s.post, length=0.6 * s.board)
    bottom, top = (s.board + CLEARANCE if s.base else 0.0), s.height
    end = top - CLEARANCE if s.top else top
    margin = 0.6 * s.post + 0.01
    far = m.at(s.posts[0] - 1, s.posts[1] - 1)
    boards = {}
    if s.top:
        boards["top"] = block((-margin, -margin, top), (far[0] + margin, far[1] + margin, top + s.board))
    if s.base:
        boards["base"] = block((-margin, -margin, 0.0), (far[0] + margin, far[1] + margin, s.board))
    for (i, j), cuts in m.cuts.items():
        if s.round_posts:
            blank = turned([(bottom, s.post / 2), (end, s.post / 2)], 16)
        else:
            blank = sweep([bottom * Z, end * Z], X, Y, rectangle(s.post, s.post, 0.003))
        if s.top and not s.butted:
            blank += tenon.tongue(joint_frame(top * Z, -Z, X))
            boards["top"] -= tenon.pocket(joint_frame(top * Z + m.at(i, j), -Z, X))
        if s.base and not s.butted:
            blank += tenon.tongue(joint_frame(s.board * Z, Z, X))
            boards["base"] -= tenon.pocket(joint_frame(s.board * Z + m.at(i, j), Z, X))
        here = move(*m.at(i, j))
        for cut in cuts:
            blank -= placed(cut, here.inverse())
        m.pieces.append(Piece(f"post_{i}{j}", "leg", blank, here))
    m.pieces.extend(Piece(name, "seat_single_surface", solid) for name, solid in boards.items())
