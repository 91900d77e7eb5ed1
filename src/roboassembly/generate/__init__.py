"""Furniture made from a seed: solid parts that mate with a clearance, with joints that decide the order of assembly.

The furniture's frame: metres, z up, feet on z = 0, centred in x and y. A sitter looks along -y and has +x on the
left hand.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture.model import RawPart
from roboassembly.furniture.part_order import in_partnet_order, label_path
from roboassembly.generate.bench import GardenChair, SlattedBench
from roboassembly.generate.cantilever import CantileverChair
from roboassembly.generate.carcass import Carcass
from roboassembly.generate.design import Design, Family, Kind, as_parts
from roboassembly.generate.folding import FoldingChair
from roboassembly.generate.joints import CLEARANCE
from roboassembly.generate.ladder import LadderChair
from roboassembly.generate.lattice import Lattice
from roboassembly.generate.panel import PanelChair
from roboassembly.generate.pedestal import PedestalChair
from roboassembly.generate.plank import PlankChair
from roboassembly.generate.remade import fused, overlapping, remade, sunk
from roboassembly.generate.shell import ShellChair
from roboassembly.generate.shelves import Bookcase, OpenShelf
from roboassembly.generate.side_frames import RockerChair, SledChair
from roboassembly.generate.splat import SplatChair
from roboassembly.generate.stool import Stool
from roboassembly.generate.tables import ApronTable, TrestleTable
from roboassembly.generate.three_legged import ThreeLeggedChair
from roboassembly.generate.throne import Throne
from roboassembly.generate.upholstered import UpholsteredChair
from roboassembly.generate.windsor import WindsorChair
from roboassembly.geometry.meshes import Mesh

__all__ = ["ABSTRACT", "CHAIRS", "CLEARANCE", "FAMILIES", "OTHERS", "Family", "Kind", "generate"]

DESIGNS: tuple[type[Design], ...] = (
    LadderChair, WindsorChair, PanelChair, PedestalChair, SledChair, RockerChair, Stool, UpholsteredChair,
    CantileverChair, ThreeLeggedChair, SplatChair, Throne, PlankChair, FoldingChair, ShellChair, SlattedBench,
    GardenChair, ApronTable, TrestleTable, OpenShelf, Bookcase, Lattice, Carcass,
)  # fmt: skip
"""Families that are declared; `fused`, `sunk` and `overlapping` start from their parts."""
FAMILIES: dict[str, Family] = {design.family.name: design.family for design in DESIGNS}
"""Everything that can be made from a seed, by name."""

FUSED_FROM = (
    "ladder", "windsor", "panel", "pedestal", "sled", "stool", "upholstered", "cantilever", "three_legged", "throne",
    "plank", "shell", "bench", "lattice", "lattice", "lattice", "carcass", "carcass",
)  # fmt: skip
"""Families that `fused` starts from, some more often: only those that data sets train on, and practice."""
FAMILIES["fused"] = Family(
    "fused",
    "other families' parts joined at random",
    partial(remade, fused, [FAMILIES[name].build for name in FUSED_FROM]),
    "abstract",
)
_DRIVEN_FROM = [FAMILIES[name].build for name in (*FUSED_FROM, "fused", "fused", "fused")]
"""Families that `sunk` and `overlapping` start from."""
FAMILIES["sunk"] = Family(
    "sunk",
    "other families' parts driven into each other, and repaired like imported ones",
    partial(remade, sunk, _DRIVEN_FROM),
    "abstract",
)
FAMILIES["overlapping"] = Family(
    "overlapping",
    "other families' parts driven into each other by centimetres, and repaired like imported ones",
    partial(remade, overlapping, _DRIVEN_FROM),
    "abstract",
)

CHAIRS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "chair"}
"""Built-in chairs: what is trained on and measured."""

OTHERS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind in ("table", "shelf")}
"""Furniture that is not a chair, for trying what was never trained on."""

ABSTRACT: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "abstract"}
"""Structures that are no furniture: to learn from, and with overlapping parts to measure on."""


def generate(family: str, seed: int, version: int = 0) -> tuple[RawPart, ...]:
    """Make one piece of furniture; family, seed and version give the same one everywhere, seed 0 the catalogue model.

    Parts are in PartNet's order; see `furniture.part_order`.

    Args:
        family: one of `FAMILIES`.
        seed: 0 or more.
        version: 0 for the piece itself; each other number gives a near relative of it, with sizes within ± 10 % and,
            for every other one on average, left and right exchanged.

    Raises:
        UnknownNameError: no such family.
        InputError: the family has no versions.
    """
    if family not in FAMILIES:
        raise UnknownNameError("furniture family", family, FAMILIES)
    key = zlib.crc32(family.encode())
    rng = None if seed == 0 else np.random.default_rng([key, seed])
    if version == 0:
        return _labeled(as_parts(FAMILIES[family].build(rng)))
    design = FAMILIES[family].design
    if design is None:
        raise InputError(f"the family '{family}' has no versions of its pieces; give a seed alone")
    varying = np.random.default_rng([key, seed, version])
    parts = as_parts((design() if rng is None else design.sample(rng)).varied(varying).parts())
    return _labeled([_mirrored(part) for part in parts] if varying.random() < 0.5 else parts)


def _labeled(parts: Sequence[RawPart]) -> tuple[RawPart, ...]:
    """Return the parts in PartNet's order, labelled with their paths in its hierarchy."""
    return in_partnet_order([replace(part, label=label_path(part.label)) for part in parts])


def _mirrored(part: RawPart) -> RawPart:
    """Return a part's mirror image across x = 0."""
    other = {"left": "right", "right": "left"}
    name = "_".join(other.get(word, word) for word in part.name.split("_"))
    return RawPart(name, Mesh(part.mesh.vertices * (-1.0, 1.0, 1.0), part.mesh.faces[:, ::-1]), part.label)
