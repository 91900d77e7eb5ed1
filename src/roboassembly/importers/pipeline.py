"""What every importer does after reading: repair, then annotate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, RawFurniture, Site
from roboassembly.geometry.poses import SE3
from roboassembly.importers.connection_sites import CLOSES
from roboassembly.repair import PartRepair, RepairLimits, repair

ROUNDING = 1e-9
"""Metres: what moving two sites together may change about their distance."""


@dataclass(frozen=True, eq=False)
class Imported:
    """Furniture from elsewhere, and what had to be done to it."""

    furniture: Furniture
    repairs: tuple[PartRepair, ...]


def finish(name: str, raw: RawFurniture, *, allow_shortening: bool = False) -> Imported:
    """Repair and annotate parts as read.

    Args:
        name: of the piece.
        raw: parts as read.
        allow_shortening: lift the limit on what repair may take off a part's size or a joint's depth.

    Raises:
        FurnitureError: what cannot be repaired within limits, or does not hold together, with the reason.
    """
    limits = replace(RepairLimits(), shortening=float("inf")) if allow_shortening else RepairLimits()
    repaired = repair(raw.parts, limits=limits)
    sites, opened = _moved(raw.sites, repaired.report)
    notes = (*raw.provenance.notes, *(str(r) for r in repaired.report), *opened)
    furniture = annotate(name, repaired.parts, replace(raw.provenance, notes=notes))
    # Annotation lays the parts' frames anew, but leaves the parts where they are.
    framed = tuple(replace(site, frame=furniture.assembled[site.part].actInv(site.frame)) for site in sites)
    return Imported(replace(furniture, sites=framed), repaired.report)


def _moved(sites: Sequence[Site], report: Sequence[PartRepair]) -> tuple[list[Site], list[str]]:
    """The sites where repair moved their parts to, still in the furniture's frame; a note for each pair that it opened.

    Sites that no longer meet have no mate.
    """
    out = [replace(site, frame=SE3(np.eye(3), np.array(report[site.part].shift)) * site.frame) for site in sites]
    notes: list[str] = []
    for index, site in enumerate(out):
        if site.mate is None or site.mate < index:
            continue
        mate = out[site.mate]
        # Scaled up, sites that closed in the source's files may be more than that apart.
        allowed = max(CLOSES, _gap(sites[index], sites[site.mate]) + ROUNDING)
        gap = _gap(site, mate)
        if gap > allowed:
            out[index], out[site.mate] = replace(site, mate=None), replace(mate, mate=None)
            notes.append(f"connection sites '{site.name}' and '{mate.name}' are {gap * 1e3:.1f} mm apart after repair")
    return out, notes


def _gap(a: Site, b: Site) -> float:
    return float(np.linalg.norm(a.frame.translation - b.frame.translation))
