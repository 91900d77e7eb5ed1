"""Joints: a tongue on one part and a pocket in the other, the tongue's shape grown by the clearance on every side.

A joint's frame sits on the face of the part that has the pocket: origin at the middle of the mouth, z out of that
part (toward the part with the tongue), x along the tongue's width, y along its thickness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from roboassembly.generate.outlines import rectangle, rectangles
from roboassembly.generate.solids import Solid, placed, polyline, sweep, turned, turned_along
from roboassembly.generate.vectors import Vector, X, Y, Z, leaning, unit, vector
from roboassembly.geometry.poses import SE3

CLEARANCE = 0.0004
"""Distance between any two faces that mate: sides and end of a tongue, and its shoulder [m]."""


def joint_frame(origin: Vector, out: Vector, width: Vector) -> SE3:
    """Return the joint frame with z along `out` and x along `width` (made orthogonal to `out`)."""
    z = unit(out)
    x = unit(width - (width @ z) * z)
    return SE3(np.column_stack([x, np.cross(z, x), z]), np.asarray(origin, dtype=float))


@dataclass(frozen=True)
class Tenon:
    """Rectangular tongue; with the length of a board's edge for its width, the tongue of a groove or housing."""

    width: float
    """Width along x of the joint's frame [m]."""
    thickness: float
    """Thickness along y [m]."""
    length: float
    """Depth below the mouth [m]."""
    root: float = 0.008
    """Length by which it reaches back into its own part, so that the two become one body [m]."""

    def tongue(self, frame: SE3) -> Solid:
        """Return what to add to the part that carries the tongue."""
        return self._prism(frame, 0.0, -self.length, self.root)

    def pocket(self, frame: SE3, over: float = 0.002) -> Solid:
        """Return what to take from the other part; it sticks out of the mouth by `over`."""
        return self._prism(frame, CLEARANCE, -self.length - CLEARANCE, over)

    def _prism(self, frame: SE3, grow: float, low: float, high: float) -> Solid:
        section = rectangle(self.width + 2 * grow, self.thickness + 2 * grow)
        return placed(sweep([vector(0, 0, low), vector(0, 0, high)], X, Y, section), frame)


@dataclass(frozen=True)
class RoundTenon:
    """Round tongue, straight or tapering toward its end; the frame's x only clocks its facets."""

    radius: float
    """Radius at the mouth [m]."""
    length: float
    end_radius: float = 0.0
    """Radius at the end; zero for a straight one [m]."""
    root: float = 0.008
    sides: int = 12

    @property
    def slope(self) -> float:
        """Growth of the radius per metre toward the mouth."""
        return (self.radius - (self.end_radius or self.radius)) / self.length

    def tongue(self, frame: SE3) -> Solid:
        """Return what to add to the part that carries the tongue."""
        return self._cone(frame, 0.0, -self.length, self.root)

    def pocket(self, frame: SE3, over: float = 0.002) -> Solid:
        """Return what to take from the other part."""
        return self._cone(frame, CLEARANCE / np.cos(np.pi / self.sides), -self.length - CLEARANCE, over)

    def _cone(self, frame: SE3, grow: float, low: float, high: float) -> Solid:
        profile = [(z, self.radius + self.slope * z + grow) for z in (low, high)]
        return placed(turned(profile, self.sides), frame)


Tongue = Tenon | RoundTenon


def mouths(start: Vector, end: Vector, up: Vector) -> tuple[SE3, SE3]:
    """Return joint frames on the two faces that a bar from `start` to `end` runs between; tenon width along `up`."""
    run = unit(end - start)
    return joint_frame(start, run, up), joint_frame(end, -run, up)


def rail(
    start: Vector, end: Vector, up: Vector, height: float, thickness: float, tenon: Tenon, chamfer: float = 0.003
) -> Solid:
    """Return a bar between two faces that stand square to it, shouldered, with a tenon at either end."""
    run = unit(end - start)
    ends = [start + CLEARANCE * run, end - CLEARANCE * run]
    body = sweep(ends, np.cross(up, run), up, rectangle(thickness, height, chamfer))
    for frame in mouths(start, end, up):
        body += tenon.tongue(frame)
    return body


def arched_rail(
    middle: Vector, half: float, rake: float, section: tuple[float, float], tenon: Tenon,
    arch: float = 0.0, bend: float = 0.0, stations: int = 9,
) -> Solid:  # fmt: skip
    """Return a rail along x of a leaning back, between posts whose faces are `half` from its middle.

    `section` has its height and thickness; its middle stands `arch` above its ends and lies `bend` behind them.
    """
    along, across = leaning(rake)
    x = np.linspace(-half + CLEARANCE, half - CLEARANCE, stations)
    hump = 1.0 - (x / half) ** 2
    path = polyline(middle, (x, X), (-(bend * hump), across), (0.5 * arch * hump, along))
    body = sweep(path, along, across, rectangles(section[0] + arch * hump, section[1], 0.003))
    for frame in mouths(middle - half * X, middle + half * X, along):
        body += tenon.tongue(frame)
    return body


def spindle(start: Vector, end: Vector, up: Vector, belly: float, tenon: RoundTenon, straight: float = 0.012) -> Solid:
    """Return a turned bar without shoulders: it enters its holes at the tenon's radius and swells to `belly` between.

    It has the tenon's radius up to `straight` metres from each mouth: for holes in round or slanted faces.
    """
    length = float(np.linalg.norm(end - start))
    profile = [(-tenon.length, tenon.radius), (straight, tenon.radius), (0.3 * length, belly), (0.7 * length, belly)]
    profile += [(length - straight, tenon.radius), (length + tenon.length, tenon.radius)]
    return turned_along(start, unit(end - start), up, profile, tenon.sides)


def splayed_leg(
    under: float, splay: float, tenon: RoundTenon, mouth: float, profile: Sequence[tuple[float, float]]
) -> tuple[Solid, Callable[[SE3], SE3]]:
    """Return a turned leg that leans toward -x on its way up to a level face above the origin.

    The second value is a function from the leg's place to its joint's frame in that face.

    Args:
        under: height of that face [m].
        splay: tilt [rad].
        tenon: tongue at the leg's upper end, along its axis; its taper goes on for `mouth` metres below the face.
        mouth: length of that taper [m].
        profile: below that, share of the length from face to floor and radius [m].
    """
    axis = unit(vector(-np.sin(splay), 0, np.cos(splay)))
    length = under / np.cos(splay)
    stations = [(-tenon.length, tenon.end_radius or tenon.radius), (mouth, tenon.radius + tenon.slope * mouth)]
    stations += [(share * length, radius) for share, radius in profile]
    body = turned_along(under * Z, -axis, Y, stations, tenon.sides)

    def mouth_at(pose: SE3) -> SE3:
        return joint_frame(pose.act(under * Z), -(pose.rotation @ axis), pose.rotation @ Y)

    return body.trim_by_plane((0.0, 0.0, 1.0), 0.0), mouth_at
