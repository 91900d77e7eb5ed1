"""The swivel chair: five feet around a hub, a column with a cover, a plate, the seat on it, a back on a bent bar.

The cover is a tube that slides over the column and rests on the hub. It is wider than the plate's socket and than
the hub's bore, so it must be on the column before the column has something at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
    loft,
    mirrored_x,
    pad,
    rectangle,
    rounded_trapezoid,
    sweep,
    turn,
    turned,
    vector,
)
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class PedestalStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.47
    depth: float = 0.46
    seat_height: float = 0.47
    seat_thickness: float = 0.062
    crown: float = 0.014
    height: float = 0.92
    spread: float = 0.29
    """Radius of the star of feet."""
    hub: float = 0.042
    casters: bool = False
    cover: bool = True
    arms: bool = False
    rake: float = 0.16
    back_width: float = 0.40
    back_height: float = 0.30


def sample(rng: np.random.Generator) -> PedestalStyle:
    """A style of 11 to 20 parts."""
    casters, cover = bool(rng.random() < 0.45), bool(rng.random() < 0.8)
    return PedestalStyle(
        width=rng.uniform(0.44, 0.51),
        depth=rng.uniform(0.43, 0.48),
        seat_height=rng.uniform(0.44, 0.49),
        seat_thickness=rng.uniform(0.05, 0.08),
        crown=rng.uniform(0.008, 0.022),
        height=rng.uniform(0.84, 1.0),
        spread=rng.uniform(0.26, 0.32),
        hub=rng.uniform(0.039, 0.048),
        casters=casters,
        cover=cover,
        arms=bool(rng.random() < 0.45) and not (casters and cover),  # that would be 21 parts
        rake=rng.uniform(0.10, 0.24),
        back_width=rng.uniform(0.34, 0.44),
        back_height=rng.uniform(0.22, 0.36),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A swivel chair of the style drawn from `rng`, or the catalogue model with 12 parts."""
    return assemble(PedestalStyle() if rng is None else sample(rng))


FOOT_TENON = Tenon(0.024, 0.012, 0.014)
CASTER_PIN = RoundTenon(radius=0.0050, length=0.010, sides=8)
PEG = RoundTenon(radius=0.0075, length=0.014, sides=8)
COLUMN = 0.0185
"""Radius of the column between its tenons."""
COLUMN_FOOT = RoundTenon(radius=0.0155, length=0.036, end_radius=0.0140, sides=16)
COLUMN_HEAD = RoundTenon(radius=0.0140, length=0.020, end_radius=0.0130, sides=16)
BAR_TENON = Tenon(0.044, 0.010, 0.026)
BACK_TENON = Tenon(0.046, 0.012, 0.090)
PLATE = 0.036
"""Thickness of the plate under the seat."""


