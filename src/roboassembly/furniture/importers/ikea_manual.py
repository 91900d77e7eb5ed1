"""IKEA-Manuals-at-Work: pieces given as `NN.obj` parts in their assembled frame, y up, normalised."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Provenance, RawFurniture, RawPart, check_part_count
from roboassembly.meshes import MAX_FACES, Mesh

TYPICAL_SIZE = {
    "bench": (0.80, 1.60),
    "chair": (0.85, 1.20),
    "desk": (0.74, 1.50),
    "misc": (0.75, 1.20),
    "shelf": (1.50, 1.90),
    "table": (0.70, 1.50),
}
"""Height and longest side, in metres, by category folder. The files have no unit: a piece is scaled until it reaches
the first of the two that it meets, so that a tall chair is 0.85 m high and a long bench does not grow to 2 m."""
DEFAULT_SIZE = (0.85, 1.20)
LICENCE = "CC-BY-4.0"


def find(root: Path) -> list[Path]:
    """The piece folders at or below `root`: a piece, a category, `parts`, or the archive's own folder.

    Raises:
        FurnitureError: no such folder, or no piece in it.
    """
    root = Path(root)
    if not root.is_dir():
        raise FurnitureError(f"'{root}' is not a folder; give a folder of NN.obj files, or one that holds such folders")
    pieces = sorted({path.parent for path in root.rglob("*.obj")})
    if not pieces:
        raise FurnitureError(f"'{root}' holds no .obj files; give a folder of NN.obj files, one a part")
    return pieces


def scale_for(category: str, extents: Float[np.ndarray, "3"]) -> float:
    """Metres per unit for a piece with these y-up extents, from its category's typical size."""
    height, longest = TYPICAL_SIZE.get(category.lower(), DEFAULT_SIZE)
    return min(height / float(extents[1]), longest / float(extents.max()))


def read(folder: Path, *, scale: float | None = None) -> RawFurniture:
    """The parts of one piece: z up, metres, lowest point at z = 0, centred on the z axis.

    Args:
        folder: holds the `NN.obj` files, one a part.
        scale: metres per unit of the files; by default from `TYPICAL_SIZE` and the name of the folder's parent.

    Raises:
        FurnitureError: missing folder, no or unreadable OBJ files, a part that is no mesh, or a count of parts
            outside 2 to 20.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FurnitureError(f"'{folder}' is not a folder; give a folder of NN.obj files, one a part")
    files = sorted(folder.glob("*.obj"))
    if not files:
        raise FurnitureError(f"'{folder}' holds no .obj files; give a folder of NN.obj files, one a part")
    check_part_count(len(files), str(folder))
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise FurnitureError(
            f"scale {scale!r} is not a positive number of metres per unit; leave it out for a typical size"
        )
    loaded = [_load(file) for file in files]
    points = np.concatenate([vertices[np.unique(faces)] for vertices, faces in loaded])
    low, high = points.min(axis=0), points.max(axis=0)
    factor = scale if scale is not None else scale_for(folder.resolve().parent.name, high - low)
    middle = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    out = []
    for file, (vertices, faces) in zip(files, loaded, strict=True):
        x, y, z = ((vertices - middle) * factor).T
        out.append(RawPart(file.stem, _mesh(file, np.column_stack([x, -z, y]), faces)))
    own = folder.resolve()
    return RawFurniture(tuple(out), Provenance("ikea-manual", f"{own.parent.name}/{own.name}", LICENCE, factor))


def _load(file: Path) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and triangles of an OBJ file, equal vertices merged; polygons are cut into fans."""
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    try:
        lines = file.read_text(encoding="utf-8", errors="strict").splitlines()
    except (OSError, UnicodeDecodeError) as problem:
        raise FurnitureError(f"'{file}' cannot be read as OBJ ({problem}); export it again as text OBJ") from None
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if words[:1] == ["v"]:
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            elif words[:1] == ["f"]:
                ring = [int(word.split("/", 1)[0]) for word in words[1:]]
                ring = [k - 1 if k > 0 else len(vertices) + k for k in ring]
                faces += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
        except ValueError:
            raise FurnitureError(
                f"'{file}' line {number} cannot be read as OBJ: {line[:60]!r}; 'v x y z' or 'f a b c' would do"
            ) from None
    if not faces:
        raise FurnitureError(f"'{file}' has no faces; a part needs at least four triangles")
    if len(faces) > MAX_FACES:
        raise FurnitureError(f"'{file}' has {len(faces)} faces; at most {MAX_FACES} are accepted, simplify it first")
    points, index = np.array(vertices, dtype=float).reshape(-1, 3), np.array(faces, dtype=np.int64)
    _mesh(file, points, index)
    unique, merged = np.unique(points, axis=0, return_inverse=True)
    return unique, merged.reshape(-1)[index]


def _mesh(file: Path, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Mesh:
    try:
        return Mesh(vertices, faces)
    except FurnitureError as problem:
        raise FurnitureError(f"'{file}': {problem}") from None
