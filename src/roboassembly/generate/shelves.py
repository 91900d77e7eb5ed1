"""Shelves: boards housed between two sides, open with bars across the rear, or a bookcase with back, top and plinth.

All boards go into the sides along x, so they are between the sides before the second one is on. The bookcase's back
then slides down the grooves of its sides, and the top closes them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.bends import cut_out
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import rail
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
    block,
    mirrored_x,
    pad,
    rectangle,
    rounded_trapezoid,
    sweep,
    vector,
)


@dataclass(frozen=True)
class OpenShelfStyle:
    """Sizes in metres; the defaults are the catalogue model."""

    width: float = 0.60
    depth: float = 0.26
    height: float = 0.90
    side: float = 0.024
    """Thickness of the sides."""
    shelf: float = 0.020
    shelves: int = 4
    bars: int = 2
    """Across the rear."""
    lean: float = 0.0
    """How much shallower the sides are above than below."""


def sample_open(rng: np.random.Generator) -> OpenShelfStyle:
    """A shelf of 5 to 9 parts."""
    return OpenShelfStyle(
        width=rng.uniform(0.45, 0.80),
        depth=rng.uniform(0.24, 0.30),
        height=rng.uniform(0.70, 1.15),
        side=rng.uniform(0.022, 0.030),
        shelf=rng.uniform(0.018, 0.026),
        shelves=int(rng.integers(2, 6)),
        bars=int(rng.integers(1, 3)),
        lean=float(rng.choice([0.0, 0.0, 0.05])),
    )


def build_open(rng: np.random.Generator | None) -> list[Piece]:
    """An open shelf of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble_open(OpenShelfStyle() if rng is None else sample_open(rng))


def assemble_open(style: OpenShelfStyle) -> list[Piece]:
    """All pieces of one open shelf."""
    s = style
    inner = s.width / 2 - s.side
    front, rear = -s.depth / 2, s.depth / 2
    outline = [(front, 0.0), (front + 0.06, 0.0), (front + 0.075, 0.03), (rear - 0.075, 0.03), (rear - 0.06, 0.0),
               (rear, 0.0), (rear, s.height - 0.01), (rear - 0.01, s.height), (front + s.lean + 0.03, s.height),
               (front + s.lean + 0.008, s.height - 0.012), (front + s.lean, s.height - 0.04)]  # fmt: skip
    side = cut_out(np.array(outline), vector(inner + s.side / 2, 0, 0), Y, Z, s.side)
    depth = 0.4 * s.side
    board_depth = s.depth - s.lean - 0.055
    middle = vector(0, rear - 0.035 - board_depth / 2, 0.085)
    tongue = Tenon(0.82 * board_depth, 0.5 * s.shelf, depth)
    board = rail(middle - inner * X, middle + inner * X, Y, board_depth, s.shelf, tongue)
    levels = np.linspace(0.0, s.height - 0.085 - 0.06, s.shelves)
    pieces: list[Piece] = []
    for k, z in enumerate(levels):
        pieces.append(Piece(f"shelf_{k + 1}", "shelf", board, move(z=float(z))))
        side -= tongue.pocket(move(z=float(z)) * joint_frame(middle + inner * X, -X, Y))
    tenon = Tenon(0.030, 0.008, depth)
    bar: Solid | None = None
    places = [0.5 * (levels[k] + levels[k + 1]) + 0.085 for k in ((-2,) if s.bars == 1 else (0, -2))]
    if s.shelves == 2 and s.bars == 2:
        places = [0.085 + levels[1] * share for share in (0.3, 0.7)]
    for k, z in enumerate(places):
        start = vector(-inner, rear - 0.014, places[0])
        bar = bar or rail(start, start + 2 * inner * X, Z, 0.050, 0.016, tenon)
        pieces.append(Piece(f"back_bar_{k + 1}", "frame_bar", bar, move(z=float(z - places[0]))))
        side -= tenon.pocket(joint_frame(vector(inner, rear - 0.014, float(z)), -X, Z))
    return [*pieces, Piece("side_left", "frame_board", side), Piece("side_right", "frame_board", mirrored_x(side))]


