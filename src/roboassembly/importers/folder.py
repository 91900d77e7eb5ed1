"""Importer for a folder of mesh files, one for each named part in its assembled pose, or for a single file.

A single file is a scene of named parts (glTF, STEP, 3MF), or a mesh of several separate bodies, which are split.

Unit: as STEP and 3MF files state it. For other files it is guessed from typical sizes of furniture (see `units`) and
recorded in the provenance; `scale` overrides both.

Up axis: z, but y for glTF (as its standard says); `up` overrides it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roboassembly.errors import FurnitureError
from roboassembly.furniture.cad import refuse_cad
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count
from roboassembly.furniture.triangles import (
    UP_ROTATIONS,
    NamedTriangles,
    Triangles,
    Up,
    bounds,
    check_scale,
    combine,
    stand,
    unique_names,
)
from roboassembly.geometry import units
from roboassembly.geometry.units import Unit
from roboassembly.importers import bodies, files
from roboassembly.importers.mesh_files import READERS, read_mesh
from roboassembly.importers.scene import FileScene
from roboassembly.importers.scene_files import SCENES, scene_format

SUFFIXES = (*READERS, *SCENES)
_BEGINNINGS = {b"ISO-10303-21": (".step", ".stp"), b"glTF": (".glb",), b"PK\x03\x04": (".3mf",), b"ply\n": (".ply",)}
"""Suffixes of formats by the bytes that files begin with."""
EXPECTED = f"a folder of named parts ({', '.join(SUFFIXES)}), one scene ({', '.join(SCENES)}), or a folder of such"


def find(root: Path) -> list[Path]:
    """Return the pieces at or below `root`: folders that directly contain mesh files, and scenes.

    A folder with several files is one piece, and each file is a part. If all files are scenes of two or more parts,
    each file is a piece.

    Raises:
        FurnitureError: the path does not exist, or holds no mesh file.
    """
    root = Path(root)
    refuse_cad(root)
    if root.is_file():
        if not _is_mesh(root.name):
            raise FurnitureError(f"'{root}' is not a file that is read here; give {EXPECTED}")
        return [root]
    if _is_mesh(root.name) and not root.exists():
        raise FurnitureError(f"'{root}' is not there; give {EXPECTED}")
    if not any(_is_mesh(name) for _, names in files.walk(root) for name in names):
        refuse_cad(root, whole=True)
    pieces: list[Path] = []
    for here in files.find_folders(root, lambda _, names: any(map(_is_mesh, names)), EXPECTED):
        meshes = _meshes(here)
        scenes = [file for file in meshes if scene_format(file)]
        if len(scenes) == len(meshes) and (len(scenes) == 1 or all(_count_parts(file) > 1 for file in scenes)):
            pieces += scenes
        else:
            pieces.append(here)
    return sorted(pieces)


def reads(piece: Path) -> Path:
    """Return the file or folder with everything that `read` may open for a piece."""
    return piece.resolve().parent if piece.suffix.lower() == ".gltf" else piece


def read(path: Path, *, scale: float | None = None, up: Up | None = None, split: bool | None = None) -> RawFurniture:
    """Read the parts of one piece: z up, metres, lowest point at z = 0, centred on the z axis.

    Args:
        path: folder of mesh files named after their parts, a scene, or a mesh file of several bodies.
        scale: metres per unit of the files; as stated or guessed by default, see the module.
        up: up axis of the files; by default z, or y for glTF.
        split: whether each separate body of a mesh becomes a part; by default only if there is one mesh.

    Raises:
        FurnitureError: the path is empty, a file cannot be read, the size is absurd, or there are not 2 to 1000 parts.
        MissingExtraError: the file needs a library that is not installed.
    """
    path = Path(path)
    check_scale(scale)
    if up is not None and up not in UP_ROTATIONS:
        known = ", ".join(UP_ROTATIONS)
        raise FurnitureError(f"up axis {files.one_line(repr(up), 40)} is not known; expected one of {known}")
    scene = _read_file(path) if path.is_file() else _read_folder(path)
    if not scene.parts:
        raise FurnitureError(
            f"'{path}' holds no triangles; export the parts of the piece, not an empty or hidden scene"
        )
    parts, remarks = _divided(path, list(scene.parts), split)
    check_part_count(len(parts), f"'{path}'")
    axis = up or scene.up
    low, high = bounds(parts, UP_ROTATIONS[axis])
    unit = _unit(scene.unit, (high - low).tolist(), scale)
    own = files.one_line(path.resolve().stem if path.is_file() else path.resolve().name)
    provenance = Provenance("folder", own, "", unit.scale, (f"unit: {unit.text}, {axis} up in the files",))
    made = stand(parts, UP_ROTATIONS[axis], unit.scale, f"'{path}'")
    return RawFurniture(made, provenance, unit=unit, remarks=tuple(remarks))


def _unit(stated: Unit | None, extents: list[float], scale: float | None) -> Unit:
    """Return the unit of a piece: as given, as stated or as guessed.

    If the stated one gives no plausible size, the likely ones are listed as other possibilities.
    """
    if scale is not None:
        return units.given(scale)
    likely = units.guess(extents)
    if stated is None:
        return likely
    if units.SMALLEST <= max(extents) * stated.scale <= units.LARGEST:
        return stated
    names = [name for name in (likely.name, *likely.others) if name not in (None, stated.name)]
    return replace(stated, others=tuple(filter(None, names)))


def _divided(path: Path, parts: list[NamedTriangles], split: bool | None) -> tuple[list[NamedTriangles], list[str]]:
    """Return the parts, split into their bodies where asked for or needed, and remarks for the user."""
    if split or (split is None and len(parts) == 1):
        divided, remarks = bodies.split(parts)
        if len(divided) > 1:
            return divided, remarks
    if len(parts) == 1:
        raise FurnitureError(_alone(path, parts[0]))
    counts = {part.name: bodies.count_closed(part.triangles) for part in parts}
    return parts, [
        f"{name}: one part of {count} separate bodies; --split would make each a part"
        for name, count in counts.items()
        if count > 1
    ]


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


def _count_parts(file: Path) -> int:
    known = scene_format(file)
    return 1 if known is None else known.count_parts(file)


def _read_file(file: Path) -> FileScene:
    _refuse_misnamed(file)
    known = scene_format(file)
    return FileScene((NamedTriangles(_part_name(file), read_mesh(file)),), "z") if known is None else known.read(file)


def _refuse_misnamed(file: Path) -> None:
    """Raise an error if a file begins like one of another format than its suffix says."""
    suffix = file.suffix.lower()
    begins = files.read_bytes(file)[:16].lstrip()
    for magic, suffixes in _BEGINNINGS.items():
        if begins.startswith(magic) and suffix not in suffixes:
            name = file.with_suffix(suffixes[0]).name
            raise FurnitureError(f"'{file}' holds {suffixes[0][1:].upper()} by its contents; name it {name}")


def _read_folder(path: Path) -> FileScene:
    """Read each file of a folder as one part."""
    path = files.folder(path, EXPECTED)
    meshes = _meshes(path)
    if not meshes:
        raise FurnitureError(f"'{path}' holds no mesh files; give {EXPECTED}")
    check_part_count(len(meshes), f"'{path}'", least=1)
    _refuse_mixture(path, meshes)
    scenes = [_read_file(file) for file in meshes]
    names = unique_names([_part_name(file) for file in meshes])
    stated = [scene.unit for scene in scenes if scene.unit is not None]
    factors = [1.0] * len(scenes)
    unit = stated[0] if stated else None
    if len({known.scale for known in stated}) > 1:
        factors = [known.scale for known in stated]
        unit = Unit(1.0, "as each file states", "m")
    parts = [
        NamedTriangles(name, _scaled(combine([part.triangles for part in scene.parts]), factor))
        for name, scene, factor in zip(names, scenes, factors, strict=True)
    ]
    return FileScene(tuple(parts), "y" if all(scene.up == "y" for scene in scenes) else "z", unit)


def _scaled(surface: Triangles, factor: float) -> Triangles:
    return surface if factor == 1.0 else Triangles(surface.points * factor, surface.faces)


def _refuse_mixture(path: Path, meshes: Sequence[Path]) -> None:
    """Raise an error if a folder holds a whole piece beside its parts, or files with and without units."""
    plain = [file for file in meshes if scene_format(file) is None]
    whole = [file for file in meshes if scene_format(file)]
    if plain and len(whole) == 1 and (count := _count_parts(whole[0])) > 1:
        raise FurnitureError(
            f"'{path}' holds {whole[0].name}, a scene of {count} parts, beside {len(plain)} mesh files; import "
            f"'{whole[0]}' alone, or move it elsewhere"
        )
    stating = [file for file in meshes if (known := scene_format(file)) and known.states_unit]
    if stating and len(stating) < len(meshes):
        other = next(file for file in meshes if file not in stating)
        raise FurnitureError(
            f"'{path}' holds {stating[0].name}, which states its unit, and {other.name}, which does not; give all "
            f"parts in one format"
        )


def _part_name(file: Path) -> str:
    return files.one_line(file.stem, 80) or "part"
