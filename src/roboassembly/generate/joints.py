"""Joints: a tongue on one part and a pocket in the other, the tongue's shape grown by the clearance on every side.

A joint's frame sits on the face of the part that has the pocket: origin at the middle of the mouth, z out of that
part (toward the part with the tongue), x along the tongue's width, y along its thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roboassembly.generate.solids import Solid, X, Y, placed, rectangle, sweep, turned, unit, vector
from roboassembly.geometry.poses import SE3

CLEARANCE = 0.0004
"""Metres between any two faces that mate: sides and end of a tongue, and its shoulder."""


def joint_frame(origin: Float[np.ndarray, "3"], out: Float[np.ndarray, "3"], width: Float[np.ndarray, "3"]) -> SE3:
    """Joint frame with z along `out` and x along `width` (made orthogonal to `out`)."""
    z = unit(out)
    x = unit(width - (width @ z) * z)
    return SE3(np.column_stack([x, np.cross(z, x), z]), np.asarray(origin, dtype=float))


@dataclass(frozen=True)
class Tenon:
    """A rectangular tongue. With `width` the length of a board's edge it is the tongue of a groove or housing."""

    width: float
    """Metres along x of the joint's frame."""
    thickness: float
    """Along y."""
    length: float
    """How far it goes in below the mouth."""
    root: float = 0.008
    """How far it reaches back into its own part, so that the two become one body."""

    def tongue(self, frame: SE3) -> Solid:
        """What to add to the part that carries the tongue."""
        return self._prism(frame, 0.0, -self.length, self.root)

    def pocket(self, frame: SE3, over: float = 0.002) -> Solid:
        """What to take from the other part; it sticks out of the mouth by `over`."""
        return self._prism(frame, CLEARANCE, -self.length - CLEARANCE, over)

    def _prism(self, frame: SE3, grow: float, low: float, high: float) -> Solid:
        section = rectangle(self.width + 2 * grow, self.thickness + 2 * grow)
        return placed(sweep([vector(0, 0, low), vector(0, 0, high)], X, Y, section), frame)


@dataclass(frozen=True)
class RoundTenon:
    """A round tongue, straight or tapering toward its end. Width and thickness directions only clock its facets."""

    radius: float
    """At the mouth."""
    length: float
    end_radius: float = 0.0
    """At the end; zero for a straight one."""
    root: float = 0.008
    sides: int = 12

    def tongue(self, frame: SE3) -> Solid:
        """What to add to the part that carries the tongue."""
        return self._cone(frame, 0.0, -self.length, self.root)

    def pocket(self, frame: SE3, over: float = 0.002) -> Solid:
        """What to take from the other part."""
        return self._cone(frame, CLEARANCE / np.cos(np.pi / self.sides), -self.length - CLEARANCE, over)

    def _cone(self, frame: SE3, grow: float, low: float, high: float) -> Solid:
        slope = (self.radius - (self.end_radius or self.radius)) / self.length
        return placed(
            turned([(low, self.radius + slope * low + grow), (high, self.radius + slope * high + grow)], self.sides),
            frame,
        )
