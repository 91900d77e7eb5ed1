"""Uploads: furniture in files that a client sends."""

from __future__ import annotations

import stat
import tempfile
import zipfile
from io import BytesIO
from pathlib import Path, PurePosixPath

from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture.model import Furniture
from roboassembly.importers.files import ARCHIVE_ERRORS
from roboassembly.studio.config import LARGEST_UPLOAD
from roboassembly.studio.sources import open_path

MOST_FILES = 500
"""Largest number of files in an archive."""
_ARCHIVE = ".zip"


def unpack(name: str, content: bytes, folder: Path) -> Path:
    """Write an uploaded file, or the contents of an uploaded archive, into an empty folder.

    Args:
        name: name of the file from the browser; only its last component is used.
        content: contents of the file: a ZIP archive of a furniture folder or of 3D files, or one 3D file.
        folder: folder to write to.

    Returns:
        The path for `sources.open_path`.

    Raises:
        InputError: the file is too large, or the archive is broken or has entries that would lie outside.
    """
    plain = PurePosixPath(name.replace("\\", "/")).name
    if not plain or plain in (".", "..") or "\0" in plain:
        raise InputError(f"'{name}' is not a valid file name")
    if len(content) > LARGEST_UPLOAD:
        raise InputError(f"'{plain}' has {len(content):,} bytes; at most {LARGEST_UPLOAD:,} are allowed")
    if not plain.lower().endswith(_ARCHIVE):
        # In a folder named after the piece.
        target = folder / PurePosixPath(plain).stem / plain
        target.parent.mkdir()
        target.write_bytes(content)
        return target.parent
    target = folder / plain[: -len(_ARCHIVE)] if plain[: -len(_ARCHIVE)] else folder / "furniture"
    target.mkdir()
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            _extract(archive, plain, target)
    except ARCHIVE_ERRORS as error:
        raise InputError(f"'{plain}' is not a readable ZIP archive: {error}") from None
    # The archive of a folder has that folder as its only entry.
    inside = [p for p in target.iterdir() if not p.name.startswith(("__MACOSX", "."))]
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else target


def _extract(archive: zipfile.ZipFile, name: str, target: Path) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_FILES:
        raise InputError(f"'{name}' contains {len(entries)} files; at most {MOST_FILES} are allowed")
    left = LARGEST_UPLOAD
    for entry in entries:
        inner = PurePosixPath(entry.filename.replace("\\", "/"))
        linked = stat.S_ISLNK(entry.external_attr >> 16)
        if inner.is_absolute() or ".." in inner.parts or ":" in entry.filename or linked:
            raise InputError(
                f"'{name}': entry '{entry.filename}' would lie outside of the folder; pack the folder itself"
            )
        path = target.joinpath(*inner.parts)
        if entry.is_dir():
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as packed, path.open("wb") as file:
            # The sizes that an archive states may be wrong.
            content = packed.read(left + 1)
            left -= len(content)
            if left < 0:
                raise InputError(f"'{name}' unpacks to more than {LARGEST_UPLOAD:,} bytes, the largest size allowed")
            file.write(content)


def open_upload(name: str, content: bytes, scale: float | None = None) -> Furniture:
    """Read furniture from an uploaded file; no files are left on the disk.

    Args:
        name: name of the file.
        content: contents of the file, as for `unpack`.
        scale: scale of 3D files [m per unit]; estimated if None.

    Raises:
        InputError: the file does not contain furniture, or the disk is full.
    """
    with tempfile.TemporaryDirectory(prefix="roboassembly-") as folder:
        try:
            return open_path.__wrapped__(str(unpack(name, content, Path(folder))), scale)
        except FurnitureError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except OSError as error:
            raise InputError(f"'{name}' cannot be unpacked: {error.strerror or error}") from None
