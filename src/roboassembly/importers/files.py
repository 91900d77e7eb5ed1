"""Opening files that strangers made: bounded sizes, nothing outside the source folder, no XML entities."""

from __future__ import annotations

import os
import stat
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar
from xml.parsers import expat

import msgspec

from roboassembly.errors import FurnitureError

MAX_BYTES = 128 * 2**20
"""Of one mesh file."""
MAX_TEXT_BYTES = 16 * 2**20
"""Of one JSON or XML file."""
MAX_ENTRIES = 500_000
"""Files and folders looked at below a source folder."""
MAX_DEPTH = 64
"""Nesting of XML elements."""

_T = TypeVar("_T")


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """The whole of a regular file.

    Raises:
        FurnitureError: missing, not a regular file, unreadable, or larger than `limit` bytes.
    """
    try:
        # A pipe would block on opening; what is no regular file is not waited for.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else str(problem)
        raise FurnitureError(f"'{_shown(path)}' cannot be read: {reason}") from None
    try:
        with os.fdopen(handle, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise FurnitureError(f"'{_shown(path)}' is not a regular file")
            data = file.read(limit + 1) if status.st_size <= limit else None
    except OSError as problem:
        raise FurnitureError(f"'{_shown(path)}' cannot be read: {problem.strerror}") from None
    if data is None or len(data) > limit:
        raise FurnitureError(f"'{_shown(path)}' is larger than {limit // 2**20} MiB; simplify or split it")
    return data


def read_text(path: Path, what: str, limit: int = MAX_BYTES) -> str:
    """The whole of a UTF-8 text file.

    Raises:
        FurnitureError: as `read_bytes`, or no UTF-8; `what` (`OBJ`, ...) says what was expected.
    """
    try:
        return read_bytes(path, limit).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise FurnitureError(
            f"'{_shown(path)}' cannot be read as {what} ({problem.reason} at byte {problem.start}); "
            f"export it again as text"
        ) from None


def decode_json(data: bytes, kind: type[_T], where: str) -> _T:
    """JSON of the given type.

    Raises:
        FurnitureError: not JSON, of another shape, or nested too deeply.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as problem:
        raise FurnitureError(f"{where} is not valid: {one_line(str(problem))}") from None
    except RecursionError:
        raise FurnitureError(f"{where} is nested too deeply") from None


def read_json(path: Path, kind: type[_T]) -> _T:
    """A JSON file of the given type; raises as `read_bytes` and `decode_json`."""
    return decode_json(read_bytes(path, MAX_TEXT_BYTES), kind, f"'{_shown(path)}'")


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file that declares no document type and no entities.

    Raises:
        FurnitureError: as `read_bytes`; not well formed; a DOCTYPE; elements nested deeper than `MAX_DEPTH`.
    """
    data = read_bytes(path, MAX_TEXT_BYTES)
    where = f"'{_shown(path)}'"
    depth = 0

    def refuse(*_: object) -> None:
        raise FurnitureError(f"{where} declares a document type or entities; remove the <!DOCTYPE ...> part")

    def start(_name: str, _attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise FurnitureError(f"{where} nests elements deeper than {MAX_DEPTH}")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
        return ElementTree.fromstring(data)
    except (expat.ExpatError, ElementTree.ParseError, LookupError, ValueError) as problem:
        raise FurnitureError(f"{where} is not well-formed XML: {one_line(str(problem))}") from None


def inside(root: Path, name: str, where: str) -> Path:
    """The file that a source's own text names, relative to `root`.

    Raises:
        FurnitureError: an absolute path, or one that leads out of `root`, by `..` or by a link.
    """
    try:
        # Windows separators and drives mean a way out elsewhere; no file here needs them.
        path = (root / name).resolve()
        safe = bool(name) and "\\" not in name and not Path(name).is_absolute()
        safe = safe and path.is_relative_to(root.resolve())
    except (OSError, ValueError, RuntimeError):
        safe, path = False, root
    if not safe:
        raise FurnitureError(f"{where} names the file {one_line(repr(name))}, which is not inside '{_shown(root)}'")
    return path


def folder(path: Path, wanted: str) -> Path:
    """`path` as given, if it is a folder; raises `FurnitureError` saying what is `wanted` if not."""
    path = Path(path)
    try:
        there = path.is_dir()
    except ValueError:
        there = False
    if not there:
        raise FurnitureError(f"'{_shown(path)}' is not a folder; give {wanted}")
    return path


def walk(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Every folder at or below `root` with the names of its files, sorted; links to folders are not followed.

    Raises:
        FurnitureError: more than `MAX_ENTRIES` files and folders.
    """
    seen = 0
    for here, folders, files in os.walk(root):
        seen += len(folders) + len(files)
        if seen > MAX_ENTRIES:
            raise FurnitureError(f"'{_shown(root)}' holds more than {MAX_ENTRIES} files; name a smaller folder")
        folders.sort()
        yield Path(here), sorted(files)


def find_folders(root: Path, has: Callable[[Path, list[str]], bool], wanted: str) -> list[Path]:
    """The folders at or below `root` that `has` accepts (folder, names of its files), sorted.

    Raises:
        FurnitureError: `root` is no folder, or holds none.
    """
    root = folder(root, wanted)
    found = sorted(here for here, files in walk(root) if has(here, files))
    if not found:
        raise FurnitureError(f"'{_shown(root)}' holds nothing to import; give {wanted}")
    return found


def one_line(text: str, length: int = 160) -> str:
    """Text from a stranger, fit for a one-line message."""
    text = " ".join("".join(c if c.isprintable() else "?" for c in text).split())
    return text if len(text) <= length else text[: length - 1] + "…"


def _shown(path: Path) -> str:
    return one_line(str(path), 400)
