"""The panel chair: a board seat on four tapered legs, and a back of boards that slide in the grooves of two posts.

The boards come from above, one after the other, and the top rail closes the grooves: boards first. An armrest
meets its post along y and its support along z, so that post, armrest and support must be one before they go down
into the seat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
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
class PanelStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.48
    """Of the seat's front edge."""
    depth: float = 0.46
    seat_height: float = 0.45
    seat_thickness: float = 0.034
    height: float = 0.86
    leg: float = 0.042
    taper: float = 0.58
    """Side of a leg's foot over the side of its top."""
    post: float = 0.036
    rake: float = 0.17
    boards: int = 1
    """That the panel is made of, one above the other."""
    open_below: float = 0.10
    """Between seat and panel."""
    rail_height: float = 0.045
    arms: bool = True


def sample(rng: np.random.Generator) -> PanelStyle:
    """A style of 9 to 15 parts."""
    arms = bool(rng.random() < 0.55)
    return PanelStyle(
        width=rng.uniform(0.45, 0.51) + (0.02 if arms else 0.0),
        depth=rng.uniform(0.43, 0.48),
        seat_height=rng.uniform(0.42, 0.465),
        seat_thickness=rng.uniform(0.03, 0.05),
        height=rng.uniform(0.78, 0.95),
        leg=rng.uniform(0.036, 0.05),
        taper=rng.uniform(0.5, 0.85),
        post=rng.uniform(0.034, 0.042),
        rake=rng.uniform(0.10, 0.22),
        boards=int(rng.integers(1, 4)),
        open_below=rng.uniform(0.03, 0.16),
        rail_height=rng.uniform(0.035, 0.06),
        arms=arms,
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A panel chair of the style drawn from `rng`, or the catalogue model with 13 parts."""
    return assemble(PanelStyle() if rng is None else sample(rng))


GROOVE = 0.008
"""Depth of the grooves that hold the panel."""
BOARD = 0.011
"""Thickness of its boards."""


def assemble(style: PanelStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    under, half = s.seat_height - s.seat_thickness, s.post / 2
    pieces: list[Piece] = []
    outline = rounded_trapezoid(s.width, s.width - 0.05, s.depth, 0.035, steps=4)
    seat = pad(outline, under, s.seat_height, 0.008, under=0.006)

    deep = (s.seat_thickness - 0.0105) / 2  # joints from above and from below keep this board between them
    leg_tenon = Tenon(0.5 * s.leg, 0.5 * s.leg, deep)
    leg = _leg(s, under, leg_tenon)
    leg_x, leg_y = s.width / 2 - 0.030 - s.leg / 2, s.depth / 2 - 0.020 - s.leg / 2
    for quarter, (name, x, y) in enumerate(
        (("front_right", -1, -1), ("front_left", 1, -1), ("back_left", 1, 1), ("back_right", -1, 1))
    ):
        inward = 0.025 if y > 0 else 0.0
        at = vector(x * (leg_x - inward), y * leg_y, 0)
        pieces.append(Piece(f"leg_{name}", "leg", leg, SE3(turn(Z, quarter * np.pi / 2), at)))
        seat -= leg_tenon.pocket(joint_frame(at + under * Z, -Z, X))

    # Posts lean back from the seat's rear corners; everything between them lies along `along`.
    along, across = vector(0, np.sin(s.rake), np.cos(s.rake)), vector(0, -np.cos(s.rake), np.sin(s.rake))
    post_x = s.width / 2 - 0.025 - 0.022 - half
    foot = vector(-post_x, s.depth / 2 - 0.012 - half, s.seat_height)
    reach = (s.height - s.rail_height * np.cos(s.rake) - s.seat_height) / np.cos(s.rake)
    low = s.open_below / np.cos(s.rake)
    post_tenon = Tenon(0.55 * s.post, 0.40 * s.post, deep)
    rail_tenon = Tenon(0.38 * s.post, 0.34 * s.post, 0.5 * s.rail_height)

    path = [foot + d * along for d in (c / np.cos(s.rake), reach + 0.05)]
    post = sweep(path, X, Y, rectangle(s.post, s.post, 0.003)).trim_by_plane(
        -along, -(foot + (reach - c) * along) @ along
    )
    top = foot + reach * along - 0.10 * s.post * X
    post += post_tenon.tongue(joint_frame(foot, Z, X))
    groove_mouth = foot + half * X + (low + reach) / 2 * along
    groove = Tenon(reach - low, BOARD, GROOVE)
    post -= groove.pocket(joint_frame(groove_mouth, X, along))
    post -= groove.pocket(joint_frame(groove_mouth + 0.03 * along, X, along))  # open at the top
    post += rail_tenon.tongue(joint_frame(top, -along, X))

    # Boards: their ends are the tongues in the grooves.
    length = 2 * (post_x - half + GROOVE)
    board_height = (reach - c - low - (s.boards - 1) * c) / s.boards
    middle = vector(0, foot[1], foot[2]) + (low + board_height / 2) * along
    board = sweep(
        [middle - length / 2 * X, middle + length / 2 * X], along, across, rectangle(board_height, BOARD, 0.0015)
    )
    for k in range(s.boards):
        lift = k * (board_height + c) * along
        name = "panel" if s.boards == 1 else f"panel_board_{k + 1}"
        pieces.append(Piece(name, "back_single_surface", board, move(*lift)))

    rail = _rail(s, foot, reach, along, across, post_x + half + 0.012)
    for side in (-1, 1):
        rail -= rail_tenon.pocket(joint_frame(vector(-side * top[0], top[1], top[2]), -along, X))
        seat -= post_tenon.pocket(joint_frame(vector(side * foot[0], foot[1], foot[2]), Z, X))
    pieces.append(Piece("top_rail", "back_frame_horizontal_bar", rail))

    if s.arms:
        arm, support, support_tenon, arm_tenon, arm_mouth = _arm(s, foot, along, across)
        post -= arm_tenon.pocket(joint_frame(arm_mouth, -Y, Z), over=0.012)
        pieces += [Piece("armrest_right", "arm_horizontal_bar", arm)]
        pieces += [Piece("armrest_left", "arm_horizontal_bar", mirrored_x(arm))]
        for side, name in ((-1, "right"), (1, "left")):
            at = vector(side * (s.width / 2 - 0.045), -0.14 * s.depth, s.seat_height)
            seat -= support_tenon.pocket(joint_frame(at, Z, X))
            pieces.append(Piece(f"arm_support_{name}", "arm_near_vertical_bar", support, move(*at)))
    pieces += [Piece("post_right", "back_frame_vertical_bar", post)]
    pieces += [Piece("post_left", "back_frame_vertical_bar", mirrored_x(post))]
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _leg(s: PanelStyle, under: float, tenon: Tenon) -> Solid:
    """A leg about the z axis, outer faces (-x, -y) upright, inner ones tapering: it serves all corners."""
    stations = [(0.0, s.taper - 0.06), (0.003, s.taper), (0.88 * under, 1.0), (under - CLEARANCE, 1.0)]
    path = [vector(-(1 - k) * s.leg / 2, -(1 - k) * s.leg / 2, z) for z, k in stations]
    path[0] = vector(path[1][0], path[1][1], 0.0)
    body = sweep(np.array(path), X, Y, [rectangle(k * s.leg, k * s.leg, 0.004) for _, k in stations])
    return body + tenon.tongue(joint_frame(under * Z, -Z, X))


def _rail(
    s: PanelStyle,
    foot: Float[np.ndarray, "3"],
    reach: float,
    along: Float[np.ndarray, "3"],
    across: Float[np.ndarray, "3"],
    end: float,
) -> Solid:
    """The top rail, on the posts and over the panel, its upper corners rounded."""
    x = end * np.array([-1, -0.97, -0.9, -0.5, 0, 0.5, 0.9, 0.97, 1])
    size = s.rail_height * np.array([0.62, 0.84, 0.97, 1.0, 1.04, 1.0, 0.97, 0.84, 0.62])
    base = vector(0, foot[1], foot[2]) + reach * along
    path = base + x[:, None] * X + (size / 2)[:, None] * along
    return sweep(path, along, across, [rectangle(h, 1.02 * s.post, 0.005) for h in size])


def _arm(
    s: PanelStyle, foot: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], across: Float[np.ndarray, "3"]
) -> tuple[Solid, Solid, Tenon, Tenon, Float[np.ndarray, "3"]]:
    """The right armrest, its support (foot at the origin), the tenons of the support and of the armrest, its mouth."""
    c, rise, thickness = CLEARANCE, 0.205, 0.024
    tenon = Tenon(0.013, 0.007, 0.38 * s.post, root=0.02)
    support_tenon = Tenon(0.018, 0.014, 0.014)
    level = s.seat_height + rise + thickness / 2
    # Mouth: on the post's front face, at the armrest's height, off the post's middle and so clear of the groove.
    mouth = vector(foot[0] - 0.0045, foot[1] - s.post / 2 + (level - foot[2]) * np.tan(s.rake), level)
    support_x, support_y = -(s.width / 2 - 0.045), -0.14 * s.depth
    front = support_y - 0.055
    y = np.array([front, front + 0.006, front + 0.03, support_y + 0.04, 0.5 * (support_y + mouth[1]), mouth[1] + 0.02])
    x = np.interp(y, [support_y, mouth[1]], [support_x, foot[0] - 0.002])
    x[:3] = support_x
    widths = [0.034, 0.046, 0.056, 0.054, 0.046, 0.038]
    heights = [0.014, 0.021, thickness, thickness, thickness, thickness]
    path = np.column_stack([x, y, np.full(6, level)])
    arm = sweep(path, X, Z, [rectangle(w, h, 0.004) for w, h in zip(widths, heights, strict=True)])
    face = mouth + c * across
    arm = arm.trim_by_plane(across, float(face @ across))
    # A long root would show where the face leans away from the armrest's end.
    arm += tenon.tongue(joint_frame(mouth, -Y, Z))
    shaft = rise - c
    stations = [(c, 0.030, 0.030), (0.5 * rise, 0.025, 0.025), (shaft, 0.034, 0.030)]
    support = sweep([vector(0, 0, z) for z, _, _ in stations], X, Y, [rectangle(w, d, 0.004) for _, w, d in stations])
    support += support_tenon.tongue(joint_frame(np.zeros(3), Z, X))
    pin = joint_frame(rise * Z, -Z, X)
    support += support_tenon.tongue(pin)
    arm -= support_tenon.pocket(move(support_x, support_y, s.seat_height) * pin)
    return arm, support, support_tenon, tenon, mouth
