"""The Windsor: a saddled seat that carries everything, four splayed turned legs below, spindles and a comb above.

All spindles of a back are parallel, so that the comb can come down on them in one straight motion. Once the comb
sits on one spindle that is in the seat, another spindle can no longer get between them. The legs are splayed and
go in one by one, along their own axes; for that reason no stretcher joins them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import RoundTenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import Solid, X, Y, Z, circle, pad, rectangle, sweep, turn, unit, vector
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class WindsorStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    seat_width: float = 0.45
    seat_depth: float = 0.42
    seat_height: float = 0.45
    seat_thickness: float = 0.042
    saddle: float = 0.010
    """How deep the seat is hollowed."""
    height: float = 0.92
    splay: float = 0.23
    """Tilt of a leg."""
    leg_radius: float = 0.018
    rake: float = 0.20
    spindles: int = 6
    bow: float = 0.065
    """How far the middle of the row of spindles lies behind its ends."""
    comb_height: float = 0.075
    belt: bool = False
    """A second rail part of the way up, with a second row of spindles above it."""
    turnings: int = 1
    """0 plain tapered legs, 1 a vase, 2 two rings."""


def sample(rng: np.random.Generator) -> WindsorStyle:
    """A style of 10 to 16 parts."""
    belt = bool(rng.random() < 0.3)
    height = rng.uniform(0.86, 1.0)
    return WindsorStyle(
        seat_width=rng.uniform(0.42, 0.49),
        seat_depth=rng.uniform(0.40, 0.45),
        seat_height=rng.uniform(0.43, 0.465),
        seat_thickness=rng.uniform(0.038, 0.048),
        saddle=rng.uniform(0.006, 0.012),
        height=height + (0.06 if belt else 0.0),
        splay=rng.uniform(0.17, 0.26),
        leg_radius=rng.uniform(0.0155, 0.02),
        rake=rng.uniform(0.16, 0.24),
        spindles=int(rng.integers(4, 6)) if belt else int(rng.integers(4, 7)),
        bow=float(rng.choice([0.0, 0.04, 0.06, 0.07])),
        comb_height=rng.uniform(0.055, 0.09),
        belt=belt,
        turnings=int(rng.integers(0, 3)),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A Windsor of the style drawn from `rng`, or the catalogue model with 12 parts."""
    return assemble(WindsorStyle() if rng is None else sample(rng))


LEG_TENON = RoundTenon(radius=0.0125, length=0.026, end_radius=0.011)
SPINDLE_FOOT = RoundTenon(radius=0.0080, length=0.020, sides=8)
SPINDLE_TIP = RoundTenon(radius=0.0062, length=0.022, sides=8)
MOUTH = 0.012
"""Holes are slanted to the faces that they start from, so that a tool enters from this far outside."""


