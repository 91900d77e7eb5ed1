"""Importer for a folder of mesh files, one for each named part in its assembled pose, or for a single file.

A single file is a GLB scene of named nodes, or a mesh of several separate bodies to be split.

Unit: guessed from typical sizes of furniture (see `units`) and recorded in the provenance; `scale` overrides it.

Up axis: z for OBJ, STL and PLY, y for GLB (as its standard says); `up` overrides it.
"""

from __future__ import annotations

from pathlib import Path

from roboassembly.errors import FurnitureError
from roboassembly.furniture.cad import refuse_cad
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count
from roboassembly.furniture.triangles import (
    UP_ROTATIONS,
    NamedTriangles,
    Up,
    bounds,
    check_scale,
    combine,
    stand,
    unique_names,
)
from roboassembly.geometry import units
from roboassembly.importers import bodies, files
from roboassembly.importers.glb import count_parts, read_glb
from roboassembly.importers.mesh_files import READERS, read_mesh

SUFFIXES = (*READERS, ".glb")
EXPECTED = f"a folder of named parts ({', '.join(SUFFIXES)}), one GLB scene, or a folder that holds such"


def find(root: Path) -> list[Path]:
    """Return the pieces at or below `root`: folders that directly contain mesh files, and GLB scenes.

    A folder with several files is one piece, and each file is a part. If all files are GLB scenes of two or more
    named nodes, each file is a piece.

    Raises:
        FurnitureError: the path does not exist, or holds no mesh file.
    """
    root = Path(root)
    refuse_cad(root)
    if root.is_file():
        if not _is_mesh(root.name):
            raise FurnitureError(f"'{root}' is not a mesh file; give {EXPECTED}")
        return [root]
    if not any(_is_mesh(name) for _, names in files.walk(root) for name in names):
        refuse_cad(root, whole=True)
    pieces: list[Path] = []
    for here in files.find_folders(root, lambda _, names: any(map(_is_mesh, names)), EXPECTED):
        meshes = _meshes(here)
        scenes = [file for file in meshes if file.suffix.lower() == ".glb"]
        if len(scenes) == len(meshes) and (len(scenes) == 1 or all(count_parts(file) > 1 for file in scenes)):
            pieces += scenes
        else:
            pieces.append(here)
    return sorted(pieces)


def read(path: Path, *, scale: float | None = None, up: Up | None = None, split: bool = False) -> RawFurniture:
    """Read the parts of one piece: z up, metres, lowest point at z = 0, centred on the z axis.

    Args:
        path: folder of mesh files named after their parts, a GLB scene, or a mesh file of several bodies.
        scale: metres per unit of the files; guessed by default, see the module.
        up: up axis of the files; by default z, or y for GLB.
        split: whether each separate body of a mesh becomes a part.

    Raises:
        FurnitureError: the path is empty, a file cannot be read, the size is absurd, or there are not 2 to 1000 parts.
    """
    path = Path(path)
    check_scale(scale)
    if up is not None and up not in UP_ROTATIONS:
        known = ", ".join(UP_ROTATIONS)
        raise FurnitureError(f"up axis {files.one_line(repr(up), 40)} is not known; expected one of {known}")
    single = path.is_file()
    glb = single and path.suffix.lower() == ".glb"
    parts = read_glb(path) if glb else [_read_part(path)] if single else _read_folder(path)
    if split:
        parts, remarks = bodies.split(parts)
    elif len(parts) == 1:
        raise FurnitureError(_alone(path, parts[0]))
    else:
        counts = {part.name: bodies.count_closed(part.triangles) for part in parts}
        remarks = [
            f"{name}: one part of {count} separate bodies; --split would make each a part"
            for name, count in counts.items()
            if count > 1
        ]
    check_part_count(len(parts), f"'{path}'")
    axis = up or ("y" if glb or (not single and all(f.suffix.lower() == ".glb" for f in _meshes(path))) else "z")
    low, high = bounds(parts, UP_ROTATIONS[axis])
    unit = units.given(scale) if scale is not None else units.guess((high - low).tolist())
    own = files.one_line(path.resolve().stem if single else path.resolve().name)
    provenance = Provenance("folder", own, "", unit.scale, (f"unit: {unit.text}, {axis} up in the files",))
    made = stand(parts, UP_ROTATIONS[axis], unit.scale, f"'{path}'")
    return RawFurniture(made, provenance, unit=unit, remarks=tuple(remarks))


def _alone(path: Path, part: NamedTriangles) -> str:
    """Return the message for a single mesh, which is not furniture: the reason and the remedy."""
    count = len(bodies.split([part])[0])
    if count > 1:
        return f"'{path}': one mesh of {count} separate bodies; --split makes a part of each"
    return f"'{path}': 1 part; furniture has 2 or more: give {EXPECTED}"


def _is_mesh(name: str) -> bool:
    return name.lower().endswith(SUFFIXES) and not name.startswith(".")


def _meshes(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if _is_mesh(file.name) and file.is_file())


def _read_folder(path: Path) -> list[NamedTriangles]:
    path = files.folder(path, EXPECTED)
    meshes = _meshes(path)
    if not meshes:
        raise FurnitureError(f"'{path}' holds no mesh files; give {EXPECTED}")
    check_part_count(len(meshes), f"'{path}'", least=1)
    names = unique_names([_part_name(file) for file in meshes])
    return [NamedTriangles(name, _read_part(file).triangles) for name, file in zip(names, meshes, strict=True)]


def _read_part(file: Path) -> NamedTriangles:
    """Read a whole file as one part."""
    if file.suffix.lower() == ".glb":
        return NamedTriangles(_part_name(file), combine([part.triangles for part in read_glb(file)]))
    return NamedTriangles(_part_name(file), read_mesh(file))


def _part_name(file: Path) -> str:
    return files.one_line(file.stem, 80) or "part"