@dataclass(frozen=True)
class BookcaseStyle:
    """Sizes in metres; the defaults are the catalogue model."""

    width: float = 0.62
    depth: float = 0.28
    height: float = 0.92
    board: float = 0.022
    """Thickness of all boards but the back."""
    shelves: int = 2
    """Between bottom and top."""
    plinth: float = 0.07
    backs: int = 1
    """Boards that the back is made of, one above the other."""
    cornice: float = 0.012
    """How far the top sticks out in front and at the sides."""


def sample_bookcase(rng: np.random.Generator) -> BookcaseStyle:
    """A bookcase of 7 to 11 parts."""
    return BookcaseStyle(
        width=rng.uniform(0.45, 0.80),
        depth=rng.uniform(0.25, 0.33),
        height=rng.uniform(0.70, 1.15),
        board=rng.uniform(0.021, 0.028),
        shelves=int(rng.integers(1, 5)),
        plinth=rng.uniform(0.05, 0.09),
        backs=int(rng.integers(1, 3)),
        cornice=rng.uniform(0.0, 0.02),
    )


def build_bookcase(rng: np.random.Generator | None) -> list[Piece]:
    """A bookcase of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble_bookcase(BookcaseStyle() if rng is None else sample_bookcase(rng))


BACK = 0.009
GROOVE = 0.008
TOP_TENON = Tenon(0.060, 0.008, 0.010)


def assemble_bookcase(style: BookcaseStyle) -> list[Piece]:
    """All pieces of one bookcase."""
    s, c = style, CLEARANCE
    inner, t = s.width / 2 - s.board, s.board
    front, rear = -s.depth / 2, s.depth / 2
    under = s.height - t
    side = block((inner, front, 0), (inner + t, rear, under - c))
    groove_y = rear - 0.020
    tongue_depth = 0.4 * t
    pieces: list[Piece] = []
    # Bottom and shelves: the same boards.
    shelf_rear = groove_y - BACK / 2 - 0.009
    board_depth = shelf_rear - (front + 0.004)
    middle = vector(0, shelf_rear - board_depth / 2, s.plinth + c + t / 2 + 0.009)
    tongue = Tenon(0.85 * board_depth, 0.5 * t, tongue_depth)
    board = rail(middle - inner * X, middle + inner * X, Y, board_depth, t, tongue, 0.002)
    pitch = (under - middle[2]) / (s.shelves + 1)
    for k in range(s.shelves + 1):
        name = "bottom" if k == 0 else f"shelf_{k}"
        pieces.append(Piece(name, "shelf", board, move(z=k * pitch)))
        side -= tongue.pocket(joint_frame(middle + inner * X + k * pitch * Z, -X, Y))
    at = vector(0, front + 0.030, s.plinth / 2)
    tenon = Tenon(0.55 * s.plinth, 0.008, tongue_depth)
    pieces.append(
        Piece("plinth", "frame_board", rail(at - inner * X, at + inner * X, Z, s.plinth - 0.004, 0.018, tenon))
    )
    side -= tenon.pocket(joint_frame(at + inner * X, -X, Z))
    # The back in the sides' grooves, which the top closes.
    low = s.plinth + 0.004
    slot = Tenon(under - low, BACK, GROOVE)
    for lift in (0.0, 0.03):
        side -= slot.pocket(joint_frame(vector(inner, groove_y, (low + under) / 2 + lift), -X, Z))
    tall = (under - c - low - (s.backs - 1) * c) / s.backs
    start = vector(0, groove_y, low + tall / 2)
    ends = (inner + GROOVE) * X
    back = sweep([start - ends, start + ends], Y, Z, rectangle(BACK, tall, 0.001))
    for k in range(s.backs):
        name = "back" if s.backs == 1 else f"back_{k + 1}"
        pieces.append(Piece(name, "back_panel", back, move(z=k * (tall + c))))
    wide, deep = s.width + 2 * s.cornice, s.depth + s.cornice
    outline = rounded_trapezoid(wide, wide, deep, 0.004) + np.array([0.0, -s.cornice / 2])
    top = pad(outline, under, s.height, 0.004)
    for x in (-inner - 0.5 * t, inner + 0.5 * t):
        peg = joint_frame(vector(x, -0.02, under), -Z, Y)
        top -= TOP_TENON.pocket(peg)
        if x > 0:
            side += TOP_TENON.tongue(peg)
    pieces.append(Piece("top", "top_panel", top))
    return [*pieces, Piece("side_left", "frame_board", side), Piece("side_right", "frame_board", mirrored_x(side))]
