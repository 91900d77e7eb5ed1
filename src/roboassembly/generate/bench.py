"""Two-seaters and garden chairs: slatted seat and slatted back between two sides, each sawn from one board.

Everything but armrests lies along x between the sides, so that whatever joins both of them shuts out the rest; the
bench's upright slats must be between their two rails before a side is on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import bent, ribbon
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail
from roboassembly.generate.solids import Solid, X, Y, Z, block, mirrored_x, rectangle, sweep, unit, vector


@dataclass(frozen=True)
class SlattedStyle:
    """Sizes in metres, angles in radians; the defaults are the bench's catalogue model."""

    width: float = 1.06
    """Over the outer faces of the sides."""
    depth: float = 0.50
    seat_height: float = 0.44
    height: float = 0.84
    side: float = 0.040
    """Thickness of the sides, along x."""
    stile: float = 0.050
    """Width of their legs and posts, seen from the side."""
    rake: float = 0.26
    seat_slats: int = 4
    back_slats: int = 0
    """Along x, alike; with upright ones, none."""
    upright_slats: int = 6
    arms: bool = True
    stretcher: bool = False


def sample_bench(rng: np.random.Generator) -> SlattedStyle:
    """A bench of 10 to 17 parts."""
    width = rng.uniform(0.92, 1.20)
    upright = bool(rng.random() < 0.55)
    return SlattedStyle(
        width=width,
        depth=rng.uniform(0.46, 0.54),
        seat_height=rng.uniform(0.42, 0.46),
        height=rng.uniform(0.78, 0.92),
        side=rng.uniform(0.036, 0.046),
        stile=rng.uniform(0.044, 0.058),
        rake=rng.uniform(0.18, 0.32),
        seat_slats=int(rng.integers(3, 5)),
        back_slats=0 if upright else int(rng.integers(2, 4)),
        upright_slats=int(rng.integers(4, 8)) if upright else 0,
        arms=bool(rng.random() < 0.7),
        stretcher=bool(rng.random() < 0.4) and not upright,
    )


def sample_garden(rng: np.random.Generator) -> SlattedStyle:
    """A garden chair of 7 to 13 parts."""
    return SlattedStyle(
        width=rng.uniform(0.50, 0.62),
        depth=rng.uniform(0.46, 0.54),
        seat_height=rng.uniform(0.39, 0.44),
        height=rng.uniform(0.78, 0.98),
        side=rng.uniform(0.028, 0.038),
        stile=rng.uniform(0.040, 0.052),
        rake=rng.uniform(0.20, 0.38),
        seat_slats=int(rng.integers(3, 6)),
        back_slats=int(rng.integers(2, 4)),
        upright_slats=0,
        arms=bool(rng.random() < 0.75),
        stretcher=False,
    )


GARDEN = SlattedStyle(
    width=0.56, depth=0.50, seat_height=0.41, height=0.86, side=0.032, stile=0.046, rake=0.30, seat_slats=4,
    back_slats=3, upright_slats=0,
)  # fmt: skip


def build_bench(rng: np.random.Generator | None) -> list[Piece]:
    """A bench of the style drawn from `rng`, or the catalogue model with 16 parts."""
    return assemble(SlattedStyle() if rng is None else sample_bench(rng))


def build_garden(rng: np.random.Generator | None) -> list[Piece]:
    """A garden chair of the style drawn from `rng`, or the catalogue model with 11 parts."""
    return assemble(GARDEN if rng is None else sample_garden(rng))


SEAT_SLAT = 0.022
ARM_TENON = Tenon(0.018, 0.014, 0.013)
UPRIGHT_TENON = Tenon(0.024, 0.008, 0.014)


