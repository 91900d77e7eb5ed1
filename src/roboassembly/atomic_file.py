"""Writing of files that are either complete or absent."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: Path, scratch: Path | None = None) -> Generator[Path]:
    """Yield a temporary path; it replaces `path` if the block ends without an error.

    Missing folders are created.

    Args:
        path: file to write.
        scratch: folder of the temporary path, on the same disk; that of `path` if None. A killed process leaves the
            temporary file there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if scratch is not None:
        scratch.mkdir(parents=True, exist_ok=True)
    unfinished = (scratch or path.parent) / f".{path.stem}.{os.getpid()}{path.suffix}"
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
