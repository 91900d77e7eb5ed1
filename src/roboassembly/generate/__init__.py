"""Furniture made from a seed: solid parts that mate with a clearance, with joints that decide the order of assembly.

The furniture's frame: metres, z up, feet on z = 0, centred in x and y. A sitter looks along -y and has +x on the
left hand.
"""

from __future__ import annotations

import zlib
from functools import partial

import numpy as np

from roboassembly.errors import UnknownNameError
from roboassembly.furniture.model import RawPart
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
from roboassembly.generate.remade import fused, remade, sunk
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

__all__ = ["ABSTRACT", "CHAIRS", "CLEARANCE", "FAMILIES", "OTHERS", "Family", "Kind", "generate"]

DESIGNS: tuple[type[Design], ...] = (
    LadderChair, WindsorChair, PanelChair, PedestalChair, SledChair, RockerChair, Stool, UpholsteredChair,
    CantileverChair, ThreeLeggedChair, SplatChair, Throne, PlankChair, FoldingChair, ShellChair, SlattedBench,
    GardenChair, ApronTable, TrestleTable, OpenShelf, Bookcase, Lattice, Carcass,
)  # fmt: skip
"""Families that are declared; `fused` and `sunk` start from their parts."""
FAMILIES: dict[str, Family] = {design.family.name: design.family for design in DESIGNS}
"""Everything that can be made from a seed, by name."""

FUSED_FROM = (
    "ladder", "windsor", "panel", "pedestal", "sled", "stool", "upholstered", "cantilever", "three_legged", "throne",
    "plank", "shell", "bench", "lattice", "lattice", "lattice", "carcass", "carcass",
)  # fmt: skip
"""Families that `fused` and `sunk` start from, some more often: only those that data sets train on, and practice."""
FAMILIES["fused"] = Family(
    "fused",
    "other families' parts joined at random",
    partial(remade, fused, [FAMILIES[name].build for name in FUSED_FROM]),
    "abstract",
)
FAMILIES["sunk"] = Family(
    "sunk",
    "other families' parts driven into each other, and repaired like imported ones",
    partial(remade, sunk, [FAMILIES[name].build for name in (*FUSED_FROM, "fused", "fused", "fused")]),
    "abstract",
)

CHAIRS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "chair"}
"""Built-in chairs: what is trained on and measured."""

OTHERS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind in ("table", "shelf")}
"""Furniture that is not a chair, for trying what was never trained on."""

ABSTRACT: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "abstract"}
"""Structures to learn from that are no furniture."""


def generate(family: str, seed: int) -> tuple[RawPart, ...]:
    """Make one piece of furniture; a family and a seed give the same one everywhere, seed 0 the catalogue model.

    Raises:
        UnknownNameError: no such family.
    """
    if family not in FAMILIES:
        raise UnknownNameError("furniture family", family, FAMILIES)
    rng = None if seed == 0 else np.random.default_rng([zlib.crc32(family.encode()), seed])
    return as_parts(FAMILIES[family].build(rng))
