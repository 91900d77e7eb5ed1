"""Furniture in other sizes, made from a piece and a factor for each axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.model import Furniture, RawPart


def resized(furniture: Furniture, name: str, factors: Float[np.ndarray, "3"], *, with_grasps: bool = True) -> Furniture:
    """Return a piece with all lengths along the furniture's axes multiplied by factors, annotated anew.

    Parts that do not overlap still do not, and touch where they touched. Parts of one shape that stand in different
    directions become different. Fasteners and marked sites are left out.

    Args:
        furniture: the piece.
        name: name of the result.
        factors: factors along x, y and z, all above 0.
        with_grasps: whether to find grasps.

    Raises:
        FurnitureError: parts are not connected any more, because their gaps have become too wide.
    """
    parts = [
        RawPart(part.name, part.mesh.transformed(slot).stretched(np.diag(factors)), part.label)
        for part, slot in zip(furniture.parts, furniture.assembled, strict=True)
    ]
    note = "resized by " + " × ".join(f"{factor:.3f}" for factor in factors)
    provenance = replace(furniture.provenance, notes=(*furniture.provenance.notes, note))
    return annotate(name, parts, provenance, with_grasps=with_grasps, with_near_shapes=True)
