"""Furniture by name: the built-in families, or a folder on disk."""

from __future__ import annotations

import os
from pathlib import Path

from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture import storage
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.cad import refuse_sources
from roboassembly.furniture.model import Furniture, Provenance
from roboassembly.generate import FAMILIES, generate

DEFAULT = "ladder"
"""What is assembled when nothing is named: a chair of 15 parts with mortise-and-tenon joints."""


def make(family: str, seed: int = 0, *, with_grasps: bool = True) -> Furniture:
    """Generate and annotate one chair.

    Args:
        family: one of `FAMILIES`.
        seed: 0 or more.
        with_grasps: as of `annotate`.

    Raises:
        UnknownNameError: no such family.
        InputError: a negative seed.
    """
    if seed < 0:
        raise InputError(f"seed {seed} is negative; 0 or more would do")
    provenance = Provenance("generated", f"{family}:{seed}", "MIT")
    return annotate(f"{family}-{seed}", generate(family, seed), provenance, with_grasps=with_grasps)


def find(name: str, *, with_grasps: bool = True) -> Furniture:
    """Furniture by `FAMILY`, `FAMILY:SEED`, or the path of a furniture folder.

    Args:
        name: of it.
        with_grasps: as of `annotate`; a folder has those that were found for it in any case.

    Raises:
        UnknownNameError: neither a family nor a path.
        FurnitureError: the folder does not hold valid furniture.
    """
    family, _, seed = name.partition(":")
    if family in FAMILIES and (seed.isdigit() or not seed):
        return make(family, int(seed or 0), with_grasps=with_grasps)
    if os.path.exists(name) or "/" in name:  # other than `Path.exists` this takes names of any length
        refuse_sources(Path(name))
        return storage.load(name)
    if family in FAMILIES:
        raise InputError(f"seed '{seed}' of '{name}' is not a whole number; write for instance {family}:3")
    raise UnknownNameError("furniture (a built-in family or a folder)", name, FAMILIES)
