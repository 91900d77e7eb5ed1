"""The ladder-back: posts that run from floor to crest, slats and rails tenoned between them, the seat laid on top.

Rails that run across (x) slide into a post along x, those that run fore and aft (y) along y, the seat comes from
above. So a frame must be closed by its last upright: once two posts are joined by anything, what else belongs
between them can no longer go in. The same holds for the front frame, and for the rails between the two frames.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, count, drawn, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, Tenon, arched_rail, joint_frame, rail
from roboassembly.generate.outlines import rectangle, rectangles, rounded_trapezoid
from roboassembly.generate.solids import Solid, block, column, pad, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, spin, vector

CROSS_TENON = Tenon(0.018, 0.008, 0.007)


@family("ladder", "four posts, slats tenoned between the rear two, seat on top")
class LadderChair(Design):
    """A chair of 11 to 18 parts; x to the sitter's left, y to the back."""

    side_stretchers: int = one_of(0, 1, 1, 1, 2, default=1)  # on either side
    # Between the two side stretchers.
    cross_stretcher: bool = drawn(False, lambda rng, s: bool(s.side_stretchers and rng.random() < 0.35))
    width: float = size(0.44, 0.41, 0.47)  # over the outer faces of the posts
    depth: float = size(0.42, 0.39, 0.45)  # over the outer faces of the posts' feet, front to back
    seat_height: float = size(0.455, 0.43, 0.475)  # top of the seat's edge
    height: float = size(0.94, 0.86, 1.06)
    post: float = size(0.038, 0.035, 0.042)  # side of a post
    rake: float = size(0.15, 0.10, 0.19)
    slats: int = count(3, 1, 4)  # under the crest rail
    slat_height: float = size(0.048, 0.038, 0.06)
    crest_height: float = size(0.085, 0.065, 0.10)
    bend: float = size(0.016, 0.0, 0.022)  # how far a slat's middle lies behind its ends
    arch: float = one_of(0.0, 0.012, 0.02, default=0.012)  # how much the crest rail's middle stands above its ends
    seat_thickness: float = size(0.034, 0.022, 0.045)
    crown: float = one_of(0.0, 0.012, 0.02, default=0.012)
    apron: float = size(0.058, 0.05, 0.07)
    front_stretcher: bool = drawn(False, lambda rng, s: bool(rng.random() < (0.15 if s.cross_stretcher else 0.4)))
    rear_stretcher: bool = drawn(False, lambda rng, s: bool(rng.random() < (0.2 if s.cross_stretcher else 0.5)))

    def fits(self) -> bool:
        stretchers = 2 * self.side_stretchers + self.front_stretcher + self.cross_stretcher + self.rear_stretcher
        # Rails across and fore and aft are clearly different parts, too.
        return 11 <= 10 + self.slats + stretchers <= 18 and abs(self.width - self.depth) > 0.01

    @cached_property
    def post_x(self) -> float:
        """Distance of the axes of posts and legs from the middle."""
        return self.width / 2 - self.post / 2

    @cached_property
    def front_y(self) -> float:
        """The axes of the front legs; those of the posts lie as far behind the middle."""
        return -self.depth / 2 + self.post / 2

    @cached_property
    def lower(self) -> tuple[float, ...]:
        """Heights of the side stretchers."""
        return (0.145, 0.235) if self.side_stretchers == 2 else (0.165,)

    def on_post(self, up: float) -> Vector:
        """Return the middle of the leaning post, `up` metres above its knee, at x = 0."""
        along, _ = leaning(self.rake)
        return vector(0, -self.front_y, self.seat_height + 0.01) + up * along

    def build(self, a: Assembly) -> None:
        s, front_y, back_y, half = self, self.front_y, -self.front_y, self.post / 2
        inner, top = s.post_x - half, s.seat_height - s.seat_thickness - CLEARANCE
        along, _ = leaning(s.rake)
        post, leg = Blank(), Blank()  # the right-hand ones (x < 0)

        # Rails across, at the back: slats and crest (leaning), apron and stretcher (upright).
        reach = (s.height - (s.seat_height + 0.01)) / np.cos(s.rake)
        crest_up = reach - 0.004 - s.crest_height / 2
        first_up = 0.10 if s.slats > 1 else 0.5 * crest_up
        gap = (crest_up - s.crest_height / 2 - first_up - (s.slats - 0.5) * s.slat_height) / s.slats
        tenon = Tenon(0.7 * s.slat_height, 0.009, 0.40 * s.post)
        bent = Blank(arched_rail(s.on_post(first_up), inner, s.rake, (s.slat_height, 0.016), tenon, bend=s.bend))
        for k in range(s.slats):
            up = first_up + k * (s.slat_height + gap)
            lift = s.on_post(up) - s.on_post(first_up)
            a.part(f"slat_{k + 1}", "back_surface_horizontal_bar", bent, move(*lift))
            post -= tenon.pocket(joint_frame(s.on_post(up) - inner * X, X, along))
        middle, tenon = s.on_post(crest_up), Tenon(0.6 * s.crest_height, 0.009, 0.40 * s.post)
        crest = arched_rail(middle, inner, s.rake, (s.crest_height, 0.016), tenon, s.arch, s.bend)
        a.part("crest_rail", "back_frame_horizontal_bar", crest)
        post -= tenon.pocket(joint_frame(middle - inner * X, X, along))

        # A leg's joints come from two sides: toward the outer corner they keep out of each other's way.
        outward, deep = 0.12 * s.post, 0.30 * s.post
        apron_z, apron_tenon, tenon = top - s.apron / 2, Tenon(0.6 * s.apron, 0.008, deep), Tenon(0.020, 0.008, deep)
        front, back = front_y - outward, back_y + outward
        for name, label, z, section, joint, at_front, at_back in (
            ("apron", "seat_frame_bar", apron_z, (s.apron, 0.018), apron_tenon, True, True),
            ("stretcher", "bar_stretcher", 0.27, (0.030, 0.017), tenon, s.front_stretcher, s.rear_stretcher),
        ):
            bar = Blank(rail(vector(-inner, front, z), vector(inner, front, z), Z, *section, joint))
            if at_front:
                a.part(f"{name}_front", label, bar)
                leg -= joint.pocket(joint_frame(vector(-inner, front, z), X, Z))
            if at_back:
                a.part(f"{name}_back", label, bar, move(y=back - front))
                post -= joint.pocket(joint_frame(vector(-inner, back, z), X, Z))

        # Rails fore and aft; the left one is the right one moved over.
        side_x = -(s.post_x + outward)
        rows = [("apron", "seat_frame_bar", apron_z, 0.0, (s.apron, 0.018), apron_tenon)]
        for k, z in enumerate(s.lower[: s.side_stretchers]):
            name = "stretcher" if s.side_stretchers == 1 else f"stretcher_{('lower', 'upper')[k]}"
            rows.append((name, "bar_stretcher", z, z - s.lower[0], (0.030, 0.017), tenon))
        bars = [self.side_rail(side_x, z, section, joint) for _, _, z, _, section, joint in rows[:2]]
        for k, (name, label, z, lift, _, joint) in enumerate(rows):
            leg -= joint.pocket(joint_frame(vector(side_x, front_y + half, z), Y, Z))
            post -= joint.pocket(joint_frame(vector(side_x, back_y - half, z), -Y, Z))
            if s.cross_stretcher and k == 1:
                # This pair has a mortise on the inner face: the left one is the right one turned about z.
                start, end = vector(side_x + 0.017 / 2, 0, z), vector(-side_x - 0.017 / 2, 0, z)
                bar = Blank(bars[1].solid - CROSS_TENON.pocket(joint_frame(start, X, Z)))
                a.each(name, label, bar, {"right": move(), "left": spin(np.pi)})
                a.part("stretcher_cross", "bar_stretcher", rail(start, end, Z, 0.030, 0.017, CROSS_TENON))
            else:
                places = {"right": move(z=lift), "left": move(-2 * side_x, z=lift)}
                a.each(name, label, bars[min(k, 1)], places)

        post.body, leg.body = self.post_blank(reach), self.leg_blank(top)
        a.pair("post", "back_frame_vertical_bar", post)
        if s.side_stretchers or s.front_stretcher:
            a.pair("leg_front", "leg", leg)
        else:
            # Only the two apron mortises, alike and symmetric about the leg's diagonal: a quarter turn does it.
            a.part("leg_front_right", "leg", leg)
            a.part("leg_front_left", "leg", leg, move(s.post_x, front_y) * spin(np.pi / 2) * move(s.post_x, -front_y))
        a.part("seat", "seat_single_surface", self.seat())

    def side_rail(self, x: float, z: float, section: tuple[float, float], tenon: Tenon) -> Blank:
        """Return a rail of a height and a thickness from a front leg to a post."""
        start, end = vector(x, self.front_y + self.post / 2, z), vector(x, -self.front_y - self.post / 2, z)
        body = sweep([start + CLEARANCE * Y, end - CLEARANCE * Y], X, Z, rectangle(section[1], section[0], 0.003))
        return Blank(body + tenon.tongue(joint_frame(start, Y, Z)) + tenon.tongue(joint_frame(end, -Y, Z)))

    def post_blank(self, reach: float) -> Solid:
        """Return the right-hand post without mortises: square below, leaning and growing slimmer above."""
        y, t = -self.front_y, self.post
        along, _ = leaning(self.rake)
        straight = self.lower[0] - 0.02  # up to the knee, vertical faces, so that rails meet them squarely
        top = self.on_post(reach)
        path = [
            vector(0, y + 0.014, 0), vector(0, y + 0.008, 0.06), vector(0, y, straight),
            vector(0, y, self.seat_height + 0.01 - 0.03), self.on_post(0.03), top - 0.006 * along, top,
        ]  # fmt: skip
        wide, deep = np.array([0.86, 0.95, 1, 1, 1, 1, 0.75]), np.array([0.74, 0.88, 1, 1, 0.96, 0.68, 0.50])
        # Horizontal sections, so that the foot is level; the rake is small enough for them to look square.
        return sweep(path, X, Y, rectangles(wide * t, deep * t, 0.004)).translate((-self.post_x, 0, 0))

    def leg_blank(self, top: float) -> Solid:
        """Return the right-hand front leg without mortises: square at the apron, slimmer toward the foot."""
        t, jointed = self.post, self.side_stretchers or self.front_stretcher
        low = self.lower[0] - 0.02 if jointed else top - self.apron - 0.02
        stations = [(0.0, 0.68), (0.004, 0.74), (0.5 * low, 0.90), (low, 1.0), (top, 1.0)]
        return column([(z, t * k, t * k) for z, k in stations], 0.004).translate((-self.post_x, self.front_y, 0))

    def seat(self) -> Solid:
        """Return a board wider than its frame, notched around the posts and mounted from above."""
        s, under = self, self.seat_height - self.seat_thickness
        front, rear = s.front_y - s.post / 2 - 0.016, -s.front_y + 0.25 * s.post
        width, edge = s.width + 0.024, min(0.012, 0.4 * s.seat_thickness)
        outline = rounded_trapezoid(width + 0.012, width, rear - front, 0.03) + np.array([0.0, (front + rear) / 2])
        seat = pad(outline, under, s.seat_height, edge, s.crown, under=0.004)
        x, y = s.post_x - s.post / 2 - CLEARANCE, -s.front_y - s.post / 2 - CLEARANCE
        seat -= block((-0.5, y, under - 0.01), (-x, 0.5, s.seat_height + 0.05))
        return seat - block((x, y, under - 0.01), (0.5, 0.5, s.seat_height + 0.05))
