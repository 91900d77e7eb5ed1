"""The swivel chair: five feet around a hub, a column with a cover, a plate, the seat on it, a back on a bent bar.

The cover is a tube that slides over the column and rests on the hub. It is wider than the plate's socket and than
the hub's bore, so it must be on the column before the column has something at both ends.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, drawn, family, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.outlines import rectangle, rectangles, rounded_trapezoid
from roboassembly.generate.solids import bar, pad, polyline, ribbon, sweep, turned
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, spin, unit, vector

FOOT_TENON = Tenon(0.024, 0.012, 0.014)
CASTER_PIN = RoundTenon(radius=0.0050, length=0.010, sides=8)
SEAT_PEG = RoundTenon(radius=0.0075, length=0.014, sides=8)
COLUMN = 0.0185  # radius of the column between its tenons
COLUMN_FOOT = RoundTenon(radius=0.0155, length=0.036, end_radius=0.0140, sides=16)
COLUMN_HEAD = RoundTenon(radius=0.0140, length=0.020, end_radius=0.0130, sides=16)
BAR_TENON = Tenon(0.044, 0.010, 0.026)
BACK_TENON = Tenon(0.046, 0.012, 0.090)
BRACKET_TENON = Tenon(0.034, 0.010, 0.030)
ARM_PIN = Tenon(0.030, 0.008, 0.011)
PLATE = 0.036  # thickness of the plate under the seat


@family("pedestal", "five feet around a hub, column with cover, upholstered seat, back on a bar")
class PedestalChair(Design):
    """A chair of 11 to 20 parts."""

    casters: bool = chance(False, 0.45)
    cover: bool = chance(True, 0.8)
    width: float = size(0.47, 0.44, 0.51)
    depth: float = size(0.46, 0.43, 0.48)
    seat_height: float = size(0.47, 0.44, 0.49)
    seat_thickness: float = size(0.062, 0.05, 0.08)
    crown: float = size(0.014, 0.008, 0.022)
    height: float = size(0.92, 0.84, 1.0)
    star: float = size(0.29, 0.26, 0.32)  # radius of the star of feet
    hub: float = size(0.042, 0.039, 0.048)
    # With casters and a cover, armrests would make 21 parts.
    arms: bool = drawn(False, lambda rng, s: bool(rng.random() < 0.45) and not (s.casters and s.cover))
    rake: float = size(0.16, 0.10, 0.24)
    back_width: float = size(0.40, 0.34, 0.44)
    back_height: float = size(0.30, 0.22, 0.36)

    def build(self, a: Assembly) -> None:
        s, c, lift = self, CLEARANCE, 0.052 if self.casters else 0.0
        hub_low, hub_top = 0.050 + lift, 0.118 + lift
        under = s.seat_height - s.seat_thickness
        plate_low = under - c - PLATE

        # Hub and feet. A ten-sided hub, its corners at multiples of 36 degrees, has flats at -90, -18, 54...
        rim = [(hub_low, -0.004), (hub_low + 0.004, 0.0), (hub_top - 0.004, 0.0), (hub_top, -0.004)]
        hub = Blank(turned([(z, s.hub + out) for z, out in rim], 10))
        hub -= COLUMN_FOOT.pocket(joint_frame(hub_top * Z, Z, X))
        mouth, tip = vector(s.hub * np.cos(np.pi / 10), 0, (hub_low + hub_top) / 2), vector(s.star, 0, 0.024 + lift)
        foot = self.foot(mouth, tip)
        caster = self.caster(tip[2] - 0.011)
        for k in range(5):
            place = spin(2 * np.pi * k / 5 - np.pi / 2)  # one foot points forward
            a.part(f"foot_{k + 1}", "star_leg", foot, place)
            hub -= FOOT_TENON.pocket(place * joint_frame(mouth, X, Z))
            if s.casters:
                a.part(f"caster_{k + 1}", "wheel", caster, place * move(tip[0] - 0.010))
        a.part("hub", "central_support", hub)

        # Column, its cover, and the plate that carries the seat.
        low, high = hub_top + c, hub_top + 0.55 * (plate_low - hub_top)
        column = turned([(low, COLUMN - 0.001), (low + 0.001, COLUMN), (plate_low - c, COLUMN)], 16)
        column += COLUMN_FOOT.tongue(joint_frame(hub_top * Z, Z, X))
        a.part("column", "pedestal", column + COLUMN_HEAD.tongue(joint_frame(plate_low * Z, -Z, X)))
        if s.cover:
            tube = [(low, 0.033), (low + 0.012, 0.033), (low + 0.014, 0.0285), (high - 0.003, 0.0265), (high, 0.024)]
            bore = COLUMN + c / np.cos(np.pi / 16)
            a.part("column_cover", "pedestal", turned(tube, 16) - turned([(0.0, bore), (high + 1, bore)], 16))
        plate = Blank(pad(rounded_trapezoid(0.17, 0.15, 0.20, 0.03), plate_low, plate_low + PLATE, 0.002, under=0.010))
        plate -= COLUMN_HEAD.pocket(joint_frame(plate_low * Z, -Z, X))
        outline = rounded_trapezoid(s.width, s.width - 0.05, s.depth, 0.07, steps=4)
        seat = Blank(pad(outline, under, s.seat_height, 0.3 * s.seat_thickness, s.crown, 0.2 * s.seat_thickness))
        for x in (-0.055, 0.055):
            a.join(SEAT_PEG, joint_frame(vector(x, -0.02, under), -Z, X), plate, seat)

        # The back on its bent bar.
        start = vector(0, 0.10, plate_low + 0.015)
        plate -= BAR_TENON.pocket(joint_frame(start, Y, X))
        along, _ = leaning(s.rake)
        bend = vector(0, s.depth / 2 + 0.016 + 0.075, start[2])
        mouth = bend + (s.height - s.back_height * np.cos(s.rake) - start[2]) / along[2] * along
        a.part("back_bar", "back_connector", self.bar(start, bend, mouth))
        a.part("back", "back_single_surface", self.back(mouth))
        a.part("plate", "seat_frame_bar", plate)
        if s.arms:
            self.armrests(a, seat, under + 0.45 * s.seat_thickness)
        a.part("seat", "seat_single_surface", seat)

    def foot(self, mouth: Vector, tip: Vector) -> Blank:
        """Return a foot along +x from the hub's flat to its tip."""
        (flat, _, z), (end, _, low) = mouth, tip
        x = [flat + CLEARANCE, flat + 0.06, 0.6 * end, end - 0.010, end + 0.012, end + 0.018]
        height = [z, z - 0.001, 0.62 * z + 0.38 * low, low, low - 0.001, low - 0.002]
        wide, high = [0.022, 0.027, 0.027, 0.030, 0.028, 0.018], [0.050, 0.044, 0.032, 0.022, 0.018, 0.010]
        body = bar(x, 0.0, height, Y, Z, wide, high, 0.004) + FOOT_TENON.tongue(joint_frame(mouth, X, Z))
        under = vector(end - 0.010, 0, low - 0.011)
        if self.casters:
            return Blank(body - CASTER_PIN.pocket(joint_frame(under, -Z, X)))
        glide = turned([(0.0, 0.010), (0.003, 0.012), (under[2] + 0.004, 0.012)], 10)
        return Blank(body + glide.translate((under[0], 0.0, 0.0)))

    def caster(self, top: float) -> Blank:
        """Return a ball caster about the z axis from the floor to a foot's underside at `top`, its pin included."""
        high = top - CLEARANCE
        r = (high - 0.006) / 2
        angle = np.radians([-64, -35, 0, 35, 64])
        z = r + r * np.sin(angle)
        profile = [*zip(z - z[0], 1.1 * r * np.cos(angle), strict=True), (z[-1] - z[0] + 0.001, 0.009), (high, 0.009)]
        return Blank(turned(profile, 12) + CASTER_PIN.tongue(joint_frame(top * Z, -Z, X)))

    def bar(self, start: Vector, bend: Vector, mouth: Vector) -> Blank:
        """Return a flat bar backward from the plate and up to the back, with tongues at both ends."""
        along, _ = leaning(self.rake)
        begin, finish = bend - 0.07 * Y, bend + 0.07 * along
        shares = np.linspace(0, 1, 6)
        curve = [(1 - t) ** 2 * begin + 2 * t * (1 - t) * bend + t**2 * finish for t in shares]
        tangents = [unit(2 * (1 - t) * (bend - begin) + 2 * t * (finish - bend)) for t in shares]
        points = [start + CLEARANCE * Y, *curve, mouth - CLEARANCE * along]
        body = ribbon(points, [Y, *tangents, along], X, rectangle(0.060, 0.016, 0.004))
        body += BAR_TENON.tongue(joint_frame(start, Y, X))
        return Blank(body + BACK_TENON.tongue(joint_frame(mouth, -along, X)))

    def back(self, mouth: Vector) -> Blank:
        """Return an upholstered back, gently bent around the sitter, with a socket in its lower edge."""
        along, across = leaning(self.rake)
        x = self.back_width / 2 * np.array([-1, -0.97, -0.85, -0.5, 0, 0.5, 0.85, 0.97, 1])
        high = self.back_height * np.array([0.62, 0.78, 0.93, 1, 1, 1, 0.93, 0.78, 0.62])
        thick = np.array([0.022, 0.032, 0.042, 0.046, 0.048, 0.046, 0.042, 0.032, 0.022])
        middle, forward = mouth + self.back_height / 2 * along, 0.035 * (x / (self.back_width / 2)) ** 2
        path = polyline(middle, (x, X), (forward, across))
        body = sweep(path, along, across, rectangles(high, thick, 0.3 * thick))
        return Blank(body - BACK_TENON.pocket(joint_frame(mouth, -along, X)))

    def armrests(self, a: Assembly, seat: Blank, level: float) -> None:
        """Add brackets at the seat's sides, and pads on them."""
        # The seat's side is not quite parallel to y: cut its flat for the bracket.
        y = -0.02
        face = self.width / 2 - 0.05 * (0.5 + y / self.depth) / 2 - 0.006
        for side in (1, -1):
            ends = [vector(side * (face - CLEARANCE), y, level), vector(side * (face + 0.05), y, level)]
            seat -= sweep(ends, Y, Z, rectangle(0.062, 1.0))
        # A bracket out of the seat's side at x = 0 and up, mirror-symmetric in y.
        top = self.seat_height + 0.175
        x = np.array([CLEARANCE, 0.034 - 0.012, 0.034 + 0.008, 0.034 + 0.014, 0.034 + 0.008])
        z = np.array([level, level, level + 0.014, level + 0.05, top - CLEARANCE])
        tangents = [X, X, 0.7 * (X + Z), Z, Z]
        body = ribbon(np.column_stack([x, 0 * x, z]), tangents, Y, rectangle(0.050, 0.018, 0.004))
        socket, pin = joint_frame(vector(0, 0, level), X, Y), joint_frame(vector(x[-1], 0, top), -Z, Y)
        bracket = Blank(body + BRACKET_TENON.tongue(socket) + ARM_PIN.tongue(pin))
        # The left pad: flared outward in front.
        y_pad = np.array([-0.125, -0.118, -0.09, 0.0, 0.09, 0.108, 0.113])
        x_pad = x[-1] + np.array([0.016, 0.015, 0.012, 0.0, -0.006, -0.007, -0.007])
        wide = np.array([0.040, 0.058, 0.070, 0.062, 0.052, 0.042, 0.030])
        high = np.array([0.012, 0.022, 0.026, 0.026, 0.026, 0.022, 0.014])
        rest = Blank(bar(x_pad, y_pad, top + 0.013, X, Z, wide, high, 0.004) - ARM_PIN.pocket(pin))
        for side, place in (("left", spin(0.0, face, y)), ("right", spin(np.pi, -face, y))):
            seat -= BRACKET_TENON.pocket(place * socket, over=0.02)
            a.part(f"arm_bracket_{side}", "arm_near_vertical_bar", bracket, place)
            a.part(f"arm_pad_{side}", "arm_horizontal_bar", rest, move(*place.translation), mirrored=side == "right")
