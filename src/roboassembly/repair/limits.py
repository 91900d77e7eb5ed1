"""Limits on the changes that repair makes to a part."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RepairLimits:
    """Limits above which repair refuses."""

    trimmed: float = 0.2
    """Largest share of a part's volume to trim."""
    displacement: float = 0.02
    """Largest translation of a part, as a share of the furniture's diagonal."""
    shortening: float = 0.005
    """Largest reduction of a part's size along its own axes, or of its depth in a neighbour [m]."""
    shape_error: float = 0.005
    """Largest distance that the delivered surface sticks out of its solid, 99th percentile [m]."""
    faces: int = 3000
    """Number of triangles of a simplified part; a part with many cuts may keep a few more."""
    openings: int = 24
    """Largest number of sockets to cut open; each may take seconds."""
    captive: bool = False
    """Whether parts may lock each other in place, so that none of them can leave in any direction."""
