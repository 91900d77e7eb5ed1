"""Errors for CAD and scene files, which cannot be read, with advice on how to convert them."""

from __future__ import annotations

from pathlib import Path

from roboassembly.errors import FurnitureError

_FORMATS = {
    **dict.fromkeys((".iges", ".igs"), "IGES"), ".fcstd": "FreeCAD",
    ".f3d": "Fusion", ".sldprt": "SolidWorks", ".sldasm": "SolidWorks", ".ipt": "Inventor", ".iam": "Inventor",
    ".skp": "SketchUp", ".3dm": "Rhino", ".dwg": "AutoCAD", ".dxf": "DXF", ".blend": "Blender", ".fbx": "FBX",
    ".dae": "COLLADA", ".3ds": "3DS", ".usd": "USD", ".usdz": "USD",
}  # fmt: skip
"""Name of a file format by suffix."""
_MESHES = (".stl", ".obj", ".ply", ".glb", ".gltf", ".step", ".stp", ".3mf")


def refuse_sources(path: Path) -> None:
    """Raise an error with advice if a path that should be a furniture folder names files to import.

    Raises:
        FurnitureError: the path is a mesh or CAD file, or a folder of such files without furniture.
    """
    if not path.exists() or (path / "furniture.json").exists():
        return
    meshes = [path] if path.is_file() else sorted(path.iterdir()) if path.is_dir() else []
    if any(f.suffix.lower() in _MESHES and f.is_file() for f in meshes):
        raise FurnitureError(
            f"'{path}' holds 3D files, no furniture folder; import it first: roboassembly import {path} --out "
            f"FOLDER, then name that folder"
        )
    refuse_cad(path, whole=True)


def refuse_cad(path: Path, *, whole: bool = False) -> None:
    """Raise an error with advice if a path is a CAD file.

    Args:
        path: a file or folder.
        whole: whether to look into the folder too.

    Raises:
        FurnitureError: the path is a CAD file or a folder that holds one.
    """
    found = path if path.suffix.lower() in _FORMATS and not path.is_dir() else None
    if found is None and whole and path.is_dir():
        found = next((f for f in sorted(path.iterdir()) if f.suffix.lower() in _FORMATS and f.is_file()), None)
    if found is None:
        return
    raise FurnitureError(
        f"'{found}' is a {_FORMATS[found.suffix.lower()]} file, which is not read here; open it in the program "
        f"that made it, or in FreeCAD or Blender, save the whole piece as STEP, 3MF or GLB, and import that file: "
        f"roboassembly import FILE"
    )
