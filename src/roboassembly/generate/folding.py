"""The chair that looks as if it folded: two pairs of crossed legs, the seat and a rod between the inner ones.

Everything lies along x, in layers: outer leg, inner leg, seat. The inner legs are joined by seat and rod first,
then come the outer ones with back and rod between them; each layer shuts out what was left behind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import ribbon
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail, spindle
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
    unit,
    vector,
)


@dataclass(frozen=True)
class FoldingStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.46
    """Over the outer legs."""
    depth: float = 0.46
    """Of the feet."""
    seat_height: float = 0.45
    height: float = 0.82
    stile: float = 0.038
    """Width of a leg, seen from the side."""
    thickness: float = 0.022
    """Of a leg, along x."""
    slats: int = 2
    """In the back."""
    seat_thickness: float = 0.024
    low_rod: bool = True
    """Between the outer legs."""
    rest: bool = True
    """A rod between the outer legs, on which the seat's rear lies."""


def sample(rng: np.random.Generator) -> FoldingStyle:
    """A style of 7 to 11 parts."""
    return FoldingStyle(
        width=rng.uniform(0.44, 0.50),
        depth=rng.uniform(0.42, 0.50),
        seat_height=rng.uniform(0.43, 0.47),
        height=rng.uniform(0.76, 0.88),
        stile=rng.uniform(0.034, 0.044),
        thickness=rng.uniform(0.021, 0.026),
        slats=int(rng.integers(1, 4)),
        seat_thickness=rng.uniform(0.020, 0.034),
        low_rod=bool(rng.random() < 0.5),
        rest=bool(rng.random() < 0.5),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A crossed-leg chair of the style drawn from `rng`, or the catalogue model with 10 parts."""
    return assemble(FoldingStyle() if rng is None else sample(rng))


ROD = RoundTenon(radius=0.0075, length=0.012, sides=10)
PIVOT = RoundTenon(radius=0.0085, length=0.010, sides=12)
APART = 0.009
"""Between the crossed legs: a collar around the pivot fills it."""


def assemble(style: FoldingStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c, t = style, CLEARANCE, style.thickness
    outer_x = s.width / 2 - t / 2
    inner_x = outer_x - t - APART
    outer_face, inner_face = outer_x - t / 2, inner_x - t / 2
    under = s.seat_height - s.seat_thickness
    # The outer leg: from the floor in front, up and back past the seat's rear, then steeper to the crest.
    rear_cross = vector(0, 0.16, s.seat_height)
    front_foot = vector(0, -s.depth / 2, 0)
    rise = unit(rear_cross - front_foot)
    bend = rear_cross + 0.035 * rise
    steep = unit(vector(0, 0.30, 1.0))
    top = bend + (s.height - bend[2]) / steep[2] * steep
    outer = _leg([front_foot, bend, top], outer_x, t, s.stile)
    # The inner leg: from the floor behind to under the seat's front.
    front_top = vector(0, -0.135, under + 0.5 * s.seat_thickness)
    rear_foot = vector(0, s.depth / 2, 0)
    lean = unit(front_top - rear_foot)
    inner = _leg([rear_foot, front_top + 0.012 * lean], inner_x, t, s.stile)
    pieces: list[Piece] = []

    # Where they cross, a pin of the inner leg goes into the outer one.
    a, b = np.array([rise[1:], -lean[1:]]).T, (rear_foot - front_foot)[1:]
    cross = front_foot + np.linalg.solve(a, b)[0] * rise
    collar = sweep(
        [cross + (inner_x + 0.3 * t) * X, cross + (outer_face - c) * X], Y, Z, rectangle(0.024, 0.024, 0.006)
    )
    pin = joint_frame(cross + outer_face * X, -X, Z)
    inner += collar + PIVOT.tongue(pin)
    outer -= PIVOT.pocket(pin)

    # Between the inner legs: seat and rod.
    depth = 0.5 * t
    front, rear = front_top[1] - 0.055, rear_cross[1] + 0.015
    wide = 2 * (inner_face - c)
    outline = rounded_trapezoid(wide, wide, rear - front, 0.02) + np.array([0.0, (front + rear) / 2])
    seat = pad(outline, under, s.seat_height, 0.006, under=0.004)
    tongue = Tenon(0.6 * s.stile, 0.011, depth)
    inner_cuts = [tongue.pocket(joint_frame(front_top + inner_face * X, -X, Y))]
    added = tongue.tongue(joint_frame(front_top + inner_face * X, -X, Y))
    seat += added + mirrored_x(added)
    rods: list[tuple[str, Float[np.ndarray, "3"], float]] = [
        ("rod_inner", rear_foot + 0.13 / lean[2] * lean, inner_face)
    ]
    if s.low_rod:
        rods.append(("rod_outer", front_foot + 0.10 / rise[2] * rise, outer_face))
    outer_cuts: list[Solid] = []
    for name, at, face in rods:
        start, end = at - face * X, at + face * X
        pieces.append(Piece(name, "bar_stretcher", spindle(start, end, Z, 0.0105, ROD)))
        (inner_cuts if face == inner_face else outer_cuts).append(ROD.pocket(mouths(start, end, Z)[1]))
    if s.rest:
        bar = Tenon(0.016, 0.009, depth)
        at = front_foot + (under - c - 0.014 - front_foot[2]) / rise[2] * rise
        start, end = at - outer_face * X, at + outer_face * X
        pieces.append(Piece("seat_rest", "seat_frame_bar", rail(start, end, Z, 0.028, 0.016, bar, 0.002)))
        outer_cuts.append(bar.pocket(mouths(start, end, Z)[1]))

    # Slats between the outer legs, above the bend.
    slat_tenon = Tenon(0.030, 0.009, depth)
    length = float(np.linalg.norm(top - bend))
    height = 0.046 if s.slats > 1 else 0.10
    highest = length - 0.012 - height / 2
    slat = _slat(top - (length - highest) * steep, steep, outer_face, height, slat_tenon)
    for k in range(s.slats):
        down = (height + 0.026) * k
        name = "crest_rail" if k == 0 else f"slat_{k}"
        pieces.append(Piece(name, "back_surface_horizontal_bar", slat, move(*(-down * steep))))
        at = bend + (highest - down) * steep + outer_face * X
        outer_cuts.append(slat_tenon.pocket(joint_frame(at, -X, steep)))
    for cut in inner_cuts:
        inner -= cut
    for cut in outer_cuts:
        outer -= cut
    pieces += [Piece("leg_inner_left", "leg", inner), Piece("leg_inner_right", "leg", mirrored_x(inner))]
    pieces += [Piece("leg_outer_left", "leg", outer), Piece("leg_outer_right", "leg", mirrored_x(outer))]
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _leg(course: list[Float[np.ndarray, "3"]], x: float, thickness: float, stile: float) -> Solid:
    """A flat leg along a course in the y-z plane, its foot cut level at the floor."""
    first, last = unit(course[1] - course[0]), unit(course[-1] - course[-2])
    points = np.array([course[0] - 0.05 * first, *course[1:-1], course[-1] - 0.012 * last, course[-1]]) + x * X
    tangents = np.array([first, *[unit(last + first)] * (len(course) - 2), last, last])
    wide = [stile] * (len(points) - 1) + [0.6 * stile]
    body = ribbon(points, tangents, X, [rectangle(thickness, w, 0.003) for w in wide])
    return body.trim_by_plane((0.0, 0.0, 1.0), 0.0)


def _slat(at: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], face: float, height: float, tenon: Tenon) -> Solid:
    """A slat between the outer legs, bent around the sitter."""
    end = face - CLEARANCE
    x = end * np.linspace(-1, 1, 9)
    across = np.cross(X, along)
    path = at + x[:, None] * X - (0.022 * (1 - (x / end) ** 2))[:, None] * across
    body = sweep(path, along, across, rectangle(height, 0.016, 0.003))
    for frame in mouths(at - face * X, at + face * X, along):
        body += tenon.tongue(frame)
    return body
