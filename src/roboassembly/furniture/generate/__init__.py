"""Chairs made from a seed: solid parts that mate with a clearance, with joints that decide the order of assembly.

The furniture's frame: metres, z up, feet on z = 0, centred in x and y. A sitter looks along -y and has +x on the
left hand.
"""

from __future__ import annotations

import zlib

import numpy as np

from roboassembly.errors import UnknownNameError
from roboassembly.furniture.generate import ladder, panel, pedestal, sideframe, stool, windsor
from roboassembly.furniture.generate.joints import CLEARANCE
from roboassembly.furniture.generate.pieces import Family, as_parts
from roboassembly.furniture.model import RawPart

__all__ = ["CLEARANCE", "FAMILIES", "Family", "generate"]

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
    )
}


def generate(family: str, seed: int) -> tuple[RawPart, ...]:
    """Make one chair. The same family and seed give the same chair everywhere; seed 0 is the catalogue model.

    Raises:
        UnknownNameError: no such family.
    """
    if family not in FAMILIES:
        raise UnknownNameError("chair family", family, FAMILIES)
    rng = None if seed == 0 else np.random.default_rng([zlib.crc32(family.encode()), seed])
    return as_parts(FAMILIES[family].build(rng))
