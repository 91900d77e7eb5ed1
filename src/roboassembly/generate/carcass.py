"""Boxes to practise on: boards between, on and behind boards, butted or housed, on feet or on the floor.

Like `lattice` no furniture of its own, but what shelves, cabinets, drawers and benches have in common.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import Solid, X, Y, Z, block, turn, turned, vector
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class CarcassStyle:
    """One box, metres; x across, y from front to back."""

    width: float = 0.8
    height: float = 1.0
    depth: float = 0.3
    board: float = 0.018
    bays: tuple[float, ...] = (1.0,)
    """Shares of the width between the sides; there is a divider between any two."""
    shelves: tuple[tuple[float, ...], ...] = ((0.35, 0.7),)
    """Heights of each bay's shelves, shares of the room."""
    top_over: bool = True
    """The top lies on the sides, not between them."""
    bottom_under: bool = False
    back: bool = True
    """A board behind everything."""
    rails: int = 0
    """Bars between the sides at the back, where there is no board."""
    feet: bool = False
    housing: float = 0.0
    """How deep shelves go into the sides; 0 for butted ones."""
    shelf_depth: float = 1.0
    """Share of the depth, from the back."""
    lean: float = 0.0
    """Radians about x by which the whole leans."""


def sample(rng: np.random.Generator) -> CarcassStyle:
    """A box of 4 to 18 parts."""
    while True:
        bays = int(rng.choice([1, 1, 1, 2, 2, 3]))
        shares = rng.dirichlet(np.full(bays, 6.0)) if rng.random() < 0.5 else np.full(bays, 1.0 / bays)
        levels = [tuple(_levels(rng, int(rng.integers(0, 4)))) for _ in range(bays)]
        if rng.random() < 0.5:
            levels = [levels[0]] * bays
        back = bool(rng.random() < 0.5)
        style = CarcassStyle(
            width=rng.uniform(0.25, 1.4),
            height=rng.uniform(0.2, 1.7),
            depth=rng.uniform(0.15, 0.55),
            board=rng.uniform(0.012, 0.035),
            bays=tuple(map(float, shares)),
            shelves=tuple(levels),
            top_over=bool(rng.random() < 0.6),
            bottom_under=bool(rng.random() < 0.4),
            back=back,
            rails=0 if back else int(rng.integers(0, 3)),
            feet=bool(rng.random() < 0.3),
            housing=float(rng.choice([0.0, 0.0, 0.35, 0.45])),
            shelf_depth=float(rng.choice([1.0, 1.0, 0.8, 0.6])),
            lean=rng.uniform(-0.3, 0.3) if rng.random() < 0.2 else 0.0,
        )
        narrow = min(style.bays) * style.width < 0.1
        crowded = any(len(own) > 1 and min(np.diff(own)) * style.height < 0.08 for own in levels)
        if not (narrow or crowded) and style.height > 0.12 + 3 * style.board and 4 <= len(assemble(style)) <= 18:
            return style


def _levels(rng: np.random.Generator, count: int) -> list[float]:
    even = [(k + 1) / (count + 1) for k in range(count)]
    return even if rng.random() < 0.6 else [h + rng.uniform(-0.08, 0.08) for h in even]


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A box of the style drawn from `rng`, or the default one."""
    return assemble(CarcassStyle() if rng is None else sample(rng))


@dataclass(eq=False)
class _Making:
    style: CarcassStyle
    pieces: list[Piece] = field(default_factory=list)
    grooves: dict[int, list[Solid]] = field(default_factory=dict)
    """Of each upright, in the furniture's frame."""
    shared: dict[tuple[float, ...], Solid] = field(default_factory=dict)

    def board(self, name: str, label: str, low: np.ndarray, high: np.ndarray) -> None:
        """A box; boards of one size are interchangeable."""
        size = tuple(np.round(high - low, 6).tolist())
        solid = self.shared.setdefault(size, block((0.0, 0.0, 0.0), size))
        self.pieces.append(Piece(name, label, solid, move(*low)))