def assemble(style: PedestalStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    lift = 0.052 if s.casters else 0.0
    hub_low, hub_top = 0.050 + lift, 0.118 + lift
    under = s.seat_height - s.seat_thickness
    plate_low = under - c - PLATE
    pieces: list[Piece] = []

    # Hub and feet. A ten-sided hub, its corners at multiples of 36 degrees, has flats at -90, -18, 54...
    decagon = [(hub_low, s.hub - 0.004), (hub_low + 0.004, s.hub), (hub_top - 0.004, s.hub), (hub_top, s.hub - 0.004)]
    hub = turned(decagon, 10) - COLUMN_FOOT.pocket(joint_frame(hub_top * Z, Z, X))
    flat = s.hub * np.cos(np.pi / 10)
    foot_z = (hub_low + hub_top) / 2
    foot, tip = _foot(s, flat, foot_z, lift)
    caster = _caster(tip[2]) if s.casters else None
    for k in range(5):
        # One foot points forward.
        spin = SE3(turn(Z, 2 * np.pi * k / 5 - np.pi / 2), np.zeros(3))
        pieces.append(Piece(f"foot_{k + 1}", "star_leg", foot, spin))
        frame = spin * joint_frame(vector(flat, 0, foot_z), X, Z)
        hub -= FOOT_TENON.pocket(frame)
        if caster is not None:
            pieces.append(Piece(f"caster_{k + 1}", "wheel", caster, spin * move(tip[0])))
    pieces.append(Piece("hub", "central_support", hub))

    # Column, its cover, and the plate that carries the seat.
    column = turned([(hub_top + c, COLUMN - 0.001), (hub_top + c + 0.001, COLUMN), (plate_low - c, COLUMN)], 16)
    column += COLUMN_FOOT.tongue(joint_frame(hub_top * Z, Z, X))
    column += COLUMN_HEAD.tongue(joint_frame(plate_low * Z, -Z, X))
    pieces.append(Piece("column", "pedestal", column))
    if s.cover:
        low, high = hub_top + c, hub_top + 0.55 * (plate_low - hub_top)
        shell = [(low, 0.033), (low + 0.012, 0.033), (low + 0.014, 0.0285), (high - 0.003, 0.0265), (high, 0.024)]
        bore = COLUMN + c / np.cos(np.pi / 16)
        pieces.append(
            Piece("column_cover", "pedestal", turned(shell, 16) - turned([(0.0, bore), (high + 1, bore)], 16))
        )
    plate = pad(rounded_trapezoid(0.17, 0.15, 0.20, 0.03), plate_low, plate_low + PLATE, 0.002, under=0.010)
    plate -= COLUMN_HEAD.pocket(joint_frame(plate_low * Z, -Z, X))
    outline = rounded_trapezoid(s.width, s.width - 0.05, s.depth, 0.07, steps=4)
    seat = pad(outline, under, s.seat_height, 0.3 * s.seat_thickness, s.crown, under=0.2 * s.seat_thickness)
    for x in (-0.055, 0.055):
        peg = joint_frame(vector(x, -0.02, under), -Z, X)
        plate += PEG.tongue(peg)
        seat -= PEG.pocket(peg)

    # The back on its bent bar.
    bar_z = plate_low + 0.015
    bar_mouth = vector(0, 0.10, bar_z)
    plate -= BAR_TENON.pocket(joint_frame(bar_mouth, Y, X))
    along, across = vector(0, np.sin(s.rake), np.cos(s.rake)), vector(0, -np.cos(s.rake), np.sin(s.rake))
    bend = vector(0, s.depth / 2 + 0.016, bar_z)
    lower_edge = s.height - s.back_height * np.cos(s.rake)
    back_mouth = bend + (0.075 * Y) + (lower_edge - bar_z) / along[2] * along
    pieces.append(Piece("back_bar", "back_connector", _bar(bar_mouth, bend, back_mouth, along)))
    pieces.append(Piece("back", "back_single_surface", _back(s, back_mouth, along, across)))
    pieces.append(Piece("plate", "seat_frame_bar", plate))

    if s.arms:
        arm_z, tenon = under + 0.45 * s.seat_thickness, Tenon(0.034, 0.010, 0.030)
        y = -0.02
        side = s.width / 2 - 0.05 * (0.5 + y / s.depth) / 2
        # The seat's side is not quite parallel to y: cut its flat for the bracket.
        face = side - 0.006
        seat = seat - sweep([vector(face - c, y, arm_z), vector(face + 0.05, y, arm_z)], Y, Z, rectangle(0.062, 1.0))
        seat = seat - sweep([vector(-face + c, y, arm_z), vector(-face - 0.05, y, arm_z)], Y, Z, rectangle(0.062, 1.0))
        bracket, pin, pin_tenon = _bracket(s, arm_z, tenon)
        rest = _arm_pad(pin, pin_tenon)
        for sign, name in ((1, "left"), (-1, "right")):
            pose = move(sign * face, y) * SE3(turn(Z, 0.0 if sign > 0 else np.pi), np.zeros(3))
            seat -= tenon.pocket(pose * joint_frame(vector(0, 0, arm_z), X, Y), over=0.02)
            pieces.append(Piece(f"arm_bracket_{name}", "arm_near_vertical_bar", bracket, pose))
            solid = rest if sign > 0 else mirrored_x(rest)
            pieces.append(Piece(f"arm_pad_{name}", "arm_horizontal_bar", solid, move(sign * face, y)))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _foot(s: PedestalStyle, flat: float, z: float, lift: float) -> tuple[Solid, Float[np.ndarray, "3"]]:
    """A foot along +x from the hub's flat, and the middle of its tip's underside."""
    end = s.spread
    tip_z = 0.024 + lift
    stations = [
        (flat + CLEARANCE, z, 0.022, 0.050),
        (flat + 0.06, z - 0.001, 0.027, 0.044),
        (0.6 * end, 0.62 * z + 0.38 * tip_z, 0.027, 0.032),
        (end - 0.010, tip_z, 0.030, 0.022),
        (end + 0.012, tip_z - 0.001, 0.028, 0.018),
        (end + 0.018, tip_z - 0.002, 0.018, 0.010),
    ]
    path = np.array([vector(x, 0, h) for x, h, _, _ in stations])
    body = sweep(path, Y, Z, [rectangle(w, h, 0.004) for _, _, w, h in stations])
    body += FOOT_TENON.tongue(joint_frame(vector(flat, 0, z), X, Z))
    under = vector(end - 0.010, 0, tip_z - 0.011)
    if s.casters:
        return body - CASTER_PIN.pocket(joint_frame(under, -Z, X)), under
    glide = turned([(0.0, 0.010), (0.003, 0.012), (under[2] + 0.004, 0.012)], 10)
    return body + glide.translate((under[0], 0.0, 0.0)), under


def _caster(top: float) -> Solid:
    """A ball caster about the z axis from the floor to a foot's underside at `top`, its pin included."""
    high = top - CLEARANCE
    r = (high - 0.006) / 2
    angle = np.radians([-64, -35, 0, 35, 64])
    ball = [(r + r * np.sin(a), 1.1 * r * np.cos(a)) for a in angle]
    base = ball[0][0]
    ball = [(h - base, radius) for h, radius in ball]
    neck = [(ball[-1][0] + 0.001, 0.009), (high, 0.009)]
    return turned([*ball, *neck], 12) + CASTER_PIN.tongue(joint_frame(top * Z, -Z, X))


def _bar(
    start: Float[np.ndarray, "3"],
    bend: Float[np.ndarray, "3"],
    mouth: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
) -> Solid:
    """A flat bar backward from the plate and up to the back, with tongues at both ends."""
    corner = mouth - ((mouth - bend)[2] / along[2]) * along
    stations = [(start + CLEARANCE * Y, Y)]
    begin, finish = corner - 0.07 * Y, corner + 0.07 * along
    for t in np.linspace(0, 1, 6):
        at = (1 - t) ** 2 * begin + 2 * t * (1 - t) * corner + t**2 * finish
        tangent = 2 * (1 - t) * (corner - begin) + 2 * t * (finish - corner)
        stations.append((at, tangent / np.linalg.norm(tangent)))
    stations.append((mouth - CLEARANCE * along, along))
    outline = rectangle(0.060, 0.016, 0.004)
    rings = [at + outline[:, :1] * X + outline[:, 1:] * np.cross(tangent, X) for at, tangent in stations]
    body = loft(np.array(rings))
    body += BAR_TENON.tongue(joint_frame(start, Y, X))
    return body + BACK_TENON.tongue(joint_frame(mouth, -along, X))


def _back(
    s: PedestalStyle, mouth: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], across: Float[np.ndarray, "3"]
) -> Solid:
    """An upholstered back, gently bent around the sitter, with a socket in its lower edge."""
    half = s.back_width / 2
    x = half * np.array([-1, -0.97, -0.85, -0.5, 0, 0.5, 0.85, 0.97, 1])
    high = s.back_height * np.array([0.62, 0.78, 0.93, 1, 1, 1, 0.93, 0.78, 0.62])
    thick = np.array([0.022, 0.032, 0.042, 0.046, 0.048, 0.046, 0.042, 0.032, 0.022])
    middle = mouth + s.back_height / 2 * along
    path = middle + x[:, None] * X + (0.035 * (x / half) ** 2)[:, None] * across
    body = sweep(path, along, across, [rectangle(h, t, 0.3 * t) for h, t in zip(high, thick, strict=True)])
    return body - BACK_TENON.pocket(joint_frame(mouth, -along, X))


