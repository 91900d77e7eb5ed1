"""The chair that looks as if it folded: two pairs of crossed legs, the seat and a rod between the inner ones.

Everything lies along x, in layers: outer leg, inner leg, seat. The inner legs are joined by seat and rod first,
then come the outer ones with back and rod between them; each layer shuts out what was left behind.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, family, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, mouths, spindle
from roboassembly.generate.outlines import from_front_to_rear, rectangle, rectangles
from roboassembly.generate.solids import pad, polyline, ribbon, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, move, unit, vector

ROD = RoundTenon(radius=0.0075, length=0.012, sides=10)
PIVOT = RoundTenon(radius=0.0085, length=0.010, sides=12)
BETWEEN_LEGS = 0.009  # gap between the crossed legs, which a collar around the pivot fills [m]


@family("folding", "two pairs of crossed legs with rods, seat and slats between them")
class FoldingChair(Design):
    """A chair of 7 to 11 parts."""

    width: float = size(0.46, 0.44, 0.50)  # over the outer legs
    depth: float = size(0.46, 0.42, 0.50)  # of the feet
    seat_height: float = size(0.45, 0.43, 0.47)
    height: float = size(0.82, 0.76, 0.88)
    stile: float = size(0.038, 0.034, 0.044)  # width of a leg, seen from the side
    thickness: float = size(0.022, 0.021, 0.026)  # of a leg, along x
    slats: int = count(2, 1, 3)  # in the back
    seat_thickness: float = size(0.024, 0.020, 0.034)
    low_rod: bool = chance(True)  # between the outer legs
    rest: bool = chance(True)  # a rod between the outer legs, on which the seat's rear lies

    def build(self, a: Assembly) -> None:
        s, c, t = self, CLEARANCE, self.thickness
        outer_x = s.width / 2 - t / 2
        inner_x = outer_x - t - BETWEEN_LEGS
        outer_face, inner_face = outer_x - t / 2, inner_x - t / 2
        under, deep = s.seat_height - s.seat_thickness, 0.5 * t
        # The outer leg: from the floor in front, up and back past the seat's rear, then steeper to the crest.
        seat_rear, front_foot = vector(0, 0.16, s.seat_height), vector(0, -s.depth / 2, 0)
        rise, steep = unit(seat_rear - front_foot), unit(vector(0, 0.30, 1.0))
        bend = seat_rear + 0.035 * rise
        top = bend + (s.height - bend[2]) / steep[2] * steep
        outer = self.leg([front_foot, bend, top], outer_x)
        # The inner leg: from the floor behind to under the seat's front.
        seat_front, rear_foot = vector(0, -0.135, under + 0.5 * s.seat_thickness), vector(0, s.depth / 2, 0)
        lean = unit(seat_front - rear_foot)
        inner = self.leg([rear_foot, seat_front + 0.012 * lean], inner_x)

        # A pin of the inner leg goes into the outer leg at the crossing.
        lines = np.array([rise[1:], -lean[1:]]).T
        cross = front_foot + np.linalg.solve(lines, (rear_foot - front_foot)[1:])[0] * rise
        pin, collar = joint_frame(cross + outer_face * X, -X, Z), [inner_x + 0.3 * t, outer_face - c]
        inner += sweep([cross + x * X for x in collar], Y, Z, rectangle(0.024, 0.024, 0.006)) + PIVOT.tongue(pin)
        outer -= PIVOT.pocket(pin)

        # Seat and rods.
        outline = from_front_to_rear(seat_front[1] - 0.055, seat_rear[1] + 0.015, 2 * (inner_face - c), 0.02)
        seat = Blank(pad(outline, under, s.seat_height, 0.006, under=0.004))
        a.join_sides(Tenon(0.6 * s.stile, 0.011, deep), joint_frame(seat_front + inner_face * X, -X, Y), seat, inner)
        rods = [("rod_inner", rear_foot + 0.13 / lean[2] * lean, inner_face, inner)]
        if s.low_rod:
            rods.append(("rod_outer", front_foot + 0.10 / rise[2] * rise, outer_face, outer))
        for name, at, face, leg in rods:
            start, end = at - face * X, at + face * X
            a.part(name, "bar_stretcher", spindle(start, end, Z, 0.0105, ROD))
            leg -= ROD.pocket(mouths(start, end, Z)[1])
        if s.rest:
            at = front_foot + (under - c - 0.014) / rise[2] * rise
            tenon = Tenon(0.016, 0.009, deep)
            a.cross("seat_rest", "seat_frame_bar", at, outer_face, Z, (0.028, 0.016), tenon, outer, 0.002)

        # Slats between the outer legs, above the bend.
        tenon = Tenon(0.030, 0.009, deep)
        length = float(np.linalg.norm(top - bend))
        height = 0.046 if s.slats > 1 else 0.10
        highest = length - 0.012 - height / 2
        slat = self.slat(top - (length - highest) * steep, steep, outer_face, height, tenon)
        for k in range(s.slats):
            down = (height + 0.026) * k
            a.part(f"slat_{k}" if k else "crest_rail", "back_surface_horizontal_bar", slat, move(*(-down * steep)))
            outer -= tenon.pocket(joint_frame(bend + (highest - down) * steep + outer_face * X, -X, steep))
        a.pair("leg_inner", "leg", inner, first="left")
        a.pair("leg_outer", "leg", outer, first="left")
        a.part("seat", "seat_single_surface", seat)

    def leg(self, line: list[Vector], x: float) -> Blank:
        """Return a flat leg along a line in the y-z plane, its foot cut level at the floor."""
        first, last = unit(line[1] - line[0]), unit(line[-1] - line[-2])
        points = np.array([line[0] - 0.05 * first, *line[1:-1], line[-1] - 0.012 * last, line[-1]]) + x * X
        tangents = [first, *[unit(last + first)] * (len(line) - 2), last, last]
        wide = np.array([self.stile] * (len(points) - 1) + [0.6 * self.stile])
        body = ribbon(points, tangents, X, rectangles(self.thickness, wide, 0.003))
        return Blank(body.trim_by_plane((0.0, 0.0, 1.0), 0.0))

    def slat(self, at: Vector, along: Vector, face: float, height: float, tenon: Tenon) -> Blank:
        """Return a slat between the outer legs, bent around the sitter."""
        end, across = face - CLEARANCE, np.cross(X, along)
        x = end * np.linspace(-1, 1, 9)
        path = polyline(at, (x, X), (-(0.022 * (1 - (x / end) ** 2)), across))
        body = sweep(path, along, across, rectangle(height, 0.016, 0.003))
        for frame in mouths(at - face * X, at + face * X, along):
            body += tenon.tongue(frame)
        return Blank(body)
