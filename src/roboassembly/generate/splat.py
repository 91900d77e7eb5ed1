"""The splat-back: a board seat, curved front legs under it, posts at its sides, and a vase between seat and crest.

Posts come to the seat along x, front legs from below, the splat and the crest along the back's slope. So both posts
are at the seat and the splat is in its mortise before the crest goes on; a crest that is on a post is too early.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, count, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame, rail
from roboassembly.generate.outlines import rectangles, rounded_trapezoid, smooth, symmetric
from roboassembly.generate.solids import bar, bent, block, cut_out, mirrored_x, pad, polyline, sweep
from roboassembly.generate.vectors import X, Y, Z, leaning, move, spin, vector

LEG_TENON = Tenon(0.024, 0.024, 0.022)
SEAT_TENON = Tenon(0.030, 0.018, 0.013)
CREST_TENON = Tenon(0.015, 0.012, 0.026)
BAR_TENON = Tenon(0.016, 0.008, 0.010)
OUTLINES = (
    [(0.34, 0.0), (0.30, 0.06), (0.20, 0.18), (0.24, 0.30), (0.50, 0.62), (0.44, 0.78), (0.26, 0.92), (0.34, 1.0)],
    [(0.40, 0.0), (0.42, 0.16), (0.20, 0.36), (0.22, 0.50), (0.46, 0.74), (0.48, 0.86), (0.36, 1.0)],
    [(0.26, 0.0), (0.30, 0.3), (0.38, 0.7), (0.44, 1.0)],
)
"""Vase, fiddle and taper: half the splat's width over the distance between the posts, at shares of its height."""


