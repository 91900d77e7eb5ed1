"""The `roboassembly` command."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from typing import Annotated, Any

import tyro

from roboassembly.cli.assemble import Assemble
from roboassembly.cli.bench import Bench
from roboassembly.cli.benchmark import Benchmark
from roboassembly.cli.dataset import Dataset
from roboassembly.cli.evaluate import Evaluate
from roboassembly.cli.export import Export
from roboassembly.cli.flags import CONFIG, registry
from roboassembly.cli.generate import Generate
from roboassembly.cli.importing import Import
from roboassembly.cli.output import DONE_BADLY, guard_terminal, plain, print_json, reader_may_leave, say, show
from roboassembly.cli.train import Train
from roboassembly.cli.view import View
from roboassembly.errors import InputError, RoboAssemblyError

_Command = (
    Annotated[Assemble, tyro.conf.subcommand("assemble")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Import, tyro.conf.subcommand("import")]
    | Annotated[Generate, tyro.conf.subcommand("generate")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Dataset, tyro.conf.subcommand("dataset")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
)


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)
"""Disks that are full or may not be written; it may turn out in the middle of a command."""


def parse(arguments: Sequence[str] | None = None) -> Any:
    """The command that a line asks for, not run yet; exits with 0 after `--help`, with 2 if there is no such command.

    Args:
        arguments: the words after `roboassembly`; the process's own if None.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if all(plain(word) == word for word in words):
        return _parsed(words)
    # The parser repeats what it does not understand, control characters included.
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            return _parsed(words)
    finally:
        show(*out.getvalue().splitlines())
        say(*err.getvalue().splitlines())


def _parsed(words: Sequence[str]) -> Any:
    with registry(), reader_may_leave():
        return tyro.cli(
            _Command,  # pyright: ignore[reportArgumentType]
            prog="roboassembly",
            description="Plan, simulate and learn furniture assembly.",
            args=words,
            config=CONFIG,
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command and exit: 0 done, 1 not solved or not possible here, 2 bad input."""
    guard_terminal()
    command = parse(arguments)
    try:
        status = command.run()
    except RoboAssemblyError as error:
        status = _failed(command, str(error), 2 if isinstance(error, InputError) else DONE_BADLY)
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        status = _failed(command, f"cannot write {error.filename or 'all of it'}: {error.strerror}", DONE_BADLY)
    except KeyboardInterrupt:
        say("interrupted")
        status = 130
    sys.exit(status)


def _failed(command: Any, reason: str, status: int) -> int:
    say(f"error: {reason}")
    if command.json:
        print_json({"success": False, "error": reason})
    return status
