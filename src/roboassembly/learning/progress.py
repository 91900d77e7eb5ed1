"""How far a run is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far one stage is, and what it says."""

    stage: str
    done: int
    total: int
    scalars: dict[str, float]
