"""Tables: legs joined by aprons under a top, or two trestles with a stretcher between them.

Aprons run along x and along y into the legs, whose tenons go up into the top: legs are joined in pairs, the pairs to
each other, and the top comes last. In a trestle the post stands between foot and head; the stretcher goes between
two posts along x, the top comes down on the heads.
"""

from __future__ import annotations

import numpy as np

from roboassembly.generate.design import Assembly, Blank, Design, corners, count, drawn, family, one_of, size
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame, mouths, rail
from roboassembly.generate.outlines import rounded_trapezoid, symmetric
from roboassembly.generate.solids import bar, cut_out, pad
from roboassembly.generate.vectors import X, Y, Z, move, spin, vector

LEG_TENON = RoundTenon(radius=0.011, length=0.014, sides=12)
HEAD_PEG = RoundTenon(radius=0.009, length=0.012, sides=12)


@family("table_apron", "four tapered legs joined by aprons, top on them", "table")
class ApronTable(Design):
    """A table of 9 or 11 parts."""

    width: float = size(0.55, 0.45, 0.65)
    length: float = drawn(0.80, lambda rng, s: s.width + rng.uniform(0.10, 0.45))  # along x
    height: float = size(0.52, 0.42, 0.74)
    top: float = size(0.028, 0.022, 0.036)
    leg: float = size(0.048, 0.040, 0.058)
    taper: float = size(0.62, 0.5, 0.95)  # side of a leg's foot over that of its top
    apron: float = size(0.075, 0.06, 0.10)
    overhang: float = size(0.03, 0.015, 0.06)
    shelf_bars: int = one_of(0, 0, 2)  # rails along x low between the legs

    def build(self, a: Assembly) -> None:
        s, under, half = self, self.height - self.top, self.leg / 2
        x, y = s.length / 2 - s.overhang - half, s.width / 2 - s.overhang - half
        top = Blank(pad(rounded_trapezoid(s.length, s.length, s.width, 0.025), under, s.height, 0.006, under=0.004))
        # The leg at (-x, -y): its outer faces upright, its inner ones tapering below the aprons.
        z = np.array([0.0, 0.004, under - s.apron - 0.03, under - CLEARANCE])
        thick = np.array([0.94 * s.taper, s.taper, 1.0, 1.0])
        inward = -(1 - thick) * half
        leg = Blank(bar(inward, inward, z, X, Y, thick * s.leg, thick * s.leg, 0.004))
        # Without bars a leg is alike across its diagonal.
        legs = corners(x, y, alike=not s.shelf_bars)
        a.join(LEG_TENON, joint_frame(under * Z, -Z, X), leg, top, at=[pose for _, pose, _ in legs])

        tenon, level = Tenon(0.6 * s.apron, 0.009, 0.22 * s.leg), (under - 0.010 - s.apron / 2) * Z
        for axis, reach, over, sides in ((X, x, y * Y, ("front", "back")), (Y, y, x * X, ("right", "left"))):
            apron = Blank(rail((half - reach) * axis + level, (reach - half) * axis + level, Z, s.apron, 0.020, tenon))
            a.each("apron", "apron", apron, {sides[0]: move(*-over), sides[1]: move(*over)})
            leg -= tenon.pocket(joint_frame(half * axis + level, axis, Z))
        if s.shelf_bars:
            low, height = Tenon(0.016, 0.008, 0.008), 0.28 * under
            k = float(np.interp(height, z, thick))
            face, middle = -x - (1 - k) * half + k * half + 0.0012, -y - (1 - k) * half
            start, end = vector(face, middle, height), vector(-face, middle, height)
            low_bar = Blank(rail(start, end, Z, 0.026, 0.012, low))
            a.each("bar", "bar_stretcher", low_bar, {"front": move(), "back": move(y=-2 * middle)})
            leg -= low.pocket(move(x, y) * mouths(start, end, Z)[0], over=0.012)
        for corner, pose, mirrored in legs:
            a.part(f"leg_{corner}", "leg", leg, pose, mirrored)
        a.part("top", "tabletop", top)


