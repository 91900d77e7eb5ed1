"""A plain folder of mesh files, one a named part in its assembled pose; or one GLB scene of named nodes.

Unit: metres, unless that makes an absurd size. If the longest side of all parts together is not 0.1 to 4 units, the
files are taken to be in centimetres (10 to 250), then millimetres (100 to 4,000); if neither fits, the piece is scaled
to a longest side of 1 m. The provenance says which. `scale` overrides it.

Up axis: z for OBJ, STL and PLY, y for GLB (as its standard says); `up` overrides it.
"""

from __future__ import annotations

from pathlib import Path

from roboassembly.errors import FurnitureError
from roboassembly.furniture.importers import files
from roboassembly.furniture.importers.glb import count_parts, read_glb
from roboassembly.furniture.importers.mesh_files import READERS, read_mesh
from roboassembly.furniture.importers.triangles import (
    UP_ROTATIONS,
    NamedTriangles,
    Up,
    bounds,
    check_scale,
    combine,
    stand,
    unique_names,
)
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count

SUFFIXES = (*READERS, ".glb")
WANTED = f"a folder of named parts ({', '.join(SUFFIXES)}), one GLB scene, or a folder that holds such"
UNITS = ((1.0, "metres", 0.1, 4.0), (0.01, "centimetres", 10.0, 250.0), (0.001, "millimetres", 100.0, 4000.0))
"""Metres per unit, its name, and the range of the longest side, in that unit, in which it is believed."""


def find(root: Path) -> list[Path]:
    """The pieces at or below `root`: folders with mesh files directly in them, and GLB scenes.

    A folder with several files is one piece, a file a part; unless all of them are GLB scenes of two or more named
    nodes each: then each is a piece.

    Raises:
        FurnitureError: no such file or folder, or no mesh file in it.
    """
    root = Path(root)
    if root.is_file():
        if root.suffix.lower() != ".glb":
            raise FurnitureError(f"'{root}' is a single part; give {WANTED}")
        return [root]
    pieces: list[Path] = []
    for here in files.find_folders(root, lambda _, names: any(map(_is_mesh, names)), WANTED):
        meshes = _meshes(here)
        scenes = [file for file in meshes if file.suffix.lower() == ".glb"]
        if len(scenes) == len(meshes) and (len(scenes) == 1 or all(count_parts(file) > 1 for file in scenes)):
            pieces += scenes
        else:
            pieces.append(here)
    return sorted(pieces)


def read(path: Path, *, scale: float | None = None, up: Up | None = None) -> RawFurniture:
    """The parts of one piece: z up, metres, lowest point at z = 0, centred on the z axis.

    Args:
        path: a folder of mesh files, each named as its part, or one GLB scene.
        scale: metres per unit of the files; guessed by default, see above.
        up: the files' up axis; by default z, or y for GLB.

    Raises:
        FurnitureError: nothing there, a file that cannot be read, an absurd size, or a count of parts outside 2 to 20.
    """
    path = Path(path)
    check_scale(scale)
    if up is not None and up not in UP_ROTATIONS:
        raise FurnitureError(f"up axis {files.one_line(repr(up), 40)} is not known; {', '.join(UP_ROTATIONS)} would do")
    parts = read_glb(path) if path.is_file() and path.suffix.lower() == ".glb" else _read_folder(path)
    check_part_count(len(parts), f"'{path}'")
    glb = path.suffix.lower() == ".glb" and path.is_file()
    axis = up or ("y" if glb or all(f.suffix.lower() == ".glb" for f in _meshes(path)) else "z")
    low, high = bounds(parts, UP_ROTATIONS[axis])
    factor, note = (scale, "scale given") if scale is not None else guess_unit(float((high - low).max()))
    own = files.one_line(path.resolve().stem if glb else path.resolve().name)
    provenance = Provenance("folder", own, "", factor, (f"{note}, {axis} up in the files",))
    return RawFurniture(stand(parts, UP_ROTATIONS[axis], factor, f"'{path}'"), provenance)


def guess_unit(longest: float) -> tuple[float, str]:
    """Metres per unit for a piece whose longest side is so many units, and why."""
    for factor, name, low, high in UNITS:
        if low <= longest <= high:
            return factor, f"taken to be in {name}"
    if not longest > 0:
        raise FurnitureError("all its points are one and the same; give parts with some extent")
    return 1.0 / longest, f"longest side of {longest:.4g} units fits no unit: scaled to 1 m"


def _is_mesh(name: str) -> bool:
    return name.lower().endswith(SUFFIXES) and not name.startswith(".")


def _meshes(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if _is_mesh(file.name) and file.is_file())


def _read_folder(path: Path) -> list[NamedTriangles]:
    path = files.folder(path, WANTED)
    meshes = _meshes(path)
    if not meshes:
        raise FurnitureError(f"'{path}' holds no mesh files; give {WANTED}")
    check_part_count(len(meshes), f"'{path}'")
    names = unique_names([files.one_line(file.stem, 80) or "part" for file in meshes])
    out = []
    for name, file in zip(names, meshes, strict=True):
        if file.suffix.lower() == ".glb":
            surface = combine([part.triangles for part in read_glb(file)])
        else:
            surface = read_mesh(file)
        out.append(NamedTriangles(name, surface))
    return out
