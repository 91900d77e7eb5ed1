"""Safe readers for untrusted files: bounded sizes, nothing outside the source folder, no XML entities."""

from __future__ import annotations

import os
import stat
import xml.etree.ElementTree as ElementTree
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar
from xml.parsers import expat

import msgspec

from roboassembly.errors import FurnitureError

MAX_BYTES = 128 * 2**20
"""Largest size of one mesh file [bytes]."""
MAX_TEXT_BYTES = 16 * 2**20
"""Largest size of one JSON or XML file [bytes]."""
MAX_ENTRIES = 500_000
"""Largest number of files and folders below a source folder."""
MAX_DEPTH = 64
"""Largest nesting depth of XML elements."""

ARCHIVE_ERRORS = (
    zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError, ValueError,
)  # fmt: skip
"""Errors of opening and unpacking a ZIP archive that is damaged, encrypted or something else."""

_T = TypeVar("_T")


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Return the contents of a regular file.

    Raises:
        FurnitureError: the file is missing, not regular, unreadable, or larger than `limit` bytes.
    """
    try:
        # Without O_NONBLOCK, opening a pipe would block.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else str(problem)
        raise FurnitureError(f"'{_display_path(path)}' cannot be read: {reason}") from None
    try:
        with os.fdopen(handle, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise FurnitureError(f"'{_display_path(path)}' is not a regular file")
            data = file.read(limit + 1) if status.st_size <= limit else None
    except OSError as problem:
        raise FurnitureError(f"'{_display_path(path)}' cannot be read: {problem.strerror}") from None
    if data is None or len(data) > limit:
        raise FurnitureError(f"'{_display_path(path)}' is larger than {limit // 2**20} MiB; simplify or split it")
    return data


def read_text(path: Path, what: str, limit: int = MAX_BYTES) -> str:
    """Return the contents of a UTF-8 text file.

    Raises:
        FurnitureError: as `read_bytes`, or the text is not UTF-8; the message names the format `what` (`OBJ`, ...).
    """
    try:
        return read_bytes(path, limit).decode("utf-8")
    except UnicodeDecodeError as problem:
        raise FurnitureError(
            f"'{_display_path(path)}' cannot be read as {what} ({problem.reason} at byte {problem.start}); "
            f"export it again as text"
        ) from None


def decode_json(data: bytes, kind: type[_T], where: str) -> _T:
    """Decode JSON of the given type.

    Raises:
        FurnitureError: the data is not JSON, does not fit the type, or is nested too deeply.
    """
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as problem:
        raise FurnitureError(f"{where} is not valid: {one_line(str(problem))}") from None
    except RecursionError:
        raise FurnitureError(f"{where} is nested too deeply") from None


def read_json(path: Path, kind: type[_T]) -> _T:
    """Read a JSON file of the given type; raises as `read_bytes` and `decode_json`."""
    return decode_json(read_bytes(path, MAX_TEXT_BYTES), kind, f"'{_display_path(path)}'")


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root of an XML file that declares no document type and no entities.

    Raises:
        FurnitureError: as `read_bytes`; the file is not well formed, has a DOCTYPE, or nests elements deeper than
            `MAX_DEPTH`.
    """
    data = read_bytes(path, MAX_TEXT_BYTES)
    where = f"'{_display_path(path)}'"
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
    """Return the path of a file that a source file names relative to `root`.

    Raises:
        FurnitureError: the name is absolute, or leads out of `root` through `..` or a link.
    """
    try:
        # Windows separators and drives could lead out of the folder on other systems; no format needs them.
        path = (root / name).resolve()
        safe = bool(name) and "\\" not in name and not Path(name).is_absolute()
        safe = safe and path.is_relative_to(root.resolve())
    except (OSError, ValueError, RuntimeError):
        safe, path = False, root
    if not safe:
        raise FurnitureError(
            f"{where} names the file {one_line(repr(name))}, which is not inside '{_display_path(root)}'"
        )
    return path


def folder(path: Path, expected: str) -> Path:
    """Return `path` if it is a folder; otherwise raise `FurnitureError` with the `expected` contents."""
    path = Path(path)
    try:
        exists = path.is_dir()
    except ValueError:
        exists = False
    if not exists:
        raise FurnitureError(f"'{_display_path(path)}' is not a folder; give {expected}")
    return path


def walk(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield every folder at or below `root` with the sorted names of its files; links to folders are not followed.

    Raises:
        FurnitureError: there are more than `MAX_ENTRIES` files and folders.
    """
    seen = 0
    for here, folders, files in os.walk(root):
        seen += len(folders) + len(files)
        if seen > MAX_ENTRIES:
            raise FurnitureError(f"'{_display_path(root)}' holds more than {MAX_ENTRIES} files; name a smaller folder")
        folders.sort()
        yield Path(here), sorted(files)


def find_folders(root: Path, has: Callable[[Path, list[str]], bool], expected: str) -> list[Path]:
    """Return the sorted folders at or below `root` that `has` accepts (folder, names of its files).

    Raises:
        FurnitureError: `root` is not a folder, or `has` accepts no folder.
    """
    root = folder(root, expected)
    found = sorted(here for here, files in walk(root) if has(here, files))
    if not found:
        raise FurnitureError(f"'{_display_path(root)}' holds nothing to import; give {expected}")
    return found


def one_line(text: str, length: int = 160) -> str:
    """Return untrusted text as one printable line of at most `length` characters."""
    text = " ".join("".join(c if c.isprintable() else "?" for c in text).split())
    return text if len(text) <= length else text[: length - 1] + "…"


def _display_path(path: Path) -> str:
    return one_line(str(path), 400)
