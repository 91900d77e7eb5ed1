"""The Windsor: a saddled seat that carries everything, four splayed turned legs below, spindles and a comb above.

All spindles of a back are parallel, so that the comb can come down on them in one straight motion. Once the comb
sits on one spindle that is in the seat, another spindle can no longer get between them. The legs are splayed and
go in one by one, along their own axes; for that reason no stretcher joins them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, drawn, family, one_of, size
from roboassembly.generate.joints import RoundTenon, joint_frame, splayed_leg
from roboassembly.generate.outlines import Outline, rectangles
from roboassembly.generate.solids import Solid, pad, sweep, turned_along
from roboassembly.generate.vectors import Points, Vector, X, Y, leaning, move, spin

LEG_TENON = RoundTenon(radius=0.0125, length=0.026, end_radius=0.011)
SPINDLE_FOOT = RoundTenon(radius=0.0080, length=0.020, sides=8)
SPINDLE_TIP = RoundTenon(radius=0.0062, length=0.022, sides=8)
MOUTH = 0.012  # holes are slanted to the faces that they start from, so that a tool enters from this far outside
SPAN = 0.37  # distance of the outer spindles from the middle, share of the seat's width
BELT = 0.032  # height of the rail between two rows of spindles


@family("windsor", "saddled seat on splayed turned legs, spindles under a bent comb")
class WindsorChair(Design):
    """A chair of 10 to 16 parts."""

    belt: bool = chance(False, 0.3)  # a second rail part of the way up, with a second row of spindles above it
    height: float = drawn(0.92, lambda rng, s: rng.uniform(0.86, 1.0) + (0.06 if s.belt else 0.0))
    seat_width: float = size(0.45, 0.42, 0.49)
    seat_depth: float = size(0.42, 0.40, 0.45)
    seat_height: float = size(0.45, 0.43, 0.465)
    seat_thickness: float = size(0.042, 0.038, 0.048)
    saddle: float = size(0.010, 0.006, 0.012)  # how deep the seat is hollowed
    splay: float = size(0.23, 0.17, 0.26)  # tilt of a leg
    leg_radius: float = size(0.018, 0.0155, 0.02)
    rake: float = size(0.20, 0.16, 0.24)
    spindles: int = drawn(6, lambda rng, s: int(rng.integers(4, 6 if s.belt else 7)))
    bow: float = one_of(0.0, 0.04, 0.06, 0.07, default=0.065)  # how far the row's middle lies behind its ends
    comb_height: float = size(0.075, 0.055, 0.09)
    turnings: int = count(1, 0, 2)  # 0 plain tapered legs, 1 a vase, 2 two rings

    def seat_outline(self, corners: int) -> Outline:
        """Return the seat's shield: round at the back, squarer in front."""
        angle = 2 * np.pi * np.arange(corners) / corners
        c, s = np.cos(angle), np.sin(angle)
        power = np.where(s < 0, 2 / 3.2, 2 / 2.3)
        x = np.sign(c) * np.abs(c) ** power * self.seat_width / 2
        y = np.sign(s) * np.abs(s) ** power * self.seat_depth / 2
        return np.column_stack([x * (1.0 - 0.06 * s), y])

    def on_back(self, x: Float[np.ndarray, "k"], z: float) -> Points:
        """Return points of the row of spindles at x, moved up along the back to the height z."""
        along, _ = leaning(self.rake)
        span, base = SPAN * self.seat_width, self.seat_height
        # Every hole keeps clear of the seat's rounded edge.
        edge = self.seat_outline(200)[1:100]
        limit = float(np.interp(span, edge[::-1, 0], edge[::-1, 1])) - 0.036
        rear = min(self.seat_depth / 2 - 0.030, self.bow + limit)
        row = np.stack(np.broadcast_arrays(x, rear - self.bow * (x / span) ** 2, base), axis=-1)
        return row + along * (z - base) / np.cos(self.rake)

    def build(self, a: Assembly) -> None:
        s, base = self, self.seat_height
        under = base - s.seat_thickness
        seat = Blank(pad(self.seat_outline(20), under, base, 0.007, crown=-s.saddle, under=0.010))

        # Legs: the same leg, turned about the vertical to each of its four directions.
        solid, mouth_at = splayed_leg(under, s.splay, LEG_TENON, MOUTH, self.leg_profile())
        leg = Blank(solid)
        for end, y, heading in (("front", -0.30, -0.85), ("back", 0.28, 0.95)):
            for side, x in (("left", 0.29), ("right", -0.29)):
                pose = spin(heading if x > 0 else np.pi - heading, x * s.seat_width, y * s.seat_depth)
                a.part(f"leg_{end}_{side}", "leg", leg, pose)
                seat -= LEG_TENON.pocket(mouth_at(pose), over=MOUTH)

        # The back: everything along one leaning direction, in tiers of spindles with a rail on top of each.
        along, _ = leaning(s.rake)
        comb_low = s.height - s.comb_height * np.cos(s.rake)
        low = base + 0.42 * (comb_low - base)
        comb, belt = Blank(self.rail(comb_low, s.comb_height, True)), Blank(self.rail(low, BELT, False))
        xs = np.linspace(-SPAN * s.seat_width, SPAN * s.seat_width, s.spindles)
        tiers = [("", xs, base - 0.001, comb_low, seat, comb)]
        if s.belt:
            # The upper row stands between the lower one, so that the belt's holes from both sides do not meet.
            tiers = [("_lower", xs, base - 0.001, low, seat, belt)]
            tiers += [("_upper", (xs[1:] + xs[:-1]) / 2, low + BELT * np.cos(s.rake), comb_low, belt, comb)]
        for tier, stand, low, high, lower, upper in tiers:
            spindle = Blank(self.spindle((high - low) / np.cos(s.rake), along))
            feet, heads = self.on_back(stand, low), self.on_back(stand, high)
            for k, (foot, head) in enumerate(zip(feet, heads, strict=True)):
                a.part(f"spindle{tier}_{k + 1}", "back_surface_vertical_bar", spindle, move(*foot))
                lower -= SPINDLE_FOOT.pocket(joint_frame(foot, along, X), over=MOUTH)
                upper -= SPINDLE_TIP.pocket(joint_frame(head, -along, X), over=MOUTH)
        a.part("comb", "back_frame_horizontal_bar", comb)
        if s.belt:
            a.part("belt", "back_frame_horizontal_bar", belt)
        a.part("seat", "seat_single_surface", seat)

    def leg_profile(self) -> list[tuple[float, float]]:
        """Return radii [m] of a leg at shares of its length below the seat."""
        r = self.leg_radius
        if self.turnings == 0:
            return [(0.45, r), (0.62, 0.97 * r), (1.05, 0.62 * r)]
        vase = [(0.16, 0.95), (0.40, 1.12), (0.52, 0.72), (0.55, 0.98), (0.58, 0.74), (0.72, 1.0)]
        rings = [(0.10, 0.9), (0.13, 1.15), (0.16, 0.85), (0.45, 1.1), (0.66, 0.72), (0.69, 1.0)]
        foot = [(0.73, 0.8), (0.82, 0.95), (1.05, 0.58)]
        return [(share, k * r) for share, k in [*(vase if self.turnings == 1 else rings), *foot]]

    def spindle(self, length: float, along: Vector) -> Solid:
        """Return a spindle from hole to hole, `length` between the mouths, its lower mouth at the origin."""
        foot, tip = SPINDLE_FOOT, SPINDLE_TIP
        profile = [(-foot.length, foot.radius), (MOUTH, foot.radius), (0.35 * length, 1.3 * foot.radius)]
        profile += [(length - MOUTH, tip.radius), (length + tip.length, tip.radius)]
        return turned_along(0 * X, along, X, profile, 8)

    def rail(self, z: float, height: float, tapered: bool) -> Solid:
        """Return a bent rail over the row of spindles, level below at z; tapered, its ends are lower and rounded."""
        along, _ = leaning(self.rake)
        share = np.array([-1, -0.95, -0.8, -0.55, -0.28, 0.0, 0.28, 0.55, 0.8, 0.95, 1])
        x = (SPAN * self.seat_width + 0.030) * share
        sizes = [1, 0.97, 0.88, 0.72, 0.55] if tapered else [1, 1, 1, 1, 1]
        high = np.interp(np.abs(share), [0, 0.55, 0.8, 0.95, 1], sizes)
        thick = np.interp(np.abs(share), [0, 0.95, 1], [0.025, 0.025, 0.016])
        path = self.on_back(x, z) + along * (height * high / 2)[:, None]
        return sweep(path, along, Y, rectangles(high * height, thick, 0.004))
