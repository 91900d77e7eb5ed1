"""Cache of imports: the furniture made from the same files, or the reason for their refusal.

The key is a hash of all files that the importer may read, the options, the code that reads, repairs, annotates and
chooses grasps, and the versions of the libraries. A change of the files or of the program therefore never returns an
old result.

An entry is one file, `imports/*.import`: a checksum, then the result. Entries appear and disappear atomically; a
damaged entry is ignored.
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

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.cache import cache_folder
from roboassembly.geometry.units import Unit

MAX_BYTES = 1_000_000_000
"""Largest total size of the cache [bytes]; the least recently used entries are removed first."""
MAX_FILES, MAX_READ = 5_000, 500_000_000
"""Largest number of files and bytes of a source that is cached; hashing a larger source takes too long."""
REPORT = "import-report.html"
"""Name of the report page in a furniture folder."""
LIBRARIES = (
    "cascadio",
    "coal",
    "embreex",
    "fast-simplification",
    "manifold3d",
    "networkx",
    "numpy",
    "pin",
    "scipy",
    "trimesh",
)
"""Libraries whose version may change the result of repair or annotation."""
_CHECKSUM_BYTES = 16
_ABANDONED = 86_400.0
"""Age after which an unfinished file is removed [s]."""


class Summary(msgspec.Struct, frozen=True):
    """Result of an import in figures."""

    parts: int = 0
    connections: int = 0
    displacement_max_mm: float = 0.0
    trimmed_max_percent: float = 0.0
    parts_mm: dict[str, float] = {}
    """Largest change of size of each part, by name; negative if it became smaller [mm]."""
    changes: tuple[str, ...] = ()
    """Changes of size and losses of depth above 1 mm, one line each."""
    unholdable: tuple[str, ...] = ()
    """Names of the parts that no Franka gripper can grasp."""
    unit: Unit | None = None
    size_m: tuple[float, float, float] | None = None
    """Size of the piece as read along x, y and z (up) [m]."""
    remarks: tuple[str, ...] = ()
    """Remarks on the reading for the user, one line each."""
    findings: tuple[str, ...] = ()
    """Findings worth a look, the most important first."""
    error: str | None = None
    """Reason for the refusal; None if the import succeeded."""
    refused_at: str | None = None
    """Path of the source if `error` may name it; the entry then holds for that path only."""


class _Entry(msgspec.Struct, frozen=True):
    summary: Summary
    files: dict[str, bytes]
    """Files of the furniture folder by name; empty if the import was refused."""
    report: bytes | None = None
    """Report page; None if there is none."""


def place_of(source: Path, reads: Path, *options: object) -> Path | None:
    """Return the path of an import's cache entry; None if the source is too large to hash or unreadable.

    Args:
        source: path of the piece.
        reads: file or folder with everything that the importer may read for it.
        options: all other values that the result depends on.
    """
    own = source.resolve()
    digest = hashlib.blake2b(program_hash(), digest_size=16)
    # Importers take a piece's name from the last component of its path, and its category from the one before.
    digest.update(repr((own.parent.name, own.name, options)).encode())
    content = _content(reads.resolve())
    if content is None:
        return None
    digest.update(content)
    return cache_folder() / "imports" / f"{digest.hexdigest()}.import"


def recall(place: Path, source: Path, target: Path) -> Summary | None:
    """Write a cached import to `target`; None if there is no valid entry, or it is a refusal of another path.

    Raises:
        InputError: `target` cannot be written.
    """
    try:
        data = place.read_bytes()
    except OSError:
        return None
    if checksum(data[_CHECKSUM_BYTES:]) != data[:_CHECKSUM_BYTES]:
        return None
    try:
        entry = msgspec.msgpack.decode(data[_CHECKSUM_BYTES:], type=_Entry)
    except msgspec.MsgspecError:
        return None
    if entry.summary.refused_at not in (None, str(source)):
        return None
    refused = entry.summary.error is not None
    if not refused:
        storage.save_files(entry.files, target)
    if entry.report is not None:
        write_report(entry.report, report_path(target, refused=refused))
    try:
        os.utime(place)
    except OSError:
        # The cache is read-only, or another process evicted the entry: the result is valid all the same.
        return entry.summary
    return entry.summary


def keep(place: Path, summary: Summary, target: Path) -> None:
    """Store an import whose furniture was saved at `target`; does nothing if the cache cannot be written."""
    try:
        files = storage.read_files(target) if summary.error is None else {}
        page = report_path(target, refused=summary.error is not None)
        report = page.read_bytes() if page.is_file() else None
        data = msgspec.msgpack.encode(_Entry(summary, files, report))
        place.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(prefix=".new-", dir=place.parent)
    except (OSError, InputError):
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(checksum(data) + data)
        Path(scratch).replace(place)
        evict(place.parent)
    except OSError:
        # The disk is full, or another process evicts entries at the same time: the import itself has succeeded.
        return
    finally:
        Path(scratch).unlink(missing_ok=True)


def report_path(target: Path, *, refused: bool) -> Path:
    """Return the path of the report page: in the furniture folder, or beside it for a piece that was refused."""
    return target.with_name(f"{target.name}.refused.html") if refused else target / REPORT


def write_report(page: bytes, path: Path) -> None:
    """Write a report page, completely or not at all.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with atomic_write(path) as unfinished:
            unfinished.write_bytes(page)
    except OSError as error:
        raise InputError(f"cannot write '{path}': {error.strerror or error}") from None


