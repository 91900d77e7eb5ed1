"""Chairs made of two side frames on runners, flat (sled) or curved (rocker), with everything else between them.

In a side frame the seat rail and the armrest run along y between leg and post, and the armrest sits on the leg and
the runner under both along z. So leg, seat rail and armrest come together first, then the post along y, then the
runner from below; a runner that already joins leg and post shuts the armrest out. The rest runs along x between the
two frames, and the spindles of a back have to be between its two rails before a post is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail
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
    vector,
)
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class SideFrameStyle:
    """Sizes in metres, angles in radians; the defaults are the sled's catalogue model."""

    width: float = 0.50
    """Over the outer faces of the legs."""
    depth: float = 0.46
    """Over the outer faces of leg and post."""
    seat_height: float = 0.44
    height: float = 0.84
    post: float = 0.036
    rake: float = 0.22
    arms: bool = True
    seat_thickness: float = 0.055
    crown: float = 0.014
    rail: float = 0.050
    slats: int = 2
    """Horizontal slats in the back under the crest; with spindles, 1: the rail they stand on."""
    spindles: int = 0
    crest: float = 0.07
    bow: float = 0.0
    """Radius of curvature of the runners; zero for flat ones."""


def sample_sled(rng: np.random.Generator) -> SideFrameStyle:
    """A sled of 12 to 17 parts."""
    width = rng.uniform(0.47, 0.53)
    return SideFrameStyle(
        width=width,
        depth=width - rng.uniform(0.015, 0.06),  # rails across and along differ by more than a hair
        seat_height=rng.uniform(0.41, 0.46),
        height=rng.uniform(0.78, 0.90),
        post=rng.uniform(0.034, 0.041),
        rake=rng.uniform(0.15, 0.28),
        arms=bool(rng.random() < 0.65),
        seat_thickness=rng.uniform(0.03, 0.07),
        crown=rng.uniform(0.0, 0.02),
        rail=rng.uniform(0.045, 0.06),
        slats=int(rng.integers(0, 4)),
        crest=rng.uniform(0.06, 0.12),
    )


def sample_rocker(rng: np.random.Generator) -> SideFrameStyle:
    """A rocker of 16 to 20 parts."""
    arms = bool(rng.random() < 0.7)
    width = rng.uniform(0.49, 0.54)
    return SideFrameStyle(
        width=width,
        depth=width - rng.uniform(0.015, 0.06),
        seat_height=rng.uniform(0.41, 0.45),
        height=rng.uniform(0.92, 1.08),
        post=rng.uniform(0.034, 0.040),
        rake=rng.uniform(0.20, 0.30),
        arms=arms,
        seat_thickness=rng.uniform(0.025, 0.05),
        crown=rng.uniform(0.0, 0.02),
        rail=rng.uniform(0.045, 0.06),
        slats=1,
        spindles=int(rng.integers(3, 6)),
        crest=rng.uniform(0.07, 0.11),
        bow=rng.uniform(0.95, 1.25),
    )


ROCKER = SideFrameStyle(
    width=0.52, depth=0.47, seat_height=0.43, height=1.02, rake=0.25, seat_thickness=0.04, slats=1, spindles=5,
    crest=0.09, bow=1.1,
)  # fmt: skip


def build_sled(rng: np.random.Generator | None) -> list[Piece]:
    """A sled of the style drawn from `rng`, or the catalogue model with 16 parts."""
    return assemble(SideFrameStyle() if rng is None else sample_sled(rng))


def build_rocker(rng: np.random.Generator | None) -> list[Piece]:
    """A rocker of the style drawn from `rng`, or the catalogue model with 20 parts."""
    return assemble(ROCKER if rng is None else sample_rocker(rng))


RUNNER = 0.032
"""Height of a runner."""
ARM = 0.024
SPINDLE_TENON = Tenon(0.015, 0.007, 0.014)


