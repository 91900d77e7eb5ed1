"""Two-seaters and garden chairs: slatted seat and slatted back between two sides, each sawn from one board.

Everything but armrests lies along x between the sides, so that whatever joins both of them shuts out the rest; the
bench's upright slats must be between their two rails before a side is on.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, drawn, family, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame, mouths, rail
from roboassembly.generate.outlines import rectangles
from roboassembly.generate.solids import Solid, bar, bent, block, ribbon, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, unit, vector

SEAT_SLAT = 0.022
CREST = 0.075
ARM_TENON = Tenon(0.018, 0.014, 0.013)
UPRIGHT_TENON = Tenon(0.024, 0.008, 0.014)


@family("bench", "two-seater: slatted seat and back between two sides, armrests")
class SlattedBench(Design):
    """A bench of 10 to 17 parts."""

    width: float = size(1.06, 0.92, 1.20)  # over the outer faces of the sides
    upright: bool = chance(True, 0.55)  # slats of the back between two rails, instead of bars along x
    depth: float = size(0.50, 0.46, 0.54)
    seat_height: float = size(0.44, 0.42, 0.46)
    height: float = size(0.84, 0.78, 0.92)
    side: float = size(0.040, 0.036, 0.046)  # thickness of the sides, along x
    stile: float = size(0.050, 0.044, 0.058)  # width of their legs and posts, seen from the side
    rake: float = size(0.26, 0.18, 0.32)
    seat_slats: int = count(4, 3, 4)
    back_bars: int = drawn(0, lambda rng, s: 0 if s.upright else int(rng.integers(2, 4)))
    upright_slats: int = drawn(6, lambda rng, s: int(rng.integers(4, 8)) if s.upright else 0)
    arms: bool = chance(True, 0.7)
    stretcher: bool = drawn(False, lambda rng, s: bool(rng.random() < 0.4) and not s.upright)

    def build(self, a: Assembly) -> None:
        s, inner, deep = self, self.width / 2 - self.side, 0.42 * self.side
        along, across = leaning(s.rake)
        front, rear = -s.depth / 2, s.depth / 2
        knee = vector(0, rear - 0.10, s.seat_height + 0.01)
        reach = (s.height - knee[2]) / along[2]
        top = s.seat_height + 0.19 if s.arms else s.seat_height - 0.003
        leg_top = vector(s.width / 2 - s.side / 2, front + s.stile / 2 + 0.01, top)
        side = Blank(self.sawn_side(leg_top, front, rear, knee, along, reach))

        # Seat slats, alike, between the sides and flush with their seat rails.
        pitch = (knee[1] - 0.035 - (front + 0.012)) / s.seat_slats
        tenon = Tenon(0.55 * pitch, 0.011, deep)
        first = vector(0, front + 0.012 + pitch / 2, s.seat_height - SEAT_SLAT / 2 - 0.003)
        slat = Blank(rail(first - inner * X, first + inner * X, Y, pitch - 0.0125, SEAT_SLAT, tenon, 0.004))
        places = a.each("seat_slat", "seat_surface_bar", slat, [move(y=k * pitch) for k in range(s.seat_slats)])
        a.pockets(tenon, joint_frame(first + inner * X, -X, Y), side, places)
        self.back(a, side, knee, along, reach)
        if s.stretcher:
            # On the middle line of the rear legs, which run straight up to their bend.
            share = 0.15 / (knee[2] - 0.045)
            at = vector(0, (1 - share) * (rear - 0.01) + share * knee[1], 0.15)
            a.cross("stretcher", "bar_stretcher", at, inner, Z, (0.045, 0.022), Tenon(0.024, 0.012, deep), side)
        if s.arms:
            arm = Blank(self.armrest(leg_top, knee, along, across))
            a.each("armrest", "arm_horizontal_bar", arm, {"left": move(), "right": move(-2 * leg_top[0])})
            a.join(ARM_TENON, joint_frame(leg_top, -Z, Y), side, arm)
        a.pair("side", "leg", side, first="left")

    def back(self, a: Assembly, side: Blank, knee: Vector, along: Vector, reach: float) -> None:
        """Add the back: bars along x, all alike, or two with upright slats between them."""
        inner, top, low = self.width / 2 - self.side, reach - 0.010 - CREST / 2, 0.085

        def blank(up: float, height: float) -> Blank:
            at, tenon = knee + up * along, Tenon(0.6 * height, 0.010, 0.42 * self.side)
            return Blank(rail(at - inner * X, at + inner * X, along, height, 0.022, tenon, 0.004))

        if self.upright:
            crest, lower = blank(top, CREST), blank(low, 0.050)
            bars = [("crest_rail", top, CREST, crest, 0.0), ("back_rail_lower", low, 0.050, lower, 0.0)]
            start, end = knee + (low + 0.025) * along, knee + (top - CREST / 2) * along
            upright = Blank(rail(start, end, X, 0.052, 0.012, UPRIGHT_TENON, 0.002))
            pitch = 2 * inner / self.upright_slats
            places = [move((k - (self.upright_slats - 1) / 2) * pitch) for k in range(self.upright_slats)]
            a.each("back_slat", "back_surface_vertical_bar", upright, places)
            for frame, rail_blank in zip(mouths(start, end, X), (lower, crest), strict=True):
                a.pockets(UPRIGHT_TENON, frame, rail_blank, places)
        else:
            height = min(0.085, 0.60 * (top - low) / max(1, self.back_bars - 1))
            ups = np.linspace(low + 0.03, reach - 0.010 - height / 2, self.back_bars)
            first = blank(ups[0], height)
            bars = [(f"back_bar_{k + 1}", up, height, first, up - ups[0]) for k, up in enumerate(ups)]
        for name, up, height, shape, lift in bars:
            a.part(name, "back_surface_horizontal_bar", shape, move(*(lift * along)))
            tenon = Tenon(0.6 * height, 0.010, 0.42 * self.side)
            side -= tenon.pocket(joint_frame(knee + up * along + inner * X, -X, along))

    def sawn_side(self, leg_top: Vector, front: float, rear: float, knee: Vector, along: Vector, reach: float) -> Solid:
        """Return the left side in one piece: front leg, seat rail and the rear leg that bends back."""
        s, x, half = self, leg_top[0], self.stile / 2
        rail_z = s.seat_height - 0.5 * s.stile - 0.004
        foot, middle = vector(x, front + half, 0), vector(x, leg_top[1], rail_z)
        path = [foot, foot + 0.004 * Z, middle, leg_top - CLEARANCE * Z]
        leg = sweep(path, X, Y, rectangles(s.side, np.array([0.78, 0.84, 1.0, 0.9]) * s.stile, 0.003))
        thin = s.side / 2 - 0.0001
        seat_rail = block((x - thin, front + 0.02, rail_z - half), (x + thin, knee[1], rail_z + half))
        heel, bend = vector(x, rear - 0.01, 0), knee + x * X
        points, tangents = bent([heel - 0.05 * unit(bend - heel), bend - 0.045 * Z, bend + reach * along], 0.35, 4)
        points = np.concatenate([points[:-1], points[-1:] - 0.014 * along, points[-1:]])
        tangents = np.concatenate([tangents, tangents[-1:]])
        wide = s.stile * np.interp(points[:, 2], [0, knee[2], s.height - 0.02, s.height], [0.9, 1.0, 0.85, 0.55])
        post = ribbon(points, tangents, X, rectangles(s.side, wide, 0.003))
        return leg + seat_rail + post.trim_by_plane((0.0, 0.0, 1.0), 0.0)

    def armrest(self, leg_top: Vector, knee: Vector, along: Vector, across: Vector) -> Solid:
        """Return the left armrest on its front leg, to the leaning post's front edge."""
        x, front, z = leg_top + 0.012 * Z
        end = knee + (z - knee[2]) / along[2] * along + (self.stile / 2 + 0.0012) * across
        y = np.array([front - 0.050, front - 0.044, front - 0.01, 0.5 * (front + end[1]), end[1] + 0.04])
        wide = np.array([0.040, 0.052, 0.062, 0.054, 0.044]) * max(1.0, self.side / 0.036)
        high = np.array([0.014, 0.020, 0.024, 0.024, 0.024])
        return bar(x, y, z, X, Z, wide, high, 0.004).trim_by_plane(across, float((end + 0.008 * across) @ across))


@family("garden", "slats between two sides that are sawn in one piece, armrests")
class GardenChair(SlattedBench):
    """A garden chair of 7 to 13 parts."""

    width: float = size(0.56, 0.50, 0.62)
    upright: bool = False
    seat_height: float = size(0.41, 0.39, 0.44)
    height: float = size(0.86, 0.78, 0.98)
    side: float = size(0.032, 0.028, 0.038)
    stile: float = size(0.046, 0.040, 0.052)
    rake: float = size(0.30, 0.20, 0.38)
    seat_slats: int = count(4, 3, 5)
    back_bars: int = count(3, 2, 3)
    upright_slats: int = 0
    arms: bool = chance(True, 0.75)
    stretcher: bool = False
