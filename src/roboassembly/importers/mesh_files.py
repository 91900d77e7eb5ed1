"""Readers of OBJ, STL and PLY files as triangles; every broken file gives a one-line error."""

from __future__ import annotations

import io
import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roboassembly.errors import FurnitureError
from roboassembly.furniture.triangles import Triangles
from roboassembly.geometry.meshes import MAX_FACES
from roboassembly.importers.files import one_line, read_bytes, read_text


def read_mesh(path: Path) -> Triangles:
    """Return the triangles of an OBJ, STL or PLY file, in its own frame and units.

    Raises:
        FurnitureError: the file is of another format, unreadable, broken, without faces, or too large; the message
            names the file.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise FurnitureError(f"'{path}' is not a mesh file that can be read; expected one of {', '.join(READERS)}")
    try:
        return reader(path)
    except FurnitureError as problem:
        text = str(problem)
        raise FurnitureError(text if text.startswith("'") else f"'{path}': {text}") from None


def _read_obj(path: Path) -> Triangles:
    # Flat arrays filled line by line: lists of Python objects would take ten times the size of the file.
    coordinates, corners = array("d"), array("q")
    for number, line in enumerate(io.StringIO(read_text(path, "OBJ"), newline=None), start=1):
        fields = line.split()
        try:
            if fields[:1] == ["v"]:
                x, y, z = fields[1:4]
                coordinates.extend((float(x), float(y), float(z)))
            elif fields[:1] == ["f"]:
                count = len(coordinates) // 3
                ring = [int(field.split("/", 1)[0]) for field in fields[1:]]
                ring = [k - 1 if k > 0 else count + k for k in ring]
                if not all(-1 < k < 2**62 for k in ring):
                    raise ValueError(ring)
                for k in range(1, len(ring) - 1):
                    corners.extend((ring[0], ring[k], ring[k + 1]))
        except ValueError:
            raise FurnitureError(
                f"'{path}' line {number} cannot be read as OBJ: {one_line(line, 60)!r}; expected 'v x y z' or 'f a b c'"
            ) from None
        if len(corners) > 3 * MAX_FACES:
            raise FurnitureError(f"'{path}' has more than {MAX_FACES} faces; simplify it first")
    points, faces = np.frombuffer(coordinates, dtype=float), np.frombuffer(corners, dtype=np.int64)
    return _triangles(path, points.reshape(-1, 3), faces.reshape(-1, 3))


def _triangles(path: Path, points: np.ndarray, faces: np.ndarray) -> Triangles:
    if not len(faces):
        raise FurnitureError(f"'{path}' has no faces; a part needs at least four triangles")
    return Triangles(points, faces).merged()


def _read_stl(path: Path) -> Triangles:
    data = read_bytes(path)
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        rows = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]), count, 84)
        points = rows["v"].reshape(-1, 3).astype(float)
    elif data[:5].lower() == b"solid":
        points = _ascii_stl(path, data)
    else:
        raise FurnitureError(
            f"'{path}' cannot be read as STL: {len(data)} bytes, where {max(count, 0)} triangles need "
            f"{84 + 50 * max(count, 0)}"
        )
    return _triangles(path, points, np.arange(len(points)).reshape(-1, 3))


def _ascii_stl(path: Path, data: bytes) -> np.ndarray:
    fields = data.split()
    corners = [k for k, field in enumerate(fields) if field.lower() == b"vertex"]
    try:
        points = np.array([[float(w) for w in fields[k + 1 : k + 4]] for k in corners], dtype=float).reshape(-1, 3)
    except ValueError:
        raise FurnitureError(f"'{path}' cannot be read as STL: 'vertex' without three numbers") from None
    if len(points) % 3 or b"endsolid" not in (field.lower() for field in fields[-20:]):
        raise FurnitureError(f"'{path}' cannot be read as STL: it ends in the middle")
    return points


_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    """Numpy type code."""
    length_kind: str | None
    """Numpy type code of a list's length; None for a single number."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def _read_ply(path: Path) -> Triangles:
    data = read_bytes(path)
    end = data.find(b"end_header")
    line_end = data.find(b"\n", end) + 1
    if data[:3] != b"ply" or end < 0 or line_end == 0:
        raise FurnitureError(f"'{path}' cannot be read as PLY: it has no header")
    order, elements = _ply_header(path, data[:end])
    body = data[line_end:]
    try:
        if order is None:
            points, faces = _ascii_ply(body, elements)
        else:
            points, faces = _binary_ply(body, elements, order)
    except (ValueError, IndexError, struct.error, OverflowError) as problem:
        raise FurnitureError(f"'{path}' cannot be read as PLY: {one_line(str(problem))}") from None
    return _triangles(path, points, faces)


def _ply_header(path: Path, header: bytes) -> tuple[str | None, list[_Element]]:
    """Return the byte order (None for text) and the elements of a PLY header."""
    orders = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    order: str | None = None
    elements: list[_Element] = []
    for line in header.decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", kind, _] if kind in orders:
                order = orders[kind]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 12:
                elements.append(_Element(name, int(count), ()))
            case ["property", "list", length, kind, name] if elements and length in _PLY_TYPES and kind in _PLY_TYPES:
                _extend(elements, _Property(name, _PLY_TYPES[kind], _PLY_TYPES[length]))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                _extend(elements, _Property(name, _PLY_TYPES[kind], None))
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise FurnitureError(f"'{path}' cannot be read as PLY: header line {one_line(line, 60)!r}")
    return order, elements


