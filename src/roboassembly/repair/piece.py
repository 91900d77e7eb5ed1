"""A part on its way through the repair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.repair.insertion import box_axes, engaged, extents, insertion_depth
from roboassembly.repair.proximity import Shell
from roboassembly.repair.solid import Solid
from roboassembly.repair.surface import to_surface

NOTHING = 1e-4
"""Metres of size that do not count as lost."""
HARM_LIMIT = 0.0025
"""Metres of lost size or depth above which a cut is made only where nothing else does."""


@dataclass(eq=False)
class Piece:
    """A part while it is being repaired."""

    name: str
    body: m3.Manifold
    solid: Solid
    whole: float
    """Cubic metres before any trimming."""
    removed: float = 0.0
    """Cubic metres trimmed so far."""
    moved: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Metres moved so far."""
    notes: list[str] = field(default_factory=list)
    weight: float = 1.0
    """Factor on the cost of trimming this part, when it is chosen which of two is trimmed."""
    axes: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    """Axes of the smallest box around the part: a unit vector a row, the longest side first."""
    size: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Metres along these axes before any trimming."""
    depths: dict[str, Float[np.ndarray, "3"]] = field(default_factory=dict)
    """Depth in each neighbour before any trimming, in metres along the axes, by the neighbour's name."""
    _shell: Shell | None = None

    @classmethod
    def of(cls, name: str, solid: Solid) -> Piece:
        """A part before any trimming."""
        points = to_surface(solid.body).vertices
        axes = box_axes(points)
        return cls(name, solid.body, solid, solid.body.volume(), axes=axes, size=extents(points, axes))

    @property
    def shell(self) -> Shell:
        """The present triangles, ready for collision questions."""
        if self._shell is None:
            self._shell = Shell(to_surface(self.body))
        return self._shell

    def become(self, body: m3.Manifold) -> None:
        """Replace the solid."""
        self.body, self._shell = body, None

    def shrinkage(self, body: m3.Manifold) -> float:
        """Metres by which `body` is smaller than the part was before any trimming, along the axis that loses most."""
        return float((self.size - extents(to_surface(body).vertices, self.axes)).max())

    def measure_depth(self, other: Piece) -> None:
        """Note how deep this part sits in another one; to be called before any trimming."""
        depth = insertion_depth(self.body, other.body, self.axes)
        if depth.any():
            self.depths[other.name] = depth

    def depth_loss(self, body: m3.Manifold, neighbor: str, other: m3.Manifold) -> float:
        """Metres by which `body` sits less deep in a neighbour, now `other`, than before any trimming."""
        before = self.depths.get(neighbor)
        if before is None:
            return 0.0
        return float((before - extents(engaged(body, other), self.axes))[before > 0.0].max())

    def depth_losses(
        self, bodies: Mapping[str, m3.Manifold], least: float, body: m3.Manifold | None = None
    ) -> tuple[tuple[str, float], ...]:
        """Neighbours in which this part sits less deep than before any trimming.

        Args:
            bodies: present solid of every part, by name.
            least: losses up to so many metres are left out.
            body: this part's solid; its present one if None.

        Returns:
            Name of the neighbour and metres lost, of each.
        """
        own = self.body if body is None else body
        losses = ((other, self.depth_loss(own, other, bodies[other])) for other in self.depths)
        return tuple((other, loss) for other, loss in losses if loss > least)


def harm(trimmed: Piece, cutter: Piece, body: m3.Manifold, other: m3.Manifold | None = None) -> float:
    """Metres of size, or of the depth of the joint between two parts, that a cut takes.

    Args:
        trimmed: becomes `body`.
        cutter: becomes `other`, or stays as it is if None.
    """
    other = cutter.body if other is None else other
    smaller = trimmed.shrinkage(body)
    return max(
        0.0,
        smaller if smaller > trimmed.shrinkage(trimmed.body) + NOTHING else 0.0,
        trimmed.depth_loss(body, cutter.name, other),
        cutter.depth_loss(other, trimmed.name, body),
    )
