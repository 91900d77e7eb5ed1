"""The upholstered chair: a thick seat, a thick back on it, a base below, and blocks for armrests at the sides.

The back comes down on the seat's pegs, armrests take the tongues of seat and back along x. So seat and back are
joined before the second armrest is on: once both are at the seat, or both at the back, the other is shut out.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, drawn, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.outlines import rectangles, rounded_trapezoid
from roboassembly.generate.solids import Solid, bar, block, column, pad, polyline, sweep, turned
from roboassembly.generate.vectors import X, Y, Z, move, spin, vector

TURNED_LEGS, SQUARE_LEGS, RUNNERS, PLINTH = range(4)
BACK_PEG = RoundTenon(radius=0.011, length=0.032, sides=12)
LEG_PEG = RoundTenon(radius=0.011, length=0.026, sides=12)
SEAT_TONGUE = Tenon(0.20, 0.036, 0.022)
BACK_TONGUE = Tenon(0.070, 0.030, 0.022)


@family("upholstered", "thick seat, thick back and armrest blocks on legs or a plinth")
class UpholsteredChair(Design):
    """A chair of 3 to 8 parts."""

    arms: bool = chance(True, 0.6)
    seat_thickness: float = drawn(0.17, lambda rng, s: rng.uniform(*((0.14, 0.22) if s.arms else (0.09, 0.15))))
    width: float = drawn(0.52, lambda rng, s: rng.uniform(*((0.50, 0.58) if s.arms else (0.45, 0.56))))  # of the seat
    depth: float = drawn(0.56, lambda rng, s: rng.uniform(*((0.54, 0.64) if s.arms else (0.46, 0.56))))
    seat_height: float = size(0.43, 0.41, 0.46)
    crown: float = size(0.016, 0.008, 0.022)
    height: float = size(0.80, 0.76, 0.98)
    back_thickness: float = drawn(0.12, lambda rng, s: rng.uniform(*((0.10, 0.15) if s.arms else (0.075, 0.11))))
    rake: float = size(0.20, 0.12, 0.26)
    arm_width: float = size(0.105, 0.075, 0.14)
    arm_rise: float = size(0.19, 0.17, 0.23)  # of the armrest's top above the seat
    base: int = one_of(TURNED_LEGS, TURNED_LEGS, SQUARE_LEGS, SQUARE_LEGS, RUNNERS, PLINTH, default=SQUARE_LEGS)

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        under, half = s.seat_height - s.seat_thickness, s.width / 2
        edge = min(0.03, 0.22 * s.seat_thickness)
        outline = rounded_trapezoid(2 * (half - c), 2 * (half - c), s.depth, 0.03)
        seat = Blank(pad(outline, under, s.seat_height, edge, s.crown, under=0.4 * edge))
        # The back leans, its lower and upper faces are level. It covers the eased edge at the seat's rear.
        deep = s.back_thickness / np.cos(s.rake)
        rear = s.depth / 2 - edge - 0.004 - deep / 2
        seat -= block((-half, rear - deep / 2 - 0.012, s.seat_height), (half, s.depth, s.seat_height + 0.1))
        back = Blank(self.back(rear, deep))
        for x in (-0.5 * half, 0.5 * half):
            a.join(BACK_PEG, joint_frame(vector(x, rear, s.seat_height), Z, X), back, seat)
        if not s.arms:
            self.stand(a, seat, under, half - 0.055)
        else:
            outline = rounded_trapezoid(s.arm_width, s.arm_width, s.depth + 0.01, 0.018)
            cushion = pad(outline, under, s.seat_height + s.arm_rise, min(0.03, 0.4 * s.arm_width), under=0.008)
            arm = Blank(cushion.translate((half + s.arm_width / 2, 0.0, 0.0)))
            on_seat = vector(half, -0.05, under + 0.5 * s.seat_thickness)
            on_back = vector(half, rear + 0.5 * s.arm_rise * np.tan(s.rake), s.seat_height + 0.5 * s.arm_rise)
            a.join_sides(SEAT_TONGUE, joint_frame(on_seat, -X, Y), seat, arm)
            a.join_sides(BACK_TONGUE, joint_frame(on_back, -X, Z), back, arm)
            self.stand(a, arm, under, half + s.arm_width / 2)
            a.pair("arm", "arm_sofa_style", arm, first="left")
        a.part("back", "back_soft_surface", back)
        a.part("seat", "seat_soft_surface", seat)

    def back(self, rear: float, deep: float) -> Solid:
        """Return the back, `deep` from front to rear where it stands on the seat at y = `rear`."""
        half, rise = self.width / 2 - CLEARANCE, self.height - self.seat_height - CLEARANCE
        x = half * np.array([-1, -0.96, -0.85, 0, 0.85, 0.96, 1])
        high = rise * np.array([0.93, 0.97, 1, 1, 1, 0.97, 0.93])
        thick = deep * np.array([0.82, 0.93, 1, 1, 1, 0.93, 0.82])
        up = vector(0, np.tan(self.rake), 1)
        path = polyline(vector(0, rear, self.seat_height + CLEARANCE), (x, X), (high / 2, up))
        return sweep(path, up, Y, rectangles(high, thick, 0.18 * deep))

    def stand(self, a: Assembly, on: Blank, under: float, x: float) -> None:
        """Add what carries the seat (or the left armrest, which is mirrored), `x` from the middle."""
        y, top = self.depth / 2 - 0.06, under - CLEARANCE
        sides = (x,) if self.arms else (x, -x)
        if self.base in (TURNED_LEGS, SQUARE_LEGS):
            foot = [(0.0, 0.011), (0.004, 0.013), (0.8 * under, 0.023), (under - 0.012, 0.025), (top, 0.022)]
            square = [(0.0, 0.028, 0.028), (0.004, 0.031, 0.031), (top, 0.050, 0.050)]
            leg = Blank(turned(foot, 16) if self.base == TURNED_LEGS else column(square, 0.004))
            places = {f"{end}_{side}": move(sign * x, at) for end, at in (("front", -y), ("back", y))
                      for side, sign in (("left", 1), ("right", -1))}  # fmt: skip
            on_left = [pose for pose in places.values() if pose.translation[0] > 0 or not self.arms]
            a.join(LEG_PEG, joint_frame(under * Z, -Z, X), leg, on, at=on_left)
            a.each("leg", "leg", leg, places)
        elif self.base == RUNNERS or self.arms:
            along, high = np.array([-y - 0.03, -y - 0.02, y + 0.02, y + 0.03]), top * np.array([0.9, 1, 1, 0.9])
            runner = Blank(bar(0.0, along, top / 2, X, Z, 0.045, high, 0.004))
            for at in (-0.6 * y, 0.6 * y):
                poses = [move(px) for px in reversed(sides)]
                a.join(LEG_PEG, joint_frame(vector(0, at, under), -Z, X), runner, on, at=poses)
            a.each("runner", "runner", runner, {"left": move(x), "right": spin(np.pi, -x)})
        else:
            outline = rounded_trapezoid(2 * x + 0.04, 2 * x + 0.04, 2 * y + 0.04, 0.03)
            plinth = a.part("plinth", "foot_base", pad(outline, 0.0, top, 0.006))
            for px in (-0.6 * x, 0.6 * x):
                a.join(LEG_PEG, joint_frame(vector(px, 0, under), -Z, X), plinth, on)
