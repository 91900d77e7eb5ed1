"""PartNet v0: a folder a shape, the leaves of its merged hierarchy as parts, y up, normalised.

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
WANTED = f"a PartNet v0 folder ({HIERARCHY} and objs/), or one that holds such folders"
MAX_NODES = 2_000
MAX_DEPTH = 32
MAX_OBJS = 2_000
"""Meshes of one leaf."""


class _Node(msgspec.Struct, frozen=True):
    name: str
    children: list[_Node] = []
    objs: list[str] = []


class _Meta(msgspec.Struct, frozen=True):
    model_cat: str = ""
    model_id: str = ""


def find(root: Path) -> list[Path]:
    """The shape folders at or below `root`.

    Raises:
        FurnitureError: no such folder, or no shape in it.
    """
    return files.find_folders(root, lambda _, names: HIERARCHY in names, WANTED)


def read(path: Path, *, scale: float | None = None) -> RawFurniture:
    """The leaves of one shape's merged hierarchy: z up, metres, on the ground.

    A part's name is its way down from the root (`chair_base/regular_leg_base/leg`), numbered where it comes again;
    its label is the leaf's own name. A leaf that lists exactly the meshes of an earlier one is that part again: it is
    left out, and the provenance says so.

    Args:
        path: the shape's folder.
        scale: metres per unit of the files; by default from the category's typical size.

    Raises:
        FurnitureError: missing or broken files, a leaf without meshes, a mesh outside `objs`, or a count of leaves
            outside 2 to 20.
    """
    path = files.folder(path, WANTED)
    check_scale(scale)
    leaves = _leaves(path)
    check_part_count(len(leaves), str(path))
    names = unique_names(["/".join(way) for way, _ in leaves])
    parts: list[NamedTriangles] = []
    notes: list[str] = []
    owner: dict[frozenset[str], str] = {}
    for name, (way, objs) in zip(names, leaves, strict=True):
        first = owner.setdefault(frozenset(objs), name)
        if first != name:
            notes.append(f"leaf '{name}' left out: it lists the same meshes as '{first}'")
            continue
        try:
            surface = combine([read_mesh(files.inside(path / "objs", f"{o}.obj", f"'{path}'")) for o in objs])
        except FurnitureError as problem:
            raise FurnitureError(f"part '{name}': {problem}") from None
        parts.append(NamedTriangles(name, surface, way[-1]))
    check_part_count(len(parts), str(path))
    rotation = UP_ROTATIONS["y"]
    low, high = bounds(parts, rotation)
    meta = files.read_json(path / "meta.json", _Meta) if (path / "meta.json").exists() else _Meta()
    factor = scale or typical_scale(meta.model_cat, float(high[2] - low[2]), float((high - low).max()))
    identifier = files.one_line(path.resolve().name)
    if meta.model_cat:
        notes.insert(0, f"category {files.one_line(meta.model_cat)}, ShapeNet model {files.one_line(meta.model_id)}")
    provenance = Provenance("partnet", identifier, LICENCE, factor, tuple(notes))
    return RawFurniture(stand(parts, rotation, factor, str(path)), provenance)


def _leaves(path: Path) -> list[tuple[list[str], list[str]]]:
    """For every leaf, names from below the root down to it, and its meshes without repeats."""
    roots = files.read_json(path / HIERARCHY, list[_Node])
    if len(roots) != 1:
        raise FurnitureError(f"'{path / HIERARCHY}' has {len(roots)} roots; one shape has one")
    out: list[tuple[list[str], list[str]]] = []
    stack: list[tuple[_Node, list[str]]] = [(roots[0], [])]
    count = 0
    while stack:
        node, way = stack.pop()
        count += 1
        if count > MAX_NODES or len(way) > MAX_DEPTH:
            raise FurnitureError(
                f"'{path / HIERARCHY}' has more than {MAX_NODES} nodes, or is deeper than {MAX_DEPTH} levels"
            )
        if node.children:
            stack.extend((c, [*way, files.one_line(c.name, 60) or "unnamed"]) for c in reversed(node.children))
        else:
            way = way or [files.one_line(node.name, 60) or "unnamed"]
            objs = list(dict.fromkeys(node.objs))
            if not 1 <= len(objs) <= MAX_OBJS:
                raise FurnitureError(f"'{path}': part '{'/'.join(way)}' lists {len(objs)} meshes under 'objs'")
            out.append((way, objs))
    return out
