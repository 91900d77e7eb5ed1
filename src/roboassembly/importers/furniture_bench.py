"""Importer for FurnitureBench: OBJ parts in metres, with poses of children in their parents' frames.

    assembled_poses.json     {"furniture": {NAME: {"parts": [...], "mesh": [...], "assembled_rel_poses":
                             [{"parent": 0, "child": 1, "alternatives": [4x4, ...]}, ...]}}}
    mesh/NAME/*.obj          paths under "mesh" are relative to the JSON file

Part 0 is the root. A part takes its first alternative that no other child of the same parent uses.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count
from roboassembly.furniture.triangles import UP_ROTATIONS, NamedTriangles, stand, unique_names
from roboassembly.importers import files
from roboassembly.importers.mesh_files import read_mesh

POSES = "assembled_poses.json"
LICENCE = "MIT"
EXPECTED = f"a folder with {POSES} and the meshes that it names"
UP = {"round_table": "-z"}
"""Up axis of the root part's frame, by name of the piece; `-y` for all others."""
_FEW_PARTS = 20
"""Number of parts for which four times as many poses are read at least."""
MAX_ALTERNATIVES = 64

_Matrix = list[list[float]]


class _Joint(msgspec.Struct, frozen=True):
    parent: int
    child: int
    alternatives: list[_Matrix]


class _Piece(msgspec.Struct, frozen=True):
    parts: list[str]
    mesh: list[str]
    joints: list[_Joint] = msgspec.field(name="assembled_rel_poses")


class _File(msgspec.Struct, frozen=True):
    furniture: dict[str, _Piece]


def find(root: Path) -> list[Path]:
    """Return one path for each piece: the mesh folder named after it.

    Raises:
        FurnitureError: there is no pose file at, below or above `root`, or it lists no piece at or below `root`.
    """
    root = files.folder(root, EXPECTED)
    own = _poses_above(root)
    places = [own] if own else [here for here, names in files.walk(root) if POSES in names]
    found = [
        path
        for place in places
        for name in files.read_json(place / POSES, _File).furniture
        if (path := files.inside(place, f"mesh/{name}", f"'{place / POSES}'")).is_relative_to(root.resolve())
    ]
    if not found:
        raise FurnitureError(f"'{root}' holds nothing to import; give {EXPECTED}")
    return sorted(found)


def read(path: Path, *, scale: float | None = None) -> RawFurniture:
    """Read the parts of one piece at their assembled poses: z up, metres, on the ground.

    Args:
        path: `.../mesh/NAME`, below the folder of `assembled_poses.json`.
        scale: metres per unit of the files; 1 by default.

    Raises:
        FurnitureError: files are missing or broken, a pose is not rigid, poses do not reach a part or form a loop, a
            mesh lies outside the folder, or there are not 2 to 1000 parts.
    """
    path = Path(path).resolve()
    place = _poses_above(path)
    if place is None:
        raise FurnitureError(f"'{path}' has no {POSES} beside or above it; give {EXPECTED}")
    where = f"'{place / POSES}'"
    pieces = files.read_json(place / POSES, _File).furniture
    if path.name not in pieces:
        raise FurnitureError(f"{where} has no piece '{path.name}'; it has {files.one_line(', '.join(sorted(pieces)))}")
    piece, name = pieces[path.name], path.name
    check_part_count(len(piece.parts), name)
    if len(piece.mesh) != len(piece.parts):
        raise FurnitureError(f"{where}: '{name}' has {len(piece.parts)} parts and {len(piece.mesh)} meshes")
    poses = _poses(piece, f"{where}: '{name}'")
    names = unique_names([files.one_line(part, 80) or "part" for part in piece.parts])
    parts = [
        NamedTriangles(part, read_mesh(files.inside(place, mesh, where)).moved(pose))
        for part, mesh, pose in zip(names, piece.mesh, poses, strict=True)
    ]
    factor = 1.0 if scale is None else scale
    rotation = UP_ROTATIONS[UP.get(name, "-y")]
    return RawFurniture(stand(parts, rotation, factor, name), Provenance("furniture-bench", name, LICENCE, factor))


def reads(path: Path) -> Path:
    """Return the folder of the pose file, which also holds the meshes; `path` itself if there is no pose file."""
    return _poses_above(path) or path


def _poses_above(path: Path) -> Path | None:
    """Return the nearest folder, at most two levels up, that holds the pose file."""
    here = path.resolve()
    return next((place for place in (here, *here.parents[:2]) if (place / POSES).is_file()), None)


def _poses(piece: _Piece, where: str) -> list[Float[np.ndarray, "4 4"]]:
    """Return `root_from_part` for each part."""
    count = len(piece.parts)
    if len(piece.joints) > 4 * max(count, _FEW_PARTS):
        raise FurnitureError(f"{where} has {len(piece.joints)} poses for {count} parts")
    placed: dict[int, Float[np.ndarray, "4 4"]] = {0: np.eye(4)}
    used: list[tuple[int, Float[np.ndarray, "4 4"]]] = []
    pending = list(piece.joints)
    while pending:
        ready = [joint for joint in pending if joint.parent in placed]
        if not ready:
            break
        joint = ready[0]
        pending.remove(joint)
        if joint.child in placed or not 0 <= joint.child < count:
            raise FurnitureError(f"{where}: part {joint.child} is placed twice, or does not exist")
        options = [_matrix(m, f"{where}: part {joint.child}") for m in joint.alternatives[:MAX_ALTERNATIVES]]
        free = [m for m in options if not any(p == joint.parent and np.allclose(m, t) for p, t in used)]
        if not free:
            raise FurnitureError(f"{where}: part {joint.child} has no pose that is free; other parts use all of them")
        used.append((joint.parent, free[0]))
        placed[joint.child] = placed[joint.parent] @ free[0]
    lost = [piece.parts[k] for k in range(count) if k not in placed]
    if lost:
        raise FurnitureError(f"{where}: no chain of poses leads to part '{files.one_line(lost[0], 80)}'")
    return [placed[k] for k in range(count)]


def _matrix(rows: _Matrix, where: str) -> Float[np.ndarray, "4 4"]:
    """Return a pose as a rigid 4x4 matrix; raises `FurnitureError` if it is not rigid."""
    if len(rows) != 4 or any(len(row) != 4 for row in rows):
        raise FurnitureError(f"{where}: a pose is 4 rows of 4 numbers")
    matrix = np.array(rows, dtype=float)
    rotation = matrix[:3, :3]
    rigid = np.isfinite(matrix).all() and np.abs(matrix).max() < 1e6
    if not (rigid and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0):
        raise FurnitureError(f"{where}: a pose is a rotation and a translation; this matrix is not one")
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise FurnitureError(f"{where}: the last row of a pose is 0 0 0 1")
    return matrix
