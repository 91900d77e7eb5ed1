"""The throne: two boards from floor to armrest stand at the sides, everything else is held between them.

Seat and front board have tongues in the sides, along x; the back slides down the sides' leaning grooves, and the
crest on top of the sides closes them. A crest that is on both sides before the back is in shuts it out, and so do
two sides before the seat is between them.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.outlines import from_front_to_rear, rectangle, rectangles
from roboassembly.generate.solids import Solid, block, cut_out, pad, polyline, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, vector

GROOVE = 0.011
BOARD = 0.014
CREST = 0.055
CREST_TENON = Tenon(0.040, 0.009, 0.018)


@family("throne", "board sides to the armrests, seat and back in their grooves, a crest on top")
class Throne(Design):
    """A chair of 5 to 8 parts."""

    width: float = size(0.52, 0.49, 0.60)  # over the outer faces of the sides
    depth: float = size(0.52, 0.47, 0.56)
    side: float = size(0.030, 0.026, 0.036)  # thickness
    seat_height: float = size(0.44, 0.40, 0.45)
    seat_thickness: float = size(0.030, 0.026, 0.045)
    height: float = size(0.92, 0.80, 1.05)
    arm: float = size(0.20, 0.17, 0.23)  # height of the armrests above the seat
    rake: float = size(0.14, 0.10, 0.20)
    window: bool = chance(True, 0.6)  # an opening in each side, below the seat
    boards: int = one_of(1, 1, 2)  # that the back is made of
    front: bool = chance(True, 0.6)  # a board below the seat's front
    cushion: bool = chance(False, 0.3)

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        inner = s.width / 2 - s.side
        under = s.seat_height - s.seat_thickness
        along, across = leaning(s.rake)
        heel = vector(0, s.depth / 2 - 0.095, s.seat_height)  # where the back's middle plane crosses the seat's height
        reach = (s.height - s.seat_height) / along[2] - CREST
        side = Blank(self.side_board(inner, heel, along, reach))

        # Seat and front board.
        front, rear = -s.depth / 2 + 0.012, heel[1] - 0.024
        outline = from_front_to_rear(front, rear, 2 * (inner - c), 0.012)
        seat = Blank(pad(outline, under, s.seat_height, 0.006, under=0.003))
        mouth = vector(inner, (front + rear) / 2, under + 0.013)
        a.join_sides(Tenon(0.75 * (rear - front), 0.014, GROOVE), joint_frame(mouth, -X, Y), seat, side)
        if s.front:
            high = under - 0.012
            low = max(0.10, high - 0.20)
            board = Blank(block((-inner + c, front + 0.035, low), (inner - c, front + 0.055, high)))
            mouth = vector(inner, front + 0.045, (high + low) / 2)
            a.join_sides(Tenon(0.6 * (high - low), 0.010, GROOVE), joint_frame(mouth, -X, Z), board, side)
            a.part("front_board", "seat_frame_bar", board)

        # The back slides down along the slope; its ends are the tongues.
        low = 0.030 / along[2]
        slot = Tenon(reach - low, BOARD, GROOVE)
        for lift in (0.0, 0.03):
            side -= slot.pocket(joint_frame(heel + inner * X + ((low + reach) / 2 + lift) * along, -X, along))
        tall = (reach - c - low - (s.boards - 1) * c) / s.boards
        ends, middle = (inner + GROOVE) * X, heel + (low + tall / 2) * along
        back = Blank(sweep([middle - ends, middle + ends], along, across, rectangle(tall, BOARD, 0.002)))
        for k in range(s.boards):
            name = "back" if s.boards == 1 else f"back_{k + 1}"
            a.part(name, "back_single_surface", back, move(*(k * (tall + c) * along)))

        # The crest on the sides, over the back, arched above.
        x = (s.width / 2 + 0.008) * np.array([-1, -0.97, -0.85, -0.6, -0.3, 0, 0.3, 0.6, 0.85, 0.97, 1])
        high = CREST * np.array([0.55, 0.72, 0.8, 0.95, 1.08, 1.15, 1.08, 0.95, 0.8, 0.72, 0.55])
        path = polyline(heel + reach * along + c * along, (x, X), (high / 2, along))
        crest = Blank(sweep(path, along, across, rectangles(high, 0.066, 0.006)))
        # Beside the groove, so that the tongue's root does not close it.
        at, beside = heel + reach * along, (inner + GROOVE + 0.0075) * X
        a.join(CREST_TENON, joint_frame(at + beside, -along, across), side, crest)
        crest -= CREST_TENON.pocket(joint_frame(at - beside, -along, across))
        a.part("crest_rail", "back_frame_horizontal_bar", crest)
        if s.cushion:
            outline = from_front_to_rear(front + 0.015, rear - 0.015, 2 * inner - 0.03, 0.03)
            low = s.seat_height + c
            a.part("cushion", "seat_soft_surface", pad(outline, low, low + 0.035, 0.012, 0.014, under=0.008))
        a.pair("side", "arm_sofa_style", side, first="left")
        a.part("seat", "seat_single_surface", seat)

    def side_board(self, inner: float, heel: Vector, along: Vector, reach: float) -> Solid:
        """Return the left side: a board with feet, an armrest's level edge, and a stile that leans to the crest."""
        arm, stile = self.seat_height + self.arm, 0.038
        slope, normal, base = along[1:], np.array([along[2], -along[1]]), heel[1:]
        top = base + reach * slope
        front, rear = -self.depth / 2, self.depth / 2

        def edge(offset: float, z: float) -> float:
            """Return the stile's edge at `offset` in front of (+) or behind (-) its middle, at the height z."""
            y, height = base - offset * normal
            return float(y + (z - height) * slope[0] / slope[1])

        outline = [
            (front + 0.010, 0.0), (front + 0.085, 0.0), (front + 0.100, 0.045), (rear - 0.115, 0.045),
            (rear - 0.10, 0.0), (rear - 0.02, 0.0), (edge(-stile, self.seat_height), self.seat_height),
            top + stile * normal, top - stile * normal, (edge(stile, arm + 0.05), arm + 0.05),
            (edge(stile, arm + 0.015) - 0.010, arm + 0.012), (edge(stile, arm) - 0.045, arm), (front + 0.035, arm),
            (front + 0.006, arm - 0.012), (front - 0.006, arm - 0.045), (front, self.seat_height),
        ]  # fmt: skip
        low, high, start, end = 0.11, self.seat_height - 0.13, front + 0.10, rear - 0.12
        window = np.array([(start, low), (end, low), (end - 0.01, high), (start + 0.01, high)])
        holes = [window] if self.window else []
        return cut_out(np.array(outline), vector(inner + self.side / 2, 0, 0), Y, Z, self.side, holes)
