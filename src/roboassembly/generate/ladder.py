"""The ladder-back: posts that run from floor to crest, slats and rails tenoned between them, the seat laid on top.

Rails that run across (x) slide into a post along x, those that run fore and aft (y) along y, the seat comes from
above. So a frame must be closed by its last upright: once two posts are joined by anything, what else belongs
between them can no longer go in. The same holds for the front frame, and for the rails between the two frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
    block,
    mirrored_x,
    pad,
    rectangle,
    rounded_trapezoid,
    sweep,
    turn,
    vector,
)
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class LadderStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.44
    """Over the outer faces of the posts."""
    depth: float = 0.42
    """Over the outer faces of the posts' feet, front to back."""
    seat_height: float = 0.455
    """Top of the seat's edge."""
    height: float = 0.94
    post: float = 0.038
    """Side of a post."""
    rake: float = 0.15
    slats: int = 3
    """Under the crest rail."""
    slat_height: float = 0.048
    crest_height: float = 0.085
    bend: float = 0.016
    """How far a slat's middle lies behind its ends."""
    arch: float = 0.012
    """How much the crest rail's middle stands above its ends."""
    seat_thickness: float = 0.034
    crown: float = 0.012
    apron: float = 0.058
    side_stretchers: int = 1
    """On either side."""
    front_stretcher: bool = False
    cross_stretcher: bool = False
    """Between the two side stretchers."""
    rear_stretcher: bool = False


def sample(rng: np.random.Generator) -> LadderStyle:
    """A style of 11 to 18 parts."""
    while True:
        side = int(rng.choice([0, 1, 1, 1, 2]))
        cross = bool(side and rng.random() < 0.35)
        style = LadderStyle(
            width=rng.uniform(0.41, 0.47),
            depth=rng.uniform(0.39, 0.45),
            seat_height=rng.uniform(0.43, 0.475),
            height=rng.uniform(0.86, 1.06),
            post=rng.uniform(0.035, 0.042),
            rake=rng.uniform(0.10, 0.19),
            slats=int(rng.integers(1, 5)),
            slat_height=rng.uniform(0.038, 0.06),
            crest_height=rng.uniform(0.065, 0.10),
            bend=rng.uniform(0.0, 0.022),
            arch=float(rng.choice([0.0, 0.012, 0.02])),
            seat_thickness=rng.uniform(0.022, 0.045),
            crown=float(rng.choice([0.0, 0.012, 0.02])),
            apron=rng.uniform(0.05, 0.07),
            side_stretchers=side,
            front_stretcher=bool(rng.random() < (0.15 if cross else 0.4)),
            cross_stretcher=cross,
            rear_stretcher=bool(rng.random() < (0.2 if cross else 0.5)),
        )
        count = 10 + style.slats + 2 * side + style.front_stretcher + style.cross_stretcher + style.rear_stretcher
        # Rails across and fore and aft are clearly different parts, too.
        if 11 <= count <= 18 and abs(style.width - style.depth) > 0.01:
            return style


