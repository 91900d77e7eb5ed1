"""Parts bent from one strip or tube, boards with a curved outline, and splayed legs."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
from jaxtyping import Float

from roboassembly.generate.joints import RoundTenon
from roboassembly.generate.solids import Solid, Y, circle, loft, sweep, unit, vector


def bent(
    corners: Sequence[Float[np.ndarray, "3"]], radius: float, steps: int = 5
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """A line from corner to corner with every inner corner rounded to `radius` metres; points and unit tangents."""
    points, tangents = [corners[0]], [unit(corners[1] - corners[0])]
    for before, here, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        come, go = unit(here - before), unit(after - here)
        angle = float(np.arccos(np.clip(come @ go, -1, 1)))
        start = here - radius * np.tan(angle / 2) * come
        inward = unit(go - (go @ come) * come)
        for t in np.linspace(0.0, angle, steps + 1):
            points.append(start + radius * (np.sin(t) * come + (1 - np.cos(t)) * inward))
            tangents.append(np.cos(t) * come + np.sin(t) * inward)
    points.append(corners[-1])
    tangents.append(unit(corners[-1] - corners[-2]))
    return np.array(points), np.array(tangents)


def ribbon(
    points: Float[np.ndarray, "k 3"],
    tangents: Float[np.ndarray, "k 3"],
    side: Float[np.ndarray, "3"],
    sections: Float[np.ndarray, "n 2"] | Sequence[Float[np.ndarray, "n 2"]],
) -> Solid:
    """Sections square to a line that stays in the plane square to `side`; their first coordinate is along `side`."""
    outline = np.asarray(sections, dtype=float)
    outlines = np.broadcast_to(outline, (len(points), *outline.shape[-2:]))
    rings = [
        at + section[:, :1] * side + section[:, 1:] * np.cross(tangent, side)
        for at, tangent, section in zip(points, tangents, outlines, strict=True)
    ]
    return loft(np.array(rings))


def cut_out(
    outline: Float[np.ndarray, "n 2"],
    origin: Float[np.ndarray, "3"],
    u: Float[np.ndarray, "3"],
    v: Float[np.ndarray, "3"],
    thickness: float,
    holes: Sequence[Float[np.ndarray, "m 2"]] = (),
) -> Solid:
    """A board of any outline in the plane of unit vectors `u` and `v`, its middle plane through `origin`, with holes.

    Outlines run counter-clockwise, in metres along `u` and `v` from `origin`.
    """
    section = manifold3d.CrossSection([np.asarray(outline, dtype=float)])
    for hole in holes:
        section = section - manifold3d.CrossSection([np.asarray(hole, dtype=float)])
    normal = np.cross(u, v)
    return section.extrude(thickness).transform(
        np.column_stack([u, v, normal, np.asarray(origin, dtype=float) - thickness / 2 * normal])
    )


def symmetric(half: Sequence[tuple[float, float]]) -> Float[np.ndarray, "n 2"]:
    """A closed outline, mirror-symmetric about the second axis, from its right half `(x, y)` in rising y."""
    right = [(x, y) for x, y in half]
    return np.array([*right, *[(-x, y) for x, y in reversed(right) if x > 0]])


def smooth(points: Sequence[tuple[float, float]], count: int) -> list[tuple[float, float]]:
    """`count` points on a smooth curve x(y) through `(x, y)` points in rising y, the ends among them."""
    x, y = np.array(points).T
    levels = np.linspace(y[0], y[-1], count)
    low = np.clip(np.searchsorted(y, levels, side="right") - 1, 0, len(y) - 2)
    t = (levels - y[low]) / (y[low + 1] - y[low])
    ease = t * t * (3 - 2 * t)
    return [(float(a), float(b)) for a, b in zip(x[low] + ease * (x[low + 1] - x[low]), levels, strict=True)]


def splayed_leg(
    under: float, splay: float, tenon: RoundTenon, profile: Sequence[tuple[float, float]], mouth: float
) -> tuple[Solid, Float[np.ndarray, "3"]]:
    """A turned leg that leans toward -x on its way up and meets a level face above the origin; with its axis.

    Args:
        under: height of that face, metres.
        splay: tilt, radians.
        tenon: at its upper end, along its axis; its taper goes on for `mouth` metres below the face.
        profile: below that, share of the length from face to floor and radius in metres.
        mouth: metres.
    """
    axis = unit(vector(-np.sin(splay), 0, np.cos(splay)))
    length = under / np.cos(splay)
    slope = (tenon.radius - (tenon.end_radius or tenon.radius)) / tenon.length
    stations = [(-tenon.length, tenon.end_radius or tenon.radius), (mouth, tenon.radius + slope * mouth)]
    stations += [(share * length, radius) for share, radius in profile]
    path = np.array([under * np.array([0.0, 0.0, 1.0]) - d * axis for d, _ in stations])
    body = sweep(path, Y, np.cross(Y, axis), [circle(radius, tenon.sides) for _, radius in stations])
    return body.trim_by_plane((0.0, 0.0, 1.0), 0.0), axis
