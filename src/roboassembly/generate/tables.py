"""Tables: legs joined by aprons under a top, or two trestles with a stretcher between them.

Aprons run along x and along y into the legs, whose tenons go up into the top: legs are joined in pairs, the pairs to
each other, and the top comes last. In a trestle the post stands between foot and head; the stretcher goes between
two posts along x, the top comes down on the heads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.bends import cut_out, symmetric
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
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
class ApronTableStyle:
    """Sizes in metres; the defaults are the catalogue model."""

    length: float = 0.80
    """Along x."""
    width: float = 0.55
    height: float = 0.52
    top: float = 0.028
    leg: float = 0.048
    taper: float = 0.62
    """Side of a leg's foot over that of its top."""
    apron: float = 0.075
    overhang: float = 0.03
    shelf_bars: int = 0
    """Rails along x low between the legs."""


def sample_apron(rng: np.random.Generator) -> ApronTableStyle:
    """A table of 9 or 11 parts."""
    width = rng.uniform(0.45, 0.65)
    return ApronTableStyle(
        length=width + rng.uniform(0.10, 0.45),
        width=width,
        height=rng.uniform(0.42, 0.74),
        top=rng.uniform(0.022, 0.036),
        leg=rng.uniform(0.040, 0.058),
        taper=rng.uniform(0.5, 0.95),
        apron=rng.uniform(0.06, 0.10),
        overhang=rng.uniform(0.015, 0.06),
        shelf_bars=int(rng.choice([0, 0, 2])),
    )


def build_apron(rng: np.random.Generator | None) -> list[Piece]:
    """A table of the style drawn from `rng`, or the catalogue model with 9 parts."""
    return assemble_apron(ApronTableStyle() if rng is None else sample_apron(rng))


LEG_TENON = RoundTenon(radius=0.011, length=0.014, sides=12)


def assemble_apron(style: ApronTableStyle) -> list[Piece]:
    """All pieces of one table with aprons."""
    s, c = style, CLEARANCE
    under, half = s.height - s.top, s.leg / 2
    x, y = s.length / 2 - s.overhang - half, s.width / 2 - s.overhang - half
    top = pad(rounded_trapezoid(s.length, s.length, s.width, 0.025), under, s.height, 0.006, under=0.004)
    # Leg for the corner (-x, -y): its outer faces upright, its inner ones tapering below the aprons.
    stations = [(0.0, 0.94 * s.taper), (0.004, s.taper), (under - s.apron - 0.03, 1.0), (under - c, 1.0)]
    path = [vector(-(1 - k) * half, -(1 - k) * half, z) for z, k in stations]
    leg = sweep(path, X, Y, [rectangle(k * s.leg, k * s.leg, 0.004) for _, k in stations])
    leg += LEG_TENON.tongue(joint_frame(under * Z, -Z, X))
    pieces: list[Piece] = []
    tenon = Tenon(0.6 * s.apron, 0.009, 0.22 * s.leg)
    level = under - 0.010 - s.apron / 2
    for axis, reach, across, names in ((X, x, y, ("front", "back")), (Y, y, x, ("right", "left"))):
        start, end = (half - reach) * axis + level * Z, (reach - half) * axis + level * Z
        bar = rail(start, end, Z, s.apron, 0.020, tenon)
        side = Y if axis is X else X
        for sign, name in zip((-1, 1), names, strict=True):
            pieces.append(Piece(f"apron_{name}", "apron", bar, move(*(sign * across * side))))
        leg -= tenon.pocket(joint_frame(half * axis + level * Z, axis, Z))
    if s.shelf_bars:
        low, thin = Tenon(0.016, 0.008, 0.008), 0.012
        z = 0.28 * under
        k = float(np.interp(z, [q[0] for q in stations], [q[1] for q in stations]))
        face = -x - (1 - k) * half + k * half
        mid = -y - (1 - k) * half
        start, end = vector(face + 0.0012, mid, z), vector(-face - 0.0012, mid, z)
        bar = rail(start, end, Z, 0.026, thin, low)
        for sign, name in ((1, "front"), (-1, "back")):
            pose = move() if sign > 0 else move(y=-2 * mid)
            pieces.append(Piece(f"bar_{name}", "bar_stretcher", bar, pose))
        leg -= low.pocket(move(x, y) * mouths(start, end, Z)[0], over=0.012)
    # Without bars a leg is alike across its diagonal, and a quarter turn serves the other two corners.
    other, quarter = (mirrored_x(leg), 0.0) if s.shelf_bars else (leg, np.pi / 2)
    for name, solid, sx, sy, angle in (
        ("front_right", leg, -1, -1, 0.0),
        ("back_left", leg, 1, 1, np.pi),
        ("front_left", other, 1, -1, quarter),
        ("back_right", other, -1, 1, np.pi + quarter),
    ):
        pose = SE3(turn(Z, angle), vector(sx * x, sy * y, 0))
        pieces.append(Piece(f"leg_{name}", "leg", solid, pose))
        top -= LEG_TENON.pocket(pose * joint_frame(under * Z, -Z, X))
    pieces.append(Piece("top", "tabletop", top))
    return pieces