def checksum(data: bytes) -> bytes:
    """Return the checksum of an entry's data."""
    return hashlib.blake2b(data, digest_size=_CHECKSUM_BYTES).digest()


@cache
def program_hash() -> bytes:
    """Return a hash of all code and library versions that an import's result may depend on."""
    root = Path(__file__).parents[1]
    digest = hashlib.blake2b(repr([library_version(name) for name in LIBRARIES]).encode())
    files = [root / "robots" / "gripper.py", *sorted((root / "viewer").glob("import_*.py"))]
    files += [
        path
        for package in ("geometry", "furniture", "importers", "planning", "rendering", "repair", "solvers", "task")
        for path in sorted((root / package).rglob("*.py"))
    ]
    for path in files:
        digest.update(path.read_bytes())
    return digest.digest()


def library_version(library: str) -> str | None:
    """Return the version of an installed library; None if it is installed under another name."""
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def _content(source: Path) -> bytes | None:
    """Return a hash of a file, or of all names and files below a folder; None if too large or unreadable."""
    digest = hashlib.blake2b()
    total = 0
    try:
        for count, file in enumerate(_below(source)):
            status = _status(file)
            total += status.st_size if status else 0
            if count >= MAX_FILES or total > MAX_READ:
                return None
            digest.update(repr(str(file.relative_to(source))).encode())
            # Importers read neither pipes nor broken links: only their presence counts.
            digest.update(_file_hash(file, status.st_size, status.st_ctime_ns) if status else b"no file")
    except OSError:
        return None
    return digest.digest()


def _below(source: Path) -> Iterator[Path]:
    """Yield the file itself, or all folders and files below a folder in a fixed order; follows links."""
    if source.is_file():
        yield source
    # Links may form a cycle; the caller stops after `MAX_FILES`.
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
    """Return the hash of a file; cached by size and change time, so that pieces in one folder share it."""
    return hashlib.blake2b(file.read_bytes()).digest()


def evict(folder: Path) -> None:
    """Remove unfinished files, and the least recently used entries beyond `MAX_BYTES`."""
    for left in folder.glob(".new-*"):
        if time.time() - left.stat().st_mtime > _ABANDONED:
            left.unlink(missing_ok=True)
    entries = [(path.stat(), path) for path in folder.glob("*.import")]
    total = 0
    for status, path in sorted(entries, key=lambda entry: entry[0].st_mtime, reverse=True):
        total += status.st_size
        if total > MAX_BYTES:
            path.unlink(missing_ok=True)
