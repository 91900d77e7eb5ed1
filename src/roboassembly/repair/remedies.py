"""Remedies for furniture that repair would refuse, tried one on top of the other; they only start after a refusal.

1. Doubled surfaces, of which two parts have the same triangles, are left to one part.
2. A part that loses its shape when it is simplified keeps four times as many triangles.
3. Thin panels that lie in another part are moved out of it.
4. Doubled volumes, which two parts both have, are left to one part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import RawPart
from roboassembly.repair.doubles import without_doubled_surfaces

MORE_DETAIL = 4
"""Factor on the allowed triangles of a part that loses its shape."""


class ShapeError(FurnitureError):
    """Error for a part that could not be made solid in its delivered shape."""


@dataclass(frozen=True, eq=False)
class Treatment:
    """Remedies that are in use."""

    parts: tuple[RawPart, ...]
    """Parts as delivered, or without doubled surfaces."""
    notes: tuple[tuple[str, ...], ...]
    """Notes on the changes of each part."""
    detail: int = 1
    """Factor on the allowed triangles of parts that lose their shape."""
    moves_panels: bool = False
    """Whether thin panels are moved out of other parts."""
    shares_out: bool = False
    """Whether doubled volumes are left to one part."""
    sets_back: bool = True
    """Whether all faces are set back if parts overlap or touch."""

    @classmethod
    def none(cls, parts: Sequence[RawPart], sets_back: bool = True) -> Treatment:
        """Return the treatment of parts as delivered."""
        return cls(tuple(parts), ((),) * len(parts), sets_back=sets_back)


def treated_surfaces(treatment: Treatment, _: FurnitureError) -> Treatment | None:
    """Add the first remedy; None if no surfaces are doubled."""
    found = without_doubled_surfaces(treatment.parts)
    return None if found is None else replace(treatment, parts=tuple(found[0]), notes=tuple(found[1]))


def treated_detail(treatment: Treatment, refusal: FurnitureError) -> Treatment | None:
    """Add the second remedy; None if the refusal is not about a shape."""
    return replace(treatment, detail=MORE_DETAIL) if isinstance(refusal, ShapeError) else None


def treated_panels(treatment: Treatment, refusal: FurnitureError) -> Treatment | None:
    """Add the third remedy; None if the refusal is about a shape."""
    return None if isinstance(refusal, ShapeError) else replace(treatment, moves_panels=True)


def treated_volumes(treatment: Treatment, refusal: FurnitureError) -> Treatment | None:
    """Add the fourth remedy; None if the refusal is about a shape."""
    return None if isinstance(refusal, ShapeError) else replace(treatment, shares_out=True)


REMEDIES = (treated_surfaces, treated_detail, treated_panels, treated_volumes)
"""Remedies in the order in which they are tried."""
