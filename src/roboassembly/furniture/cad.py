"""CAD and scene files that cannot be read, and what to do with them."""

from __future__ import annotations

from pathlib import Path

from roboassembly.errors import FurnitureError

_KINDS = {
    **dict.fromkeys((".step", ".stp"), "STEP"), **dict.fromkeys((".iges", ".igs"), "IGES"), ".fcstd": "FreeCAD",
    ".f3d": "Fusion", ".sldprt": "SolidWorks", ".sldasm": "SolidWorks", ".ipt": "Inventor", ".iam": "Inventor",
    ".skp": "SketchUp", ".3dm": "Rhino", ".dwg": "AutoCAD", ".dxf": "DXF", ".blend": "Blender", ".fbx": "FBX",
    ".dae": "COLLADA", ".3ds": "3DS", ".gltf": "text glTF", ".3mf": "3MF", ".usd": "USD", ".usdz": "USD",
}  # fmt: skip
"""By file suffix."""


_MESHES = (".stl", ".obj", ".ply", ".glb")


def refuse_sources(path: Path) -> None:
    """Say what to do where a furniture folder is wanted and a path names a file, or a folder of files, to import.

    Raises:
        FurnitureError: it is a mesh or CAD file, or a folder that holds such and no furniture.
    """
    if not path.exists() or (path / "furniture.json").exists():
        return
    meshes = [path] if path.is_file() else sorted(path.iterdir()) if path.is_dir() else []
    if any(f.suffix.lower() in _MESHES and f.is_file() for f in meshes):
        raise FurnitureError(
            f"'{path}' holds 3D files, no furniture folder; import it first: roboassembly import folder {path} --out "
            f"FOLDER, then name that folder"
        )
    refuse_cad(path, whole=True)


def refuse_cad(path: Path, *, whole: bool = False) -> None:
    """Say what to do where a path is a CAD file.

    Args:
        path: of a file or folder.
        whole: look into the folder too.

    Raises:
        FurnitureError: it is one, or holds some.
    """
    found = path if path.suffix.lower() in _KINDS and not path.is_dir() else None
    if found is None and whole and path.is_dir():
        found = next((f for f in sorted(path.iterdir()) if f.suffix.lower() in _KINDS and f.is_file()), None)
    if found is None:
        return
    raise FurnitureError(
        f"'{found}' is a {_KINDS[found.suffix.lower()]} file, which is not read here; open it in FreeCAD or Blender, "
        f"export every part as STL in its assembled place, one file a part, and import the folder: roboassembly import "
        f"folder FOLDER"
    )
