"""The shell chair: seat and back in one bent piece, on two bars with splayed legs, and spreaders between the bars.

Spreaders go between the bars along y, the bars meet the shell from below: once both bars are at the shell, no
spreader gets in. Legs go into their bars one by one, along their own axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.bends import bent, splayed_leg
from roboassembly.generate.joints import CLEARANCE, RoundTenon, Tenon, joint_frame
from roboassembly.generate.pieces import Piece, move
from roboassembly.generate.rails import mouths, rail
from roboassembly.generate.solids import Solid, X, Y, Z, block, loft, turn, vector
from roboassembly.geometry.poses import SE3


@dataclass(frozen=True)
class ShellStyle:
    """Sizes in metres, angles in radians; the defaults are the catalogue model."""

    width: float = 0.46
    depth: float = 0.44
    """Of the seat."""
    seat_height: float = 0.44
    height: float = 0.82
    rake: float = 0.24
    bend: float = 0.09
    """Radius between seat and back."""
    shell: float = 0.013
    """Its thickness."""
    hollow: float = 0.018
    """How far seat and back are dished."""
    splay: float = 0.20
    leg: float = 0.017
    """Largest radius of a leg."""
    spreaders: int = 1
    back_width: float = 0.88
    """Width of the back's top over that of the seat."""


def sample(rng: np.random.Generator) -> ShellStyle:
    """A style of 7 to 9 parts."""
    return ShellStyle(
        width=rng.uniform(0.43, 0.50),
        depth=rng.uniform(0.41, 0.46),
        seat_height=rng.uniform(0.42, 0.46),
        height=rng.uniform(0.76, 0.88),
        rake=rng.uniform(0.18, 0.30),
        bend=rng.uniform(0.06, 0.12),
        shell=rng.uniform(0.011, 0.018),
        hollow=rng.uniform(0.0, 0.03),
        splay=rng.uniform(0.14, 0.25),
        leg=rng.uniform(0.0155, 0.020),
        spreaders=int(rng.choice([0, 1, 1, 2])),
        back_width=rng.uniform(0.72, 1.0),
    )


def build(rng: np.random.Generator | None) -> list[Piece]:
    """A shell chair of the style drawn from `rng`, or the catalogue model with 8 parts."""
    return assemble(ShellStyle() if rng is None else sample(rng))


MOUTH = 0.010
LEG_TENON = RoundTenon(radius=0.0115, length=0.022, end_radius=0.0105, sides=12)
LUG_PEG = Tenon(0.030, 0.014, 0.012)
BAR = (0.042, 0.036)
"""Depth and height of the bars."""
LUG = 0.022
"""Height of the lugs under the shell."""


def assemble(style: ShellStyle) -> list[Piece]:
    """All pieces of one style."""
    s, c = style, CLEARANCE
    bar_top = s.seat_height - s.shell - s.hollow - LUG
    bar_low = bar_top - BAR[1]
    pieces: list[Piece] = []

    # A bar along x with a leg at either end; turned about the vertical it is the other one.
    half_bar, y = 0.30 * s.width + 0.03, 0.26 * s.depth
    bar = block((-half_bar, -BAR[0] / 2, bar_low), (half_bar, BAR[0] / 2, bar_top - c))
    profile = [(0.12, s.leg), (0.5, 0.95 * s.leg), (1.05, 0.58 * s.leg)]
    leg, axis = splayed_leg(bar_low, s.splay, LEG_TENON, profile, MOUTH)
    leg_x = 0.30 * s.width
    # On the front bar (the one at -y) both legs lean outward and forward.
    legs = [(-1, np.pi + 0.9), (1, -0.9)]
    for side, heading in legs:
        spin = turn(Z, heading)
        frame = joint_frame(vector(side * leg_x, 0, bar_low), -(spin @ axis), spin @ Y)
        bar -= LEG_TENON.pocket(frame, over=MOUTH)
    lug_x = 0.62 * leg_x
    for x in (-lug_x, lug_x):
        bar -= LUG_PEG.pocket(joint_frame(vector(x, 0, bar_top), Z, X))
    inner = y - BAR[0] / 2
    tenon = Tenon(0.016, 0.010, 0.014)
    xs = {0: [], 1: [0.0], 2: [-0.045, 0.045]}[s.spreaders]
    spreader: Solid | None = None
    for k, x in enumerate(xs):
        start, end = vector(x, -inner, bar_low + 0.014), vector(x, inner, bar_low + 0.014)
        spreader = spreader or rail(start, end, Z, 0.026, 0.020, tenon)
        pieces.append(Piece(f"spreader_{k + 1}", "bar_stretcher", spreader, move(x - xs[0])))
        bar -= tenon.pocket(move(y=y) * mouths(start, end, Z)[0])
    for name, turned in (("front", 0.0), ("back", np.pi)):
        place = move(y=-y if name == "front" else y) * SE3(turn(Z, turned), np.zeros(3))
        pieces.append(Piece(f"bar_{name}", "seat_frame_bar", bar, place))
        for side, heading in legs:
            pose = place * SE3(turn(Z, heading), vector(side * leg_x, 0, 0))
            left = (side > 0) == (name == "front")
            pieces.append(Piece(f"leg_{name}_{'left' if left else 'right'}", "leg", leg, pose))
    seat, height_at = _shell(s)
    for x in (-lug_x, lug_x):
        for at in (-y, y):
            lug = block((x - 0.022, at - 0.013, bar_top), (x + 0.022, at + 0.013, height_at(x, at)))
            seat += lug + LUG_PEG.tongue(joint_frame(vector(x, at, bar_top), Z, X))
    pieces.append(Piece("seat", "seat_single_surface", seat))
    return pieces