def assemble(style: CarcassStyle) -> list[Piece]:
    """All pieces of one style."""
    s, m, c = style, _Making(style), CLEARANCE
    foot = 0.06 if s.feet else 0.0
    low = foot + (s.board + c if s.bottom_under else 0.0)
    high = s.height - (s.board + c if s.top_over else 0.0)
    # Left faces of the uprights: two sides and the dividers between them.
    inner = s.width - (len(s.bays) + 1) * s.board
    lefts = np.concatenate([[0.0], np.cumsum([share * inner + s.board for share in s.bays])])
    for index in range(len(lefts)):
        m.grooves[index] = []
    floor = low if s.bottom_under else low + 0.04 + s.board
    ceiling = high if s.top_over else high - s.board
    for bay in range(len(s.bays)):
        heights = [floor + share * (ceiling - floor) for share in s.shelves[bay]]
        if not s.bottom_under:
            heights.append(low + 0.04)
        if not s.top_over:
            heights.append(high - s.board)
        for k, z in enumerate(heights):
            full = k >= len(s.shelves[bay])
            _between(m, f"shelf_{bay}_{k}", bay, lefts, z, 1.0 if full else s.shelf_depth)
    for k in range(s.rails):
        z = floor + (k + 0.5) * (ceiling - floor) / s.rails
        solid = (lefts[0] + s.board + c, 0.2 * s.depth, z), (lefts[-1] - c, 0.2 * s.depth + 0.02, z + 0.05)
        if len(s.bays) == 1 and all(abs(z - h) > 0.12 for h in _shelf_heights(s, floor, ceiling)):
            m.board(f"rail_{k}", "bar", np.array(solid[0]), np.array(solid[1]))
    for index, left in enumerate(lefts):
        corner = np.array([left, 0.0, low])
        upright = block(corner.tolist(), (corner + vector(s.board, s.depth, high - low)).tolist())
        for groove in m.grooves[index]:
            upright -= groove
        m.pieces.append(Piece(f"upright_{index}", "board", upright))
    if s.top_over:
        m.board("top", "board", vector(0, 0, high + c), vector(s.width, s.depth, s.height))
    if s.bottom_under:
        m.board("bottom", "board", vector(0, 0, foot), vector(s.width, s.depth, foot + s.board))
    if s.back:
        m.board("back", "board", vector(0, s.depth + c, low), vector(s.width, s.depth + c + 0.008, high))
    if s.feet:
        _feet(m, foot, lefts)
    lean = SE3(turn(X, s.lean), np.zeros(3))
    return [replace(piece, pose=lean * piece.pose) for piece in m.pieces]


def _shelf_heights(s: CarcassStyle, floor: float, ceiling: float) -> list[float]:
    return [floor + share * (ceiling - floor) for bay in s.shelves for share in bay]


def _between(m: _Making, name: str, bay: int, lefts: np.ndarray, z: float, depth: float) -> None:
    """A board between two uprights, in grooves that are open at the front, or butted."""
    s, c = m.style, CLEARANCE
    deep = s.housing * s.board / (2 if len(s.bays) > 1 else 1)
    if deep < 0.004:
        deep = 0.0
    start, end = float(lefts[bay]) + s.board, float(lefts[bay + 1])
    y = (1.0 - depth) * s.depth
    body = np.array([[start + c - deep, y, z], [end - c + deep, s.depth, z + s.board]])
    if deep:
        for index, x, out in ((bay, start, X), (bay + 1, end, -X)):
            # From the front edge, or the shelf could not come in where a back closes the other way.
            frame = joint_frame(vector(x, s.depth / 2, z + s.board / 2), out, Y)
            m.grooves[index].append(Tenon(s.depth + 0.02, s.board, deep).pocket(frame))
    m.board(name, "shelf", body[0], body[1])


def _feet(m: _Making, foot: float, lefts: np.ndarray) -> None:
    """Round feet, under the bottom board or under the sides."""
    s, c = m.style, CLEARANCE
    r = 0.022 if s.bottom_under else max(0.008, 0.8 * s.board)
    inset = 0.04 if s.bottom_under else s.board / 2
    pin = RoundTenon(radius=0.3 * r, length=0.008, sides=10) if s.bottom_under and s.board > 0.014 else None
    solid = turned([(0.0, 0.8 * r), (foot - c, r)], 14)
    if pin is not None:
        solid += pin.tongue(joint_frame(foot * Z, -Z, X))
    places = [(x, y) for x in (inset, s.width - inset) for y in (0.04, s.depth - 0.04)]
    for k, (x, y) in enumerate(places):
        m.pieces.append(Piece(f"foot_{k}", "foot", solid, move(x, y, 0.0)))
        if pin is not None:
            _drill(m, pin.pocket(joint_frame(vector(x, y, foot), -Z, X)))


def _drill(m: _Making, hole: Solid) -> None:
    """Take a hole out of the bottom board, which is then a part of its own."""
    index = next(i for i, p in enumerate(m.pieces) if p.name == "bottom")
    bottom = m.pieces[index]
    m.pieces[index] = replace(bottom, solid=bottom.solid - hole.translate(tuple((-bottom.pose.translation).tolist())))