@family("splat", "board seat, curved front legs, a vase between seat and crest")
class SplatChair(Design):
    """A chair of 7 to 9 parts."""

    width: float = size(0.49, 0.46, 0.52)  # of the seat's front edge
    back_width: float = size(0.40, 0.37, 0.42)  # over the outer faces of the posts
    depth: float = size(0.44, 0.41, 0.47)
    seat_height: float = size(0.46, 0.43, 0.475)
    seat_thickness: float = size(0.058, 0.048, 0.075)
    height: float = size(0.97, 0.88, 1.06)
    rake: float = size(0.15, 0.10, 0.20)
    post: float = size(0.034, 0.031, 0.038)
    leg: float = size(0.046, 0.040, 0.052)
    knee: float = one_of(0.0, 0.010, 0.014, 0.018, default=0.014)  # of a front leg; zero for straight tapered legs
    outline: int = count(0, 0, 2)  # of the splat
    crest: float = size(0.062, 0.05, 0.08)
    ears: float = size(0.022, 0.008, 0.035)  # how far the crest reaches beyond the posts
    stretchers: int = count(0, 0, 2)  # rails between the posts below the seat

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        under, inner = s.seat_height - s.seat_thickness, s.back_width / 2 - s.post
        rear = s.depth / 2 - 0.024 - s.post / 2
        along, across = leaning(s.rake)

        # A post: bent backward below the seat, leaning above it; level sections, so that its inner face stays plane.
        knee = vector(s.back_width / 2 - s.post / 2, rear, s.seat_height + 0.015)
        reach = (s.height - s.crest - knee[2]) / along[2]
        line = [vector(knee[0], rear + 0.055, 0), vector(knee[0], rear, under - 0.05), knee, knee + (reach - c) * along]
        points, tangents = bent(line, 0.14)
        points = np.concatenate([points[:1], points[:1] + 0.005 * tangents[:1], points[1:]])
        deep = s.post * np.interp(points[:, 2], [0, 0.005, 0.2, s.seat_height, s.height], [0.72, 0.80, 1, 1, 0.82])
        shaft = sweep(points, X, Y, rectangles(s.post, deep, 0.004))
        post = Blank(shaft.trim_by_plane(-along, -float((knee + (reach - c) * along) @ along)))

        # The crest on posts and splat: level below, waved above.
        top, foot = knee + reach * along, vector(0, knee[1] + (s.seat_height - knee[2]) * np.tan(s.rake), s.seat_height)
        span = (top[2] - s.seat_height) / along[2]
        x = np.array([-1, -0.96, -0.86, -0.7, -0.45, -0.2, 0, 0.2, 0.45, 0.7, 0.86, 0.96, 1])
        high = s.crest * np.array([0.68, 0.84, 0.92, 0.84, 0.86, 1.02, 1.08, 1.02, 0.86, 0.84, 0.92, 0.84, 0.68])
        path = polyline(foot + span * along, ((s.back_width / 2 + s.ears) * x, X), (high / 2, along))
        crest = Blank(sweep(path, along, -across, rectangles(high, 0.030, 0.006)))

        # The splat, between seat and crest, both along the slope; the seat, notched for the posts.
        splat, tenon = self.splat(0.62 * inner, span)
        body = Blank(cut_out(splat, foot, X, along, 0.013))
        a.join(tenon, joint_frame(foot + span * along, -along, X), body, crest)
        splat = Blank(body.solid.trim_by_plane((0.0, 0.0, 1.0), s.seat_height + c / along[2]))
        outline = rounded_trapezoid(s.width, s.back_width + 0.01, s.depth, 0.03, steps=4)
        seat = Blank(pad(outline, under, s.seat_height, 0.012, under=0.008))
        notch = block((inner - c, rear - s.post / 2 - 0.012, 0), (1, 1, 1))
        seat -= notch + mirrored_x(notch)
        a.join(CREST_TENON, joint_frame(top, -along, X), post, crest)
        crest -= CREST_TENON.pocket(joint_frame(top * [-1, 1, 1], -along, X))
        a.join_sides(SEAT_TENON, joint_frame(vector(inner, rear, under + 0.5 * s.seat_thickness), -X, Z), seat, post)
        a.join(tenon, joint_frame(foot, along, X), splat, seat, over=0.01)
        a.part("splat", "back_single_surface", splat)
        a.part("crest_rail", "back_frame_horizontal_bar", crest)

        # Rails between the posts, below the seat.
        stretcher = Blank(rail(-inner * X, inner * X, Z, 0.026, 0.014, BAR_TENON))
        places = [move(y=np.interp(z, points[:, 2], points[:, 1]), z=z) for z in (0.16, 0.25)[: s.stretchers]]
        a.each("stretcher", "bar_stretcher", stretcher, places)
        a.pockets(BAR_TENON, joint_frame(inner * X, -X, Z), post, places)
        a.pair("post", "back_frame_vertical_bar", post, first="left")

        leg = self.front_leg(under - c)
        x, y = s.width / 2 - 0.022 - s.leg / 2, -s.depth / 2 + 0.022 + s.leg / 2
        places = {"right": spin(0.0, -x, y), "left": spin(np.pi / 2, x, y)}
        a.join(LEG_TENON, joint_frame(under * Z, -Z, X), leg, seat, a.each("leg_front", "leg", leg, places))
        a.part("seat", "seat_single_surface", seat)

    def front_leg(self, top: float) -> Blank:
        """Return a leg about the z axis, symmetric about its diagonal: a quarter turn gives the other side's leg."""
        z = np.array([0.0, 0.006, 0.02, 0.10, 0.45 * top, 0.78 * top, 0.92 * top, top])
        wide = self.leg * np.array([0.62, 0.72, 0.68, 0.52, 0.66, 0.94, 1.0, 1.0])
        out = self.knee * np.array([-1.3, -1.3, -1.0, 0.35, 0.25, -0.75, -0.4, 0.0])
        if self.knee == 0.0:
            wide = self.leg * np.interp(z / top, [0, 0.9, 1], [0.6, 1, 1])
            out = -(self.leg - wide) / 2
        return Blank(bar(out, out, z, X, Y, wide, wide, 0.2 * wide))

    def splat(self, space: float, span: float) -> tuple[np.ndarray, Tenon]:
        """Return the outline of the splat, with something to trim below, and the tenon it has at either end."""
        points = smooth([(space * x, span * y) for x, y in OUTLINES[self.outline]], 19)
        points = [(x, min(max(y, -0.012), span - CLEARANCE)) for x, y in points]
        points[0] = (points[0][0], -0.02)
        return symmetric(points), Tenon(1.1 * min(points[0][0], points[-1][0]), 0.007, 0.016, root=0.012)
