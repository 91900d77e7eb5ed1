"""The panel chair: a board seat on four tapered legs, and a back of boards that slide in the grooves of two posts.

The boards come from above, one after the other, and the top rail closes the grooves: boards first. An armrest
meets its post along y and its support along z, so that post, armrest and support must be one before they go down
into the seat.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, chance, count, drawn, family, size
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.outlines import rectangle, rectangles, rounded_trapezoid
from roboassembly.generate.solids import bar, column, pad, polyline, sweep
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, move, spin, vector

GROOVE = 0.008  # depth of the grooves that hold the panel
BOARD = 0.011  # thickness of its boards


@family("panel", "board seat on tapered legs, boards in grooves between two posts, armrests")
class PanelChair(Design):
    """A chair of 9 to 15 parts."""

    arms: bool = chance(True, 0.55)
    width: float = drawn(0.48, lambda rng, s: rng.uniform(0.45, 0.51) + (0.02 if s.arms else 0.0))  # seat's front edge
    depth: float = size(0.46, 0.43, 0.48)
    seat_height: float = size(0.45, 0.42, 0.465)
    seat_thickness: float = size(0.034, 0.03, 0.05)
    height: float = size(0.86, 0.78, 0.95)
    leg: float = size(0.042, 0.036, 0.05)
    taper: float = size(0.58, 0.5, 0.85)  # side of a leg's foot over the side of its top
    post: float = size(0.036, 0.034, 0.042)
    rake: float = size(0.17, 0.10, 0.22)
    boards: int = count(1, 1, 3)  # that the panel is made of, one above the other
    open_below: float = size(0.10, 0.03, 0.16)  # between seat and panel
    rail_height: float = size(0.045, 0.035, 0.06)

    def build(self, a: Assembly) -> None:
        s, c = self, CLEARANCE
        under, half = s.seat_height - s.seat_thickness, s.post / 2
        outline = rounded_trapezoid(s.width, s.width - 0.05, s.depth, 0.035, steps=4)
        seat = Blank(pad(outline, under, s.seat_height, 0.008, under=0.006))

        deep = (s.seat_thickness - 0.0105) / 2  # joints from above and from below keep this board between them
        # A leg's outer faces (-x, -y) are upright, its inner ones taper: quarter turns take it to all corners.
        z, thick = np.array([0.0, 0.003, 0.88 * under, under - c]), np.array([s.taper, s.taper, 1.0, 1.0])
        inward, wide = -(1 - thick) * s.leg / 2, (thick - [0.06, 0, 0, 0]) * s.leg
        leg = Blank(bar(inward, inward, z, X, Y, wide, wide, 0.004))
        x, y = s.width / 2 - 0.030 - s.leg / 2, s.depth / 2 - 0.020 - s.leg / 2
        feet = [(-x, -y), (x, -y), (x - 0.025, y), (0.025 - x, y)]
        for quarter, corner in enumerate(("front_right", "front_left", "back_left", "back_right")):
            a.part(f"leg_{corner}", "leg", leg, spin(quarter * np.pi / 2, *feet[quarter]))
        tenon = Tenon(0.5 * s.leg, 0.5 * s.leg, deep)
        a.join(tenon, joint_frame(under * Z, -Z, X), leg, seat, at=[move(*foot) for foot in feet])

        # Posts lean back from the seat's rear corners; everything between them lies along `along`.
        along, across = leaning(s.rake)
        post_x = s.width / 2 - 0.025 - 0.022 - half
        foot = vector(-post_x, s.depth / 2 - 0.012 - half, s.seat_height)
        reach = (s.height - s.rail_height * np.cos(s.rake) - s.seat_height) / np.cos(s.rake)
        low = s.open_below / np.cos(s.rake)
        post_tenon = Tenon(0.55 * s.post, 0.40 * s.post, deep)
        rail_tenon = Tenon(0.38 * s.post, 0.34 * s.post, 0.5 * s.rail_height)
        ends = [foot + c / np.cos(s.rake) * along, foot + (reach + 0.05) * along]
        shaft = sweep(ends, X, Y, rectangle(s.post, s.post, 0.003))
        post = Blank(shaft.trim_by_plane(-along, -(foot + (reach - c) * along) @ along))
        top = foot + reach * along - 0.10 * s.post * X
        post += post_tenon.tongue(joint_frame(foot, Z, X))
        groove, mouth = Tenon(reach - low, BOARD, GROOVE), foot + half * X + (low + reach) / 2 * along
        post -= groove.pocket(joint_frame(mouth, X, along))
        post -= groove.pocket(joint_frame(mouth + 0.03 * along, X, along))  # open at the top
        post += rail_tenon.tongue(joint_frame(top, -along, X))

        # Boards: their ends are the tongues in the grooves.
        ends = (post_x - half + GROOVE) * X
        tall = (reach - c - low - (s.boards - 1) * c) / s.boards
        middle = vector(0, foot[1], foot[2]) + (low + tall / 2) * along
        board = Blank(sweep([middle - ends, middle + ends], along, across, rectangle(tall, BOARD, 0.0015)))
        for k in range(s.boards):
            name = "panel" if s.boards == 1 else f"panel_board_{k + 1}"
            a.part(name, "back_single_surface", board, move(*(k * (tall + c) * along)))

        # The top rail, on the posts and over the panel, its upper corners rounded.
        x = (post_x + half + 0.012) * np.array([-1, -0.97, -0.9, -0.5, 0, 0.5, 0.9, 0.97, 1])
        high = s.rail_height * np.array([0.62, 0.84, 0.97, 1.0, 1.04, 1.0, 0.97, 0.84, 0.62])
        path = polyline(vector(0, foot[1], foot[2]) + reach * along, (x, X), (high / 2, along))
        rail = Blank(sweep(path, along, across, rectangles(high, 1.02 * s.post, 0.005)))
        for side in (-1, 1):
            rail -= rail_tenon.pocket(joint_frame(vector(-side * top[0], top[1], top[2]), -along, X))
            seat -= post_tenon.pocket(joint_frame(vector(side * foot[0], foot[1], foot[2]), Z, X))
        a.part("top_rail", "back_frame_horizontal_bar", rail)
        if s.arms:
            self.armrests(a, foot, across, post, seat)
        a.pair("post", "back_frame_vertical_bar", post)
        a.part("seat", "seat_single_surface", seat)

    def armrests(self, a: Assembly, foot: Vector, across: Vector, post: Blank, seat: Blank) -> None:
        """Add armrests, between the posts' front faces and supports on the seat."""
        s, c, rise, thickness = self, CLEARANCE, 0.205, 0.024
        tenon, support_tenon = Tenon(0.013, 0.007, 0.38 * s.post, root=0.02), Tenon(0.018, 0.014, 0.014)
        level = s.seat_height + rise + thickness / 2
        # On the post's front face, off the post's middle and so clear of the groove.
        mouth = vector(foot[0] - 0.0045, foot[1] - s.post / 2 + (level - foot[2]) * np.tan(s.rake), level)
        support_x, support_y = -(s.width / 2 - 0.045), -0.14 * s.depth
        places = [move(x, support_y, s.seat_height) for x in (support_x, -support_x)]
        length = mouth[1] - support_y
        y = support_y + np.array([-0.055, -0.049, -0.025, 0.04, 0.5 * length, length + 0.02])
        x = np.interp(y, [support_y, mouth[1]], [support_x, foot[0] - 0.002])
        x[:3] = support_x
        widths, heights = [0.034, 0.046, 0.056, 0.054, 0.046, 0.038], [0.014, 0.021, *[thickness] * 4]
        whole = bar(x, y, level, X, Z, widths, heights, 0.004)
        arm = Blank(whole.trim_by_plane(across, float((mouth + c * across) @ across)))
        # A long root would show where the face leans away from the armrest's end.
        a.join(tenon, joint_frame(mouth, -Y, Z), arm, post, over=0.012)
        a.pair("armrest", "arm_horizontal_bar", arm)
        support = Blank(column([(c, 0.030, 0.030), (0.5 * rise, 0.025, 0.025), (rise - c, 0.034, 0.030)], 0.004))
        a.join(support_tenon, joint_frame(vector(0, 0, 0), Z, X), support, seat, at=places)
        a.join(support_tenon, joint_frame(rise * Z, -Z, X), support, arm, at=places[:1])
        a.each("arm_support", "arm_near_vertical_bar", support, {"right": places[0], "left": places[1]})
