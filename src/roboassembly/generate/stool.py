"""The stool: four turned legs, stretchers between all of them, a seat on top.

The legs' tenons go up into the seat, the stretchers run along x and along y at different heights. So the legs are
joined in pairs, the pairs to each other, and the seat comes last: legs that stand in the seat cannot be spread to
let a stretcher in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.joints import CLEARANCE, RoundTenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, spindle
from roboassembly.generate.solids import (
    Solid,
    X,
    Z,
    circle,
    mirrored_x,
    pad,
    placed,
    rounded_trapezoid,
    turn,
    turned,
    vector,
)
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class StoolStyle:
    """Sizes in metres; the defaults are the catalogue model."""

    seat: float = 0.38
    """Diameter, or side, of the seat."""
    height: float = 0.47
    thickness: float = 0.036
    round: bool = True
    saddle: float = 0.008
    """How deep the seat is hollowed; negative for a cushion."""
    leg_radius: float = 0.020
    stretcher: float = 0.0115
    """Radius of a stretcher's belly."""
    rows: int = 1
    """Stretchers on each side."""


def sample(rng: np.random.Generator) -> StoolStyle:
    """A style of 9 or 13 parts."""
    return StoolStyle(
        seat=rng.uniform(0.34, 0.42),
        height=rng.uniform(0.44, 0.50),
        thickness=rng.uniform(0.032, 0.05),
        round=bool(rng.random() < 0.5),
        saddle=float(rng.choice([0.008, 0.005, -0.012])),
        leg_radius=rng.uniform(0.0185, 0.023),
        stretcher=rng.uniform(0.0105, 0.013),
        rows=int(rng.integers(1, 3)),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A stool of the style drawn from `rng`, or the catalogue model with 9 parts."""
    return assemble(StoolStyle() if rng is None else sample(rng))


LEG_TENON = RoundTenon(radius=0.0125, length=0.020)
STRETCHER_TENON = RoundTenon(radius=0.0075, length=0.0135, sides=10)


def assemble(style: StoolStyle) -> list[Piece]:
    """All pieces of one style."""
    s = style
    under = s.height - s.thickness
    reach = (0.31 if s.round else 0.40) * s.seat
    """Distance of a leg's axis from both middle planes."""
    outline = circle(s.seat / 2, 24) if s.round else rounded_trapezoid(s.seat, s.seat, s.seat, 0.05, steps=4)
    seat = pad(outline, under, s.height, 0.008, -s.saddle, under=0.008)
    leg = _leg(s, under)
    pieces: list[Piece] = []

    # One leg's holes, for the corner (-x, -y); stretchers along x are lower than those along y, and all are alike.
    inset = 0.93 * s.leg_radius
    start, end = vector(-reach + inset, 0, 0), vector(reach - inset, 0, 0)
    stretcher = spindle(start, end, Z, s.stretcher, STRETCHER_TENON, free=0.014)
    hole = STRETCHER_TENON.pocket(move(reach) * mouths(start, end, Z)[0], over=0.012)
    levels = [0.12, 0.165] if s.rows == 1 else [0.10, 0.14, 0.235, 0.275]
    for k, z in enumerate(levels):
        quarter = SE3(turn(Z, k % 2 * np.pi / 2), np.zeros(3))
        leg -= placed(hole, move(z=z) * quarter)
        row = "" if s.rows == 1 else ("_lower", "_upper")[k // 2]
        # The quarter turn takes -y, the front, to +x, the left.
        for y, name in zip((-reach, reach), (("front", "back"), ("left", "right"))[k % 2], strict=True):
            pieces.append(Piece(f"stretcher_{name}{row}", "bar_stretcher", stretcher, move(z=z) * quarter * move(y=y)))
    other = mirrored_x(leg)
    corners = (
        ("front_right", leg, (-1, -1), 0.0),
        ("back_left", leg, (1, 1), np.pi),
        ("front_left", other, (1, -1), 0.0),
        ("back_right", other, (-1, 1), np.pi),
    )
    for name, solid, (x, y), angle in corners:
        pose = SE3(turn(Z, angle), vector(x * reach, y * reach, 0))
        pieces.append(Piece(f"leg_{name}", "leg", solid, pose))
        seat -= LEG_TENON.pocket(pose * joint_frame(under * Z, -Z, X))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _leg(s: StoolStyle, under: float) -> Solid:
    """A turned leg about the z axis, of even thickness where stretchers come in."""
    r, top = s.leg_radius, under - CLEARANCE
    profile = [(0.0, 0.60 * r), (0.004, 0.68 * r), (0.072, r), (0.31, r)]
    profile += [(0.325, 0.72 * r), (0.335, 1.02 * r), (0.345, 0.78 * r), (top - 0.02, 0.92 * r), (top, 0.86 * r)]
    if s.rows == 1:
        profile[3:4] = [(0.20, r), (0.26, 1.1 * r)]
    return turned(profile, 16) + LEG_TENON.tongue(joint_frame(under * Z, -Z, X))