def assemble(style: SlattedStyle) -> list[Piece]:
    """All pieces of one style."""
    s = style
    middle, inner = s.width / 2 - s.side / 2, s.width / 2 - s.side
    depth = 0.42 * s.side
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    front, rear = -s.depth / 2, s.depth / 2
    knee = vector(0, rear - 0.10, s.seat_height + 0.01)
    reach = (s.height - knee[2]) / along[2]
    rail_z = s.seat_height - 0.5 * s.stile - 0.004
    side, leg_top = _side(s, middle, front, rear, rail_z, knee, along, reach)
    pieces: list[Piece] = []
    cuts: list[Solid] = []

    # Seat slats, alike, between the sides and flush with their seat rails.
    pitch = (knee[1] - 0.035 - (front + 0.012)) / s.seat_slats
    slat_tenon = Tenon(0.55 * pitch, 0.011, depth)
    level = s.seat_height - SEAT_SLAT / 2 - 0.003
    wide = pitch - 0.0125
    first = vector(0, front + 0.012 + pitch / 2, level)
    slat = rail(first - inner * X, first + inner * X, Y, wide, SEAT_SLAT, slat_tenon, 0.004)
    for k in range(s.seat_slats):
        at = first + k * pitch * Y
        pieces.append(Piece(f"seat_slat_{k + 1}", "seat_surface_bar", slat, move(y=k * pitch)))
        cuts.append(slat_tenon.pocket(joint_frame(at + inner * X, -X, Y)))

    # The back: slats along x, or upright ones between two rails.
    crest_height = 0.075
    top, low = reach - 0.010 - crest_height / 2, 0.085
    if s.upright_slats:
        rails = [("crest_rail", top, crest_height), ("back_rail_lower", low, 0.050)]
        solids = [_back_bar(s, knee + up * along, along, inner, height, depth) for _, up, height in rails]
        start, end = knee + (low + 0.025) * along, knee + (top - crest_height / 2) * along
        upright = rail(start, end, X, 0.052, 0.012, UPRIGHT_TENON, 0.002)
        room = 2 * inner / s.upright_slats
        for k in range(s.upright_slats):
            x = (k - (s.upright_slats - 1) / 2) * room
            pieces.append(Piece(f"back_slat_{k + 1}", "back_surface_vertical_bar", upright, move(x)))
            foot, head = mouths(start + x * X, end + x * X, X)
            solids = [solids[0] - UPRIGHT_TENON.pocket(head), solids[1] - UPRIGHT_TENON.pocket(foot)]
        bars = [(name, up, height, solid, move()) for (name, up, height), solid in zip(rails, solids, strict=True)]
    else:
        # All bars of the back are alike.
        height = min(0.085, 0.60 * (top - low) / max(1, s.back_slats - 1))
        ups = np.linspace(low + 0.03, reach - 0.010 - height / 2, s.back_slats)
        bar = _back_bar(s, knee + ups[0] * along, along, inner, height, depth)
        bars = [
            (f"back_bar_{k + 1}", float(up), height, bar, move(*((up - ups[0]) * along))) for k, up in enumerate(ups)
        ]
    for name, up, height, solid, pose in bars:
        pieces.append(Piece(name, "back_surface_horizontal_bar", solid, pose))
        cuts.append(Tenon(0.6 * height, 0.010, depth).pocket(joint_frame(knee + up * along + inner * X, -X, along)))
    if s.stretcher:
        tenon = Tenon(0.024, 0.012, depth)
        # On the middle line of the rear legs, which run straight up to their bend.
        share = 0.15 / (knee[2] - 0.045)
        at = vector(0, (1 - share) * (rear - 0.01) + share * knee[1], 0.15)
        pieces.append(Piece("stretcher", "bar_stretcher", rail(at - inner * X, at + inner * X, Z, 0.045, 0.022, tenon)))
        cuts.append(tenon.pocket(joint_frame(at + inner * X, -X, Z)))
    for cut in cuts:
        side -= cut
    if s.arms:
        pin = joint_frame(leg_top, -Z, Y)
        side += ARM_TENON.tongue(pin)
        arm = _arm(s, leg_top, knee, along) - ARM_TENON.pocket(pin)
        pieces += [Piece("armrest_left", "arm_horizontal_bar", arm)]
        pieces += [Piece("armrest_right", "arm_horizontal_bar", arm, move(-2 * leg_top[0]))]
    pieces += [Piece("side_left", "leg", side), Piece("side_right", "leg", mirrored_x(side))]
    return pieces


def _side(
    s: SlattedStyle,
    x: float,
    front: float,
    rear: float,
    rail_z: float,
    knee: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    reach: float,
) -> tuple[Solid, Float[np.ndarray, "3"]]:
    """The left side in one piece: front leg, seat rail and the rear leg that bends back; the front leg's top."""
    half = s.stile / 2
    top = s.seat_height + 0.19 if s.arms else s.seat_height - 0.003
    foot = vector(x, front + half, 0)
    leg_top = vector(x, front + half + 0.01, top)
    leg = sweep(
        [foot, foot + 0.004 * Z, vector(x, leg_top[1], rail_z), leg_top - CLEARANCE * Z],
        X,
        Y,
        [rectangle(s.side, k * s.stile, 0.003) for k in (0.78, 0.84, 1.0, 0.9)],
    )
    bar = block(
        (x - s.side / 2 + 0.0001, front + 0.02, rail_z - half), (x + s.side / 2 - 0.0001, knee[1], rail_z + half)
    )
    heel = vector(x, rear - 0.01, 0)
    bend = knee + x * X
    points, tangents = bent([heel - 0.05 * unit(bend - heel), bend - 0.045 * Z, bend + reach * along], 0.35, 4)
    points = np.concatenate([points[:-1], points[-1:] - 0.014 * along, points[-1:]])
    tangents = np.concatenate([tangents, tangents[-1:]])
    size = s.stile * np.interp(points[:, 2], [0, knee[2], s.height - 0.02, s.height], [0.9, 1.0, 0.85, 0.55])
    post = ribbon(points, tangents, X, [rectangle(s.side, w, 0.003) for w in size])
    return leg + bar + post.trim_by_plane((0.0, 0.0, 1.0), 0.0), leg_top


def _back_bar(
    s: SlattedStyle,
    at: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    inner: float,
    height: float,
    depth: float,
) -> Solid:
    """A bar of the back between the sides."""
    return rail(at - inner * X, at + inner * X, along, height, 0.022, Tenon(0.6 * height, 0.010, depth), 0.004)


def _arm(
    s: SlattedStyle, leg_top: Float[np.ndarray, "3"], knee: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"]
) -> Solid:
    """The left armrest on its front leg, to the leaning post's front edge."""
    z = leg_top[2] + 0.012
    across = np.cross(X, along)
    end = knee + (z - knee[2]) / along[2] * along + (s.stile / 2 + 0.0012) * across
    y = np.array(
        [leg_top[1] - 0.050, leg_top[1] - 0.044, leg_top[1] - 0.01, 0.5 * (leg_top[1] + end[1]), end[1] + 0.04]
    )
    wide = np.array([0.040, 0.052, 0.062, 0.054, 0.044]) * max(1.0, s.side / 0.036)
    high = np.array([0.014, 0.020, 0.024, 0.024, 0.024])
    path = np.column_stack([np.full(5, leg_top[0]), y, np.full(5, z)])
    arm = sweep(path, X, Z, [rectangle(w, h, 0.004) for w, h in zip(wide, high, strict=True)])
    return arm.trim_by_plane(across, float((end + 0.008 * across) @ across))
