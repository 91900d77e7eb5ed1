"""The three-legged chair: a round seat on three legs a third of a turn apart, with or without a back.

Either splayed legs go into the seat one by one, or a three-armed stretcher holds bent legs together: it meets every
leg along a radius and the seat meets them from above, so the seat comes last of all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roboassembly.generate.bends import splayed_leg
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.solids import (
    Solid,
    X,
    Y,
    Z,
    circle,
    pad,
    placed,
    rectangle,
    sweep,
    turn,
    turned,
    vector,
)
from roboassembly.geometry.poses import SE3

NO_BACK, HOOP, POSTS = range(3)


@dataclass(frozen=True)
class ThreeLeggedStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    seat: float = 0.40
    """Diameter of the seat."""
    seat_height: float = 0.45
    thickness: float = 0.042
    saddle: float = 0.008
    height: float = 0.80
    rake: float = 0.20
    star: bool = True
    """A three-armed stretcher between bent legs, instead of straight splayed ones."""
    star_height: float = 0.20
    leg: float = 0.034
    splay: float = 0.20
    back: int = POSTS
    posts: int = 2


def sample(rng: np.random.Generator) -> ThreeLeggedStyle:
    """A style of 4 to 9 parts."""
    back = int(rng.choice([NO_BACK, HOOP, HOOP, POSTS, POSTS]))
    return ThreeLeggedStyle(
        seat=rng.uniform(0.36, 0.43),
        seat_height=rng.uniform(0.43, 0.49),
        thickness=rng.uniform(0.038, 0.050),
        saddle=float(rng.choice([0.008, 0.005, -0.014])),
        height=rng.uniform(0.70, 0.86),
        rake=rng.uniform(0.14, 0.24),
        star=bool(rng.random() < 0.65),
        star_height=rng.uniform(0.15, 0.26),
        leg=rng.uniform(0.031, 0.040),
        splay=rng.uniform(0.16, 0.26),
        back=back,
        posts=int(rng.integers(2, 4)),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A three-legged chair of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble(ThreeLeggedStyle() if rng is None else sample(rng))


MOUTH = 0.012
LEG_PEG = RoundTenon(radius=0.0125, length=0.022, end_radius=0.0115, sides=12)
STAR_TENON = Tenon(0.020, 0.012, 0.012)
POST_FOOT = RoundTenon(radius=0.0085, length=0.020, sides=8)
POST_TIP = RoundTenon(radius=0.0075, length=0.022, sides=8)
HOOP_TENON = Tenon(0.030, 0.011, 0.018)


def assemble(style: ThreeLeggedStyle) -> list[Piece]:
    """All pieces of one style."""
    s = style
    under = s.seat_height - s.thickness
    seat = pad(circle(s.seat / 2, 30), under, s.seat_height, 0.008, crown=-s.saddle, under=0.008)
    pieces: list[Piece] = []
    # One leg points forward, two backward.
    spins = [SE3(turn(Z, 2 * np.pi * k / 3 - np.pi / 2), np.zeros(3)) for k in range(3)]
    if s.star:
        reach = 0.36 * s.seat
        leg, mouth = _bent_leg(s, under, reach)
        star = turned([(-0.014, 0.028), (-0.010, 0.032), (0.010, 0.032), (0.014, 0.028)], 18)
        arm_path = [vector(0, 0, 0), vector(mouth - CLEARANCE, 0, 0)]
        arm = sweep(arm_path, Y, Z, [rectangle(0.024, 0.022, 0.003), rectangle(0.021, 0.022, 0.003)])
        arm += STAR_TENON.tongue(joint_frame(vector(mouth, 0, 0), -X, Y))
        for spin in spins:
            star += placed(arm, spin)
            seat -= placed(LEG_PEG.pocket(joint_frame(vector(reach, 0, under), -Z, X)), spin)
        poses = spins
        pieces.append(Piece("stretcher", "bar_stretcher", star, move(z=s.star_height)))
    else:
        radius = 0.5 * s.leg
        profile = [(0.2, 0.9 * radius), (0.42, 1.15 * radius), (0.60, radius), (1.05, 0.68 * radius)]
        leg, axis = splayed_leg(under, s.splay, LEG_PEG, profile, MOUTH)
        poses = [spin * move(0.28 * s.seat) for spin in spins]
        for pose in poses:
            frame = joint_frame(pose.act(under * Z), -(pose.rotation @ axis), pose.rotation @ Y)
            seat -= LEG_PEG.pocket(frame, over=MOUTH)
    names = ("front", "back_left", "back_right")
    pieces += [Piece(f"leg_{name}", "leg", leg, pose) for name, pose in zip(names, poses, strict=True)]
    if s.back == HOOP:
        pieces.append(Piece("back", "back_single_surface", _hoop(s)))
        for frame in _hoop_mouths(s):
            seat -= HOOP_TENON.pocket(frame, over=MOUTH)
    elif s.back == POSTS:
        seat = _posts(s, seat, pieces)
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _bent_leg(s: ThreeLeggedStyle, under: float, reach: float) -> tuple[Solid, float]:
    """A leg at distance `reach` along +x, upright from the stretcher up, its foot outward; x of its inner face."""
    top = under - CLEARANCE
    z = np.array([0.0, 0.004, 0.05, s.star_height - 0.06, s.star_height - 0.03, top - 0.03, top])
    out = np.array([0.062, 0.060, 0.040, 0.010, 0.0, 0.0, 0.0])
    wide = s.leg * np.array([0.60, 0.66, 0.70, 0.92, 1.0, 1.0, 0.92])
    path = np.column_stack([reach + out, 0 * z, z])
    leg = sweep(path, X, Y, [rectangle(w, 0.8 * w, 0.005) for w in wide])
    leg += LEG_PEG.tongue(joint_frame(vector(reach, 0, under), -Z, X))
    mouth = reach - s.leg / 2
    return leg - STAR_TENON.pocket(joint_frame(vector(mouth, 0, s.star_height), -X, Y)), mouth


def _lean(s: ThreeLeggedStyle) -> tuple[np.ndarray, float, float]:
    """Direction of the back, y of its foot on the seat, and its length along the direction."""
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    return along, 0.5 * s.seat - 0.062, (s.height - s.seat_height) / along[2]


def _hoop_mouths(s: ThreeLeggedStyle) -> list[SE3]:
    _, y, _ = _lean(s)
    return [joint_frame(vector(x, y, s.seat_height - 0.001), Z, X) for x in (-0.055, 0.055)]


def _hoop(s: ThreeLeggedStyle) -> Solid:
    """A back in one piece: a board that widens on its way up, bent around the sitter, with two tongues below."""
    along, y, reach = _lean(s)
    at = vector(0, y, s.seat_height)
    share = np.array([0.0, 0.3, 0.55, 0.75, 0.9, 0.97, 1.0])
    width = s.seat * np.array([0.44, 0.46, 0.58, 0.74, 0.77, 0.70, 0.54])
    # A gap below, so that a leaning board stays clear of the seat but for its tongues.
    path = at + (0.012 + share[:, None] * (reach - 0.012)) * along + (0.035 * share**2)[:, None] * Y
    body = sweep(path, X, Y, [rectangle(w, 0.019, 0.004) for w in width])
    root = Tenon(HOOP_TENON.width, HOOP_TENON.thickness, HOOP_TENON.length, root=0.03)
    for frame in _hoop_mouths(s):
        body += root.tongue(frame)
    return body


def _posts(s: ThreeLeggedStyle, seat: Solid, pieces: list[Piece]) -> Solid:
    """Turned posts and a bent crest on them; the seat with their holes."""
    along, y, reach = _lean(s)
    crest = 0.072
    span = 0.27 * s.seat
    length = reach - crest
    stations = [(-POST_FOOT.length, POST_FOOT.radius), (MOUTH, POST_FOOT.radius), (0.4 * length, 0.0135)]
    stations += [(length - MOUTH, POST_TIP.radius), (length + POST_TIP.length, POST_TIP.radius)]
    path = np.array([d * along for d, _ in stations])
    post = sweep(path, X, np.cross(along, X), [circle(r, 8) for _, r in stations])
    bow = 0.05
    end = span + 0.055
    x = end * np.array([-1, -0.95, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 0.95, 1])
    size = crest * np.interp(np.abs(x) / end, [0, 0.75, 0.95, 1], [1.1, 1.0, 0.85, 0.6])

    def row(at: np.ndarray) -> np.ndarray:
        return y - bow * ((at / span) ** 2 - 1) * 0.5

    base = np.column_stack([x, row(x), np.full(len(x), s.seat_height)]) + length * along
    thick = np.interp(np.abs(x) / end, [0, 0.95, 1], [0.027, 0.027, 0.017])
    rail = sweep(
        base + (size / 2)[:, None] * along,
        along,
        Y,
        [rectangle(h, t, 0.004) for h, t in zip(size, thick, strict=True)],
    )
    for k, at in enumerate(np.linspace(-span, span, s.posts)):
        foot = vector(at, float(row(np.array(at))), s.seat_height - 0.001)
        pieces.append(Piece(f"post_{k + 1}", "back_surface_vertical_bar", post, move(*foot)))
        seat -= POST_FOOT.pocket(joint_frame(foot, along, X), over=MOUTH)
        rail -= POST_TIP.pocket(joint_frame(foot + length * along, -along, X), over=MOUTH)
    pieces.append(Piece("crest_rail", "back_frame_horizontal_bar", rail))
    return seat