def _bracket(s: PedestalStyle, z: float, tenon: Tenon) -> tuple[Solid, Float[np.ndarray, "3"], Tenon]:
    """A bracket out of the seat's side at x = 0 and up, mirror-symmetric in y; its pin's mouth, and its pin."""
    out, rise = 0.034, s.seat_height + 0.175
    path = np.array(
        [
            vector(CLEARANCE, 0, z),
            vector(out - 0.012, 0, z),
            vector(out + 0.008, 0, z + 0.014),
            vector(out + 0.014, 0, z + 0.05),
            vector(out + 0.008, 0, rise - CLEARANCE),
        ]
    )
    tangents = [X, X, np.array([0.7, 0, 0.7]), Z, Z]
    outline = rectangle(0.050, 0.018, 0.004)
    rings = [at + outline[:, :1] * Y + outline[:, 1:] * np.cross(t, Y) for at, t in zip(path, tangents, strict=True)]
    body = loft(np.array(rings)) + tenon.tongue(joint_frame(vector(0, 0, z), X, Y))
    mouth, pin = vector(path[-1][0], 0, rise), Tenon(0.030, 0.008, 0.011)
    return body + pin.tongue(joint_frame(mouth, -Z, Y)), mouth, pin


def _arm_pad(mouth: Float[np.ndarray, "3"], pin: Tenon) -> Solid:
    """The left arm pad on its bracket: flared outward in front."""
    y = np.array([-0.125, -0.118, -0.09, 0.0, 0.09, 0.108, 0.113])
    x = mouth[0] + np.array([0.016, 0.015, 0.012, 0.0, -0.006, -0.007, -0.007])
    w = np.array([0.040, 0.058, 0.070, 0.062, 0.052, 0.042, 0.030])
    h = np.array([0.012, 0.022, 0.026, 0.026, 0.026, 0.022, 0.014])
    path = np.column_stack([x, y, mouth[2] + 0.013 + 0 * y])
    return sweep(path, X, Z, [rectangle(a, b, 0.004) for a, b in zip(w, h, strict=True)]) - pin.pocket(
        joint_frame(mouth, -Z, Y)
    )