def _shell(s: ShellStyle) -> tuple[Solid, Callable[[float, float], float]]:
    """Seat and back from the front edge, turned down, to the top edge, dished across; height of its middle surface."""
    front, rear = -s.depth / 2, s.depth / 2
    level = s.seat_height - s.shell / 2
    along = vector(0, np.sin(s.rake), np.cos(s.rake))
    corner = vector(0, rear, level - 0.010)
    reach = (s.height - corner[2]) / along[2]
    corners = [vector(0, front - 0.012, level - 0.022), vector(0, front + 0.05, level), corner, corner + reach * along]
    points, tangents = bent(corners, s.bend, 4)
    # More stations on the straight stretches and toward the ends, for the dishing and the outline to come and go.
    stations, directions = [points[0]], [tangents[0]]
    for a, b, t in zip(points[:-1], points[1:], tangents[1:], strict=True):
        far = float(np.linalg.norm(b - a))
        stops = np.linspace(0, 1, max(2, int(far // 0.10) + 1))[1:]
        if np.array_equal(b, points[-1]):
            stops = np.concatenate(
                [stops[stops < 1 - 0.09 / far], 1 - np.array([0.085, 0.05, 0.025, 0.008, 0.0]) / far]
            )
        stations += [a + k * (b - a) for k in stops]
        directions += [t if len(stops) == 1 else (b - a) / far] * len(stops)
    path, heading = np.array(stations), np.array(directions)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    share = length / length[-1]
    dish = s.hollow * np.clip(np.minimum(share, 1 - share) / 0.22, 0, 1)
    wide = s.width / 2 * np.interp(share, [0, 0.04, 0.12, 0.5, 0.9], [0.90, 0.97, 1, 1, s.back_width])
    # A round of 85 mm at the upper corners.
    left = np.clip(1 - (length[-1] - length) / 0.085, 0, 1)
    wide -= 0.085 * (1 - np.sqrt(1 - left**2)) * 0.9
    across = np.linspace(-1, 1, 7)
    rings = []
    for at, t, w, d in zip(path, heading, wide, dish, strict=True):
        normal = np.cross(X, t)
        rings.append(_ring(at, w * across, d * (1 - across**2), normal, s.shell))
    seat = path[:, 2] < corner[2] + 0.02

    def height_at(x: float, y: float) -> float:
        w, d, z = (float(np.interp(y, path[seat, 1], values[seat])) for values in (wide, dish, path[:, 2]))
        return z - d * (1 - (x / w) ** 2)

    return loft(np.array(rings)), height_at


def _ring(
    at: Float[np.ndarray, "3"],
    x: Float[np.ndarray, "n"],
    dish: Float[np.ndarray, "n"],
    normal: Float[np.ndarray, "3"],
    thickness: float,
) -> Float[np.ndarray, "m 3"]:
    """A cross-section of the shell: its lower and its upper side, `dish` metres against `normal`."""
    middle = at + x[:, None] * X - dish[:, None] * normal
    return np.concatenate([middle - thickness / 2 * normal, (middle + thickness / 2 * normal)[::-1]])