def assemble(style: WindsorStyle) -> list[Piece]:
    """All pieces of one style."""
    s = style
    under = s.seat_height - s.seat_thickness
    seat = pad(_seat_outline(s.seat_width, s.seat_depth), under, s.seat_height, 0.007, crown=-s.saddle, under=0.010)
    pieces: list[Piece] = []

    # Legs: the same leg, turned about the vertical to each of its four directions.
    leg, tilted = _leg(s, under)
    for end, y, heading in (("front", -0.30, -0.85), ("back", 0.28, 0.95)):
        for side, x in (("left", 0.29), ("right", -0.29)):
            angle = heading if x > 0 else np.pi - heading
            pose = SE3(turn(Z, angle), vector(x * s.seat_width, y * s.seat_depth, 0))
            pieces.append(Piece(f"leg_{end}_{side}", "leg", leg, pose))
            mouth, axis = pose.act(vector(0, 0, under)), pose.rotation @ tilted
            seat -= LEG_TENON.pocket(joint_frame(mouth, -axis, pose.rotation @ Y), over=MOUTH)

    # The back: everything along one leaning direction.
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    span = 0.37 * s.seat_width
    xs = np.linspace(-span, span, s.spindles)
    # Every hole keeps clear of the seat's rounded edge.
    edge = _seat_outline(s.seat_width, s.seat_depth, 200)[1:100]
    rear = min(s.seat_depth / 2 - 0.030, s.bow + float(np.interp(span, edge[::-1, 0], edge[::-1, 1])) - 0.036)

    def row(x: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return rear - s.bow * (x / span) ** 2

    comb_low = s.height - s.comb_height * np.cos(s.rake)
    levels = [s.seat_height - 0.001, comb_low]
    belt_height = 0.032
    if s.belt:
        low = s.seat_height + 0.42 * (comb_low - s.seat_height)
        levels = [levels[0], low, low + belt_height * np.cos(s.rake), comb_low]
    base = s.seat_height

    def lean(z: float) -> SE3:
        """From the seat's top up to the height z, along the back."""
        return move(*(along * (z - base) / np.cos(s.rake)))

    rails: list[Solid] = []
    for low, height, taper in ((comb_low, s.comb_height, True), *([(levels[1], belt_height, False)] if s.belt else [])):
        rails.append(_rail(span, row, lean(low), base, along, height, taper))
    comb, belt = rails[0], rails[-1]
    for tier, (low, high) in enumerate(zip(levels[::2], levels[1::2], strict=True)):
        # The upper row stands between the lower one, so that the belt's holes from both sides do not meet.
        stand = xs if tier == 0 else (xs[1:] + xs[:-1]) / 2
        spindle = _spindle((high - low) / np.cos(s.rake), along)
        for k, x in enumerate(stand):
            foot = lean(low) * vector(x, float(row(np.array(x))), base)
            head = lean(high) * vector(x, float(row(np.array(x))), base)
            name = f"spindle_{k + 1}" if not s.belt else f"spindle_{('lower', 'upper')[tier]}_{k + 1}"
            pieces.append(Piece(name, "back_surface_vertical_bar", spindle, move(*foot)))
            foot_hole = SPINDLE_FOOT.pocket(joint_frame(foot, along, X), over=MOUTH)
            head_hole = SPINDLE_TIP.pocket(joint_frame(head, -along, X), over=MOUTH)
            if tier == 0:
                seat -= foot_hole
            else:
                belt -= foot_hole
            if tier == 0 and s.belt:
                belt -= head_hole
            else:
                comb -= head_hole
    pieces.append(Piece("comb", "back_frame_horizontal_bar", comb))
    if s.belt:
        pieces.append(Piece("belt", "back_frame_horizontal_bar", belt))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _seat_outline(width: float, depth: float, corners: int = 20) -> Float[np.ndarray, "n 2"]:
    """A shield: round at the back, squarer in front."""
    angle = 2 * np.pi * np.arange(corners) / corners
    c, s = np.cos(angle), np.sin(angle)
    power = np.where(s < 0, 2 / 3.2, 2 / 2.3)
    x = np.sign(c) * np.abs(c) ** power * width / 2
    y = np.sign(s) * np.abs(s) ** power * depth / 2
    return np.column_stack([x * (1.0 - 0.06 * s), y])


def _leg(s: WindsorStyle, under: float) -> tuple[Solid, Float[np.ndarray, "3"]]:
    """A leg whose axis leans toward -x on its way up and meets the seat's underside above the origin; its axis."""
    axis = unit(vector(-np.sin(s.splay), 0, np.cos(s.splay)))
    length = under / np.cos(s.splay)
    r = s.leg_radius
    # Metres below the mouth, radius. The first three lie on the tenon's cone.
    slope = (LEG_TENON.radius - LEG_TENON.end_radius) / LEG_TENON.length
    profile = [(-LEG_TENON.length, LEG_TENON.end_radius), (MOUTH, LEG_TENON.radius + slope * MOUTH)]
    shapes = {
        0: [(0.45, r), (0.62, 0.97 * r), (1.05, 0.62 * r)],
        1: [(0.16, 0.95 * r), (0.40, 1.12 * r), (0.52, 0.72 * r), (0.55, 0.98 * r), (0.58, 0.74 * r), (0.72, r)],
        2: [(0.10, 0.9 * r), (0.13, 1.15 * r), (0.16, 0.85 * r), (0.45, 1.1 * r), (0.66, 0.72 * r), (0.69, r)],
    }
    profile += [(k * length, radius) for k, radius in shapes[s.turnings]]
    if s.turnings:
        profile += [(0.73 * length, 0.8 * r), (0.82 * length, 0.95 * r), (1.05 * length, 0.58 * r)]
    profile = sorted(profile)
    mouth = vector(0, 0, under)
    path = np.array([mouth - d * axis for d, _ in profile])
    u = Y
    solid = sweep(path, u, np.cross(u, axis), [circle(radius, 12) for _, radius in profile])
    return solid.trim_by_plane((0.0, 0.0, 1.0), 0.0), axis


def _spindle(length: float, along: Float[np.ndarray, "3"]) -> Solid:
    """A spindle from hole to hole, `length` between the mouths, its lower mouth at the origin."""
    foot, tip = SPINDLE_FOOT, SPINDLE_TIP
    stations = [(-foot.length, foot.radius), (MOUTH, foot.radius), (0.35 * length, 1.3 * foot.radius)]
    stations += [(length - MOUTH, tip.radius), (length + tip.length, tip.radius)]
    path = np.array([d * along for d, _ in stations])
    return sweep(path, X, np.cross(along, X), [circle(radius, 8) for _, radius in stations])


def _rail(
    span: float,
    row: Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n"]],
    pose: SE3,
    base: float,
    along: Float[np.ndarray, "3"],
    height: float,
    taper: bool,
) -> Solid:
    """A bent rail over the row of spindles, level below; its ends are lower and rounded where it tapers."""
    end = span + 0.030
    x = end * np.array([-1, -0.95, -0.8, -0.55, -0.28, 0.0, 0.28, 0.55, 0.8, 0.95, 1])
    size = np.interp(np.abs(x) / end, [0, 0.55, 0.8, 0.95, 1], [1, 0.97, 0.88, 0.72, 0.55]) if taper else np.ones(11)
    thick = np.interp(np.abs(x) / end, [0, 0.95, 1], [0.025, 0.025, 0.016])
    path = np.column_stack([x, row(x), np.full(11, base)]) @ pose.rotation.T + pose.translation
    path = path + along * (height * size / 2)[:, None]
    sections = [rectangle(h * height, t, 0.004) for h, t in zip(size, thick, strict=True)]
    return sweep(path, along, Y, np.array(sections))
