"""The throne: two boards from floor to armrest stand at the sides, everything else is held between them.

Seat and front board have tongues in the sides, along x; the back slides down the sides' leaning grooves, and the
crest on top of the sides closes them. A crest that is on both sides before the back is in shuts it out, and so do
two sides before the seat is between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import cut_out
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
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
class ThroneStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.52
    """Over the outer faces of the sides."""
    depth: float = 0.52
    side: float = 0.030
    """Thickness of a side."""
    seat_height: float = 0.44
    seat_thickness: float = 0.030
    height: float = 0.92
    arm: float = 0.20
    """Height of the armrests above the seat."""
    rake: float = 0.14
    window: bool = True
    """An opening in each side, below the seat."""
    boards: int = 1
    """That the back is made of."""
    front: bool = True
    """A board below the seat's front."""
    cushion: bool = False


def sample(rng: np.random.Generator) -> ThroneStyle:
    """A style of 5 to 8 parts."""
    return ThroneStyle(
        width=rng.uniform(0.49, 0.60),
        depth=rng.uniform(0.47, 0.56),
        side=rng.uniform(0.026, 0.036),
        seat_height=rng.uniform(0.40, 0.45),
        seat_thickness=rng.uniform(0.026, 0.045),
        height=rng.uniform(0.80, 1.05),
        arm=rng.uniform(0.17, 0.23),
        rake=rng.uniform(0.10, 0.20),
        window=bool(rng.random() < 0.6),
        boards=int(rng.choice([1, 1, 2])),
        front=bool(rng.random() < 0.6),
        cushion=bool(rng.random() < 0.3),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A throne of the style drawn from `rng`, or the catalogue model with 6 parts."""
    return assemble(ThroneStyle() if rng is None else sample(rng))


GROOVE = 0.011
BOARD = 0.014
CREST_TENON = Tenon(0.040, 0.009, 0.018)


def assemble(style: ThroneStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    inner = s.width / 2 - s.side
    under = s.seat_height - s.seat_thickness
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    across = np.cross(X, along)  # forward and up: toward the sitter is -y
    # The back's middle plane crosses the seat's height here.
    heel = vector(0, s.depth / 2 - 0.095, s.seat_height)
    crest_height = 0.055
    reach = (s.height - s.seat_height) / along[2] - crest_height
    side = _side(s, inner, heel, along, reach)
    pieces: list[Piece] = []

    # Seat and front board.
    front, rear = -s.depth / 2 + 0.012, heel[1] - 0.024
    seat_outline = rounded_trapezoid(2 * (inner - c), 2 * (inner - c), rear - front, 0.012)
    seat_outline = seat_outline + np.array([0.0, (front + rear) / 2])
    seat = pad(seat_outline, under, s.seat_height, 0.006, under=0.003)
    tongues = [(Tenon(0.75 * (rear - front), 0.014, GROOVE), vector(inner, (front + rear) / 2, under + 0.013), Y)]
    added = _both(tongues[0])
    seat += added
    if s.front:
        high = under - 0.012
        low = max(0.10, high - 0.20)
        tongues.append((Tenon(0.6 * (high - low), 0.010, GROOVE), vector(inner, front + 0.045, (high + low) / 2), Z))
        board = block((-inner + c, front + 0.035, low), (inner - c, front + 0.055, high)) + _both(tongues[1])
        pieces.append(Piece("front_board", "seat_frame_bar", board))
    for tongue, mouth, width in tongues:
        side -= tongue.pocket(joint_frame(mouth, -X, width))

    # The back slides down along the slope; its ends are the tongues.
    low = 0.030 / along[2]
    slot = Tenon(reach - low, BOARD, GROOVE)
    for lift in (0.0, 0.03):
        side -= slot.pocket(joint_frame(heel + inner * X + ((low + reach) / 2 + lift) * along, -X, along))
    tall = (reach - c - low - (s.boards - 1) * c) / s.boards
    ends = inner + GROOVE
    middle = heel + (low + tall / 2) * along
    back = sweep([middle - ends * X, middle + ends * X], along, across, rectangle(tall, BOARD, 0.002))
    for k in range(s.boards):
        name = "back" if s.boards == 1 else f"back_{k + 1}"
        pieces.append(Piece(name, "back_single_surface", back, move(*(k * (tall + c) * along))))

    crest = _crest(s, heel + reach * along, along, across, crest_height)
    # Beside the groove, so that the tongue's root does not close it.
    for x in (inner + GROOVE + 0.0075, -inner - GROOVE - 0.0075):
        peg = joint_frame(heel + reach * along + x * X, -along, across)
        crest -= CREST_TENON.pocket(peg)
        if x > 0:
            side += CREST_TENON.tongue(peg)
    pieces.append(Piece("crest_rail", "back_frame_horizontal_bar", crest))
    if s.cushion:
        shape = rounded_trapezoid(2 * inner - 0.03, 2 * inner - 0.03, rear - front - 0.03, 0.03)
        low_z = s.seat_height + c
        cushion = pad(shape + np.array([0.0, (front + rear) / 2]), low_z, low_z + 0.035, 0.012, 0.014, under=0.008)
        pieces.append(Piece("cushion", "seat_soft_surface", cushion))
    pieces += [Piece("side_left", "arm_sofa_style", side), Piece("side_right", "arm_sofa_style", mirrored_x(side))]
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _both(tongue: tuple[Tenon, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]) -> Solid:
    """A tongue into the left-hand side, and one into the other."""
    tenon, mouth, width = tongue
    left = tenon.tongue(joint_frame(mouth, -X, width))
    return left + mirrored_x(left)


def _side(
    s: ThroneStyle, inner: float, heel: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], reach: float
) -> Solid:
    """The left side: a board with feet, an armrest's level edge, and a stile that leans to the crest."""
    arm = s.seat_height + s.arm
    slope = np.array([along[1], along[2]])
    normal = np.array([along[2], -along[1]])
    base = np.array([heel[1], heel[2]])
    stile = 0.038
    top = base + reach * slope

    def at(offset: float, z: float) -> tuple[float, float]:
        """The point of the stile's edge at `offset` in front of (+) or behind (-) its middle, at the height z."""
        point = base - offset * normal
        return float(point[0] + (z - point[1]) * slope[0] / slope[1]), z

    front, rear = -s.depth / 2, s.depth / 2
    outline = [
        (front + 0.010, 0.0), (front + 0.085, 0.0), (front + 0.100, 0.045), (rear - 0.115, 0.045), (rear - 0.10, 0.0),
        (rear - 0.02, 0.0), at(-stile, s.seat_height), tuple(top + stile * normal), tuple(top - stile * normal),
        at(stile, arm + 0.05), (at(stile, arm + 0.015)[0] - 0.010, arm + 0.012), (at(stile, arm)[0] - 0.045, arm),
        (front + 0.035, arm), (front + 0.006, arm - 0.012), (front - 0.006, arm - 0.045), (front, s.seat_height),
    ]  # fmt: skip
    holes = []
    if s.window:
        low, high = 0.11, s.seat_height - 0.13
        wide = np.array([front + 0.10, rear - 0.12])
        holes = [np.array([(wide[0], low), (wide[1], low), (wide[1] - 0.01, high), (wide[0] + 0.01, high)])]
    return cut_out(np.array(outline), vector(inner + s.side / 2, 0, 0), Y, Z, s.side, holes)


def _crest(
    s: ThroneStyle,
    base: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    across: Float[np.ndarray, "3"],
    height: float,
) -> Solid:
    """The crest on the sides, over the back, arched above."""
    end = s.width / 2 + 0.008
    x = end * np.array([-1, -0.97, -0.85, -0.6, -0.3, 0, 0.3, 0.6, 0.85, 0.97, 1])
    size = height * np.array([0.55, 0.72, 0.8, 0.95, 1.08, 1.15, 1.08, 0.95, 0.8, 0.72, 0.55])
    path = base + CLEARANCE * along + x[:, None] * X + (size / 2)[:, None] * along
    return sweep(path, along, across, [rectangle(h, 0.066, 0.006) for h in size])
