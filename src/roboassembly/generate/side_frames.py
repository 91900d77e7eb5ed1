"""Chairs made of two side frames on runners, flat (sled) or curved (rocker), with everything else between them.

In a side frame the seat rail and the armrest run along y between leg and post, and the armrest sits on the leg and
the runner under both along z. So leg, seat rail and armrest come together first, then the post along y, then the
runner from below; a runner that already joins leg and post shuts the armrest out. The rest runs along x between the
two frames, and the spindles of a back have to be between its two rails before a post is.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, drawn, family, size
from roboassembly.generate.joints import CLEARANCE, Tenon, arched_rail, joint_frame, mouths, rail
from roboassembly.generate.outlines import from_front_to_rear, rectangle, rectangles
from roboassembly.generate.solids import Solid, bar, loft, pad, polyline, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, spin, vector

RUNNER = 0.032  # height of a runner
ARM = 0.024  # thickness of an armrest
SLAT = 0.042  # height of a slat
SPINDLE_TENON = Tenon(0.015, 0.007, 0.014)


@family("sled", "two side frames on flat runners, armrests, cushion on rails between them")
class SledChair(Design):
    """A chair of 12 to 17 parts."""

    width: float = size(0.50, 0.47, 0.53)  # over the outer faces of the legs
    # Over the outer faces of leg and post; rails across and along differ by more than a hair.
    depth: float = drawn(0.46, lambda rng, s: s.width - rng.uniform(0.015, 0.06))
    seat_height: float = size(0.44, 0.41, 0.46)
    height: float = size(0.84, 0.78, 0.90)
    post: float = size(0.036, 0.034, 0.041)
    rake: float = size(0.22, 0.15, 0.28)
    arms: bool = chance(True, 0.65)
    seat_thickness: float = size(0.055, 0.03, 0.07)
    crown: float = size(0.014, 0.0, 0.02)
    rail: float = size(0.050, 0.045, 0.06)
    slats: int = count(2, 0, 3)  # in the back under the crest
    spindles: int = 0  # in the place of slats, on a rail
    crest: float = size(0.07, 0.06, 0.12)
    bow: float = 0.0  # radius of curvature of the runners; zero for flat ones

    def build(self, a: Assembly) -> None:
        s, c, t, half = self, CLEARANCE, self.post, self.post / 2
        x0 = -(s.width / 2 - half)
        front, back = -s.depth / 2 + half, s.depth / 2 - half
        # Height of a runner's top at leg and post (under their middles, equally far from its lowest point).
        floor = RUNNER + (s.bow - np.sqrt(s.bow**2 - back**2) if s.bow else 0.0)
        rail_z = s.seat_height - s.seat_thickness - c - s.rail / 2
        leg_top = s.seat_height + 0.205 - ARM if s.arms else rail_z + s.rail / 2
        outward = 0.12 * t
        rail_tenon, foot_tenon = Tenon(0.6 * s.rail, 0.008, 0.30 * t), Tenon(0.5 * t, 0.5 * t, 0.018)

        leg, post = Blank(), Blank()  # the right-hand ones
        # Seat rails along y; the left one is moved over. Under a rocker's seat they are lower than the cross rails:
        # its left and right legs differ anyway (their feet are slanted), and should do so by more than a hair.
        side_x, side_z = x0 - outward, rail_z - (0.012 if s.bow else 0.0)
        start, end = vector(side_x, front + half, side_z), vector(side_x, back - half, side_z)
        side_rail = Blank(rail(start, end, Z, s.rail, 0.018, rail_tenon))
        a.each("seat_rail", "seat_frame_bar", side_rail, {"right": move(), "left": move(-2 * side_x)})
        for frame, upright in zip(mouths(start, end, Z), (leg, post), strict=True):
            upright -= rail_tenon.pocket(frame)
        # Rails along x, between the frames.
        inner = x0 + half
        start = vector(inner, front - outward, rail_z)
        cross_rail = Blank(rail(start, start - 2 * inner * X, Z, s.rail, 0.018, rail_tenon))
        for name, y, upright in (("front", front - outward, leg), ("back", back + outward, post)):
            a.part(f"cross_rail_{name}", "seat_frame_bar", cross_rail, move(y=y - start[1]))
            upright -= rail_tenon.pocket(joint_frame(vector(inner, y, rail_z), X, Z))

        # The right-hand leg and post; the post is upright to the knee, then it leans.
        along, across = leaning(s.rake)
        base = vector(0, back, s.seat_height - 0.01)  # the post's knee
        reach = (s.height - base[2]) / np.cos(s.rake)
        self.back(a, base, reach, -inner, post)
        foot = floor - (0.02 if s.bow else -c)
        leg.body = sweep([vector(x0, front, foot), vector(x0, front, leg_top - c)], X, Y, rectangle(t, t, 0.004))
        above_knee = polyline(base + x0 * X, (np.array([0.03, reach - 0.006, reach]), along))
        path = np.array([vector(x0, back, foot), vector(x0, back, base[2] - 0.03), *above_knee])
        deep = np.array([t, t, 0.95 * t, 0.70 * t, 0.52 * t])
        post.body = sweep(path, X, Y, rectangles(t, deep, 0.004))
        runner, groove = self.runner(x0, front, back, floor)
        if s.bow:
            leg.body -= groove
            post.body -= groove
        for y, upright in ((front, leg), (back, post)):
            a.join(foot_tenon, joint_frame(vector(x0, y, floor), Z, X), upright, runner, over=0.012)
        a.each("runner", "runner", runner, {"right": move(), "left": move(-2 * x0)})
        if s.arms:
            # Upright, and off the middle: clear of a slat's tenon.
            arm_tenon, level = Tenon(0.014, 0.008, 0.30 * t, root=0.02), s.seat_height + 0.205 - ARM / 2
            front_face = float(np.interp(level, path[:, 2], path[:, 1] - deep / 2))
            arm_mouth = vector(x0 - 0.2 * t, front_face, level)
            arm = self.armrest(arm_mouth, front, x0, across)
            a.join(arm_tenon, joint_frame(arm_mouth, -Y, Z), arm, post, over=0.015)
            a.join(Tenon(0.5 * t, 0.5 * t, 0.013), joint_frame(vector(x0, front, leg_top), -Z, X), leg, arm)
            a.pair("armrest", "arm_horizontal_bar", arm)
        if s.bow:
            a.pair("leg_front", "leg", leg)
        else:
            # Everything about this leg is symmetric about its diagonal: a quarter turn makes the left one of the right.
            a.part("leg_front_right", "leg", leg)
            a.part("leg_front_left", "leg", leg, move(-x0, front) * spin(np.pi / 2) * move(-x0, -front))
        a.pair("post", "back_frame_vertical_bar", post)
        a.part("seat", "seat_single_surface", self.seat(front - half - 0.012, back - half - 0.010, -inner))

    def back(self, a: Assembly, base: Vector, reach: float, inner: float, post: Blank) -> None:
        """Add crest, slats and spindles between the posts, whose faces are `inner` from the middle."""
        s, (along, _) = self, leaning(self.rake)
        crest_up, low = reach - 0.006 - s.crest / 2, 0.14
        top = crest_up - s.crest / 2
        # A low back has no room for three slats.
        space = top - low + SLAT / 2
        slats = min(s.slats, int(space / (SLAT + 0.004)))
        ups = [low + k * (SLAT + (space - slats * SLAT) / slats) for k in range(slats)] if not s.spindles else [low]
        crest_tenon, slat_tenon = Tenon(0.6 * s.crest, 0.009, 0.30 * s.post), Tenon(0.65 * SLAT, 0.009, 0.30 * s.post)
        middle = base + crest_up * along
        crest = Blank(arched_rail(middle, inner, s.rake, (s.crest, 0.018), crest_tenon, 0.018, stations=7))
        slat = Blank(arched_rail(base + low * along, inner, s.rake, (SLAT, 0.018), slat_tenon, stations=7))
        if s.spindles:
            start, end = base + (low + SLAT / 2) * along, base + top * along
            stick = Blank(rail(start, end, X, 0.026, 0.011, SPINDLE_TENON, 0.002))
            places = [move(x) for x in np.linspace(-1, 1, s.spindles) * (inner - 0.075)]
            a.each("spindle", "back_surface_vertical_bar", stick, places)
            for frame, blank in zip(mouths(start, end, X), (slat, crest), strict=True):
                a.pockets(SPINDLE_TENON, frame, blank, places)
        for k, up in enumerate(ups):
            name = "back_rail_lower" if s.spindles else f"slat_{k + 1}"
            a.part(name, "back_surface_horizontal_bar", slat, move(*((up - low) * along)))
            post -= slat_tenon.pocket(joint_frame(base + up * along - inner * X, X, along))
        a.part("crest_rail", "back_frame_horizontal_bar", crest)
        post -= crest_tenon.pocket(joint_frame(middle - inner * X, X, along))

    def runner(self, x: float, front: float, back: float, floor: float) -> tuple[Blank, Solid]:
        """Return the right-hand runner, and what fits uprights to its curved top."""
        t = self.post
        if not self.bow:
            y, low = [front - 0.075, front - 0.06, back + 0.09, back + 0.105], np.array([0.014, 0.0, 0.0, 0.014])
            return Blank(bar(x, y, (low + RUNNER) / 2, X, Z, t, RUNNER - low, 0.004)), Solid()
        angle = np.linspace((front - 0.13) / self.bow, (back + 0.22) / self.bow, 13)
        radial = np.column_stack([0 * angle, np.sin(angle), -np.cos(angle)])
        points = vector(x, 0, self.bow) + (self.bow - RUNNER / 2) * radial
        solids: list[Solid] = []
        for outline in (rectangle(t, RUNNER, 0.004), rectangle(t + 20 * CLEARANCE, RUNNER + 2 * CLEARANCE)):
            rings = [at + outline[:, :1] * X - outline[:, 1:] * out for at, out in zip(points, radial, strict=True)]
            solids.append(loft(np.array(rings)))
        below = [vector(x, front - 0.1, floor - 0.05), vector(x, back + 0.1, floor - 0.05)]
        return Blank(solids[0]), solids[1] + sweep(below, X, Z, rectangle(t + 0.02, 0.05))

    def armrest(self, mouth: Vector, front: float, leg_x: float, across: Vector) -> Blank:
        """Return the right armrest, from in front of the leg to the leaning face of the post, flared in the middle."""
        rear = mouth[1]
        y = np.array([front - 0.06, front - 0.053, front - 0.02, front + 0.06, 0.5 * (front + rear), rear + 0.03])
        x = leg_x - np.array([0.006, 0.006, 0.008, 0.008, 0.006, leg_x - mouth[0]])
        wide, high = self.post * np.array([1.1, 1.4, 1.7, 1.6, 1.25, 0.9]), ARM * np.array([0.6, 0.9, 1, 1, 1, 1])
        arm = bar(x, y, mouth[2], X, Z, wide, high, 0.004)
        # The post grows slimmer on its way up, so that its front face leans a little more than `across` says.
        return Blank(arm.trim_by_plane(across, float((mouth + CLEARANCE * across) @ across)))

    def seat(self, front: float, rear: float, inner: float) -> Solid:
        """Return a cushion or board between the frames, on the rails."""
        # Without armrests nothing stands in the way of a seat as wide as the frame.
        half = inner - 0.010 if self.arms else self.width / 2 + 0.006
        edge = min(0.014, 0.35 * self.seat_thickness)
        outline = from_front_to_rear(front, rear, 2 * half, 0.02)
        return pad(outline, self.seat_height - self.seat_thickness, self.seat_height, edge, self.crown, 0.5 * edge)


@family("rocker", "two side frames on curved runners, spindles between two rails")
class RockerChair(SledChair):
    """A chair of 16 to 20 parts."""

    first_drawn = ("arms",)
    width: float = size(0.52, 0.49, 0.54)
    depth: float = drawn(0.47, lambda rng, s: s.width - rng.uniform(0.015, 0.06))
    seat_height: float = size(0.43, 0.41, 0.45)
    height: float = size(1.02, 0.92, 1.08)
    post: float = size(0.036, 0.034, 0.040)
    rake: float = size(0.25, 0.20, 0.30)
    arms: bool = chance(True, 0.7)
    seat_thickness: float = size(0.04, 0.025, 0.05)
    slats: int = 1
    spindles: int = count(5, 3, 5)
    crest: float = size(0.09, 0.07, 0.11)
    bow: float = size(1.1, 0.95, 1.25)
