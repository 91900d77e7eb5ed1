"""The cantilever: two strips, each bent from floor to back in one piece, with a seat and a back between them.

Everything lies along x between the strips. Whatever joins both of them shuts out what is not between them yet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import bent, ribbon
from roboassembly.generate.joints import CLEARANCE, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail
from roboassembly.generate.solids import Solid, X, Y, Z, mirrored_x, rectangle, sweep, unit, vector


@dataclass(frozen=True)
class CantileverStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.50
    """Over the outer faces of the strips."""
    depth: float = 0.50
    """Of the strips on the floor."""
    seat_height: float = 0.45
    height: float = 0.84
    strip: float = 0.034
    """Width of a strip, along x."""
    thickness: float = 0.024
    rake: float = 0.22
    pitch: float = 0.05
    """How much the seat falls toward the back."""
    bend: float = 0.085
    """Radius of the strips' bends."""
    lean: float = 0.02
    """How far the front of the seat lies before the front of the runners."""
    seat: float = 0.018
    """Thickness of the seat; a cushion if it is more than the strip's."""
    backs: int = 1
    """Boards in the back."""
    floor_bar: bool = True
    seat_bar: bool = False
    """A bar under the front of the seat."""


def sample(rng: np.random.Generator) -> CantileverStyle:
    """A style of 4 to 7 parts."""
    return CantileverStyle(
        width=rng.uniform(0.47, 0.60),
        depth=rng.uniform(0.46, 0.56),
        seat_height=rng.uniform(0.42, 0.46),
        height=rng.uniform(0.76, 0.98),
        strip=rng.uniform(0.030, 0.05),
        thickness=rng.uniform(0.022, 0.030),
        rake=rng.uniform(0.16, 0.30),
        pitch=rng.uniform(0.02, 0.09),
        bend=rng.uniform(0.06, 0.11),
        lean=rng.uniform(-0.01, 0.04),
        seat=rng.uniform(0.016, 0.065),
        backs=int(rng.integers(1, 3)),
        floor_bar=bool(rng.random() < 0.75),
        seat_bar=bool(rng.random() < 0.4),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A cantilever chair of the style drawn from `rng`, or the catalogue model with 5 parts."""
    return assemble(CantileverStyle() if rng is None else sample(rng))


def assemble(style: CantileverStyle) -> list[Piece]:
    """All pieces of one style."""
    s, t = style, style.thickness
    inner = s.width / 2 - s.strip
    middle = s.width / 2 - s.strip / 2
    front, rear = -s.depth / 2, s.depth / 2
    seat_front = vector(middle, front - s.lean, s.seat_height - t / 2)
    run = vector(0, np.cos(s.pitch), -np.sin(s.pitch))
    knee = seat_front + (s.depth - 0.04) * run
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    reach = (s.height - knee[2]) / along[2]
    corners = [vector(middle, rear, t / 2), vector(middle, front, t / 2), seat_front, knee, knee + reach * along]
    points, tangents = bent(corners, s.bend)
    shrink = np.ones(len(points))
    shrink[[0, -1]] = 0.7
    strip = ribbon(points, tangents, X, [rectangle(s.strip, k * t, 0.003) for k in shrink])
    pieces: list[Piece] = []
    depth = 0.42 * s.strip
    cuts: list[Solid] = []

    # The seat, flat or cushioned, with a tongue along either side.
    seat_length = s.depth - 0.04 - 2 * (s.bend * 0.9)
    at = seat_front * (Y + Z) + (s.depth - 0.04) / 2 * run
    seat, pocket = _panel(at, run, inner, seat_length + 0.07, seat_length, s.seat, 0.45 * t, depth, 0.0)
    pieces.append(Piece("seat", "seat_single_surface", seat))
    cuts.append(pocket)

    # Boards in the back; two of them are alike.
    low, high = s.bend + 0.02, reach - 0.02
    if s.backs == 2:
        board = min(0.5 * (high - low - 0.035), 0.13)
        centers = [0.5 * (low + high - board) - 0.5 * board + 0.02, high - board / 2]
        centers[0] = min(centers[0], centers[1] - board - 0.03)
    else:
        board = min(0.75 * (high - low), 0.30)
        centers = [high - board / 2]
    back, _ = _panel(
        knee * (Y + Z) + centers[0] * along, along, inner, board, 0.8 * board, 0.014, 0.45 * t, depth, 0.02
    )
    for k, up in enumerate(centers):
        name = "back" if s.backs == 1 else f"back_{('lower', 'upper')[k]}"
        pieces.append(Piece(name, "back_single_surface", back, move(*((up - centers[0]) * along))))
        origin = knee * (Y + Z) + up * along
        cuts.append(Tenon(0.8 * board, 0.45 * t, depth).pocket(joint_frame(origin + inner * X, -X, along)))

    tenon = Tenon(0.55 * t, 0.5 * t, depth)
    bars = [("floor_bar", vector(0, rear - 0.03, t / 2), t, "bar_stretcher")] if s.floor_bar else []
    if s.seat_bar:
        # In the middle of the front upright.
        upright = (corners[1] + corners[2]) / 2 * (Y + Z)
        bars.append(("front_bar", upright + 0.35 * (corners[2] - corners[1]) * (Y + Z), 0.9 * t, "seat_frame_bar"))
    for name, center, height, label in bars:
        up = Z if name == "floor_bar" else unit((corners[2] - corners[1]) * (Y + Z))
        start, end = center - inner * X, center + inner * X
        pieces.append(Piece(name, label, rail(start, end, up, height, 0.85 * t, tenon)))
        cuts.append(tenon.pocket(mouths(start, end, up)[1]))
    for cut in cuts:
        strip -= cut
    pieces.append(Piece("frame_left", "leg", strip))
    pieces.append(Piece("frame_right", "leg", mirrored_x(strip)))
    return pieces


def _panel(
    center: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    inner: float,
    length: float,
    tongue: float,
    thickness: float,
    slot: float,
    depth: float,
    bow: float,
) -> tuple[Solid, Solid]:
    """A panel between the strips, `length` along `along`, hollowed by `bow`; the groove in the left-hand strip."""
    end = inner - CLEARANCE
    x = end * np.array([-1, -0.97, -0.7, -0.35, 0, 0.35, 0.7, 0.97, 1])
    normal = np.cross(X, along)
    edge = min(0.3 * thickness, 0.010)
    ease = np.array([0.85, 1, 1, 1, 1, 1, 1, 1, 0.85])
    path = center + x[:, None] * X - (bow * (1 - (x / end) ** 2))[:, None] * normal
    sections = [rectangle(length - (1 - k) * 0.05, thickness * k, edge) for k in ease]
    body = sweep(path, along, normal, sections)
    tenon = Tenon(tongue, slot, depth)
    for side in (1, -1):
        body += tenon.tongue(joint_frame(center + side * inner * X, -side * X, along))
    return body, tenon.pocket(joint_frame(center + inner * X, -X, along))
