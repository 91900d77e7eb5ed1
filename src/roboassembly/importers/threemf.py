"""Reader of 3MF: a ZIP archive of XML models with objects, components and a list of what is to be built.

Each object with triangles that the build list reaches is a part, as often as it is reached. Other files of the archive
may hold objects too (the production extension, which slicers use). Objects of another type than `model`, such as
support structures, are left out.
"""

from __future__ import annotations

import re
import zipfile
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from xml.parsers import expat

import numpy as np
from jaxtyping import Float

from roboassembly.errors import FurnitureError
from roboassembly.furniture.triangles import NamedTriangles, Triangles
from roboassembly.geometry.meshes import MAX_FACES
from roboassembly.geometry.units import METRES, NAMES, Unit
from roboassembly.importers.files import ARCHIVE_ERRORS, MAX_BYTES, one_line, read_bytes
from roboassembly.importers.scene import FileScene, Node, given_name, part_names

MAX_INSTANCES = 20_000
"""Largest number of placed objects."""
MAX_DEPTH = 64
"""Largest nesting depth of components."""
_ROOT_MODEL = "3D/3dmodel.model"
_START = re.compile(rb"""<[\w:]*Relationship\b[^>]*>""")
_TARGET = re.compile(rb"""\bTarget\s*=\s*["']/?([^"']+)["']""")
_UNITS = {"millimeter": "mm", "centimeter": "cm", "meter": "m", "inch": "in", "foot": "ft"}
_MICRON = 1e-6


@dataclass(eq=False)
class _Object:
    """Object of a model: triangles, or components."""

    name: str
    kind: str
    points: array[float] = field(default_factory=lambda: array("d"))
    corners: array[int] = field(default_factory=lambda: array("q"))
    components: list[_Reference] = field(default_factory=list["_Reference"])


@dataclass(frozen=True, eq=False)
class _Reference:
    """Object at a place, as a component or in the build list."""

    key: tuple[str, str]
    """Model file and number of the object."""
    parent_from_object: Float[np.ndarray, "4 4"]
    name: str
    line: int


@dataclass(eq=False)
class _Model:
    """Contents of one model file."""

    unit: str = "millimeter"
    objects: dict[str, _Object] = field(default_factory=dict[str, _Object])
    build: list[_Reference] = field(default_factory=list[_Reference])


def read_3mf(path: Path) -> FileScene:
    """Read the objects that the build list names, each at its place: z up, in the unit of the file.

    Raises:
        FurnitureError: the file is no 3MF, broken, encrypted or too large, or its components loop; the message names
            the file.
    """
    try:
        return _read(read_bytes(path))
    except FurnitureError as problem:
        text = str(problem)
        raise FurnitureError(
            text if text.startswith(f"'{path}'") else f"'{path}' cannot be read as 3MF: {text}"
        ) from None


def count_parts(path: Path) -> int:
    """Count the parts that `read_3mf` would return; 0 for a file that cannot be read."""
    try:
        return len(read_3mf(path).parts)
    except FurnitureError:
        return 0


@np.errstate(over="ignore", invalid="ignore")  # `Triangles` refuses points that overflow
def _read(data: bytes) -> FileScene:
    archive = _Archive(data)
    root = archive.model(archive.start)
    if root.unit not in {*_UNITS, "micron"}:
        raise FurnitureError(
            f"its unit {one_line(repr(root.unit), 40)} is not known; expected one of {', '.join(_UNITS)}"
        )
    symbol = _UNITS.get(root.unit)
    scale = _MICRON if symbol is None else METRES[symbol]
    unit = Unit(scale, f"{NAMES[symbol] if symbol else 'micrometres'}, as the file states", symbol)
    paths: list[tuple[Node, ...]] = []
    surfaces: list[Triangles] = []
    shapes: dict[tuple[str, str], Triangles] = {}
    total = 0
    for path, key, scene_from_object in _placed(archive, root):
        try:
            if key not in shapes:
                shapes[key] = _triangles(archive.object(key, 0))
            surfaces.append(shapes[key].moved(scene_from_object))
        except FurnitureError as problem:
            raise FurnitureError(f"object '{path[-1].name or 'without name'}': {problem}") from None
        total += len(shapes[key].faces)
        if total > MAX_FACES:
            raise FurnitureError(f"it has more than {MAX_FACES} faces; simplify it first")
        paths.append(path)
    if not surfaces:
        raise FurnitureError("its build list has no object with triangles; give parts of type 'model'")
    names = part_names(paths)
    return FileScene(tuple(map(NamedTriangles, names, surfaces)), "z", unit)


def _placed(
    archive: _Archive, root: _Model
) -> Iterator[tuple[tuple[Node, ...], tuple[str, str], Float[np.ndarray, "4 4"]]]:
    """Yield path, key and `scene_from_object` of each object with triangles, in the order of the build list."""
    nobody: tuple[Node, ...] = ()
    stack: list[tuple[_Reference, Float[np.ndarray, "4 4"], tuple[Node, ...]]] = [
        (item, np.eye(4), nobody) for item in reversed(root.build)
    ]
    number = 0
    while stack:
        reference, scene_from_parent, above = stack.pop()
        number += 1
        if number > MAX_INSTANCES:
            raise FurnitureError(f"it places more than {MAX_INSTANCES} objects; join or leave out some")
        if len(above) > MAX_DEPTH:
            raise FurnitureError(f"its components are nested deeper than {MAX_DEPTH}, or loop")
        found = archive.object(reference.key, reference.line)
        if found.kind not in ("model", "solidsupport", "surface"):
            continue
        scene_from_object = scene_from_parent @ reference.parent_from_object
        path = (*above, Node(number, given_name(found.name) or given_name(reference.name)))
        if found.corners:
            yield path, reference.key, scene_from_object
        stack.extend((part, scene_from_object, path) for part in reversed(found.components))


