"""What every importer does after reading: repair, then annotate."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, RawFurniture
from roboassembly.furniture.repair import PartRepair, repair
from roboassembly.poses import SE3


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
    sites = tuple(
        replace(site, frame=furniture.assembled[site.part].actInv(SE3(np.eye(3), np.array(moved.shift)) * site.frame))
        for site in raw.sites
        for moved in [repaired.report[site.part]]
    )
    return Imported(replace(furniture, sites=sites), repaired.report)
