"""Furniture by name: a piece of a built-in family, or a furniture folder."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from roboassembly.errors import InputError, UnknownNameError
from roboassembly.furniture import storage
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.cad import refuse_sources
from roboassembly.furniture.model import Furniture, Provenance
from roboassembly.generate import FAMILIES, generate

DEFAULT = "ladder"
"""Default furniture: a chair of 15 parts with mortise-and-tenon joints."""


def make(
    family: str, seed: int = 0, version: int = 0, *, with_grasps: bool = True, fasteners: bool = False
) -> Furniture:
    """Generate and annotate one piece.

    Args:
        family: one of `FAMILIES`.
        seed: 0 or more.
        version: 0 for the piece itself, else the number of a near relative; see `generate`.
        with_grasps: see `annotate`.
        fasteners: put screws or dowels through the joints, by the seed (`generate.fastening`). The parts are then the
            same but for holes.

    Raises:
        UnknownNameError: the family does not exist.
        InputError: the seed or the version is negative, or the family has no versions.
    """
    if seed < 0 or version < 0:
        raise InputError(f"seed {seed} and version {version} must be 0 or more")
    name = piece_name(family, seed, version)
    provenance = Provenance("generated", name, "MIT")
    parts, added = generate(family, seed, version), ()
    if fasteners:
        # Repair drills the holes; no other built-in furniture loads it.
        from roboassembly.generate.fastening import fasten

        parts, added = fasten(parts, seed)
        name = f"{name}-fastened"
    furniture = annotate(name.replace(":", "-"), parts, provenance, with_grasps=with_grasps)
    return replace(furniture, fasteners=added) if added else furniture


def piece_name(family: str, seed: int, version: int = 0) -> str:
    """Return the name by which `find` makes a piece: `FAMILY:SEED`, or `FAMILY:SEED.VERSION`."""
    return f"{family}:{seed}.{version}" if version else f"{family}:{seed}"


def find(name: str, *, with_grasps: bool = True) -> Furniture:
    """Return furniture by `FAMILY`, `FAMILY:SEED`, `FAMILY:SEED.VERSION`, or the path of a furniture folder.

    Args:
        name: name or path of the furniture.
        with_grasps: see `annotate`; furniture from a folder always has its grasps.

    Raises:
        UnknownNameError: the name is neither a family nor a path.
        FurnitureError: the folder does not contain valid furniture.
    """
    family, _, numbers = name.partition(":")
    seed, _, version = numbers.partition(".")
    if family in FAMILIES and all(number.isdigit() or not number for number in (seed, version)):
        return make(family, int(seed or 0), int(version or 0), with_grasps=with_grasps)
    if os.path.exists(name) or "/" in name:  # unlike `Path.exists`, this accepts names of any length
        refuse_sources(Path(name))
        return storage.load(name)
    if family in FAMILIES:
        raise InputError(f"seed '{numbers}' of '{name}' is not a whole number; use a name such as {family}:3")
    raise UnknownNameError("furniture (a built-in family or a folder)", name, FAMILIES)
