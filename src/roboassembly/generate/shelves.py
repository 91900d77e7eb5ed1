"""Shelves: boards housed between two sides, open with bars across the rear, or a bookcase with back, top and plinth.

All boards go into the sides along x, so they are between the sides before the second one is on. The bookcase's back
then slides down the grooves of its sides, and the top closes them.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, count, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame, rail
from roboassembly.generate.outlines import rectangle, rounded_trapezoid
from roboassembly.generate.solids import block, cut_out, pad, sweep
from roboassembly.generate.vectors import X, Y, Z, move, vector

BACK = 0.009
GROOVE = 0.008
TOP_TENON = Tenon(0.060, 0.008, 0.010)


@family("shelf_open", "boards and bars housed between two sides", "shelf")
class OpenShelf(Design):
    """A shelf of 5 to 9 parts."""

    width: float = size(0.60, 0.45, 0.80)
    depth: float = size(0.26, 0.24, 0.30)
    height: float = size(0.90, 0.70, 1.15)
    side: float = size(0.024, 0.022, 0.030)  # thickness of the sides
    shelf: float = size(0.020, 0.018, 0.026)
    shelves: int = count(4, 2, 5)
    bars: int = count(2, 1, 2)  # across the rear
    lean: float = one_of(0.0, 0.0, 0.05)  # how much shallower the sides are above than below

    def build(self, a: Assembly) -> None:
        s, inner = self, self.width / 2 - self.side
        front, rear, upper = -s.depth / 2, s.depth / 2, -s.depth / 2 + s.lean
        outline = [
            (front, 0.0), (front + 0.06, 0.0), (front + 0.075, 0.03), (rear - 0.075, 0.03), (rear - 0.06, 0.0),
            (rear, 0.0), (rear, s.height - 0.01), (rear - 0.01, s.height), (upper + 0.03, s.height),
            (upper + 0.008, s.height - 0.012), (upper, s.height - 0.04),
        ]  # fmt: skip
        side = Blank(cut_out(np.array(outline), vector(inner + s.side / 2, 0, 0), Y, Z, s.side))
        deep = s.depth - s.lean - 0.055
        first = vector(0, rear - 0.035 - deep / 2, 0.085)
        tongue = Tenon(0.82 * deep, 0.5 * s.shelf, 0.4 * s.side)
        board = Blank(rail(first - inner * X, first + inner * X, Y, deep, s.shelf, tongue))
        levels = np.linspace(0.0, s.height - 0.085 - 0.06, s.shelves)
        places = a.each("shelf", "shelf", board, [move(z=z) for z in levels])
        a.pockets(tongue, joint_frame(first + inner * X, -X, Y), side, places)
        tenon = Tenon(0.030, 0.008, 0.4 * s.side)
        heights = [0.5 * (levels[k] + levels[k + 1]) + 0.085 for k in ((-2,) if s.bars == 1 else (0, -2))]
        if s.shelves == 2 and s.bars == 2:
            heights = [0.085 + levels[1] * share for share in (0.3, 0.7)]
        start = vector(-inner, rear - 0.014, heights[0])
        bar = Blank(rail(start, start + 2 * inner * X, Z, 0.050, 0.016, tenon))
        a.each("back_bar", "frame_bar", bar, [move(z=z - heights[0]) for z in heights])
        a.pockets(tenon, joint_frame(vector(inner, rear - 0.014, 0), -X, Z), side, [move(z=z) for z in heights])
        a.pair("side", "frame_board", side, first="left")


@family("shelf_bookcase", "boards between sides, back in grooves that the top closes", "shelf")
class Bookcase(Design):
    """A bookcase of 7 to 11 parts."""

    width: float = size(0.62, 0.45, 0.80)
    depth: float = size(0.28, 0.25, 0.33)
    height: float = size(0.92, 0.70, 1.15)
    board: float = size(0.022, 0.021, 0.028)  # thickness of all boards but the back
    shelves: int = count(2, 1, 4)  # between bottom and top
    plinth: float = size(0.07, 0.05, 0.09)
    backs: int = count(1, 1, 2)  # boards that the back is made of, one above the other
    cornice: float = size(0.012, 0.0, 0.02)  # how far the top sticks out in front and at the sides

    def build(self, a: Assembly) -> None:
        s, c, t = self, CLEARANCE, self.board
        inner, under = s.width / 2 - t, s.height - t
        front, rear = -s.depth / 2, s.depth / 2
        side = Blank(block((inner, front, 0), (inner + t, rear, under - c)))
        groove = rear - 0.020
        # Bottom and shelves: the same boards.
        deep = groove - BACK / 2 - 0.009 - (front + 0.004)
        first = vector(0, groove - BACK / 2 - 0.009 - deep / 2, s.plinth + c + t / 2 + 0.009)
        tongue = Tenon(0.85 * deep, 0.5 * t, 0.4 * t)
        board = Blank(rail(first - inner * X, first + inner * X, Y, deep, t, tongue, 0.002))
        pitch = (under - first[2]) / (s.shelves + 1)
        for k in range(s.shelves + 1):
            a.part(f"shelf_{k}" if k else "bottom", "shelf", board, move(z=k * pitch))
            side -= tongue.pocket(joint_frame(first + inner * X + k * pitch * Z, -X, Y))
        at, tenon = vector(0, front + 0.030, s.plinth / 2), Tenon(0.55 * s.plinth, 0.008, 0.4 * t)
        a.cross("plinth", "frame_board", at, inner, Z, (s.plinth - 0.004, 0.018), tenon, side)
        # The back in the sides' grooves, which the top closes.
        low = s.plinth + 0.004
        slot = Tenon(under - low, BACK, GROOVE)
        for lift in (0.0, 0.03):
            side -= slot.pocket(joint_frame(vector(inner, groove, (low + under) / 2 + lift), -X, Z))
        tall = (under - c - low - (s.backs - 1) * c) / s.backs
        start, ends = vector(0, groove, low + tall / 2), (inner + GROOVE) * X
        back = Blank(sweep([start - ends, start + ends], Y, Z, rectangle(BACK, tall, 0.001)))
        for k in range(s.backs):
            a.part("back" if s.backs == 1 else f"back_{k + 1}", "back_panel", back, move(z=k * (tall + c)))
        wide = s.width + 2 * s.cornice
        outline = rounded_trapezoid(wide, wide, s.depth + s.cornice, 0.004) + np.array([0.0, -s.cornice / 2])
        top = Blank(pad(outline, under, s.height, 0.004))
        top -= TOP_TENON.pocket(joint_frame(vector(-inner - 0.5 * t, -0.02, under), -Z, Y))
        a.join(TOP_TENON, joint_frame(vector(inner + 0.5 * t, -0.02, under), -Z, Y), side, top)
        a.part("top", "top_panel", top)
        a.pair("side", "frame_board", side, first="left")
