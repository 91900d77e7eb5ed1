"""Import pipeline after reading: repair, then annotate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roboassembly.errors import FurnitureError
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, RawFastener, RawFurniture, RawPart, Site
from roboassembly.geometry.meshes import nearest_points
from roboassembly.geometry.poses import SE3
from roboassembly.importers.connection_sites import MAX_GAP
from roboassembly.repair import PartRepair, RepairLimits, RepairResult, repair
from roboassembly.repair.drilling import drill

ROUNDING = 1e-9
"""Rounding error in the distance of two sites that are moved together [m]."""

DRAWN_SHORTENING = 0.05
"""Largest reduction of a part's size or of its depth in a neighbour if parts are drawn for their looks only [m]."""


@dataclass(frozen=True, eq=False)
class Imported:
    """Imported furniture, and the repairs made to it."""

    furniture: Furniture
    repairs: tuple[PartRepair, ...]


def finish(name: str, raw: RawFurniture, *, allow_shortening: bool = False) -> Imported:
    """Repair and annotate parts as read.

    Args:
        name: name of the piece.
        raw: parts as read.
        allow_shortening: whether repair may reduce a part's size or a joint's depth without limit.

    Raises:
        FurnitureError: the parts cannot be repaired within limits, or are not connected.
    """
    repaired = _repaired(raw, allow_shortening)
    parts, fasteners = drill(repaired.parts, _moved_along(raw.fasteners, raw.parts, repaired.report))
    sites, opened = _shifted_sites(raw.sites, repaired.report)
    notes = (*raw.provenance.notes, *(str(r) for r in repaired.report), *opened)
    furniture = annotate(name, parts, replace(raw.provenance, notes=notes), with_near_shapes=True)
    # Annotation redefines the parts' frames, but does not move the parts.
    framed = tuple(replace(site, frame=furniture.assembled[site.part].actInv(site.frame)) for site in sites)
    return Imported(replace(furniture, sites=framed, fasteners=fasteners), repaired.report)


def _repaired(raw: RawFurniture, allow_shortening: bool) -> RepairResult:
    """Repair the parts; drawn ones get a wider limit if the usual one refuses them."""
    limits = RepairLimits()
    if allow_shortening:
        return repair(raw.parts, limits=replace(limits, shortening=float("inf")))
    try:
        return repair(raw.parts, limits=limits)
    except FurnitureError:
        if not raw.drawn:
            raise
        # The wider limit comes last: it also accepts losses that a remedy makes smaller.
        return repair(raw.parts, limits=replace(limits, shortening=DRAWN_SHORTENING))


def _moved_along(
    fasteners: Sequence[RawFastener], parts: Sequence[RawPart], report: Sequence[PartRepair]
) -> list[RawFastener]:
    """Return the fasteners moved with the part that each is nearest to, as repair moved that."""
    out: list[RawFastener] = []
    for fastener in fasteners:
        distances = [nearest_points(part.mesh, fastener.mesh).distance for part in parts]
        shift = np.array(report[int(np.argmin(distances))].shift)
        out.append(replace(fastener, mesh=fastener.mesh.transformed(SE3(np.eye(3), shift))))
    return out


def _shifted_sites(sites: Sequence[Site], report: Sequence[PartRepair]) -> tuple[list[Site], list[str]]:
    """Return the sites moved with their parts, in the furniture's frame, and a note for each pair that came apart.

    Sites that no longer meet have no mate.
    """
    out = [replace(site, frame=SE3(np.eye(3), np.array(report[site.part].shift)) * site.frame) for site in sites]
    notes: list[str] = []
    for index, site in enumerate(out):
        if site.mate is None or site.mate < index:
            continue
        mate = out[site.mate]
        # With a scale above 1, sites that close in the source's files may be farther apart than `MAX_GAP`.
        allowed = max(MAX_GAP, _gap(sites[index], sites[site.mate]) + ROUNDING)
        gap = _gap(site, mate)
        if gap > allowed:
            out[index], out[site.mate] = replace(site, mate=None), replace(mate, mate=None)
            notes.append(f"connection sites '{site.name}' and '{mate.name}' are {gap * 1e3:.1f} mm apart after repair")
    return out, notes


def _gap(a: Site, b: Site) -> float:
    return float(np.linalg.norm(a.frame.translation - b.frame.translation))
