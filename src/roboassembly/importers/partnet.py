"""Importer for PartNet v0: one folder for each shape, leaves of the merged hierarchy as parts, y up, normalised.

result_after_merging.json    the hierarchy; each leaf lists its meshes under `objs`
objs/*.obj                   the meshes, in the assembled shape's frame
meta.json                    the category (`model_cat`)
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Provenance, RawFurniture, check_part_count
from roboassembly.furniture.triangles import (
    UP_ROTATIONS,
    NamedTriangles,
    bounds,
    check_scale,
    combine,
    stand,
    typical_scale,
    unique_names,
)
from roboassembly.importers import files
from roboassembly.importers.mesh_files import read_mesh

HIERARCHY = "result_after_merging.json"
LICENCE = "PartNet terms of use: research only, no redistribution"
EXPECTED = f"a PartNet v0 folder ({HIERARCHY} and objs/), or one that holds such folders"
MAX_NODES = 2_000
MAX_DEPTH = 32
MAX_OBJS = 2_000
"""Largest number of meshes of one leaf."""


class _Node(msgspec.Struct, frozen=True):
    name: str
    children: list[_Node] = []
    objs: list[str] = []


class _Meta(msgspec.Struct, frozen=True):
    model_cat: str = ""
    model_id: str = ""


def find(root: Path) -> list[Path]:
    """Return the shape folders at or below `root`.

    Raises:
        FurnitureError: the folder does not exist, or holds no shape.
    """
    return files.find_folders(root, lambda _, names: HIERARCHY in names, EXPECTED)


def read(path: Path, *, scale: float | None = None) -> RawFurniture:
    """Read the leaves of one shape's merged hierarchy as parts: z up, metres, on the ground.

    Parts are in PartNet's order, depth first. A part's label is its path from the root
    (`chair_base/regular_leg_base/leg`); its name is the same, numbered if it repeats. A leaf that lists exactly the
    meshes of an earlier leaf is a duplicate: it is left out, with a note in the provenance.

    Args:
        path: folder of the shape.
        scale: metres per unit of the files; by default from the category's typical size.

    Raises:
        FurnitureError: files are missing or broken, a leaf has no meshes, a mesh lies outside `objs`, or there are not
            2 to 1000 leaves.
    """
    path = files.folder(path, EXPECTED)
    check_scale(scale)
    leaves = _leaves(path)
    check_part_count(len(leaves), str(path))
    names = unique_names(["/".join(node_path) for node_path, _ in leaves])
    parts: list[NamedTriangles] = []
    notes: list[str] = []
    owner: dict[frozenset[str], str] = {}
    for name, (node_path, objs) in zip(names, leaves, strict=True):
        first = owner.setdefault(frozenset(objs), name)
        if first != name:
            notes.append(f"leaf '{name}' left out: it lists the same meshes as '{first}'")
            continue
        try:
            surface = combine([read_mesh(files.inside(path / "objs", f"{o}.obj", f"'{path}'")) for o in objs])
        except FurnitureError as problem:
            raise FurnitureError(f"part '{name}': {problem}") from None
        parts.append(NamedTriangles(name, surface, "/".join(node_path)))
    check_part_count(len(parts), str(path))
    rotation = UP_ROTATIONS["y"]
    low, high = bounds(parts, rotation)
    meta = files.read_json(path / "meta.json", _Meta) if (path / "meta.json").exists() else _Meta()
    factor = scale or typical_scale(meta.model_cat, float(high[2] - low[2]), float((high - low).max()))
    identifier = files.one_line(path.resolve().name)
    if meta.model_cat:
        notes.insert(0, f"category {files.one_line(meta.model_cat)}, ShapeNet model {files.one_line(meta.model_id)}")
    provenance = Provenance("partnet", identifier, LICENCE, factor, tuple(notes))
    return RawFurniture(stand(parts, rotation, factor, str(path)), provenance, drawn=True)


def _leaves(path: Path) -> list[tuple[list[str], list[str]]]:
    """Return, for every leaf, the names on its path below the root, and its meshes without repeats."""
    roots = files.read_json(path / HIERARCHY, list[_Node])
    if len(roots) != 1:
        raise FurnitureError(f"'{path / HIERARCHY}' has {len(roots)} roots; one shape has one")
    out: list[tuple[list[str], list[str]]] = []
    stack: list[tuple[_Node, list[str]]] = [(roots[0], [])]
    count = 0
    while stack:
        node, node_path = stack.pop()
        count += 1
        if count > MAX_NODES or len(node_path) > MAX_DEPTH:
            raise FurnitureError(
                f"'{path / HIERARCHY}' has more than {MAX_NODES} nodes, or is deeper than {MAX_DEPTH} levels"
            )
        if node.children:
            stack.extend((c, [*node_path, files.one_line(c.name, 60) or "unnamed"]) for c in reversed(node.children))
        else:
            node_path = node_path or [files.one_line(node.name, 60) or "unnamed"]
            objs = list(dict.fromkeys(node.objs))
            if not 1 <= len(objs) <= MAX_OBJS:
                raise FurnitureError(f"'{path}': part '{'/'.join(node_path)}' lists {len(objs)} meshes under 'objs'")
            out.append((node_path, objs))
    return out