class _Frame:
    """Where faces and joints of one style lie; x to the sitter's left, y to the back, the floor at z = 0."""

    def __init__(self, style: LadderStyle) -> None:
        s = self.style = style
        self.half = s.post / 2
        self.post_x = s.width / 2 - self.half
        self.front_y, self.back_y = -s.depth / 2 + self.half, s.depth / 2 - self.half
        self.under = s.seat_height - s.seat_thickness
        """Underside of the seat; legs and aprons end a clearance below."""
        self.knee = s.seat_height + 0.01
        """Above it the posts lean back."""
        self.along = vector(0, np.sin(s.rake), np.cos(s.rake))
        """Up along the leaning part of a post."""
        self.across = vector(0, -np.cos(s.rake), np.sin(s.rake))
        """Out of the front of the back."""
        self.reach = (s.height - self.knee) / np.cos(s.rake)
        # A leg's joints come from two sides: toward the outer corner they keep out of each other's way.
        self.outward = 0.12 * s.post
        self.apron_depth = 0.30 * s.post
        self.lower = (0.145, 0.235) if s.side_stretchers == 2 else (0.165,)
        """Heights of the side stretchers."""
        self.straight = self.lower[0] - 0.02
        """Between here and the knee the uprights have vertical faces, so that rails meet them squarely."""

    def back(self, up: float) -> Float[np.ndarray, "3"]:
        """The middle of the leaning post, `up` metres above its knee, at x = 0."""
        return vector(0, self.back_y, self.knee) + up * self.along

    def post_blank(self) -> Solid:
        """A post before it gets its mortises, at x = 0: square below, leaning and growing slimmer above."""
        t = self.style.post
        knee, top = vector(0, self.back_y, self.knee - 0.03), self.back(self.reach)
        stations = [
            (vector(0, self.back_y + 0.014, 0), 0.86 * t, 0.74 * t),
            (vector(0, self.back_y + 0.008, 0.06), 0.95 * t, 0.88 * t),
            (vector(0, self.back_y, self.straight), t, t),
            (knee, t, t),
            (self.back(0.03), t, 0.96 * t),
            (top - 0.006 * self.along, t, 0.68 * t),
            (top, 0.75 * t, 0.50 * t),
        ]
        # Horizontal sections, so that the foot is level; the rake is small enough for them to look square.
        path = np.array([at for at, _, _ in stations])
        return sweep(path, X, Y, [rectangle(w, d, 0.004) for _, w, d in stations])

    def leg_blank(self) -> Solid:
        """A front leg about the z axis: square at the apron, slimmer toward the foot; fourfold symmetric."""
        t, top = self.style.post, self.under - CLEARANCE
        jointed = self.style.side_stretchers or self.style.front_stretcher
        low = self.straight if jointed else top - self.style.apron - 0.02
        stations = [(0.0, 0.68), (0.004, 0.74), (0.5 * low, 0.90), (low, 1.0), (top, 1.0)]
        return sweep(
            [vector(0, 0, z) for z, _ in stations], X, Y, [rectangle(t * k, t * k, 0.004) for _, k in stations]
        )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A ladder-back of the style drawn from `rng`, or the catalogue model with 15 parts."""
    return assemble(LadderStyle() if rng is None else sample(rng))


def assemble(style: LadderStyle) -> list[Piece]:
    """All pieces of one style."""
    f = _Frame(style)
    s, c = style, CLEARANCE
    inner = f.post_x - f.half
    post_cuts: list[Solid] = []
    """Mortises of the right-hand post (x < 0), in the furniture's frame; the left-hand post is its mirror image."""
    leg_cuts: list[Solid] = []
    pieces: list[Piece] = []

    # Rails across, at the back: slats and crest (leaning), apron and stretcher (upright).
    slat_tenon = Tenon(0.7 * s.slat_height, 0.009, 0.40 * s.post)
    crest_tenon = Tenon(0.6 * s.crest_height, 0.009, 0.40 * s.post)
    crest_up = f.reach - 0.004 - s.crest_height / 2
    first_up = 0.10 if s.slats > 1 else 0.5 * crest_up
    gap = (crest_up - s.crest_height / 2 - first_up - (s.slats - 0.5) * s.slat_height) / s.slats
    heights = [first_up + k * (s.slat_height + gap) for k in range(s.slats)]
    slat = _bent_rail(f, f.back(heights[0]), s.slat_height, 0.0, slat_tenon)
    for k, up in enumerate(heights):
        lift = f.back(up) - f.back(heights[0])
        pieces.append(Piece(f"slat_{k + 1}", "back_surface_horizontal_bar", slat, move(*lift)))
        post_cuts.append(slat_tenon.pocket(joint_frame(f.back(up) - inner * X, X, f.along)))
    pieces.append(
        Piece(
            "crest_rail",
            "back_frame_horizontal_bar",
            _bent_rail(f, f.back(crest_up), s.crest_height, s.arch, crest_tenon),
        )
    )
    post_cuts.append(crest_tenon.pocket(joint_frame(f.back(crest_up) - inner * X, X, f.along)))

    apron_z = f.under - c - s.apron / 2
    apron_tenon = Tenon(0.6 * s.apron, 0.008, f.apron_depth)
    stretcher_tenon = Tenon(0.020, 0.008, f.apron_depth)

    def across(y: float, z: float, height: float, thickness: float, tenon: Tenon) -> Solid:
        ends = [vector(-inner + c, y, z), vector(inner - c, y, z)]
        body = sweep(ends, Y, Z, rectangle(thickness, height, 0.003))
        for end in (-1, 1):
            body += tenon.tongue(joint_frame(vector(end * inner, y, z), -end * X, Z))
        return body

    def fore_and_aft(x: float, z: float, height: float, thickness: float, tenon: Tenon) -> Solid:
        ends = [vector(x, f.front_y + f.half + c, z), vector(x, f.back_y - f.half - c, z)]
        body = sweep(ends, X, Z, rectangle(thickness, height, 0.003))
        for y, out in ((f.front_y + f.half, Y), (f.back_y - f.half, -Y)):
            body += tenon.tongue(joint_frame(vector(x, y, z), out, Z))
        return body

    rows = [("apron", "seat_frame_bar", apron_z, s.apron, 0.018, apron_tenon, True, True)]
    rows.append(
        ("stretcher", "bar_stretcher", 0.27, 0.030, 0.017, stretcher_tenon, s.front_stretcher, s.rear_stretcher)
    )
    front_y, back_y = f.front_y - f.outward, f.back_y + f.outward
    for name, label, z, height, thickness, tenon, at_front, at_back in rows:
        rail = across(front_y, z, height, thickness, tenon)
        if at_front:
            pieces.append(Piece(f"{name}_front", label, rail))
            leg_cuts.append(tenon.pocket(joint_frame(vector(-inner, front_y, z), X, Z)))
        if at_back:
            pieces.append(Piece(f"{name}_back", label, rail, move(y=back_y - front_y)))
            post_cuts.append(tenon.pocket(joint_frame(vector(-inner, back_y, z), X, Z)))

    # Rails fore and aft; the left one is the right one moved over.
    side_x = -(f.post_x + f.outward)
    apron = fore_and_aft(side_x, apron_z, s.apron, 0.018, apron_tenon)
    stretchers = [fore_and_aft(side_x, f.lower[0], 0.030, 0.017, stretcher_tenon)] if s.side_stretchers else []
    sides = [("apron", "seat_frame_bar", apron, apron_z, 0.0, apron_tenon)]
    for k in range(s.side_stretchers):
        name = "stretcher" if s.side_stretchers == 1 else f"stretcher_{('lower', 'upper')[k]}"
        sides.append((name, "bar_stretcher", stretchers[0], f.lower[k], f.lower[k] - f.lower[0], stretcher_tenon))
    cross_tenon = Tenon(0.018, 0.008, 0.007)
    for k, (name, label, solid, z, lift, tenon) in enumerate(sides):
        for y, out, cuts in ((f.front_y + f.half, Y, leg_cuts), (f.back_y - f.half, -Y, post_cuts)):
            cuts.append(tenon.pocket(joint_frame(vector(side_x, y, z), out, Z)))
        if s.cross_stretcher and k == 1:
            # This pair has a mortise on the inner face: the left one is the right one turned about z.
            face = side_x + 0.017 / 2
            solid = solid - cross_tenon.pocket(joint_frame(vector(face, 0, z), X, Z))
            pieces.append(Piece(f"{name}_right", label, solid))
            pieces.append(Piece(f"{name}_left", label, solid, SE3(turn(Z, np.pi), np.zeros(3))))
            bar = sweep([vector(face + c, 0, z), vector(-face - c, 0, z)], Y, Z, rectangle(0.017, 0.030, 0.003))
            for end in (-1, 1):
                bar += cross_tenon.tongue(joint_frame(vector(-end * face, 0, z), -end * X, Z))
            pieces.append(Piece("stretcher_cross", "bar_stretcher", bar))
            continue
        pieces.append(Piece(f"{name}_right", label, solid, move(z=lift)))
        pieces.append(Piece(f"{name}_left", label, solid, move(x=-2 * side_x, z=lift)))

    pieces += _uprights(f, post_cuts, leg_cuts)
    pieces.append(Piece("seat", "seat_single_surface", _seat(f)))
    return pieces


