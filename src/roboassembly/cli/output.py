"""What commands say, and where: results on stdout, all else on stderr."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from roboassembly.errors import InputError

_LOGGED_EVERY = 30.0
"""Seconds."""
DONE, DONE_BADLY = 0, 1
"""Exit statuses: it worked; it was tried in earnest and did not work. Bad input is 2."""


def say(text: str) -> None:
    """A line for the person who watches."""
    print(text, file=sys.stderr, flush=True)


def progress_bar(iterable: Iterable[Any] | None = None, **told: Any) -> tqdm[Any]:
    """A bar for the person who watches, as `tqdm`; a line now and then where nobody does, so that log files stay small.

    Args:
        iterable: counted while it is gone through.
        told: to `tqdm`.
    """
    # A run that goes on begins with many at once; by itself tqdm would then expect as many more before it shows any.
    return tqdm(iterable, mininterval=0.1 if sys.stderr.isatty() else _LOGGED_EVERY, miniters=1, **told)


def print_json(result: Mapping[str, object]) -> None:
    """The one JSON object that `--json` promises."""
    print(json.dumps(result), flush=True)


def writable_folder(path: Path) -> Path:
    """Make the folder if need be.

    Raises:
        InputError: it is a file, or cannot be made or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        # Of a name of its own: other commands may be trying the same folder.
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise InputError(f"cannot write to folder {path}: {error.strerror or error}") from None
    return path
