"""Arrays in npz files that are written whole or not at all, and no code in them."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.errors import InputError

_BROKEN = (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error)
"""What reading a file raises that is cut short, changed, or something else."""


def write(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays, compressed; a process that is killed meanwhile leaves the file as it was."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}.npz")
    try:
        np.savez_compressed(scratch, allow_pickle=False, **arrays)
        scratch.replace(path)
    finally:
        scratch.unlink(missing_ok=True)


@contextmanager
def reading(path: Path, what: str, remedy: str) -> Iterator[Mapping[str, np.ndarray]]:
    """Arrays that `write` wrote; whatever goes wrong inside is the file's fault.

    Args:
        path: of the file.
        what: it should be, for the message.
        remedy: what to do if it is not.

    Raises:
        InputError: the file is broken, or lacks something.
    """
    try:
        with np.load(path, allow_pickle=False) as z:
            yield z
    except _BROKEN as error:
        raise InputError(f"'{path}' is not {what} ({error}); {remedy}") from None
