"""State of a part during repair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.repair.insertion import box_axes, engaged, extents, insertion_depth
from roboassembly.repair.proximity import Shell, shell_of
from roboassembly.repair.solid import Solid
from roboassembly.repair.surface import to_surface

NOTHING = 1e-4
"""Loss of size that is ignored [m]."""
HARM_LIMIT = 0.0025
"""Loss of size or depth above which a cut is the last choice [m]."""


@dataclass(eq=False)
class Piece:
    """Part during repair."""

    name: str
    body: m3.Manifold
    solid: Solid
    whole: float
    """Volume before any trimming [m³]."""
    removed: float = 0.0
    """Volume trimmed so far [m³]."""
    moved: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Translation so far [m]."""
    notes: list[str] = field(default_factory=list[str])
    gave: bool = False
    """Whether it left doubled material to another part."""
    weight: float = 1.0
    """Factor on the cost of trimming this part in the choice of the part to trim."""
    axes: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    """Axes of the smallest box around the part: unit vectors in rows, the longest side first."""
    size: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Size along these axes before any trimming [m]."""
    depths: dict[str, Float[np.ndarray, "3"]] = field(default_factory=dict[str, Float[np.ndarray, "3"]])
    """Depths in neighbours along the axes before any trimming, by the neighbour's name [m]."""

    @classmethod
    def of(cls, name: str, solid: Solid) -> Piece:
        """Return a piece before any trimming."""
        piece = cls(name, solid.body, solid, whole=0.0)
        piece.become_whole(solid.body)
        return piece

    @property
    def shell(self) -> Shell:
        """Present triangles as a collision model."""
        return shell_of(self.body)

    def become(self, body: m3.Manifold) -> None:
        """Replace the solid."""
        self.body = body

    def become_whole(self, body: m3.Manifold) -> None:
        """Replace the solid; the new one counts as the untrimmed part."""
        points = to_surface(body).vertices
        self.axes = box_axes(points)
        self.body, self.whole, self.size = body, body.volume(), extents(points, self.axes)

    def give(self, rest: m3.Manifold, others: Sequence[str]) -> None:
        """Leave doubled material to other parts: the rest counts as the untrimmed part."""
        share = 1.0 - rest.volume() / self.whole
        names = ", ".join(f"'{name}'" for name in others)
        self.become_whole(rest)
        self.gave = True
        self.notes.append(f"{share:.0%} of its volume left to {names}, which had it, too")

    def shrinkage(self, body: m3.Manifold) -> float:
        """Return the loss of size of `body` against the untrimmed part, along the axis that loses most [m]."""
        return float((self.size - extents(to_surface(body).vertices, self.axes)).max())

    def measure_depth(self, other: Piece) -> None:
        """Record how deep this part sits in another; call this before any trimming."""
        depth = insertion_depth(self.body, other.body, self.axes)
        if depth.any():
            self.depths[other.name] = depth

    def depth_loss(self, body: m3.Manifold, neighbor: str, other: m3.Manifold) -> float:
        """Return the loss of depth of `body` in a neighbour, now `other`, against the untrimmed parts [m]."""
        before = self.depths.get(neighbor)
        if before is None:
            return 0.0
        return float((before - extents(engaged(body, other), self.axes))[before > 0.0].max())

    def depth_losses(
        self, bodies: Mapping[str, m3.Manifold], least: float, body: m3.Manifold | None = None
    ) -> tuple[tuple[str, float], ...]:
        """Return the neighbours in which this part sits less deep than before any trimming.

        Args:
            bodies: present solid of every part, by name.
            least: loss above which a neighbour is returned [m].
            body: solid of this part; the present one if None.

        Returns:
            Name of each neighbour and loss of depth [m].
        """
        own = self.body if body is None else body
        losses = ((other, self.depth_loss(own, other, bodies[other])) for other in self.depths)
        return tuple((other, loss) for other, loss in losses if loss > least)


def harm(trimmed: Piece, cutter: Piece, body: m3.Manifold, other: m3.Manifold | None = None) -> float:
    """Return the loss of size, or of the depth of the joint between two parts, that a cut causes [m].

    Args:
        trimmed: part whose solid becomes `body`.
        cutter: part whose solid becomes `other`, or stays as it is if None.
    """
    other = cutter.body if other is None else other
    smaller = trimmed.shrinkage(body)
    return max(
        0.0,
        smaller if smaller > trimmed.shrinkage(trimmed.body) + NOTHING else 0.0,
        trimmed.depth_loss(body, cutter.name, other),
        cutter.depth_loss(other, trimmed.name, body),
    )