def _uprights(f: _Frame, post_cuts: list[Solid], leg_cuts: list[Solid]) -> list[Piece]:
    """Posts (mirror images) and front legs: one shape where a front stretcher and side ones do not tell them apart."""
    post = f.post_blank().translate((-f.post_x, 0, 0))
    for cut in post_cuts:
        post -= cut
    leg = f.leg_blank().translate((-f.post_x, f.front_y, 0))
    for cut in leg_cuts:
        leg -= cut
    label = "back_frame_vertical_bar"
    pieces = [Piece("post_right", label, post), Piece("post_left", label, mirrored_x(post))]
    pieces.append(Piece("leg_front_right", "leg", leg))
    if not f.style.side_stretchers and not f.style.front_stretcher:
        # Only the two apron mortises, alike and symmetric about the leg's diagonal: a quarter turn takes right to left.
        here, there = SE3(np.eye(3), vector(f.post_x, -f.front_y, 0)), SE3(turn(Z, np.pi / 2), np.zeros(3))
        pieces.append(Piece("leg_front_left", "leg", leg, move(f.post_x, f.front_y) * there * here))
    else:
        pieces.append(Piece("leg_front_left", "leg", mirrored_x(leg)))
    return pieces


def _bent_rail(f: _Frame, middle: Float[np.ndarray, "3"], height: float, arch: float, tenon: Tenon) -> Solid:
    """A slat or crest rail between the posts: bent backward, its upper edge arched, a tenon along x at either end."""
    inner = f.post_x - f.half
    x = np.linspace(-inner + CLEARANCE, inner - CLEARANCE, 9)
    hump = 1.0 - (x / inner) ** 2
    path, sections = [], []
    for at, h in zip(x, hump, strict=True):
        path.append(middle + at * X - f.style.bend * h * f.across + 0.5 * arch * h * f.along)
        sections.append(rectangle(height + arch * h, 0.016, 0.003))
    body = sweep(np.array(path), f.along, f.across, np.array(sections))
    for end in (-1, 1):
        body += tenon.tongue(joint_frame(middle + end * inner * X, -end * X, f.along))
    return body


def _seat(f: _Frame) -> Solid:
    """A board wider than its frame, notched around the posts; it comes from above."""
    s = f.style
    front, rear = f.front_y - f.half - 0.016, f.back_y + 0.25 * s.post
    width = s.width + 0.024
    outline = rounded_trapezoid(width + 0.012, width, rear - front, 0.03) + np.array([0.0, (front + rear) / 2])
    edge = min(0.012, 0.4 * s.seat_thickness)
    seat = pad(outline, f.under, s.seat_height, edge, s.crown, under=0.004)
    notch_x, notch_y = f.post_x - f.half - CLEARANCE, f.back_y - f.half - CLEARANCE
    for side in (-1, 1):
        corners = sorted((side * notch_x, side * 0.5))
        seat -= block((corners[0], notch_y, f.under - 0.01), (corners[1], 0.5, s.seat_height + 0.05))
    return seat
