"""Progress of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Progress of one stage of a run."""

    stage: str
    """Name of the stage."""
    done: int
    """Number of steps done."""
    total: int
    """Number of steps of the stage."""
    scalars: dict[str, float]
    """Losses and other values of the last step."""
