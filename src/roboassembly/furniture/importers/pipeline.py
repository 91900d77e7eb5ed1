"""What every importer does after reading: repair, then annotate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, Provenance, RawPart
from roboassembly.furniture.repair import PartRepair, repair


@dataclass(frozen=True, eq=False)
class Imported:
    """Furniture from elsewhere, and what had to be done to it."""

    furniture: Furniture
    repairs: tuple[PartRepair, ...]


def finish(name: str, raw: Sequence[RawPart], provenance: Provenance) -> Imported:
    """Repair and annotate parts as read.

    Raises:
        FurnitureError: what cannot be repaired within limits, or does not hold together, with the reason.
    """
    repaired = repair(raw)
    notes = tuple(str(r) for r in repaired.report)
    furniture = annotate(name, repaired.parts, replace(provenance, notes=(*provenance.notes, *notes)))
    return Imported(furniture, repaired.report)
