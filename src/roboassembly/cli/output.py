"""What commands print, and where: results on stdout, all else on stderr, control characters written out."""

from __future__ import annotations

import io
import json
import logging
import os
import sys
import tempfile
import threading
import traceback
import unicodedata
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from tqdm import tqdm

from roboassembly.errors import InputError

_LOGGED_EVERY = 30.0
"""Seconds."""
DONE, DONE_BADLY = 0, 1
"""Exit statuses: it worked; it was tried in earnest and did not work. Bad input is 2."""
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories that a terminal acts on or cannot show: control, format (the bidirectional overrides are among
them), lone surrogates (bytes of file names that are no text), and separators of lines and paragraphs."""
_HARMLESS = frozenset("\t\u200c\u200d")
"""Tab, and the two joiners that Persian, Indic scripts and emoji are written with."""


def plain(text: object) -> str:
    r"""The text as one line that cannot steer a terminal: each control character is written out, ESC as `\x1b`."""
    line = str(text)
    if line.isprintable():
        return line
    return "".join(_written_out(c) for c in line)


def _written_out(character: str) -> str:
    if unicodedata.category(character) not in _STEERING or character in _HARMLESS:
        return character
    return character.encode("unicode_escape").decode("ascii")


def say(*lines: object) -> None:
    """Print lines on stderr, for the person who watches."""
    _print(lines, sys.stderr)


def show(*lines: object) -> None:
    """Print lines of a result on stdout."""
    _print(lines, sys.stdout)


def _print(lines: Iterable[object], stream: TextIO) -> None:
    with reader_may_leave():
        for line in lines:
            print(plain(line), file=stream)
        stream.flush()


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """End quietly where the program that reads stdout has ended, as in `roboassembly ... | head -1`."""
    try:
        yield
    except BrokenPipeError:
        # Python flushes stdout once more when it ends, and would complain then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(DONE_BADLY)


def print_json(result: Mapping[str, object]) -> None:
    """Print the one JSON object that `--json` promises."""
    # JSON leaves the one control character as it is that ASCII has beyond the letters.
    with reader_may_leave():
        print(json.dumps(result).replace("\x7f", "\\u007f"), flush=True)


def progress_bar(iterable: Iterable[Any] | None = None, desc: str | None = None, **options: Any) -> tqdm[Any]:
    """A bar on stderr, as `tqdm`; a line now and then where stderr is no terminal, so that log files stay small.

    Args:
        iterable: counted while it is gone through.
        desc: what is counted; its control characters are written out.
        options: of `tqdm`.
    """
    # A run that goes on begins with many at once; by itself tqdm would then expect as many more before it shows any.
    every = 0.1 if sys.stderr.isatty() else _LOGGED_EVERY
    named = None if desc is None else plain(desc)
    return tqdm(iterable, desc=named, mininterval=every, miniters=1, **options)


class _PlainLog(logging.Formatter):
    """Log messages as single lines without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record))


def guard_terminal() -> None:
    """Let all that Python itself prints pass through `plain` too: tracebacks, warnings, log messages of libraries."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Letters that the terminal's encoding lacks are no reason to fail; on stderr Python does so by itself.
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.excepthook = _print_traceback
    if threading.excepthook is threading.__excepthook__:
        threading.excepthook = _print_thread_traceback
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_PlainLog())
    warnings.formatwarning = _format_warning


def _print_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    for block in traceback.format_exception(kind, error, trace):
        say(*block.rstrip("\n").split("\n"))


def _print_thread_traceback(ended: threading.ExceptHookArgs) -> None:
    if ended.exc_value is not None and not isinstance(ended.exc_value, SystemExit):
        say(f"Exception in thread {ended.thread.name if ended.thread else '?'}:")
        _print_traceback(ended.exc_type, ended.exc_value, ended.exc_traceback)


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    return plain(f"{filename}:{lineno}: {category.__name__}: {message}") + "\n"


def check_writable(path: Path) -> None:
    """Refuse a folder that could not be made or written; nothing is left behind.

    Raises:
        InputError: it or something above it is a file, or may not be written.
    """
    try:
        nearest = next(p for p in (path, *path.absolute().parents) if p.exists() or p.is_symlink())
        # With a name of its own: other commands may be trying the same folder.
        tempfile.TemporaryFile(dir=nearest).close()
    except (OSError, ValueError) as error:
        raise InputError(f"cannot write to folder {path}: {_reason(error)}") from None


def check_writable_file(path: Path) -> None:
    """Refuse a file that is there and may not be written.

    Raises:
        InputError: naming it.
    """
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputError(f"cannot write {path}: {_reason(error)}") from None


def refuse_existing(target: Path) -> None:
    """Refuse to write where something is already; an empty folder is nothing.

    Raises:
        InputError: naming it, and what would do.
    """
    try:
        there = target.is_symlink() or (any(target.iterdir()) if target.is_dir() else target.exists())
    except OSError as error:
        raise InputError(f"cannot write to {target}: {_reason(error)}") from None
    if there and target.is_dir() and not (target / "furniture.json").is_file():
        raise InputError(f"'{target}' exists and is not a furniture folder; --out names another place")
    if there:
        raise InputError(f"'{target}' exists already; --force replaces it, --out names another place")


def refuse_furniture_folder(path: Path) -> None:
    """Refuse to write other files into a furniture folder.

    Raises:
        InputError: it is one.
    """
    if (path / "furniture.json").exists():
        raise InputError(f"'{path}' is a furniture folder; name another --out for what comes of it")


def writable_folder(path: Path) -> Path:
    """Make the folder if need be.

    Raises:
        InputError: it is a file, or cannot be made or written.
    """
    check_writable(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except OSError as error:
        raise InputError(f"cannot write to folder {path}: {_reason(error)}") from None
    return path


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
