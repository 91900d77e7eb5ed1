"""The plank chair: a seat on two splayed boards that a keyed stretcher holds, and a carved board for a back.

Boards come up into the seat, the stretcher runs through them, and a key through either of its ends locks it. So
boards and stretcher come first, then keys and seat; a key in the stretcher that is not yet through its board, or
two boards in the seat, is too early.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.outlines import circle, rounded_trapezoid, smooth, symmetric
from roboassembly.generate.solids import Solid, block, column, cut_out, pad
from roboassembly.generate.vectors import X, Y, Z, leaning, move, spin, vector

BACK_TENON = Tenon(0.110, 0.016, 0.022, root=0.03)
KEY = (0.017, 0.010)  # width (along x) and thickness (along y) of a key
HEART, STRAIGHT, NO_BACK = range(3)


@family("plank", "seat on two boards with a keyed stretcher, a carved board for a back")
class PlankChair(Design):
    """A chair or stool of 4 to 7 parts."""

    width: float = size(0.44, 0.40, 0.47)
    depth: float = size(0.42, 0.38, 0.44)
    seat_height: float = size(0.45, 0.42, 0.48)
    seat_thickness: float = size(0.036, 0.034, 0.046)
    corners: float = size(0.06, 0.03, 0.12)  # radius of the seat's corners
    height: float = size(0.90, 0.80, 0.98)
    rake: float = size(0.22, 0.15, 0.27)
    board: float = size(0.030, 0.026, 0.036)  # thickness of the boards below
    stretcher: float = size(0.17, 0.13, 0.24)  # its height above the floor
    keys: bool = chance(True, 0.65)
    back: int = one_of(HEART, HEART, STRAIGHT, STRAIGHT, NO_BACK)

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        under = s.seat_height - s.seat_thickness
        outline = rounded_trapezoid(s.width, s.width - 0.04, s.depth, s.corners, steps=5)
        seat = Blank(pad(outline, under, s.seat_height, 0.008, under=0.008))

        # Boards: upright, their tongues up into the seat.
        x = 0.31 * s.width
        places = {"left": spin(0.0, x), "right": spin(np.pi, -x)}
        board = Blank(self.leg_board(under - c))
        housing = Tenon(0.50 * s.depth, 0.6 * s.board, 0.5 * s.seat_thickness - 0.004)
        a.join(housing, joint_frame(under * Z, -Z, Y), board, seat, at=list(places.values()))
        # The stretcher: shouldered between the boards, a through tenon at either end.
        inner, z = x - s.board / 2, s.stretcher
        tenon = Tenon(0.036, 0.014, s.board + 0.046 if s.keys else 0.42 * s.board)
        board -= tenon.pocket(joint_frame(vector(-s.board / 2, 0, z), -X, Z))
        stretcher = Blank(block((-inner + c, -0.011, z - 0.031), (inner - c, 0.011, z + 0.031)))
        for side in (1, -1):
            stretcher += tenon.tongue(joint_frame(vector(side * inner, 0, z), -side * X, Z))
        if s.keys:
            key, hole = self.key()
            key_x = x + s.board / 2 + c + KEY[0] / 2
            for at in (key_x, -key_x):
                stretcher -= hole.translate((at, 0.0, 0.0))
            a.each("key", "bar_stretcher", key, {"left": move(key_x), "right": move(-key_x)})
        a.part("stretcher", "bar_stretcher", stretcher)
        a.each("leg_board", "leg", board, places)
        if s.back != NO_BACK:
            along, _ = leaning(s.rake)
            foot = vector(0, s.depth / 2 - 0.075, s.seat_height)
            span = (s.height - s.seat_height) / along[2]
            hole = circle(1.0, 14) * np.array([0.045, 0.018]) + np.array([0.0, 0.74 * span])
            carved = cut_out(self.back_outline(span), foot, X, along, 0.022, [hole])
            back = a.part("back", "back_single_surface", carved.trim_by_plane((0.0, 0.0, 1.0), s.seat_height + c))
            a.join(BACK_TENON, joint_frame(foot, along, X), back, seat, over=0.012)
        a.part("seat", "seat_single_surface", seat)

    def leg_board(self, top: float) -> Solid:
        """Return a board square to x at x = 0, narrow above and with two feet below."""
        half = 0.46 * self.depth
        edge = smooth([(half, 0.035), (0.30 * self.depth, 0.40 * top), (0.36 * self.depth, top)], 9)
        right = [(0.0, 0.055), (0.28 * half, 0.045), (0.45 * half, 0.0), (half, 0.0), *edge]
        return cut_out(symmetric(right), vector(0, 0, 0), Y, Z, self.board)

    def key(self) -> tuple[Blank, Solid]:
        """Return a key about x = 0 through the stretcher's end, thicker above, and its hole in the stretcher."""
        wide, thick = KEY
        low, mouth, high = self.stretcher - 0.036, self.stretcher + 0.018 + CLEARANCE, self.stretcher + 0.044
        shaft = column([(low, wide - 0.003, thick), (low + 0.006, wide, thick), (mouth, wide, thick)], 0.001)
        thicknesses = {mouth: 2 * thick, high - 0.004: 2 * thick, high: 1.6 * thick}
        head = column([(z, wide, t) for z, t in thicknesses.items()], 0.001)
        grown = wide + 2 * CLEARANCE, thick + 2 * CLEARANCE
        return Blank(shaft + head), column([(low, *grown), (high, *grown)], 0.0)

    def back_outline(self, span: float) -> np.ndarray:
        """Return the outline of the back, with room below for cutting it off level."""
        wide = self.width - 0.05
        if self.back == HEART:
            half = [(0.16, 0.0), (0.15, 0.12), (0.24, 0.35), (0.46, 0.72), (0.47, 0.84), (0.36, 0.95), (0.22, 0.985)]
            outline = symmetric([*smooth([(wide * x, span * y) for x, y in half], 17), (0.0, 0.955 * span)])
        else:
            half = [(0.30, 0.0), (0.34, 0.4), (0.44, 0.9), (0.38, 0.975), (0.0, 1.0)]
            outline = symmetric([(wide * x, span * y) for x, y in half])
        outline[np.abs(outline[:, 1]) < 1e-9, 1] = -0.02
        return outline
