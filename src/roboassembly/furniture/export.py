"""Export of furniture: MJCF for MuJoCo, URDF for other programs. `usd` writes USD."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.furniture.triangles import unique_names
from roboassembly.geometry.meshes import WOOD_DENSITY
from roboassembly.geometry.poses import SE3, pose_to_euler, pose_to_seven

SUFFIXES = {"mjcf": "xml", "urdf": "urdf", "usd": "usda"}
"""Endings of files by format."""
_LONGEST_NAME = 60
"""Largest number of characters of a file name: at most 240 bytes, which file systems accept."""


def export_mjcf(furniture: Furniture, folder: Path) -> Path:
    """Write `FURNITURE.xml` and its meshes; returns the file, which opens in MuJoCo's viewer.

    Every part is a body at its assembled place, a child of a part that it touches, without a joint between them:
    the furniture is one rigid body above a floor.

    Raises:
        InputError: the folder cannot be written.
    """
    furniture = with_safe_names(furniture)
    names = _write_meshes(furniture, folder)
    root = ET.Element("mujoco", model=furniture.name)
    ET.SubElement(root, "compiler", angle="radian", meshdir="meshes")
    ET.SubElement(root, "option", timestep="0.002")
    asset = ET.SubElement(root, "asset")
    for mesh in dict.fromkeys(names):
        # Inertias are given with the bodies; a shell never refuses a thin mesh.
        ET.SubElement(asset, "mesh", name=mesh, file=f"{mesh}.stl", inertia="shell")
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0 0 3", dir="0.2 -0.2 -1", directional="true")
    ET.SubElement(world, "geom", name="floor", type="plane", size="0 0 1", rgba="0.85 0.86 0.88 1")
    lift = SE3(np.eye(3), np.array([0.0, 0.0, 1e-3 - furniture.lowest]))
    nodes = {0: _body(world, furniture, 0, lift * furniture.assembled[0], names[0])}
    ET.SubElement(nodes[0], "freejoint", name=furniture.name)
    for parent, child in _tree(furniture):
        relative = furniture.assembled[parent].actInv(furniture.assembled[child])
        nodes[child] = _body(nodes[parent], furniture, child, relative, names[child])
    return _write(root, exported_file(furniture, folder, "mjcf"))


def _body(parent: ET.Element, furniture: Furniture, index: int, pose: SE3, mesh: str) -> ET.Element:
    part, seven = furniture.parts[index], pose_to_seven(pose)
    body = ET.SubElement(parent, "body", name=part.name, pos=_text(seven[:3]), quat=_text(seven[3:]))
    inertia = WOOD_DENSITY * part.mesh.inertia
    ET.SubElement(
        body,
        "inertial",
        pos=_text(part.mesh.center_of_mass),
        mass=_text([WOOD_DENSITY * part.mesh.volume]),
        fullinertia=_text(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
    )
    ET.SubElement(body, "geom", type="mesh", mesh=mesh, rgba="0.80 0.62 0.42 1")
    return body


def export_urdf(furniture: Furniture, folder: Path) -> Path:
    """Write `FURNITURE.urdf` and its meshes; returns the file.

    Every part is a link; fixed joints along a spanning tree of the connections hold it at its assembled place. The
    root link is the first part, whose frame is that of its centre of mass.

    Raises:
        InputError: the folder cannot be written.
    """
    furniture = with_safe_names(furniture)
    names = _write_meshes(furniture, folder)
    root = ET.Element("robot", name=furniture.name)
    for part, mesh in zip(furniture.parts, names, strict=True):
        link = ET.SubElement(root, "link", name=part.name)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=_text(part.mesh.center_of_mass), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_text([WOOD_DENSITY * part.mesh.volume]))
        inertia = WOOD_DENSITY * part.mesh.inertia
        entries = {f"i{'xyz'[i]}{'xyz'[j]}": _text([inertia[i, j]]) for i in range(3) for j in range(i, 3)}
        ET.SubElement(inertial, "inertia", entries)
        for kind in ("visual", "collision"):
            geometry = ET.SubElement(ET.SubElement(link, kind), "geometry")
            ET.SubElement(geometry, "mesh", filename=f"meshes/{mesh}.stl")
    for parent, child in _tree(furniture):
        joint = ET.SubElement(
            root, "joint", name=f"{furniture.parts[parent].name}--{furniture.parts[child].name}", type="fixed"
        )
        ET.SubElement(joint, "parent", link=furniture.parts[parent].name)
        ET.SubElement(joint, "child", link=furniture.parts[child].name)
        relative = pose_to_euler(furniture.assembled[parent].actInv(furniture.assembled[child]))
        ET.SubElement(joint, "origin", xyz=_text(relative[:3]), rpy=_text(relative[3:]))
    return _write(root, exported_file(furniture, folder, "urdf"))


def exported_file(furniture: Furniture, folder: Path, kind: str) -> Path:
    """Return the file that an export writes; `kind` is a key of `SUFFIXES`."""
    return folder / f"{safe_name(furniture.name)}.{SUFFIXES[kind]}"


def with_safe_names(furniture: Furniture) -> Furniture:
    """Return the furniture with names that are valid as file names and in XML."""
    names = unique_names([safe_name(part.name) for part in furniture.parts])
    parts = tuple(replace(part, name=name) for part, name in zip(furniture.parts, names, strict=True))
    return replace(furniture, name=safe_name(furniture.name), parts=parts)


def safe_name(name: str) -> str:
    """Return a name with control characters, path separators and a leading dot replaced by underscores."""
    return re.sub(r"^\.|[/\\:]", "_", "".join(c if c.isprintable() else "_" for c in name[:_LONGEST_NAME])) or "_"


def _write_meshes(furniture: Furniture, folder: Path) -> list[str]:
    """Write one STL per distinct mesh; return the file name without suffix of each part's mesh."""
    try:
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        files: dict[int, str] = {}
        for part in furniture.parts:
            if id(part.mesh) not in files:
                files[id(part.mesh)] = f"{furniture.name}-{len(files):02d}"
                part.mesh.trimesh.export(folder / "meshes" / f"{files[id(part.mesh)]}.stl")
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from None
    return [files[id(part.mesh)] for part in furniture.parts]


def _write(root: ET.Element, path: Path) -> Path:
    ET.indent(root)
    try:
        ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
    return path


def _text(numbers: object) -> str:
    return " ".join(f"{float(x):.12g}" for x in np.asarray(numbers).ravel())


def _tree(furniture: Furniture) -> Iterator[tuple[int, int]]:
    """Yield parents and children of a spanning tree over the connections, from part 0, breadth first."""
    seen, queue = {0}, [0]
    while queue:
        parent = queue.pop(0)
        for child in sorted(furniture.neighbours[parent] - seen):
            seen.add(child)
            queue.append(child)
            yield parent, child
