"""Furniture files as other programs write them: folders of mesh files, GLB scenes, pieces of the IKEA environment."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import trimesh

Vector = tuple[float, float, float]
IkeaSites = Sequence[tuple[str, str, str]]


def box(extents: Vector, centre: Vector = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """Return a box with its centre at a point."""
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(centre)
    return mesh


def export(mesh: trimesh.Trimesh, path: Path, **options: Any) -> None:
    """Write a mesh in the format of the file's suffix."""
    data = mesh.export(file_type=path.suffix[1:], **options)
    path.write_bytes(data if isinstance(data, bytes) else str(data).encode())


def write_table(root: Path, unit: float = 1.0, suffixes: Sequence[str] = ("obj", "stl", "ply")) -> Path:
    """Write a table of 1.0 by 0.6 by 0.5 metres: a top on two panels, one file per part."""
    root.mkdir(exist_ok=True)
    parts = {
        "top": box((1.0, 0.6, 0.1), (0, 0, 0.45)),
        "left panel": box((0.1, 0.6, 0.4), (-0.4, 0, 0.2)),
        "right panel": box((0.1, 0.6, 0.4), (0.4, 0, 0.2)),
    }
    for (name, mesh), suffix in zip(parts.items(), suffixes, strict=True):
        mesh.apply_scale(1.0 / unit)
        export(mesh, root / f"{name}.{suffix}")
    return root


PART_PAIR = [{"children": [1, 2]}, {"name": "a", "mesh": 0}, {"name": "b", "mesh": 0, "translation": [1, 0, 0]}]
"""glTF nodes of two parts side by side; mesh 0 is the cube of `write_glb`."""
GLB_VIEWS = [{"buffer": 0, "byteLength": 96}, {"buffer": 0, "byteLength": 72, "byteOffset": 96}]
"""Buffer views of `write_glb`: points and faces."""


def glb_accessors(**changes: Any) -> list[dict[str, Any]]:
    """Return the accessors of `write_glb`, the points' with changes."""
    return [
        {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", **changes},
        {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
    ]


def write_glb(path: Path, nodes: list[dict[str, Any]], **changes: Any) -> Path:
    """Write a GLB whose mesh 0 is the unit cube from the origin to (1, 1, 1)."""
    mesh = box((1, 1, 1), (0.5, 0.5, 0.5))
    points, faces = mesh.vertices.astype("<f4").tobytes(), mesh.faces.astype("<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"name": "cube", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": glb_accessors(),
        "bufferViews": GLB_VIEWS,
        "buffers": [{"byteLength": len(points) + len(faces)}],
        **changes,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = points + faces + b"\0" * (-len(points + faces) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
    return path


def ikea_body(name: str, sites: IkeaSites, *, pose: str = "", scale: str = "1 1 1") -> tuple[str, str]:
    """Return the MJCF asset and body of a part with connection sites `(name, position, quaternion)`."""
    marks = "".join(f'<site name="{n}" pos="{p}" quat="{q}" size="0.01"/>' for n, p, q in sites)
    return (
        f'<mesh file="piece/{name}.stl" name="m_{name}" scale="{scale}"/>',
        f'<body name="{name}" {pose}><geom type="mesh" mesh="m_{name}" pos="0 0 0"/>'
        f'<geom type="box" euler="1.57 0 0" size="1 1 1" rgba="0 0 0 0"/>{marks}</body>',
    )


def write_ikea_env(folder: Path, *bodies: tuple[str, str], extra: str = "") -> Path:
    """Write a piece of the IKEA Furniture Assembly Environment and its meshes; returns its XML file."""
    (folder / "piece").mkdir(exist_ok=True)
    for name, extents in (("post", (0.1, 0.1, 0.4)), ("plate", (0.4, 0.2, 0.02)), ("rail", (0.1, 0.1, 0.1))):
        trimesh.creation.box(extents).export(folder / "piece" / f"{name}.stl")
    file = folder / "piece.xml"
    assets, elements = "".join(a for a, _ in bodies), "".join(b for _, b in bodies)
    file.write_text(f"<mujoco>{extra}<asset>{assets}</asset><worldbody>{elements}</worldbody></mujoco>")
    return file


IKEA_POST = ikea_body("post", [("post-plate,90,conn_site1", "0 0 0.2", "1 0 0 0")], pose='pos="5 5 5"')
IKEA_PLATE = ikea_body(
    "plate", [("plate-post,90,conn_site1", "0.1 0 -0.01", "0 1 0 0")], pose='quat="0.70710678 0 0.70710678 0"'
)


def edit_furniture(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the `furniture.json` of a furniture folder."""
    path = folder / "furniture.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
