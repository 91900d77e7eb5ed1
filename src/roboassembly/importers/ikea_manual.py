"""Importer for IKEA-Manuals-at-Work: `NN.obj` parts in the assembled frame, y up, normalised."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count
from roboassembly.furniture.triangles import (
    UP_ROTATIONS,
    NamedTriangles,
    bounds,
    check_scale,
    stand,
    typical_scale,
)
from roboassembly.importers import files
from roboassembly.importers.mesh_files import read_mesh

LICENCE = "CC-BY-4.0"
EXPECTED = "a folder of NN.obj files, one for each part"


def find(root: Path) -> list[Path]:
    """Return the piece folders at or below `root`: a piece, a category, `parts`, or the archive's own folder.

    Raises:
        FurnitureError: the folder does not exist, or holds no piece.
    """
    root = files.folder(root, f"{EXPECTED}, or one that holds such folders")
    pieces = sorted(here for here, names in files.walk(root) if any(name.endswith(".obj") for name in names))
    if not pieces:
        raise FurnitureError(f"'{root}' holds no .obj files; give {EXPECTED}")
    return pieces


def scale_for(category: str, extents: Float[np.ndarray, "3"]) -> float:
    """Return the metres per unit of a piece from its y-up extents and its category's typical size."""
    return typical_scale(category, float(extents[1]), float(extents.max()))


def read(path: Path, *, scale: float | None = None) -> RawFurniture:
    """Read the parts of one piece: z up, metres, lowest point at z = 0, centred on the z axis.

    Args:
        path: folder of `NN.obj` files, one for each part.
        scale: metres per unit of the files; by default from the typical size of the category (parent folder).

    Raises:
        FurnitureError: the folder is missing, OBJ files are missing or unreadable, the size is absurd, or there are
            not 2 to 1000 parts.
    """
    folder = files.folder(path, EXPECTED)
    meshes = sorted(folder.glob("*.obj"))
    if not meshes:
        raise FurnitureError(f"'{folder}' holds no .obj files; give {EXPECTED}")
    check_part_count(len(meshes), str(folder))
    check_scale(scale)
    parts = [NamedTriangles(files.one_line(file.stem, 80), read_mesh(file)) for file in meshes]
    low, high = bounds(parts, np.eye(3))
    own = folder.resolve()
    factor = scale if scale is not None else scale_for(own.parent.name, high - low)
    raw = stand(parts, UP_ROTATIONS["y"], factor, str(folder))
    return RawFurniture(raw, Provenance("ikea-manual", f"{own.parent.name}/{own.name}", LICENCE, factor))
