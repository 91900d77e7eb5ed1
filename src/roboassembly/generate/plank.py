"""The plank chair: a seat on two splayed boards that a keyed stretcher holds, and a carved board for a back.

Boards come up into the seat, the stretcher runs through them, and a key through either of its ends locks it. So
boards and stretcher come first, then keys and seat; a key in the stretcher that is not yet through its board, or
two boards in the seat, is too early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.bends import cut_out, smooth, symmetric
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
    block,
    circle,
    pad,
    rectangle,
    rounded_trapezoid,
    sweep,
    turn,
    vector,
)
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class PlankStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.44
    depth: float = 0.42
    seat_height: float = 0.45
    seat_thickness: float = 0.036
    corners: float = 0.06
    """Radius of the seat's corners."""
    height: float = 0.90
    rake: float = 0.22
    board: float = 0.030
    """Thickness of the boards below."""
    stretcher: float = 0.17
    """Its height above the floor."""
    keys: bool = True
    back: int = 0
    """0 a heart-shaped board, 1 a straight one, 2 none (a stool)."""


def sample(rng: np.random.Generator) -> PlankStyle:
    """A style of 4 to 7 parts."""
    return PlankStyle(
        width=rng.uniform(0.40, 0.47),
        depth=rng.uniform(0.38, 0.44),
        seat_height=rng.uniform(0.42, 0.48),
        seat_thickness=rng.uniform(0.034, 0.046),
        corners=rng.uniform(0.03, 0.12),
        height=rng.uniform(0.80, 0.98),
        rake=rng.uniform(0.15, 0.27),
        board=rng.uniform(0.026, 0.036),
        stretcher=rng.uniform(0.13, 0.24),
        keys=bool(rng.random() < 0.65),
        back=int(rng.choice([0, 0, 1, 1, 2])),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A plank chair of the style drawn from `rng`, or the catalogue model with 7 parts."""
    return assemble(PlankStyle() if rng is None else sample(rng))


BACK_TENON = Tenon(0.110, 0.016, 0.022, root=0.03)
KEY = (0.010, 0.017)
"""Thickness (along y) and width (along x) of a key."""


def assemble(style: PlankStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    under = s.seat_height - s.seat_thickness
    outline = rounded_trapezoid(s.width, s.width - 0.04, s.depth, s.corners, steps=5)
    seat = pad(outline, under, s.seat_height, 0.008, under=0.008)
    pieces: list[Piece] = []

    # Boards: upright, their tongues up into the seat.
    x = 0.31 * s.width
    housing = Tenon(0.50 * s.depth, 0.6 * s.board, 0.5 * s.seat_thickness - 0.004)
    board = _board(s, under) + housing.tongue(joint_frame(under * Z, -Z, Y))
    # The stretcher: shouldered between the boards, a through tenon at either end.
    height, thick = 0.062, 0.022
    inside = x - s.board / 2
    through = s.board + 0.046 if s.keys else 0.42 * s.board
    tenon = Tenon(0.036, 0.014, through)
    frame = joint_frame(vector(-s.board / 2, 0, s.stretcher), -X, Z)
    board -= tenon.pocket(frame)
    stretcher = block(
        (-inside + c, -thick / 2, s.stretcher - height / 2), (inside - c, thick / 2, s.stretcher + height / 2)
    )
    for side in (1, -1):
        stretcher += tenon.tongue(joint_frame(vector(side * inside, 0, s.stretcher), -side * X, Z))
    if s.keys:
        key_x = x + s.board / 2 + c + KEY[1] / 2
        key, hole = _key(s)
        for side, name in ((1, "left"), (-1, "right")):
            stretcher -= hole.translate((side * key_x, 0.0, 0.0))
            pieces.append(Piece(f"key_{name}", "bar_stretcher", key, move(side * key_x)))
    pieces.append(Piece("stretcher", "bar_stretcher", stretcher))
    for side, name in ((1, "left"), (-1, "right")):
        pose = move(side * x) * SE3(turn(Z, 0.0 if side > 0 else np.pi), np.zeros(3))
        pieces.append(Piece(f"leg_board_{name}", "leg", board, pose))
        seat -= housing.pocket(pose * joint_frame(under * Z, -Z, Y))
    if s.back < 2:
        back, mouth = _back(s)
        seat -= BACK_TENON.pocket(mouth, over=0.012)
        pieces.append(Piece("back", "back_single_surface", back))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _board(s: PlankStyle, under: float) -> Solid:
    """A board square to x at x = 0, narrow above and with two feet below."""
    half, top = 0.46 * s.depth, under - CLEARANCE
    edge = smooth([(half, 0.035), (0.30 * s.depth, 0.40 * top), (0.36 * s.depth, top)], 9)
    arch = [(0.45 * half, 0.0), (half, 0.0)]
    right = [(0.0, 0.055), (0.28 * half, 0.045), *arch, *edge]
    return cut_out(symmetric(right), vector(0, 0, 0), Y, Z, s.board)


def _key(s: PlankStyle) -> tuple[Solid, Solid]:
    """A key about x = 0 through the stretcher's end, thicker above, and its hole in the stretcher."""
    thick, wide = KEY
    low, high = s.stretcher - 0.036, s.stretcher + 0.044
    mouth = s.stretcher + 0.018 + CLEARANCE
    stations = [(low, thick, wide - 0.003), (low + 0.006, thick, wide), (mouth, thick, wide)]
    body = sweep([vector(0, 0, z) for z, _, _ in stations], X, Y, [rectangle(w, t, 0.001) for _, t, w in stations])
    head = sweep(
        [vector(0, 0, z) for z in (mouth, high - 0.004, high)],
        X, Y, [rectangle(wide, t, 0.001) for t in (2 * thick, 2 * thick, 1.6 * thick)],
    )  # fmt: skip
    hole = sweep([vector(0, 0, z) for z in (low, high)], X, Y, rectangle(wide + 2 * CLEARANCE, thick + 2 * CLEARANCE))
    return body + head, hole


def _back(s: PlankStyle) -> tuple[Solid, SE3]:
    """A leaning board with a handhold, and its mouth in the seat."""
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    start = vector(0, s.depth / 2 - 0.075, s.seat_height)
    span = (s.height - s.seat_height) / along[2]
    wide = s.width - 0.05
    if s.back == 0:
        half = [(0.16, 0.0), (0.15, 0.12), (0.24, 0.35), (0.46, 0.72), (0.47, 0.84), (0.36, 0.95), (0.22, 0.985)]
        outline = symmetric([*smooth([(wide * a, span * b) for a, b in half], 17), (0.0, 0.955 * span)])
    else:
        half = [(0.30, 0.0), (0.34, 0.4), (0.44, 0.9)]
        outline = symmetric([*[(wide * a, span * b) for a, b in half], (0.38 * wide, 0.975 * span), (0.0, span)])
    outline[np.abs(outline[:, 1]) < 1e-9, 1] = -0.02
    hole = circle(1.0, 14) * np.array([0.045, 0.018]) + np.array([0.0, 0.74 * span])
    body = cut_out(outline, start, X, along, 0.022, [hole]).trim_by_plane((0.0, 0.0, 1.0), s.seat_height + CLEARANCE)
    mouth = joint_frame(start, along, X)
    return body + BACK_TENON.tongue(mouth), mouth