def assemble(style: SideFrameStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c, t = style, CLEARANCE, style.post
    half = t / 2
    x0 = -(s.width / 2 - half)
    front, back = -s.depth / 2 + half, s.depth / 2 - half
    floor = RUNNER + (s.bow - np.sqrt(s.bow**2 - back**2) if s.bow else 0.0)
    """Height of a runner's top at leg and post (under their middles, which are equally far from its lowest point)."""
    rail_z = s.seat_height - s.seat_thickness - c - s.rail / 2
    arm_top = s.seat_height + 0.205
    leg_top = arm_top - ARM if s.arms else rail_z + s.rail / 2
    depth_in, outward = 0.30 * t, 0.12 * t
    rail_tenon, foot_tenon = Tenon(0.6 * s.rail, 0.008, depth_in), Tenon(0.5 * t, 0.5 * t, 0.018)
    arm_tenon = Tenon(0.014, 0.008, 0.30 * t, root=0.02)  # upright, and off the middle: clear of a slat's tenon
    pieces: list[Piece] = []
    leg_cuts: list[Solid] = []
    post_cuts: list[Solid] = []

    # Along y, on the right: seat rail (and armrest). The left ones are moved over.
    side_x = x0 - outward
    # Under a rocker's seat the side rails are lower than the cross rails: its left and right legs differ anyway
    # (their feet are slanted), and should do so by more than a hair.
    side_z = rail_z - (0.012 if s.bow else 0.0)
    ends = vector(side_x, front + half, side_z), vector(side_x, back - half, side_z)
    side_rail = rail(*ends, Z, s.rail, 0.018, rail_tenon)
    over = -2 * side_x
    pieces.append(Piece("seat_rail_right", "seat_frame_bar", side_rail))
    pieces.append(Piece("seat_rail_left", "seat_frame_bar", side_rail, move(over)))
    for frame, cuts in zip(mouths(*ends, Z), (leg_cuts, post_cuts), strict=True):
        cuts.append(rail_tenon.pocket(frame))

    # The post's course: upright to the knee, then leaning.
    along, across = vector(0, np.sin(s.rake), np.cos(s.rake)), vector(0, -np.cos(s.rake), np.sin(s.rake))
    knee = s.seat_height - 0.01
    reach = (s.height - knee) / np.cos(s.rake)
    base = vector(0, back, knee)

    # Along x, between the frames.
    inner = x0 + half
    cross = [("front", front - outward, leg_cuts), ("back", back + outward, post_cuts)]
    cross_rail = rail(
        vector(inner, cross[0][1], rail_z), vector(-inner, cross[0][1], rail_z), Z, s.rail, 0.018, rail_tenon
    )
    for name, y, cuts in cross:
        pieces.append(Piece(f"cross_rail_{name}", "seat_frame_bar", cross_rail, move(y=y - cross[0][1])))
        cuts.append(rail_tenon.pocket(joint_frame(vector(inner, y, rail_z), X, Z)))
    for piece, cut in _back(s, base, along, across, reach, inner):
        pieces.append(piece)
        if cut is not None:
            post_cuts.append(cut)

    # Uprights.
    overlap = 0.02 if s.bow else -c
    leg_path = [vector(x0, front, floor - overlap), vector(x0, front, leg_top - c)]
    leg = sweep(leg_path, X, Y, rectangle(t, t, 0.004))
    stations = [(vector(x0, back, floor - overlap), t), (vector(x0, back, knee - 0.03), t)]
    stations += [(base + x0 * X + 0.03 * along, 0.95 * t), (base + x0 * X + (reach - 0.006) * along, 0.70 * t)]
    stations += [(base + x0 * X + reach * along, 0.52 * t)]
    post = sweep([at for at, _ in stations], X, Y, [rectangle(t, d, 0.004) for _, d in stations])
    runner, groove = _runner(s, x0, front, back, floor)
    if s.bow:
        leg, post = leg - groove, post - groove
    for y in (front, back):
        foot = joint_frame(vector(x0, y, floor), Z, X)
        runner -= foot_tenon.pocket(foot, over=0.012)
        if y == front:
            leg += foot_tenon.tongue(foot)
        else:
            post += foot_tenon.tongue(foot)
    pieces.append(Piece("runner_right", "runner", runner))
    pieces.append(Piece("runner_left", "runner", runner, move(-2 * x0)))

    if s.arms:
        seat_mouth = joint_frame(vector(x0, front, leg_top), -Z, X)
        top_tenon = Tenon(0.5 * t, 0.5 * t, 0.013)
        leg += top_tenon.tongue(seat_mouth)
        level = arm_top - ARM / 2
        mouth = vector(x0 - 0.2 * t, _front_of_post(stations, level), level)
        arm = _arm(s, mouth, front, x0, across) + arm_tenon.tongue(joint_frame(mouth, -Y, Z))
        arm -= top_tenon.pocket(seat_mouth)
        post_cuts.append(arm_tenon.pocket(joint_frame(mouth, -Y, Z), over=0.015))
        pieces.append(Piece("armrest_right", "arm_horizontal_bar", arm))
        pieces.append(Piece("armrest_left", "arm_horizontal_bar", mirrored_x(arm)))
    for cut in leg_cuts:
        leg -= cut
    for cut in post_cuts:
        post -= cut
    pieces.append(Piece("leg_front_right", "leg", leg))
    if s.bow:
        pieces.append(Piece("leg_front_left", "leg", mirrored_x(leg)))
    else:
        # Everything about this leg is symmetric about its diagonal: a quarter turn makes the left one of the right.
        quarter = SE3(turn(Z, np.pi / 2), np.zeros(3))
        pieces.append(Piece("leg_front_left", "leg", leg, move(-x0, front) * quarter * move(-x0, -front)))
    pieces.append(Piece("post_right", "back_frame_vertical_bar", post))
    pieces.append(Piece("post_left", "back_frame_vertical_bar", mirrored_x(post)))
    pieces.append(Piece("seat", "seat_single_surface", _seat(s, front, back, inner)))
    return pieces


def _front_of_post(stations: list[tuple[Float[np.ndarray, "3"], float]], z: float) -> float:
    """y of the post's front face at the height z."""
    heights = [at[2] for at, _ in stations]
    return float(np.interp(z, heights, [at[1] - depth / 2 for at, depth in stations]))


def _back(
    s: SideFrameStyle,
    base: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    across: Float[np.ndarray, "3"],
    reach: float,
    inner: float,
) -> list[tuple[Piece, Solid | None]]:
    """Crest, slats and spindles; with each piece that goes into the posts, the mortise in the right-hand one."""
    tenon_depth = 0.30 * s.post
    crest_up, low_up = reach - 0.006 - s.crest / 2, 0.14
    slat_height = 0.042
    count = 1 if s.spindles else s.slats
    top = crest_up - s.crest / 2
    if s.spindles or count == 0:
        ups = [low_up] * count
    else:
        # A low back has no room for three slats.
        room = top - low_up + slat_height / 2
        count = min(count, int(room / (slat_height + 0.004)))
        gap = (room - count * slat_height) / count
        ups = [low_up + k * (slat_height + gap) for k in range(count)]
    out: list[tuple[Piece, Solid | None]] = []
    crest_tenon, slat_tenon = Tenon(0.6 * s.crest, 0.009, tenon_depth), Tenon(0.65 * slat_height, 0.009, tenon_depth)

    def bar(up: float, height: float, tenon: Tenon, arch: float) -> Solid:
        x = np.linspace(inner + CLEARANCE, -inner - CLEARANCE, 7)
        hump = 1 - (x / inner) ** 2
        path = base + up * along + x[:, None] * X + (0.5 * arch * hump)[:, None] * along
        body = sweep(path, along, across, [rectangle(height + arch * h, 0.018, 0.003) for h in hump])
        for frame in mouths(base + up * along + inner * X, base + up * along - inner * X, along):
            body += tenon.tongue(frame)
        return body

    def mortise(up: float, tenon: Tenon) -> Solid:
        return tenon.pocket(joint_frame(base + up * along + inner * X, X, along))

    crest = bar(crest_up, s.crest, crest_tenon, 0.018)
    lower = bar(ups[0], slat_height, slat_tenon, 0.0) if ups else None
    if s.spindles and lower is not None:
        low, high = base + (ups[0] + slat_height / 2) * along, base + top * along
        xs = np.linspace(-1, 1, s.spindles) * (-inner - 0.075)
        stick = rail(low, high, X, 0.026, 0.011, SPINDLE_TENON, 0.002)
        for k, x in enumerate(xs):
            for frame, which in zip(mouths(low + x * X, high + x * X, X), ("lower", "crest"), strict=True):
                if which == "lower":
                    lower -= SPINDLE_TENON.pocket(frame)
                else:
                    crest -= SPINDLE_TENON.pocket(frame)
            out.append((Piece(f"spindle_{k + 1}", "back_surface_vertical_bar", stick, move(x)), None))
    for k, up in enumerate(ups):
        name = "back_rail_lower" if s.spindles else f"slat_{k + 1}"
        piece = Piece(name, "back_surface_horizontal_bar", lower or crest, move(*((up - ups[0]) * along)))
        out.append((piece, mortise(up, slat_tenon)))
    out.append((Piece("crest_rail", "back_frame_horizontal_bar", crest), mortise(crest_up, crest_tenon)))
    return out


def _runner(s: SideFrameStyle, x: float, front: float, back: float, floor: float) -> tuple[Solid, Solid]:
    """The right-hand runner, and the same grown by the clearance, to fit uprights to its curved top."""
    t = s.post
    if not s.bow:
        y = np.array([front - 0.075, front - 0.06, back + 0.09, back + 0.105])
        low, high = np.array([0.014, 0.0, 0.0, 0.014]), np.full(4, RUNNER)
        rings = []
        for a, b, d in zip(low, high, y, strict=True):
            rings.append(vector(x, d, (a + b) / 2) + _upright(rectangle(t, b - a, 0.004)))
        return loft(np.array(rings)), Solid()
    angle = np.linspace((front - 0.13) / s.bow, (back + 0.22) / s.bow, 13)
    solids = []
    for grow in (0.0, CLEARANCE):
        rings = []
        for a in angle:
            radial = vector(0, np.sin(a), -np.cos(a))
            at = vector(x, 0, s.bow) + (s.bow - RUNNER / 2) * radial
            outline = rectangle(t + 20 * grow, RUNNER + 2 * grow, 0.0 if grow else 0.004)
            rings.append(at + outline[:, :1] * X - outline[:, 1:] * radial)
        solids.append(loft(np.array(rings)))
    return solids[0], solids[1] + sweep(
        [vector(x, front - 0.1, floor - 0.05), vector(x, back + 0.1, floor - 0.05)], X, Z, rectangle(t + 0.02, 0.05)
    )


def _upright(outline: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """An outline in the x-z plane."""
    return outline[:, :1] * X + outline[:, 1:] * Z


def _arm(
    s: SideFrameStyle, mouth: Float[np.ndarray, "3"], front: float, leg_x: float, across: Float[np.ndarray, "3"]
) -> Solid:
    """The right armrest, from in front of the leg to the leaning face of the post, flared outward in the middle."""
    t = s.post
    y = np.array([front - 0.06, front - 0.053, front - 0.02, front + 0.06, 0.5 * (front + mouth[1]), mouth[1] + 0.03])
    x = leg_x - np.array([0.006, 0.006, 0.008, 0.008, 0.006, leg_x - mouth[0]])
    w = t * np.array([1.1, 1.4, 1.7, 1.6, 1.25, 0.9])
    h = ARM * np.array([0.6, 0.9, 1, 1, 1, 1])
    path = np.column_stack([x, y, np.full(6, mouth[2])])
    arm = sweep(path, X, Z, [rectangle(a, b, 0.004) for a, b in zip(w, h, strict=True)])
    # The post grows slimmer on its way up, so that its front face leans a little more than `across` says.
    face = mouth + CLEARANCE * across
    return arm.trim_by_plane(across, float(face @ across))


def _seat(s: SideFrameStyle, front: float, back: float, inner: float) -> Solid:
    """A cushion or board between the frames, on the rails."""
    under = s.seat_height - s.seat_thickness
    start = front - s.post / 2 - 0.012
    rear = back - s.post / 2 - 0.010
    # Without armrests nothing stands in the way of a seat as wide as the frame.
    side = -inner - 0.010 if s.arms else s.width / 2 + 0.006
    edge = min(0.014, 0.35 * s.seat_thickness)
    outline = rounded_trapezoid(2 * side, 2 * side, rear - start, 0.02) + np.array([0.0, (start + rear) / 2])
    return pad(outline, under, s.seat_height, edge, s.crown, under=0.5 * edge)
