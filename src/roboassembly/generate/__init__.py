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
from roboassembly.generate import (
    bench,
    cantilever,
    carcass,
    folding,
    fused,
    ladder,
    lattice,
    panel,
    pedestal,
    plank,
    shell,
    shelves,
    sideframe,
    splat,
    stool,
    sunk,
    tables,
    three_legged,
    throne,
    upholstered,
    windsor,
)
from roboassembly.generate.joints import CLEARANCE
from roboassembly.generate.pieces import Family, Kind, as_parts

__all__ = ["CHAIRS", "CLEARANCE", "FAMILIES", "OTHERS", "PRACTICE", "Family", "Kind", "generate"]

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        Family("ladder", "four posts, slats tenoned between the rear two, seat on top", ladder.build),
        Family("windsor", "saddled seat on splayed turned legs, spindles under a bent comb", windsor.build),
        Family("panel", "board seat on tapered legs, boards in grooves between two posts, armrests", panel.build),
        Family(
            "pedestal", "five feet around a hub, column with cover, upholstered seat, back on a bar", pedestal.build
        ),
        Family(
            "sled", "two side frames on flat runners, armrests, cushion on rails between them", sideframe.build_sled
        ),
        Family("rocker", "two side frames on curved runners, spindles between two rails", sideframe.build_rocker),
        Family("stool", "turned legs, stretchers between all four, seat on top", stool.build),
        Family("upholstered", "thick seat, thick back and armrest blocks on legs or a plinth", upholstered.build),
        Family("cantilever", "two strips bent from floor to back, seat and back between them", cantilever.build),
        Family(
            "three_legged",
            "round seat on three legs a third of a turn apart, with or without a back",
            three_legged.build,
        ),
        Family("splat", "board seat, curved front legs, a vase between seat and crest", splat.build),
        Family("throne", "board sides to the armrests, seat and back in their grooves, a crest on top", throne.build),
        Family("plank", "seat on two boards with a keyed stretcher, a carved board for a back", plank.build),
        Family("folding", "two pairs of crossed legs with rods, seat and slats between them", folding.build),
        Family("shell", "seat and back bent from one piece, on two bars with splayed legs", shell.build),
        Family("bench", "two-seater: slatted seat and back between two sides, armrests", bench.build_bench),
        Family("garden", "slats between two sides that are sawn in one piece, armrests", bench.build_garden),
        Family("table_apron", "four tapered legs joined by aprons, top on them", tables.build_apron, "table"),
        Family(
            "table_trestle", "two trestles of foot, post and head, a stretcher between", tables.build_trestle, "table"
        ),
        Family("shelf_open", "boards and bars housed between two sides", shelves.build_open, "shelf"),
        Family(
            "shelf_bookcase",
            "boards between sides, back in grooves that the top closes",
            shelves.build_bookcase,
            "shelf",
        ),
        Family("lattice", "posts, rails, spindles, panels and boards at random", lattice.build, "practice"),
        Family("carcass", "boards between, on and behind boards at random", carcass.build, "practice"),
    )
}
"""Everything that can be made from a seed, by name."""

FUSED_FROM = (
    "ladder", "windsor", "panel", "pedestal", "sled", "stool", "upholstered", "cantilever", "three_legged", "throne",
    "plank", "shell", "bench", "lattice", "lattice", "lattice", "carcass", "carcass",
)  # fmt: skip
"""What `fused` and `sunk` start from, some more often: only families that data sets train on, and practice."""
FAMILIES["fused"] = Family(
    "fused",
    "other families' parts joined at random",
    partial(fused.build, tuple(FAMILIES[name].build for name in FUSED_FROM)),
    "practice",
)
FAMILIES["sunk"] = Family(
    "sunk",
    "other families' parts driven into each other, and repaired like imported ones",
    partial(sunk.build, tuple(FAMILIES[name].build for name in (*FUSED_FROM, "fused", "fused", "fused"))),
    "practice",
)

CHAIRS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "chair"}
"""The built-in chairs: what is trained on and measured."""

OTHERS: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind in ("table", "shelf")}
"""Furniture that is not a chair, for trying what was never trained on."""

PRACTICE: dict[str, Family] = {name: family for name, family in FAMILIES.items() if family.kind == "practice"}
"""No furniture, but to learn from."""


def generate(family: str, seed: int) -> tuple[RawPart, ...]:
    """Make one piece of furniture; a family and a seed give the same one everywhere, seed 0 the catalogue model.

    Raises:
        UnknownNameError: no such family.
    """
    if family not in FAMILIES:
        raise UnknownNameError("furniture family", family, FAMILIES)
    rng = None if seed == 0 else np.random.default_rng([zlib.crc32(family.encode()), seed])
    return as_parts(FAMILIES[family].build(rng))