def _extend(elements: list[_Element], added: _Property) -> None:
    last = elements[-1]
    if any(p.name == added.name for p in last.properties):
        raise FurnitureError(f"PLY property '{one_line(added.name, 40)}' is declared twice")
    if len(last.properties) >= 256:
        raise FurnitureError("PLY element has more than 256 properties")
    elements[-1] = _Element(last.name, last.count, (*last.properties, added))


def _ring_property(element: _Element) -> str:
    for p in element.properties:
        if p.length_kind and p.name in ("vertex_indices", "vertex_index"):
            return p.name
    raise ValueError("faces without a list 'vertex_indices'")


def _fans(rings: list[list[int]]) -> np.ndarray:
    faces = [(ring[0], ring[k], ring[k + 1]) for ring in rings for k in range(1, len(ring) - 1)]
    return np.array(faces, dtype=np.int64).reshape(-1, 3)


def _ascii_ply(body: bytes, elements: list[_Element]) -> tuple[np.ndarray, np.ndarray]:
    lines = body.split(b"\n")
    row = 0
    points, faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    for element in elements:
        rows = lines[row : row + element.count]
        if len(rows) < element.count:
            raise ValueError(f"{element.count} of '{one_line(element.name, 40)}' announced, {len(rows)} lines there")
        row += element.count
        names = [p.name for p in element.properties]
        if element.name == "vertex":
            if any(p.length_kind for p in element.properties):
                raise ValueError("vertices with lists are not read")
            table = np.array([[float(w) for w in line.split()] for line in rows]).reshape(len(rows), len(names))
            points = table[:, [names.index(axis) for axis in "xyz"]]
        elif element.name == "face":
            ring_name = _ring_property(element)
            rings: list[list[int]] = []
            for line in rows:
                fields, at = line.split(), 0
                for p in element.properties:
                    length = int(fields[at]) if p.length_kind else 1
                    at += bool(p.length_kind)
                    if length < 0 or at + length > len(fields):
                        raise ValueError("a face ends in the middle")
                    if p.name == ring_name:
                        rings.append([int(w) for w in fields[at : at + length]])
                    at += length
            faces = _fans(rings)
    return points, faces


def _binary_ply(body: bytes, elements: list[_Element], order: str) -> tuple[np.ndarray, np.ndarray]:
    at = 0
    points, faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    for element in elements:
        if all(p.length_kind is None for p in element.properties):
            kind = np.dtype([(p.name, order + p.kind) for p in element.properties])
            if kind.itemsize * element.count > len(body) - at:
                raise ValueError(f"{element.count} of '{one_line(element.name, 40)}' announced, the file ends before")
            if element.name == "vertex":
                table = np.frombuffer(body, kind, element.count, at)
                points = np.column_stack([table[axis].astype(float) for axis in "xyz"])
            at += kind.itemsize * element.count
        elif element.name == "face":
            faces, at = _binary_faces(body, at, element, order)
        else:
            raise ValueError(f"'{one_line(element.name, 40)}' with lists is not read")
    return points, faces


def _binary_faces(body: bytes, at: int, element: _Element, order: str) -> tuple[np.ndarray, int]:
    """Return the faces as triangles, and the offset of their end; rows of equal length are read at once."""
    ring_name = _ring_property(element)
    if element.count and len(element.properties) == 1:
        only = element.properties[0]
        head = np.dtype(order + str(only.length_kind))
        length = int(np.frombuffer(body, head, 1, at)[0])
        if 3 <= length <= 64:
            row = np.dtype([("n", head), ("ring", order + only.kind, (length,))])
            if row.itemsize * element.count <= len(body) - at:
                table = np.frombuffer(body, row, element.count, at)
                if (table["n"] == length).all():
                    corners = table["ring"].astype(np.int64)
                    fans = [corners[:, [0, k, k + 1]] for k in range(1, length - 1)]
                    return np.concatenate(fans), at + row.itemsize * element.count
    if element.count > min(MAX_FACES, len(body)):
        raise ValueError(f"{element.count} faces announced; {min(MAX_FACES, len(body))} could be there")
    rings: list[list[int]] = []
    for _ in range(element.count):
        for p in element.properties:
            length = 1
            if p.length_kind:
                head = np.dtype(order + p.length_kind)
                length = int(np.frombuffer(body, head, 1, at)[0])
                at += head.itemsize
            kind = np.dtype(order + p.kind)
            if length < 0 or length * kind.itemsize > len(body) - at:
                raise ValueError("a face ends in the middle")
            if p.name == ring_name:
                rings.append(np.frombuffer(body, kind, length, at).astype(np.int64).tolist())
            at += length * kind.itemsize
    return _fans(rings), at


READERS: dict[str, Callable[[Path], Triangles]] = {".obj": _read_obj, ".stl": _read_stl, ".ply": _read_ply}
"""Readers by file suffix."""
