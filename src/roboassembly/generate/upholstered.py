"""The upholstered chair: a thick seat, a thick back on it, a base below, and blocks for armrests at the sides.

The back comes down on the seat's pegs, armrests take the tongues of seat and back along x. So seat and back are
joined before the second armrest is on: once both are at the seat, or both at the back, the other is shut out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
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
    turned,
    vector,
)
from roboassembly.geometry.poses import SE3

TURNED_LEGS, SQUARE_LEGS, RUNNERS, PLINTH = range(4)


@dataclass(frozen=True)
class UpholsteredStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.52
    """Of the seat."""
    depth: float = 0.56
    seat_height: float = 0.43
    seat_thickness: float = 0.17
    crown: float = 0.016
    height: float = 0.80
    back_thickness: float = 0.12
    rake: float = 0.20
    arms: bool = True
    arm_width: float = 0.105
    arm_rise: float = 0.19
    """Of the armrest's top above the seat."""
    base: int = SQUARE_LEGS


def sample(rng: np.random.Generator) -> UpholsteredStyle:
    """A style of 3 to 8 parts."""
    arms = bool(rng.random() < 0.6)
    seat_thickness = rng.uniform(0.14, 0.22) if arms else rng.uniform(0.09, 0.15)
    return UpholsteredStyle(
        width=rng.uniform(0.50, 0.58) if arms else rng.uniform(0.45, 0.56),
        depth=rng.uniform(0.54, 0.64) if arms else rng.uniform(0.46, 0.56),
        seat_height=rng.uniform(0.41, 0.46),
        seat_thickness=seat_thickness,
        crown=rng.uniform(0.008, 0.022),
        height=rng.uniform(0.76, 0.98),
        back_thickness=rng.uniform(0.10, 0.15) if arms else rng.uniform(0.075, 0.11),
        rake=rng.uniform(0.12, 0.26),
        arms=arms,
        arm_width=rng.uniform(0.075, 0.14),
        arm_rise=rng.uniform(0.17, 0.23),
        base=int(rng.choice([TURNED_LEGS, TURNED_LEGS, SQUARE_LEGS, SQUARE_LEGS, RUNNERS, PLINTH])),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """An upholstered chair of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble(UpholsteredStyle() if rng is None else sample(rng))


BACK_PEG = RoundTenon(radius=0.011, length=0.032, sides=12)
LEG_PEG = RoundTenon(radius=0.011, length=0.026, sides=12)
SEAT_TONGUE = Tenon(0.20, 0.036, 0.022)
BACK_TONGUE = Tenon(0.070, 0.030, 0.022)


def assemble(style: UpholsteredStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    under, half = s.seat_height - s.seat_thickness, s.width / 2
    edge = min(0.03, 0.22 * s.seat_thickness)
    outline = rounded_trapezoid(2 * (half - c), 2 * (half - c), s.depth, 0.03)
    seat = pad(outline, under, s.seat_height, edge, s.crown, under=0.4 * edge)

    # The back leans, its lower and upper faces are level. It covers the eased edge at the seat's rear.
    deep = s.back_thickness / np.cos(s.rake)
    rear = s.depth / 2 - edge - 0.004 - deep / 2
    seat -= block((-half, rear - deep / 2 - 0.012, s.seat_height), (half, s.depth, s.seat_height + 0.1))
    back = _back(s, rear, deep)
    for x in (-0.5 * half, 0.5 * half):
        peg = joint_frame(vector(x, rear, s.seat_height), Z, X)
        back += BACK_PEG.tongue(peg)
        seat -= BACK_PEG.pocket(peg)
    pieces: list[Piece] = []
    foot_x, foot_y = half - 0.055, s.depth / 2 - 0.06
    stands_on = [seat]
    if s.arms:
        arm_outline = rounded_trapezoid(s.arm_width, s.arm_width, s.depth + 0.01, 0.018)
        arm_top = s.seat_height + s.arm_rise
        arm = pad(arm_outline, under, arm_top, min(0.03, 0.4 * s.arm_width), under=0.008)
        arm = arm.translate((half + s.arm_width / 2, 0.0, 0.0))
        height = s.seat_height + 0.5 * s.arm_rise
        for frame, tongue in (
            (joint_frame(vector(half, -0.05, under + 0.5 * s.seat_thickness), -X, Y), SEAT_TONGUE),
            (joint_frame(vector(half, rear + 0.5 * s.arm_rise * np.tan(s.rake), height), -X, Z), BACK_TONGUE),
        ):
            arm -= tongue.pocket(frame)
            added = tongue.tongue(frame)
            if tongue is SEAT_TONGUE:
                seat += added + mirrored_x(added)
            else:
                back += added + mirrored_x(added)
        stands_on = [arm]
        foot_x = half + s.arm_width / 2
    pieces += _base(s, under, foot_x, foot_y, stands_on)
    if s.arms:
        arm = stands_on[0]
        pieces += [Piece("arm_left", "arm_sofa_style", arm), Piece("arm_right", "arm_sofa_style", mirrored_x(arm))]
    else:
        seat = stands_on[0]
    pieces += [Piece("back", "back_soft_surface", back), Piece("seat", "seat_soft_surface", seat)]
    return pieces


def _back(s: UpholsteredStyle, rear: float, deep: float) -> Solid:
    """The back, `deep` from front to rear where it stands on the seat at y = `rear`."""
    half, rise = s.width / 2 - CLEARANCE, s.height - s.seat_height - CLEARANCE
    x = half * np.array([-1, -0.96, -0.85, 0, 0.85, 0.96, 1])
    high = rise * np.array([0.93, 0.97, 1, 1, 1, 0.97, 0.93])
    thick = deep * np.array([0.82, 0.93, 1, 1, 1, 0.93, 0.82])
    up = vector(0, np.tan(s.rake), 1)
    path = vector(0, rear, s.seat_height + CLEARANCE) + x[:, None] * X + (high / 2)[:, None] * up
    return sweep(path, up, Y, [rectangle(h, t, 0.18 * deep) for h, t in zip(high, thick, strict=True)])


def _base(s: UpholsteredStyle, under: float, x: float, y: float, stands_on: list[Solid]) -> list[Piece]:
    """What carries the seat (or the left armrest), its pockets cut from the solid in `stands_on`."""
    c = CLEARANCE
    corners = (("front_left", x, -y), ("front_right", -x, -y), ("back_left", x, y), ("back_right", -x, y))

    def cut(pocket: Solid) -> None:
        stands_on[0] -= pocket

    if s.base in (TURNED_LEGS, SQUARE_LEGS):
        if s.base == TURNED_LEGS:
            foot = [(0.0, 0.011), (0.004, 0.013), (0.8 * under, 0.023), (under - 0.012, 0.025), (under - c, 0.022)]
            leg = turned(foot, 16)
        else:
            path = [vector(0, 0, z) for z in (0.0, 0.004, under - c)]
            leg = sweep(path, X, Y, [rectangle(a, a, 0.004) for a in (0.028, 0.031, 0.050)])
        leg += LEG_PEG.tongue(joint_frame(under * Z, -Z, X))
        for _, px, py in corners:
            if not s.arms or px > 0:
                cut(LEG_PEG.pocket(joint_frame(vector(px, py, under), -Z, X)))
        return [Piece(f"leg_{name}", "leg", leg, move(px, py)) for name, px, py in corners]
    if s.base == RUNNERS or s.arms:
        profile = np.array([-y - 0.03, -y - 0.02, y + 0.02, y + 0.03])
        path = [vector(0, at, (under - c) / 2) for at in profile]
        runner = sweep(path, X, Z, [rectangle(0.045, k * (under - c), 0.004) for k in (0.9, 1, 1, 0.9)])
        for at in (-0.6 * y, 0.6 * y):
            runner += LEG_PEG.tongue(joint_frame(vector(0, at, under), -Z, X))
            for px in (x,) if s.arms else (-x, x):
                cut(LEG_PEG.pocket(joint_frame(vector(px, at, under), -Z, X)))
        return [
            Piece("runner_left", "runner", runner, move(x)),
            Piece("runner_right", "runner", runner, move(-x) * SE3(turn(Z, np.pi), np.zeros(3))),
        ]
    plinth = pad(rounded_trapezoid(2 * x + 0.04, 2 * x + 0.04, 2 * y + 0.04, 0.03), 0.0, under - c, 0.006)
    for px in (-0.6 * x, 0.6 * x):
        peg = joint_frame(vector(px, 0, under), -Z, X)
        plinth += LEG_PEG.tongue(peg)
        cut(LEG_PEG.pocket(peg))
    return [Piece("plinth", "foot_base", plinth)]
