"""What repair may do to a part before it refuses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RepairLimits:
    """Where repair stops and refuses."""

    trimmed: float = 0.2
    """Share of a part's volume that may be trimmed."""
    displacement: float = 0.02
    """How far a part may be moved, as a share of the furniture's diagonal."""
    shortening: float = 0.005
    """Metres that a part may become smaller along an axis of its own, or sit less deep in a neighbour."""
    shape_error: float = 0.005
    """Metres that the delivered surface may stick out of the solid made of it (99th percentile)."""
    faces: int = 3000
    """Triangles a part is simplified to; where it is trimmed in many places it may keep a few more."""
    openings: int = 24
    """Sockets cut open before giving up; each may take seconds."""
    captive: bool = False
    """Whether parts may be left that hold each other fast, so that none of them can leave in any direction."""
