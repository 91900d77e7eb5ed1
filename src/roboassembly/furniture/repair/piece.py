"""A part on its way through the repair."""

from __future__ import annotations

from dataclasses import dataclass, field

import manifold3d as m3
import numpy as np
from jaxtyping import Float

from roboassembly.furniture.repair.proximity import Shell
from roboassembly.furniture.repair.solid import Solid
from roboassembly.furniture.repair.surface import to_surface


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
    dear: float = 1.0
    """What a share of this part counts beside a share of others, when it is chosen which of two is trimmed."""
    _shell: Shell | None = None

    @property
    def shell(self) -> Shell:
        """The present triangles, ready for collision questions."""
        if self._shell is None:
            self._shell = Shell(to_surface(self.body))
        return self._shell

    def become(self, body: m3.Manifold) -> None:
        """Replace the solid."""
        self.body, self._shell = body, None
