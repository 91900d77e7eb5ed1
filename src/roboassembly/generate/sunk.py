"""Furniture to practise on that has been through the repair of imported files.

Files of real furniture overlap at nearly every joint, by anything from a hair to the depth of a tenon, and repair cuts
pockets for that: too shallow to be seen in a cloud of points, deep enough to hold a part fast. Here the parts of what
another family made are driven into their neighbours, and repaired.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roboassembly.errors import FurnitureError
from roboassembly.furniture.contacts import Contact, find_contacts
from roboassembly.furniture.model import RawPart
from roboassembly.generate.design import Blank, Build, PartDesign, as_parts
from roboassembly.generate.solids import from_triangles, triangles
from roboassembly.geometry.meshes import Mesh
from roboassembly.repair import RepairLimits, repair

TRIES = 20
SHALLOWEST, DEEPEST = 0.0003, 0.012
"""Bounds of the depth to which a part is driven into another [m]; shallow is as frequent as deep."""
LIMITS = RepairLimits(openings=8)
"""Effort of the repair; furniture that needs more takes minutes."""
VOLUME_TOLERANCE = 0.02
"""Share of the volume that two parts may differ by to be driven in alike."""


def build(bases: Sequence[Build], rng: np.random.Generator | None) -> list[PartDesign]:
    """Return parts that one of the bases builds, driven into each other and repaired."""
    rng = np.random.default_rng(1) if rng is None else rng
    for _ in range(TRIES):
        try:
            parts = as_parts(bases[int(rng.integers(len(bases)))](rng))
            repaired = repair(_driven_in(parts, rng), limits=LIMITS).parts
            return [PartDesign(p.name, p.label, Blank(from_triangles(p.mesh.vertices, p.mesh.faces))) for p in repaired]
        except FurnitureError:
            continue  # some overlaps are refused
    raise FurnitureError(f"{TRIES} tries to drive parts into each other failed; try another seed")


def _driven_in(parts: Sequence[RawPart], rng: np.random.Generator) -> list[RawPart]:
    """Return the parts, each lengthened into some of those that it touches."""
    contacts = find_contacts([p.mesh for p in parts], [p.name for p in parts])
    share = rng.choice([0.3, 0.7, 1.0])
    depth = float(np.exp(rng.uniform(np.log(SHALLOWEST), np.log(DEEPEST))))
    solids = [from_triangles(p.mesh.vertices, p.mesh.faces) for p in parts]
    whole = list(solids)
    chosen: dict[tuple[int, int], bool] = {}
    for c in contacts:
        if not chosen.setdefault(_size_class(parts, c), bool(rng.random() < share)):
            continue
        # The lesser one is driven in, as a rail into a post.
        lesser, inward = (c.a, c.normal) if parts[c.a].mesh.volume <= parts[c.b].mesh.volume else (c.b, -c.normal)
        whole[lesser] += solids[lesser].translate(tuple((c.gap + depth) * inward))
    return [replace(p, mesh=Mesh(*triangles(s))) for p, s in zip(parts, whole, strict=True)]


def _size_class(parts: Sequence[RawPart], contact: Contact) -> tuple[int, int]:
    """Return a key that contacts between like parts share: what is done to one joint is done to all like it."""
    sizes = sorted(round(float(np.log(parts[i].mesh.volume)) / VOLUME_TOLERANCE) for i in (contact.a, contact.b))
    return sizes[0], sizes[1]
