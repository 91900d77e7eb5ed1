"""Imports that were done before: what the same files became, or why they were refused.

The key is the content of all files that reading could have looked at, the options, the code that reads, repairs and
annotates, and the versions of the libraries that it computes with: neither changed files nor a changed program can
bring back an old result. A version number kept by hand would be forgotten one day.

An entry is one file, `imports/*.import`: a checksum, then what was imported. It appears and goes at once, whoever else
is reading it, and one that is damaged counts as none.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import time
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path

import msgspec

from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.cache import cache_folder
from roboassembly.geometry.units import Unit

MAX_BYTES = 1_000_000_000
"""What all kept imports may take; those not used for the longest time go first."""
MAX_FILES, MAX_READ = 5_000, 500_000_000
"""A source of more files, or more bytes, is not looked up: to read it all would take too long."""
LIBRARIES = ("coal", "embreex", "fast-simplification", "manifold3d", "networkx", "numpy", "pin", "scipy", "trimesh")
"""Another version of one of these may repair or annotate differently."""
_CHECKSUM = 16
_ABANDONED = 86_400.0
"""Seconds after which a file that nobody finished writing is removed."""


class Summary(msgspec.Struct, frozen=True):
    """What an import came to."""

    parts: int = 0
    connections: int = 0
    displacement_max_mm: float = 0.0
    trimmed_max_percent: float = 0.0
    parts_mm: dict[str, float] = {}
    """Largest change of each part's size, in mm, negative where it became smaller; by name."""
    changes: tuple[str, ...] = ()
    """Parts whose size changed, or that sit less deep in a neighbour, by more than 1 mm; a line each."""
    unholdable: tuple[str, ...] = ()
    """Names of the parts that no Franka hand can hold."""
    unit: Unit | None = None
    size_m: tuple[float, float, float] | None = None
    """Of the piece as read: along x, y and z (up), in metres."""
    remarks: tuple[str, ...] = ()
    """What a person should know of the reading, one line each."""
    error: str | None = None
    """Why it was refused."""
    refused_at: str | None = None
    """The source's path, where `error` may name it: it then holds for that path only."""


class _Entry(msgspec.Struct, frozen=True):
    summary: Summary
    files: dict[str, bytes]
    """The furniture folder's; none where it was refused."""


def place_of(source: Path, reads: Path, *options: object) -> Path | None:
    """Where an import would be kept; None if that cannot be told cheaply.

    Args:
        source: the piece.
        reads: file or folder that holds all that the importer may read of it.
        options: whatever else the result depends on.
    """
    own = source.resolve()
    digest = hashlib.blake2b(_program(), digest_size=16)
    # Formats take a piece's name from its path's last word, and its category from the one before.
    digest.update(repr((own.parent.name, own.name, options)).encode())
    content = _content(reads.resolve())
    if content is None:
        return None
    digest.update(content)
    return cache_folder() / "imports" / f"{digest.hexdigest()}.import"


def recall(place: Path, source: Path, target: Path) -> Summary | None:
    """Write what is kept to `target`; None if nothing is, if it is damaged, or refused under another path.

    Raises:
        InputError: `target` cannot be written.
    """
    try:
        data = place.read_bytes()
    except OSError:
        return None
    if _checksum(data[_CHECKSUM:]) != data[:_CHECKSUM]:
        return None
    try:
        entry = msgspec.msgpack.decode(data[_CHECKSUM:], type=_Entry)
    except msgspec.MsgspecError:
        return None
    if entry.summary.refused_at not in (None, str(source)):
        return None
    if entry.summary.error is None:
        storage.save_files(entry.files, target)
    try:
        os.utime(place)
    except OSError:
        # A cache that may only be read, or another process made room: neither spoils what was found.
        return entry.summary
    return entry.summary


def keep(place: Path, summary: Summary, target: Path) -> None:
    """Remember an import whose furniture was saved at `target`. A cache that cannot be written is done without."""
    try:
        files = storage.read_files(target) if summary.error is None else {}
        data = msgspec.msgpack.encode(_Entry(summary, files))
        place.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(prefix=".new-", dir=place.parent)
    except (OSError, InputError):
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_checksum(data) + data)
        Path(scratch).replace(place)
        _make_room(place.parent)
    except OSError:
        # A full disk, or another process made room at the same time: the import itself has succeeded.
        return
    finally:
        Path(scratch).unlink(missing_ok=True)


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_CHECKSUM).digest()


@cache
def _program() -> bytes:
    """Hash of all code that an import's result may depend on."""
    root = Path(__file__).parents[1]
    digest = hashlib.blake2b(repr([_version(name) for name in LIBRARIES]).encode())
    files = [root / "robots" / "gripper.py"]
    files += [
        path
        for room in ("geometry", "furniture", "importers", "repair")
        for path in sorted((root / room).rglob("*.py"))
    ]
    for path in files:
        digest.update(path.read_bytes())
    return digest.digest()


def _version(library: str) -> str | None:
    """None where another installer gave it another name."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def _content(source: Path) -> bytes | None:
    """Hash of a file, or of all names and files below a folder; None for too many, or what may not be read."""
    digest = hashlib.blake2b()
    total = 0
    try:
        for count, file in enumerate(_below(source)):
            status = _status(file)
            total += status.st_size if status else 0
            if count >= MAX_FILES or total > MAX_READ:
                return None
            digest.update(repr(str(file.relative_to(source))).encode())
            # Importers wait for no pipe and follow no broken link: that such a thing is there is all there is to know.
            digest.update(_file_hash(file, status.st_size, status.st_ctime_ns) if status else b"no file")
    except OSError:
        return None
    return digest.digest()


def _below(source: Path) -> Iterator[Path]:
    """The file itself, or all folders and files below a folder in a fixed order, through links too."""
    if source.is_file():
        yield source
    # Links may run in circles; whoever asks stops after so many.
    for here, folders, names in os.walk(source, followlinks=True):
        folders.sort()
        yield Path(here)
        yield from (Path(here, name) for name in sorted(names))


def _status(file: Path) -> os.stat_result | None:
    try:
        status = file.stat()
    except FileNotFoundError:
        return None
    return status if stat.S_ISREG(status.st_mode) else None


@lru_cache(maxsize=2 * MAX_FILES)
def _file_hash(file: Path, size: int, changed: int) -> bytes:
    """Of a file as it was at that size and time: pieces that share a folder have it read once."""
    return hashlib.blake2b(file.read_bytes()).digest()


def _make_room(folder: Path) -> None:
    for left in folder.glob(".new-*"):
        if time.time() - left.stat().st_mtime > _ABANDONED:
            left.unlink(missing_ok=True)
    entries = [(path.stat(), path) for path in folder.glob("*.import")]
    total = 0
    for status, path in sorted(entries, key=lambda entry: entry[0].st_mtime, reverse=True):
        total += status.st_size
        if total > MAX_BYTES:
            path.unlink(missing_ok=True)