@family("table_trestle", "two trestles of foot, post and head, a stretcher between", "table")
class TrestleTable(Design):
    """A table of 8 or 9 parts."""

    width: float = size(0.55, 0.45, 0.65)
    length: float = drawn(0.95, lambda rng, s: s.width + rng.uniform(0.25, 0.55))  # along x
    height: float = size(0.60, 0.48, 0.74)
    top: float = size(0.030, 0.026, 0.040)
    post: float = size(0.075, 0.065, 0.12)  # width along y
    thickness: float = size(0.045, 0.038, 0.052)  # of posts, feet and heads
    stretchers: int = count(1, 1, 2)
    waist: float = size(0.72, 0.6, 1.0)  # width of the post's middle over that of its ends

    def build(self, a: Assembly) -> None:
        s, c, under = self, CLEARANCE, self.height - self.top
        x = s.length / 2 - 0.16
        places = {"left": spin(0.0, x), "right": spin(np.pi, -x)}
        foot_top, head_low = 0.062, under - 0.052
        top = Blank(pad(rounded_trapezoid(s.length, s.length, s.width, 0.02), under, s.height, 0.007, under=0.004))
        arch = 0.36 * s.width
        foot_outline = [(0.0, 0.014), (0.7 * arch, 0.014), (0.75 * arch, 0.0), (1.16 * arch, 0.0)]
        foot_outline += [(1.16 * arch, 0.026), (1.1 * arch, 0.036), (0.75 * s.post, foot_top)]
        head_outline = [(0.75 * s.post, head_low), (1.05 * arch, head_low + 0.022), (1.1 * arch, under - c)]
        foot = Blank(cut_out(symmetric(foot_outline), vector(0, 0, 0), Y, Z, s.thickness))
        head = Blank(cut_out(symmetric(head_outline), vector(0, 0, 0), Y, Z, s.thickness))
        z = np.array([foot_top + c, foot_top + 0.05, 0.5 * (foot_top + head_low), head_low - 0.05, head_low - c])
        widths = s.post * np.array([1, 0.96, s.waist, 0.96, 1])
        post = Blank(bar(0.0, 0.0, z, Y, -X, widths, 0.82 * s.thickness, 0.003))
        tenon = Tenon(0.60 * s.post, 0.45 * s.thickness, 0.024)
        a.join(tenon, joint_frame(foot_top * Z, Z, Y), post, foot)
        a.join(tenon, joint_frame(head_low * Z, -Z, Y), post, head)
        # Pegs unequally far from the middle, so that a head on its post fits the top in one way only.
        for y in (-0.75 * arch, 0.55 * arch):
            a.join(HEAD_PEG, joint_frame(vector(0, y, under), -Z, X), head, top, at=list(places.values()))
        # Stretchers between the posts' inner faces.
        inner = 0.41 * s.thickness
        bar_tenon = Tenon(0.028, 0.011, 0.36 * s.thickness)
        shares = [0.62] if s.stretchers == 1 else [0.32, 0.72]
        first = vector(0, 0, foot_top + shares[0] * (head_low - foot_top))
        stretcher = Blank(rail(first - (x - inner) * X, first + (x - inner) * X, Z, 0.050, 0.024, bar_tenon))
        for k, share in enumerate(shares):
            lift = (share - shares[0]) * (head_low - foot_top)
            a.part(f"stretcher_{k + 1}", "bar_stretcher", stretcher, move(z=lift))
            at = vector(-inner, 0, foot_top + share * (head_low - foot_top))
            post -= bar_tenon.pocket(joint_frame(at, -X, Z))
        for side, facing in places.items():
            # Mortises look inward: one trestle is the other turned about; its foot is the same from both sides.
            a.part(f"foot_{side}", "leg", foot, move(*facing.translation))
            a.part(f"post_{side}", "leg", post, facing)
            a.part(f"head_{side}", "leg", head, facing)
        a.part("top", "tabletop", top)
