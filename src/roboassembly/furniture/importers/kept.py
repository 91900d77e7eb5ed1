"""Imports that were done before: what the same files became, or why they were refused.

The key is the content of all files that reading could have looked at, the options, and the code that reads, repairs
and annotates: neither changed files nor a changed program can bring back an old result.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

import msgspec

from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.cache import cache_folder

MAX_BYTES = 1_000_000_000
"""What all kept imports may take; those not used for the longest time go first."""
MAX_FILES, MAX_READ = 5_000, 500_000_000
"""A source of more files, or more bytes, is not looked up: to read it all would take too long."""
_SUMMARY, _FURNITURE = "summary.json", "furniture"


class Summary(msgspec.Struct, frozen=True):
    """What an import came to."""

    parts: int = 0
    connections: int = 0
    displacement_max_mm: float = 0.0
    trimmed_max_percent: float = 0.0
    unholdable: tuple[str, ...] = ()
    """Names of the parts that no Franka hand can hold."""
    error: str | None = None
    """Why it was refused."""


def place_of(source: Path, *options: object) -> Path | None:
    """Where an import of all that is at `source` would be kept; None if that cannot be told cheaply.

    Args:
        source: file or folder that holds all that the importer may read.
        options: whatever else the result depends on.
    """
    digest = hashlib.blake2b(_program(), digest_size=16)
    digest.update(repr(options).encode())
    content = _content(source.resolve())
    if content is None:
        return None
    digest.update(content)
    return cache_folder() / "imports" / digest.hexdigest()


def recall(place: Path, target: Path) -> Summary | None:
    """Copy what is kept to `target`; None if nothing is, or if it is broken.

    Raises:
        InputError: `target` cannot be written.
    """
    try:
        summary = msgspec.json.decode((place / _SUMMARY).read_bytes(), type=Summary)
        os.utime(place)
        if summary.error is None and not (place / _FURNITURE / storage.FILE_NAME).is_file():
            return None
    except (OSError, msgspec.MsgspecError):
        return None
    if summary.error is None:
        storage.copy(place / _FURNITURE, target)
    return summary


def keep(place: Path, summary: Summary, target: Path) -> None:
    """Remember an import whose furniture was saved at `target`. A cache that cannot be written is done without."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=".new-", dir=place.parent))
    except OSError:
        return
    try:
        if summary.error is None:
            storage.copy(target, scratch / _FURNITURE)
        (scratch / _SUMMARY).write_bytes(msgspec.json.encode(summary))
        shutil.rmtree(place, ignore_errors=True)
        scratch.rename(place)
        _make_room(place.parent)
    except (OSError, InputError):
        # A full or read-only disk, or another process was faster: the import itself has succeeded.
        return
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@cache
def _program() -> bytes:
    """Hash of all code that an import's result may depend on."""
    root = Path(__file__).parents[2]
    digest = hashlib.blake2b()
    for path in [*sorted(root.glob("*.py")), *sorted((root / "furniture").rglob("*.py"))]:
        digest.update(path.read_bytes())
    return digest.digest()


@cache
def _content(source: Path) -> bytes | None:
    """Hash of a file, or of all names and files below a folder."""
    files = [source] if source.is_file() else sorted(p for p in source.rglob("*") if p.is_file())
    digest = hashlib.blake2b()
    try:
        if len(files) > MAX_FILES or sum(f.stat().st_size for f in files) > MAX_READ:
            return None
        for file in files:
            digest.update(repr(str(file.relative_to(source))).encode())
            digest.update(hashlib.blake2b(file.read_bytes()).digest())
    except OSError:
        return None
    return digest.digest()


def _make_room(folder: Path) -> None:
    entries = sorted((p for p in folder.iterdir() if not p.name.startswith(".")), key=lambda p: -p.stat().st_mtime)
    total = 0
    for entry in entries:
        total += sum(f.stat().st_size for f in entry.rglob("*") if f.is_file())
        if total > MAX_BYTES:
            shutil.rmtree(entry, ignore_errors=True)
