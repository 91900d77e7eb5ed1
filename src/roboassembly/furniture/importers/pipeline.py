"""What every importer does after reading: repair, then annotate."""

from __future__ import annotations

from dataclasses import dataclass, replace

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, RawFurniture
from roboassembly.furniture.repair import PartRepair, repair


@dataclass(frozen=True, eq=False)
class Imported:
    """Furniture from elsewhere, and what had to be done to it."""

    furniture: Furniture
    repairs: tuple[PartRepair, ...]


def finish(name: str, raw: RawFurniture) -> Imported:
    """Repair and annotate parts as read.

    Raises:
        FurnitureError: what cannot be repaired within limits, or does not hold together, with the reason.
    """
    repaired = repair(raw.parts)
    notes = tuple(str(r) for r in repaired.report)
    provenance = replace(raw.provenance, notes=(*raw.provenance.notes, *notes))
    furniture = annotate(name, repaired.parts, provenance)
    return Imported(furniture, repaired.report)