def _triangles(found: _Object) -> Triangles:
    points = np.frombuffer(found.points, dtype=float).reshape(-1, 3)
    return Triangles(points, np.frombuffer(found.corners, dtype=np.int64).reshape(-1, 3)).merged()


class _Archive:
    """ZIP archive whose models are read on demand, each once."""

    def __init__(self, data: bytes) -> None:
        try:
            self._zip = zipfile.ZipFile(BytesIO(data))
        except ARCHIVE_ERRORS as problem:
            raise FurnitureError(f"it is no ZIP archive ({one_line(str(problem))}); export it again") from None
        # Some programs write names with backslashes, or with another case.
        self._names = {name.replace("\\", "/").lstrip("/").lower(): name for name in self._zip.namelist()}
        self._left = MAX_BYTES
        self._models: dict[str, _Model] = {}
        self.start = self._find_start()

    def model(self, name: str) -> _Model:
        """Return the contents of a model file."""
        key = name.lstrip("/").lower()
        if key not in self._models:
            self._models[key] = _parse(self._member(key), key)
        return self._models[key]

    def object(self, key: tuple[str, str], line: int) -> _Object:
        """Return an object by its model file and number."""
        found = self.model(key[0]).objects.get(key[1])
        if found is None:
            raise FurnitureError(f"line {line} refers to object {one_line(repr(key[1]), 30)}, which is not there")
        return found

    def _find_start(self) -> str:
        if "_rels/.rels" in self._names:
            for entry in _START.findall(self._member("_rels/.rels")):
                target = _TARGET.search(entry)
                if b"3dmodel" in entry and target and b"/3dmanufacturing/" in entry:
                    return target[1].decode("utf-8", "replace")
        return _ROOT_MODEL

    def _member(self, key: str) -> bytes:
        if key not in self._names:
            raise FurnitureError(f"its archive has no '{one_line(key, 80)}'; export it again")
        try:
            with self._zip.open(self._names[key]) as packed:
                # The sizes that an archive states may be wrong.
                content = packed.read(self._left + 1)
        except ARCHIVE_ERRORS as problem:
            raise FurnitureError(f"'{one_line(key, 80)}' cannot be unpacked: {one_line(str(problem))}") from None
        self._left -= len(content)
        if self._left < 0:
            raise FurnitureError(f"it unpacks to more than {MAX_BYTES // 2**20} MiB; simplify or split it")
        return content


def _parse(data: bytes, name: str) -> _Model:
    """Read one model file."""
    parser = expat.ParserCreate(namespace_separator=" ")
    reader = _Reader(parser, name)
    try:
        parser.Parse(data, True)
    except KeyError as problem:
        line = parser.CurrentLineNumber
        raise FurnitureError(f"'{one_line(name, 80)}' line {line} lacks {one_line(str(problem), 40)}") from None
    except (expat.ExpatError, LookupError, UnicodeError) as problem:
        raise FurnitureError(f"'{one_line(name, 80)}' is not well-formed XML: {one_line(str(problem))}") from None
    except (ValueError, OverflowError) as problem:
        line = parser.CurrentLineNumber
        raise FurnitureError(f"'{one_line(name, 80)}' line {line}: {one_line(str(problem), 80)}") from None
    return reader.model


class _Reader:
    """Handler of the elements of a model file; numbers go into flat arrays."""

    def __init__(self, parser: expat.XMLParserType, name: str) -> None:
        self.model = _Model()
        self._parser, self._name = parser, name
        self._now: _Object | None = None
        self._faces = 0
        parser.StartElementHandler = self._start
        parser.StartDoctypeDeclHandler = self._refuse
        parser.EntityDeclHandler = self._refuse

    def _refuse(self, *_: object) -> None:
        raise FurnitureError("it declares a document type or entities; export it again")

    def _start(self, element: str, values: dict[str, str]) -> None:
        match element.rpartition(" ")[2]:
            case "vertex" if self._now is not None:
                self._now.points.extend((float(values["x"]), float(values["y"]), float(values["z"])))
            case "triangle" if self._now is not None:
                self._now.corners.extend((int(values["v1"]), int(values["v2"]), int(values["v3"])))
                self._faces += 1
                if self._faces > MAX_FACES:
                    raise FurnitureError(f"it has more than {MAX_FACES} faces; simplify it first")
            case "object":
                name = values.get("name", "") or values.get("partnumber", "")
                self._now = _Object(name, values.get("type", "model"))
                self.model.objects[values["id"]] = self._now
            case "component" if self._now is not None:
                self._now.components.append(self._reference(values))
            case "item":
                self.model.build.append(self._reference(values))
            case "model":
                self.model.unit = values.get("unit", self.model.unit)
            case _:
                pass

    def _reference(self, values: dict[str, str]) -> _Reference:
        file = next((value for key, value in values.items() if key.endswith(" path")), self._name)
        matrix = np.eye(4)
        if "transform" in values:
            numbers = np.array([float(word) for word in values["transform"].split()])
            if len(numbers) != 12 or not np.isfinite(numbers).all():
                raise ValueError(f"transform {values['transform']!r}; expected 12 numbers")
            # Points are rows there: x y z 1 times 4 x 3.
            matrix[:3] = numbers.reshape(4, 3).T
        key = (file.lstrip("/").lower(), values["objectid"])
        return _Reference(key, matrix, values.get("partnumber", ""), self._parser.CurrentLineNumber)
