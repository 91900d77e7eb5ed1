"""The three-legged chair: a round seat on three legs a third of a turn apart, with or without a back.

Either splayed legs go into the seat one by one, or a three-armed stretcher holds bent legs together: it meets every
leg along a radius and the seat meets them from above, so the seat comes last of all.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, splayed_leg
from roboassembly.generate.outlines import circle, rectangles
from roboassembly.generate.solids import bar, pad, placed, polyline, sweep, turned, turned_along
from roboassembly.generate.vectors import Points, X, Y, Z, leaning, move, spin, vector

NO_BACK, HOOP, POSTS = range(3)
MOUTH = 0.012
LEG_PEG = RoundTenon(radius=0.0125, length=0.022, end_radius=0.0115, sides=12)
STAR_TENON = Tenon(0.020, 0.012, 0.012)
POST_FOOT = RoundTenon(radius=0.0085, length=0.020, sides=8)
POST_TIP = RoundTenon(radius=0.0075, length=0.022, sides=8)
HOOP_TENON = Tenon(0.030, 0.011, 0.018, root=0.03)
CREST = 0.072


@family("three_legged", "round seat on three legs a third of a turn apart, with or without a back")
class ThreeLeggedChair(Design):
    """A chair or stool of 4 to 9 parts."""

    back: int = one_of(NO_BACK, HOOP, HOOP, POSTS, POSTS, default=POSTS)
    seat: float = size(0.40, 0.36, 0.43)  # diameter
    seat_height: float = size(0.45, 0.43, 0.49)
    thickness: float = size(0.042, 0.038, 0.050)
    saddle: float = one_of(0.008, 0.005, -0.014)
    height: float = size(0.80, 0.70, 0.86)
    rake: float = size(0.20, 0.14, 0.24)
    star: bool = chance(True, 0.65)  # a three-armed stretcher between bent legs, instead of straight splayed ones
    star_height: float = size(0.20, 0.15, 0.26)
    leg: float = size(0.034, 0.031, 0.040)
    splay: float = size(0.20, 0.16, 0.26)
    posts: int = count(2, 2, 3)

    def build(self, a: Assembly) -> None:
        s, under = self, self.seat_height - self.thickness
        seat = Blank(pad(circle(s.seat / 2, 30), under, s.seat_height, 0.008, crown=-s.saddle, under=0.008))
        # One leg points forward, two backward.
        places = [spin(2 * np.pi * k / 3 - np.pi / 2) for k in range(3)]
        if s.star:
            reach = 0.36 * s.seat
            leg, mouth = self.bent_leg(under, reach), vector(reach - s.leg / 2, 0, 0)
            star = Blank(turned([(-0.014, 0.028), (-0.010, 0.032), (0.010, 0.032), (0.014, 0.028)], 18))
            arm = sweep([0 * X, mouth - CLEARANCE * X], Y, Z, rectangles([0.024, 0.021], 0.022, 0.003))
            arm += STAR_TENON.tongue(joint_frame(mouth, -X, Y))
            for place in places:
                star += placed(arm, place)
                seat -= placed(LEG_PEG.pocket(joint_frame(vector(reach, 0, under), -Z, X)), place)
            a.part("stretcher", "bar_stretcher", star, move(z=s.star_height))
        else:
            r = 0.5 * s.leg
            profile = [(0.2, 0.9 * r), (0.42, 1.15 * r), (0.60, r), (1.05, 0.68 * r)]
            solid, mouth_at = splayed_leg(under, s.splay, LEG_PEG, MOUTH, profile)
            leg, places = Blank(solid), [place * move(0.28 * s.seat) for place in places]
            for place in places:
                seat -= LEG_PEG.pocket(mouth_at(place), over=MOUTH)
        a.each("leg", "leg", leg, dict(zip(("front", "back_left", "back_right"), places, strict=True)))
        if s.back == HOOP:
            self.hoop(a, seat)
        elif s.back == POSTS:
            self.posts_and_crest(a, seat)
        a.part("seat", "seat_single_surface", seat)

    def bent_leg(self, under: float, reach: float) -> Blank:
        """Return a leg at distance `reach` along +x, upright from the stretcher up, its foot outward."""
        top, star = under - CLEARANCE, self.star_height
        z = np.array([0.0, 0.004, 0.05, star - 0.06, star - 0.03, top - 0.03, top])
        out = np.array([0.062, 0.060, 0.040, 0.010, 0.0, 0.0, 0.0])
        wide = self.leg * np.array([0.60, 0.66, 0.70, 0.92, 1.0, 1.0, 0.92])
        leg = bar(reach + out, 0.0, z, X, Y, wide, 0.8 * wide, 0.005)
        leg += LEG_PEG.tongue(joint_frame(vector(reach, 0, under), -Z, X))
        return Blank(leg - STAR_TENON.pocket(joint_frame(vector(reach - self.leg / 2, 0, star), -X, Y)))

    def hoop(self, a: Assembly, seat: Blank) -> None:
        """Add a back in one piece: a board that widens upward, bent around the sitter, with two tongues below."""
        along, _ = leaning(self.rake)
        foot = vector(0, 0.5 * self.seat - 0.062, self.seat_height)
        share = np.array([0.0, 0.3, 0.55, 0.75, 0.9, 0.97, 1.0])
        width = self.seat * np.array([0.44, 0.46, 0.58, 0.74, 0.77, 0.70, 0.54])
        # A gap below, so that a leaning board stays clear of the seat but for its tongues.
        up = 0.012 + share * ((self.height - self.seat_height) / along[2] - 0.012)
        board = sweep(polyline(foot, (up, along), (0.035 * share**2, Y)), X, Y, rectangles(width, 0.019, 0.004))
        back = a.part("back", "back_single_surface", board)
        for x in (-0.055, 0.055):
            a.join(HOOP_TENON, joint_frame(foot + x * X - 0.001 * Z, Z, X), back, seat, over=MOUTH)

    def posts_and_crest(self, a: Assembly, seat: Blank) -> None:
        """Add turned posts and a bent crest on them."""
        along, _ = leaning(self.rake)
        span, rear = 0.27 * self.seat, 0.5 * self.seat - 0.062
        length = (self.height - self.seat_height) / along[2] - CREST
        profile = [(-POST_FOOT.length, POST_FOOT.radius), (MOUTH, POST_FOOT.radius), (0.4 * length, 0.0135)]
        profile += [(length - MOUTH, POST_TIP.radius), (length + POST_TIP.length, POST_TIP.radius)]
        post = Blank(turned_along(0 * X, along, X, profile, 8))
        share = np.array([-1, -0.95, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 0.95, 1])
        high = CREST * np.interp(np.abs(share), [0, 0.75, 0.95, 1], [1.1, 1.0, 0.85, 0.6])
        thick = np.interp(np.abs(share), [0, 0.95, 1], [0.027, 0.027, 0.017])

        def row(x: np.ndarray, z: float) -> Points:
            """Return points of the bent row of posts at x."""
            return np.stack(np.broadcast_arrays(x, rear - 0.05 * ((x / span) ** 2 - 1) * 0.5, z), axis=-1)

        path = row((span + 0.055) * share, self.seat_height) + length * along + (high / 2)[:, None] * along
        crest = Blank(sweep(path, along, Y, rectangles(high, thick, 0.004)))
        for k, foot in enumerate(row(np.linspace(-span, span, self.posts), self.seat_height - 0.001)):
            a.part(f"post_{k + 1}", "back_surface_vertical_bar", post, move(*foot))
            seat -= POST_FOOT.pocket(joint_frame(foot, along, X), over=MOUTH)
            crest -= POST_TIP.pocket(joint_frame(foot + length * along, -along, X), over=MOUTH)
        a.part("crest_rail", "back_frame_horizontal_bar", crest)
