"""The splat-back: a board seat, curved front legs under it, posts at its sides, and a vase between seat and crest.

Posts come to the seat along x, front legs from below, the splat and the crest along the back's slope. So both posts
are at the seat and the splat is in its mortise before the crest goes on; a crest that is on a post is too early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import bent, cut_out, smooth, symmetric
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import rail
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
class SplatStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.49
    """Of the seat's front edge."""
    back_width: float = 0.40
    """Over the outer faces of the posts."""
    depth: float = 0.44
    seat_height: float = 0.46
    seat_thickness: float = 0.058
    height: float = 0.97
    rake: float = 0.15
    post: float = 0.034
    leg: float = 0.046
    knee: float = 0.014
    """How far a front leg's knee stands out; zero for straight tapered legs."""
    vase: int = 0
    """Outline of the splat: 0 vase, 1 fiddle, 2 plain taper."""
    crest: float = 0.062
    ears: float = 0.022
    """How far the crest reaches beyond the posts."""
    stretchers: int = 0
    """Rails between the posts below the seat."""


def sample(rng: np.random.Generator) -> SplatStyle:
    """A style of 7 to 9 parts."""
    return SplatStyle(
        width=rng.uniform(0.46, 0.52),
        back_width=rng.uniform(0.37, 0.42),
        depth=rng.uniform(0.41, 0.47),
        seat_height=rng.uniform(0.43, 0.475),
        seat_thickness=rng.uniform(0.048, 0.075),
        height=rng.uniform(0.88, 1.06),
        rake=rng.uniform(0.10, 0.20),
        post=rng.uniform(0.031, 0.038),
        leg=rng.uniform(0.040, 0.052),
        knee=float(rng.choice([0.0, 0.010, 0.014, 0.018])),
        vase=int(rng.integers(0, 3)),
        crest=rng.uniform(0.05, 0.08),
        ears=rng.uniform(0.008, 0.035),
        stretchers=int(rng.integers(0, 3)),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A splat-back of the style drawn from `rng`, or the catalogue model with 7 parts."""
    return assemble(SplatStyle() if rng is None else sample(rng))


LEG_TENON = Tenon(0.024, 0.024, 0.022)
SEAT_TENON = Tenon(0.030, 0.018, 0.013)
"""Of the seat into a post."""
CREST_TENON = Tenon(0.015, 0.012, 0.026)
"""Of a post into the crest."""
SPLAT = 0.013
VASES = (
    [(0.34, 0.0), (0.30, 0.06), (0.20, 0.18), (0.24, 0.30), (0.50, 0.62), (0.44, 0.78), (0.26, 0.92), (0.34, 1.0)],
    [(0.40, 0.0), (0.42, 0.16), (0.20, 0.36), (0.22, 0.50), (0.46, 0.74), (0.48, 0.86), (0.36, 1.0)],
    [(0.26, 0.0), (0.30, 0.3), (0.38, 0.7), (0.44, 1.0)],
)
"""Outlines of a splat: half its width over the room between the posts' middles, at shares of its height."""


def assemble(style: SplatStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    under = s.seat_height - s.seat_thickness
    inner = s.back_width / 2 - s.post
    rear = s.depth / 2 - 0.024 - s.post / 2
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    pieces: list[Piece] = []

    # A post: bent backward below the seat and leaning above it; level sections, so that its inner face stays plane.
    knee = vector(s.back_width / 2 - s.post / 2, rear, s.seat_height + 0.015)
    reach = (s.height - s.crest - knee[2]) / along[2]
    foot = vector(knee[0], rear + 0.055, 0)
    points, tangents = bent([foot, vector(knee[0], rear, under - 0.05), knee, knee + (reach - c) * along], 0.14)
    points = np.concatenate([points[:1], points[:1] + 0.005 * tangents[:1], points[1:]])
    size = s.post * np.interp(points[:, 2], [0, 0.005, 0.2, s.seat_height, s.height], [0.72, 0.80, 1, 1, 0.82])
    post = sweep(points, X, Y, [rectangle(s.post, d, 0.004) for d in size])
    post = post.trim_by_plane(-along, -float((knee + (reach - c) * along) @ along))
    crest_mouths = [vector(x, *(knee + reach * along)[1:]) for x in (knee[0], -knee[0])]
    post += CREST_TENON.tongue(joint_frame(crest_mouths[0], -along, X))

    # The seat: notched for the posts, with a tongue into each.
    outline = rounded_trapezoid(s.width, s.back_width + 0.01, s.depth, 0.03, steps=4)
    seat = pad(outline, under, s.seat_height, 0.012, under=0.008)
    notch = block((inner - c, rear - s.post / 2 - 0.012, 0), (1, 1, 1))
    seat -= notch + mirrored_x(notch)
    level = under + 0.5 * s.seat_thickness
    side = joint_frame(vector(inner, rear, level), -X, Z)
    tongue = SEAT_TENON.tongue(side)
    seat += tongue + mirrored_x(tongue)
    post -= SEAT_TENON.pocket(side)

    # The splat, between seat and crest, both along the slope.
    low = s.seat_height + c / along[2]
    start = vector(0, rear, s.seat_height)
    start[1] = knee[1] + (start[2] - knee[2]) * np.tan(s.rake)
    top = (knee + reach * along)[2]
    span = (top - s.seat_height) / along[2]
    splat, foot_frame, head_frame, tenon = _splat(s, start, along, span, inner)
    seat -= tenon.pocket(foot_frame, over=0.01)
    splat = splat.trim_by_plane((0.0, 0.0, 1.0), low) + tenon.tongue(foot_frame)
    crest = _crest(s, start + span * along, along) - tenon.pocket(head_frame)
    for mouth in crest_mouths:
        crest -= CREST_TENON.pocket(joint_frame(mouth, -along, X))
    pieces += [Piece("splat", "back_single_surface", splat), Piece("crest_rail", "back_frame_horizontal_bar", crest)]

    # Rails between the posts, below the seat.
    bar_tenon = Tenon(0.016, 0.008, 0.010)
    bar: Solid | None = None
    for k in range(s.stretchers):
        z = 0.16 + 0.09 * k
        y = float(np.interp(z, points[:, 2], points[:, 1]))
        start_x, end_x = vector(-inner, 0, 0), vector(inner, 0, 0)
        bar = bar or rail(start_x, end_x, Z, 0.026, 0.014, bar_tenon)
        pieces.append(Piece(f"stretcher_{k + 1}", "bar_stretcher", bar, move(y=y, z=z)))
        post -= bar_tenon.pocket(joint_frame(vector(inner, y, z), -X, Z))
    pieces += [Piece("post_left", "back_frame_vertical_bar", post)]
    pieces += [Piece("post_right", "back_frame_vertical_bar", mirrored_x(post))]

    leg = _leg(s, under)
    x, y = s.width / 2 - 0.022 - s.leg / 2, -s.depth / 2 + 0.022 + s.leg / 2
    for name, sign, angle in (("right", -1, 0.0), ("left", 1, np.pi / 2)):
        pose = SE3(turn(Z, angle), vector(sign * x, y, 0))
        pieces.append(Piece(f"leg_front_{name}", "leg", leg, pose))
        seat -= LEG_TENON.pocket(pose * joint_frame(under * Z, -Z, X))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _leg(s: SplatStyle, under: float) -> Solid:
    """A front leg about the z axis, alike to itself across its diagonal: a quarter turn serves the other side."""
    top = under - CLEARANCE
    z = np.array([0.0, 0.006, 0.02, 0.10, 0.45 * top, 0.78 * top, 0.92 * top, top])
    wide = s.leg * np.array([0.62, 0.72, 0.68, 0.52, 0.66, 0.94, 1.0, 1.0])
    out = s.knee * np.array([-1.3, -1.3, -1.0, 0.35, 0.25, -0.75, -0.4, 0.0])
    if s.knee == 0.0:
        wide = s.leg * np.interp(z / top, [0, 0.9, 1], [0.6, 1, 1])
        out = -(s.leg - wide) / 2
    path = np.column_stack([out, out, z])
    leg = sweep(path, X, Y, [rectangle(w, w, 0.2 * w) for w in wide])
    return leg + LEG_TENON.tongue(joint_frame(under * Z, -Z, X))


def _splat(
    s: SplatStyle, start: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], span: float, inner: float
) -> tuple[Solid, SE3, SE3, Tenon]:
    """A board with a vase's outline, its mouths in seat and crest, and the tenon that it has in both."""
    room = 0.62 * inner
    points = smooth([(room * x, span * y) for x, y in VASES[s.vase]], 19)
    points = [(x, min(max(y, -0.012), span - CLEARANCE)) for x, y in points]
    points[0] = (points[0][0], -0.02)  # trimmed to the seat's level afterwards
    body = cut_out(symmetric(points), start, X, along, SPLAT)
    foot_frame = joint_frame(start, along, X)
    head_frame = joint_frame(start + span * along, -along, X)
    wide = 1.1 * min(points[0][0], points[-1][0])
    tenon = Tenon(wide, 0.007, 0.016, root=0.012)
    return body + tenon.tongue(head_frame), foot_frame, head_frame, tenon


def _crest(s: SplatStyle, base: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"]) -> Solid:
    """The crest on posts and splat: level below, waved above."""
    end = s.back_width / 2 + s.ears
    x = end * np.array([-1, -0.96, -0.86, -0.7, -0.45, -0.2, 0, 0.2, 0.45, 0.7, 0.86, 0.96, 1])
    high = s.crest * np.array([0.68, 0.84, 0.92, 0.84, 0.86, 1.02, 1.08, 1.02, 0.86, 0.84, 0.92, 0.84, 0.68])
    across = np.cross(X, along)
    path = base + x[:, None] * X + (high / 2)[:, None] * along
    return sweep(path, along, -across, [rectangle(h, 0.030, 0.006) for h in high])
