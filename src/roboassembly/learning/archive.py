"""Arrays in npz files, without code, written whole or not at all."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError

_BROKEN = (
    OSError, ValueError, KeyError, EOFError, TypeError, OverflowError, MemoryError, RuntimeError, struct.error,
    zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""Errors of reading a file that is cut short, changed, encrypted, or something else."""
Arrays = Mapping[str, np.ndarray]
"""Arrays of a file by name."""
_ARCHIVE = b"PK"
"""First bytes of an npz file, as of all ZIP archives."""


def write(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays, compressed; if the process is killed meanwhile, the file stays as it was."""
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


@contextmanager
def reading(path: Path, what: str, remedy: str, largest: int | None = None) -> Generator[Arrays]:
    """Open the arrays that `write` wrote; errors inside the block count as errors of the file.

    Args:
        path: file.
        what: expected content, for messages.
        remedy: advice for messages.
        largest: largest unpacked size of all arrays [bytes]; any if None.

    Raises:
        InputError: the file is a folder, no archive, broken, too large, or lacks something.
    """
    if path.is_dir():
        raise InputError(f"'{path}' is a folder, not {what}; {remedy}")
    try:
        with path.open("rb") as file:
            begins = file.read(len(_ARCHIVE))
        if begins != _ARCHIVE:
            raise InputError(f"'{path}' is not {what}: it is no NumPy archive; {remedy}")
        if largest is not None:
            with zipfile.ZipFile(path) as packed:
                # A member cannot unpack to more than the archive says of it: reading ends there.
                size = sum(member.file_size for member in packed.infolist())
            if size > largest:
                raise InputError(f"'{path}' unpacks to {size:,} bytes; expected at most {largest:,}; {remedy}")
        with np.load(path, allow_pickle=False) as z:
            yield z
    except _BROKEN as error:
        raise InputError(f"'{path}' is not {what} ({error}); {remedy}") from None
