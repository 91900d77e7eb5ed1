"""Output of commands: results go to stdout, everything else to stderr; control characters are escaped."""

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
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

from roboassembly.errors import InputError

if TYPE_CHECKING:
    from tqdm import tqdm

_LOG_INTERVAL = 30.0
"""Time between two lines of a progress bar in a log file [s]."""
DONE, FAILED = 0, 1
"""Exit statuses of success and of failure on valid input. Bad input has status 2."""
_CONTROL = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories that a terminal interprets or cannot show: control, format (with the bidirectional overrides),
lone surrogates (bytes of file names that are not text), and separators of lines and paragraphs."""
_HARMLESS = frozenset("\t\u200c\u200d")
"""Tab, and the two joiners that Persian, Indic scripts and emoji need."""


def plain(text: object) -> str:
    r"""Return the text as one line with escaped control characters, such as `\x1b` for ESC."""
    line = str(text)
    if line.isprintable():
        return line
    return "".join(_escaped(c) for c in line)


def _escaped(character: str) -> str:
    if unicodedata.category(character) not in _CONTROL or character in _HARMLESS:
        return character
    return character.encode("unicode_escape").decode("ascii")


def say(*lines: object) -> None:
    """Print lines on stderr."""
    _print(lines, sys.stderr)


def show(*lines: object) -> None:
    """Print lines of a result on stdout."""
    _print(lines, sys.stdout)


def _print(lines: Iterable[object], stream: TextIO) -> None:
    with allow_closed_stdout():
        for line in lines:
            print(plain(line), file=stream)
        stream.flush()


@contextmanager
def allow_closed_stdout() -> Generator[None]:
    """Exit quietly if the reader of stdout has exited, as in `roboassembly ... | head -1`."""
    try:
        yield
    except BrokenPipeError:
        # Python flushes stdout at its end, which would print an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(FAILED)


def print_json(result: Mapping[str, object]) -> None:
    """Print the one JSON object that `--json` promises."""
    # JSON escapes all ASCII control characters but DEL.
    with allow_closed_stdout():
        print(json.dumps(result).replace("\x7f", "\\u007f"), flush=True)


def progress_bar(iterable: Iterable[Any] | None = None, desc: str | None = None, **options: Any) -> tqdm[Any]:
    """Return a progress bar of `tqdm` on stderr; if stderr is not a terminal, it prints a line now and then.

    Args:
        iterable: iterable to count; None to update the bar by hand.
        desc: label of the bar; its control characters are escaped.
        options: options of `tqdm`.
    """
    from tqdm import tqdm

    # A resumed run begins with many items at once; tqdm would expect as many again before the next update.
    interval = 0.1 if sys.stderr.isatty() else _LOG_INTERVAL
    label = None if desc is None else plain(desc)
    return tqdm(iterable, desc=label, mininterval=interval, miniters=1, **options)


class _PlainLog(logging.Formatter):
    """Log messages as single lines without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record))


def guard_terminal() -> None:
    """Escape control characters in the output of Python itself: tracebacks, warnings and log messages of libraries."""
    stdout = sys.stdout
    if isinstance(stdout, io.TextIOWrapper):
        # Characters that the encoding of the terminal lacks are escaped, as Python does on stderr.
        stdout.reconfigure(errors="backslashreplace")
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
    """Check that a folder can be created or written; leaves no files behind.

    Raises:
        InputError: the folder cannot be created or written.
    """
    try:
        nearest = next(p for p in (path, *path.absolute().parents) if p.exists() or p.is_symlink())
        # The name is unique: other commands may check the same folder.
        tempfile.TemporaryFile(dir=nearest).close()
    except (OSError, ValueError) as error:
        raise InputError(f"cannot write to folder {path}: {_reason(error)}") from None


def check_writable_file(path: Path) -> None:
    """Check that a file can be written.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputError(f"cannot write {path}: {_reason(error)}") from None


def refuse_existing(target: Path) -> None:
    """Check that a path does not exist or is an empty folder.

    Raises:
        InputError: the path exists.
    """
    try:
        exists = target.is_symlink() or (any(target.iterdir()) if target.is_dir() else target.exists())
    except OSError as error:
        raise InputError(f"cannot write to {target}: {_reason(error)}") from None
    if exists and target.is_dir() and not (target / "furniture.json").is_file():
        raise InputError(f"'{target}' exists and is not a furniture folder; choose another --out")
    if exists:
        raise InputError(f"'{target}' exists already; replace it with --force or choose another --out")


def refuse_furniture_folder(path: Path) -> None:
    """Check that a path is not a furniture folder, which other files must not be mixed with.

    Raises:
        InputError: the path is a furniture folder.
    """
    if (path / "furniture.json").exists():
        raise InputError(f"'{path}' is a furniture folder; choose another --out for the results")


def writable_folder(path: Path) -> Path:
    """Create a folder unless it exists, and return it.

    Raises:
        InputError: the folder cannot be created or written.
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
