"""The cantilever: two strips, each bent from floor to back in one piece, with a seat and a back between them.

Everything lies along x between the strips. Whatever joins both of them shuts out what is not between them yet.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, family, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.outlines import rectangles
from roboassembly.generate.solids import bent, polyline, ribbon, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, unit, vector


@family("cantilever", "two strips bent from floor to back, seat and back between them")
class CantileverChair(Design):
    """A chair of 4 to 7 parts."""

    width: float = size(0.50, 0.47, 0.60)  # over the outer faces of the strips
    depth: float = size(0.50, 0.46, 0.56)  # of the strips on the floor
    seat_height: float = size(0.45, 0.42, 0.46)
    height: float = size(0.84, 0.76, 0.98)
    strip: float = size(0.034, 0.030, 0.05)  # width of a strip, along x
    thickness: float = size(0.024, 0.022, 0.030)
    rake: float = size(0.22, 0.16, 0.30)
    pitch: float = size(0.05, 0.02, 0.09)  # how much the seat falls toward the back
    bend: float = size(0.085, 0.06, 0.11)  # radius of the strips' bends
    lean: float = size(0.02, -0.01, 0.04)  # how far the seat's front lies before the runners' front
    seat: float = size(0.018, 0.016, 0.065)  # thickness of the seat; a cushion if it is more than the strip's
    backs: int = count(1, 1, 2)  # boards in the back
    floor_bar: bool = chance(True, 0.75)
    seat_bar: bool = chance(False, 0.4)  # a bar under the front of the seat

    def build(self, a: Assembly) -> None:
        s, t = self, self.thickness
        inner, middle, front = s.width / 2 - s.strip, s.width / 2 - s.strip / 2, -s.depth / 2
        seat_front = vector(middle, front - s.lean, s.seat_height - t / 2)
        run = vector(0, np.cos(s.pitch), -np.sin(s.pitch))
        knee = seat_front + (s.depth - 0.04) * run
        along, _ = leaning(s.rake)
        reach = (s.height - knee[2]) / along[2]
        toe = vector(middle, front, t / 2)
        points, tangents = bent([toe + s.depth * Y, toe, seat_front, knee, knee + reach * along], s.bend)
        thick = np.full(len(points), t)
        thick[[0, -1]] *= 0.7
        strip = Blank(ribbon(points, tangents, X, rectangles(s.strip, thick, 0.003)))
        deep = 0.42 * s.strip

        # The seat, flat or cushioned, with a tongue along either side.
        long = s.depth - 0.04 - 2 * (s.bend * 0.9)
        at, tongue = seat_front * (Y + Z) + (s.depth - 0.04) / 2 * run, Tenon(long, 0.45 * t, deep)
        a.part("seat", "seat_single_surface", self.panel(at, run, long + 0.07, s.seat, tongue, 0.0))
        strip -= tongue.pocket(joint_frame(at + inner * X, -X, run))

        # Boards in the back; two of them are alike.
        low, high = s.bend + 0.02, reach - 0.02
        if s.backs == 2:
            board = min(0.5 * (high - low - 0.035), 0.13)
            lower = min(0.5 * (low + high - board) - 0.5 * board + 0.02, high - board / 2 - board - 0.03)
            ups = {"back_lower": lower, "back_upper": high - board / 2}
        else:
            board = min(0.75 * (high - low), 0.30)
            ups = {"back": high - board / 2}
        tongue, first = Tenon(0.8 * board, 0.45 * t, deep), min(ups.values())
        back = self.panel(knee * (Y + Z) + first * along, along, board, 0.014, tongue, 0.02)
        for name, up in ups.items():
            a.part(name, "back_single_surface", back, move(*((up - first) * along)))
            strip -= tongue.pocket(joint_frame(knee * (Y + Z) + up * along + inner * X, -X, along))

        tenon = Tenon(0.55 * t, 0.5 * t, deep)
        if s.floor_bar:
            at = vector(0, s.depth / 2 - 0.03, t / 2)
            a.cross("floor_bar", "bar_stretcher", at, inner, Z, (t, 0.85 * t), tenon, strip)
        if s.seat_bar:
            # In the front upright.
            upright = (seat_front - toe) * (Y + Z)
            at = (toe + seat_front) / 2 * (Y + Z) + 0.35 * upright
            a.cross("front_bar", "seat_frame_bar", at, inner, unit(upright), (0.9 * t, 0.85 * t), tenon, strip)
        a.pair("frame", "leg", strip, first="left")

    def panel(self, at: Vector, up: Vector, long: float, thick: float, tongue: Tenon, bow: float) -> Blank:
        """Return a panel between the strips, its length along `up`, hollowed by `bow`, with a tongue at either side."""
        inner, normal = self.width / 2 - self.strip, np.cross(X, up)
        end = inner - CLEARANCE
        x = end * np.array([-1, -0.97, -0.7, -0.35, 0, 0.35, 0.7, 0.97, 1])
        ease = np.array([0.85, 1, 1, 1, 1, 1, 1, 1, 0.85])
        path = polyline(at, (x, X), (-(bow * (1 - (x / end) ** 2)), normal))
        lengths, thicknesses = long - (1 - ease) * 0.05, thick * ease
        body = sweep(path, up, normal, rectangles(lengths, thicknesses, min(0.3 * thick, 0.010)))
        for side in (1, -1):
            body += tongue.tongue(joint_frame(at + side * inner * X, -side * X, up))
        return Blank(body)