@dataclass(frozen=True)
class TrestleTableStyle:
    """Sizes in metres; the defaults are the catalogue model."""

    length: float = 0.95
    """Along x."""
    width: float = 0.55
    height: float = 0.60
    top: float = 0.030
    post: float = 0.075
    """Width of a post along y."""
    thickness: float = 0.045
    """Of posts, feet and heads."""
    stretchers: int = 1
    waist: float = 0.72
    """Width of the post's middle over that of its ends."""


def sample_trestle(rng: np.random.Generator) -> TrestleTableStyle:
    """A table of 8 or 9 parts."""
    width = rng.uniform(0.45, 0.65)
    return TrestleTableStyle(
        length=width + rng.uniform(0.25, 0.55),
        width=width,
        height=rng.uniform(0.48, 0.74),
        top=rng.uniform(0.026, 0.040),
        post=rng.uniform(0.065, 0.12),
        thickness=rng.uniform(0.038, 0.052),
        stretchers=int(rng.integers(1, 3)),
        waist=rng.uniform(0.6, 1.0),
    )


def build_trestle(rng: np.random.Generator | None) -> list[Piece]:
    """A table of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble_trestle(TrestleTableStyle() if rng is None else sample_trestle(rng))


HEAD_PEG = RoundTenon(radius=0.009, length=0.012, sides=12)


def assemble_trestle(style: TrestleTableStyle) -> list[Piece]:
    """All pieces of one table with trestles."""
    s, c = style, CLEARANCE
    under = s.height - s.top
    x = s.length / 2 - 0.16
    foot_top, head_low = 0.062, under - 0.052
    top = pad(rounded_trapezoid(s.length, s.length, s.width, 0.02), under, s.height, 0.007, under=0.004)
    tenon = Tenon(0.60 * s.post, 0.45 * s.thickness, 0.024)
    arch = 0.36 * s.width
    foot_outline = [(0.0, 0.014), (0.7 * arch, 0.014), (0.75 * arch, 0.0), (1.16 * arch, 0.0), (1.16 * arch, 0.026),
                    (1.1 * arch, 0.036), (0.75 * s.post, foot_top)]  # fmt: skip
    head_outline = [(0.75 * s.post, head_low), (1.05 * arch, head_low + 0.022), (1.1 * arch, under - c)]
    foot = cut_out(symmetric(foot_outline), vector(0, 0, 0), Y, Z, s.thickness)
    head = cut_out(symmetric(head_outline), vector(0, 0, 0), Y, Z, s.thickness)
    z = np.array([foot_top + c, foot_top + 0.05, 0.5 * (foot_top + head_low), head_low - 0.05, head_low - c])
    widths = s.post * np.array([1, 0.96, s.waist, 0.96, 1])
    post = sweep(z[:, None] * Z, Y, -X, [rectangle(w, 0.82 * s.thickness, 0.003) for w in widths])
    for frame in (joint_frame(foot_top * Z, Z, Y), joint_frame(head_low * Z, -Z, Y)):
        post += tenon.tongue(frame)
    foot -= tenon.pocket(joint_frame(foot_top * Z, Z, Y))
    head -= tenon.pocket(joint_frame(head_low * Z, -Z, Y))
    # Pegs unequally far from the middle, so that a head on its post fits the top in one way only.
    for y in (-0.75 * arch, 0.55 * arch):
        peg = joint_frame(vector(0, y, under), -Z, X)
        head += HEAD_PEG.tongue(peg)
        for angle in (0.0, np.pi):
            top -= HEAD_PEG.pocket(SE3(turn(Z, angle), np.zeros(3)) * move(x) * peg)
    # Stretchers between the posts' inner faces.
    face = x - 0.41 * s.thickness
    bar_tenon = Tenon(0.028, 0.011, 0.36 * s.thickness)
    levels = [0.62] if s.stretchers == 1 else [0.32, 0.72]
    pieces: list[Piece] = []
    bar: Solid | None = None
    for k, share in enumerate(levels):
        at = vector(0, 0, foot_top + share * (head_low - foot_top))
        bar = bar or rail(at - face * X, at + face * X, Z, 0.050, 0.024, bar_tenon)
        up = (share - levels[0]) * (head_low - foot_top)
        pieces.append(Piece(f"stretcher_{k + 1}", "bar_stretcher", bar, move(z=up)))
        post -= bar_tenon.pocket(joint_frame(at - 0.41 * s.thickness * X, -X, Z))
    for side, name in ((1, "left"), (-1, "right")):
        # Mortises look inward: one trestle is the other turned about; its foot is the same from both sides.
        facing = SE3(turn(Z, 0.0 if side > 0 else np.pi), np.zeros(3))
        pieces.append(Piece(f"foot_{name}", "leg", foot, move(side * x)))
        pieces.append(Piece(f"post_{name}", "leg", post, move(side * x) * facing))
        pieces.append(Piece(f"head_{name}", "leg", head, move(side * x) * facing))
    pieces.append(Piece("top", "tabletop", top))
    return pieces
