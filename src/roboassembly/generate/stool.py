"""The stool: four turned legs, stretchers between all of them, a seat on top.

The legs' tenons go up into the seat, the stretchers run along x and along y at different heights. So the legs are
joined in pairs, the pairs to each other, and the seat comes last: legs that stand in the seat cannot be spread to
let a stretcher in.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, corners, count, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, joint_frame, mouths, spindle
from roboassembly.generate.outlines import circle, rounded_trapezoid
from roboassembly.generate.solids import Solid, pad, placed, turned
from roboassembly.generate.vectors import X, Z, move, spin, vector

LEG_TENON = RoundTenon(radius=0.0125, length=0.020)
STRETCHER_TENON = RoundTenon(radius=0.0075, length=0.0135, sides=10)


@family("stool", "turned legs, stretchers between all four, seat on top")
class Stool(Design):
    """A stool of 9 or 13 parts."""

    seat: float = size(0.38, 0.34, 0.42)  # diameter, or side
    height: float = size(0.47, 0.44, 0.50)
    thickness: float = size(0.036, 0.032, 0.05)
    round: bool = chance(True)
    saddle: float = one_of(0.008, 0.005, -0.012)  # depth of the hollow in the seat; negative for a cushion
    leg_radius: float = size(0.020, 0.0185, 0.023)
    stretcher: float = size(0.0115, 0.0105, 0.013)  # radius of the belly
    rows: int = count(1, 1, 2)  # stretchers on each side

    def build(self, a: Assembly) -> None:
        s, under = self, self.height - self.thickness
        reach = (0.31 if s.round else 0.40) * s.seat  # of a leg's axis from both middle planes
        outline = circle(s.seat / 2, 24) if s.round else rounded_trapezoid(s.seat, s.seat, s.seat, 0.05, steps=4)
        seat = Blank(pad(outline, under, s.height, 0.008, -s.saddle, under=0.008))
        leg = Blank(self.leg(under - CLEARANCE))
        legs = corners(reach, reach, alike=False)
        a.join(LEG_TENON, joint_frame(under * Z, -Z, X), leg, seat, at=[pose for _, pose, _ in legs])

        # The holes of the leg at (-x, -y); stretchers along x are lower than those along y, and all are alike.
        inner = reach - 0.93 * s.leg_radius
        start, end = vector(-inner, 0, 0), vector(inner, 0, 0)
        stretcher = Blank(spindle(start, end, Z, s.stretcher, STRETCHER_TENON, straight=0.014))
        hole = STRETCHER_TENON.pocket(move(reach) * mouths(start, end, Z)[0], over=0.012)
        for k, z in enumerate([0.12, 0.165] if s.rows == 1 else [0.10, 0.14, 0.235, 0.275]):
            level = move(z=z) * spin(k % 2 * np.pi / 2)
            leg -= placed(hole, level)
            row = "" if s.rows == 1 else ("_lower", "_upper")[k // 2]
            # The quarter turn takes -y, the front, to +x, the left.
            for y, side in zip((-reach, reach), (("front", "back"), ("left", "right"))[k % 2], strict=True):
                a.part(f"stretcher_{side}{row}", "bar_stretcher", stretcher, level * move(y=y))
        for corner, pose, mirrored in legs:
            a.part(f"leg_{corner}", "leg", leg, pose, mirrored)
        a.part("seat", "seat_single_surface", seat)

    def leg(self, top: float) -> Solid:
        """Return a turned leg about the z axis, of even thickness where stretchers come in."""
        r = self.leg_radius
        profile = [(0.0, 0.60 * r), (0.004, 0.68 * r), (0.072, r), (0.31, r)]
        profile += [(0.325, 0.72 * r), (0.335, 1.02 * r), (0.345, 0.78 * r), (top - 0.02, 0.92 * r), (top, 0.86 * r)]
        if self.rows == 1:
            profile[3:4] = [(0.20, r), (0.26, 1.1 * r)]
        return turned(profile, 16)
