"""The `roboassembly` command."""

from __future__ import annotations

import errno
import io
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from typing import Annotated, Any

import tyro

from roboassembly.cli.assemble import AssembleCommand
from roboassembly.cli.bench import BenchCommand
from roboassembly.cli.benchmark import BenchmarkCommand
from roboassembly.cli.dataset import DatasetCommand
from roboassembly.cli.demos import DemosCommand
from roboassembly.cli.evaluate import EvaluateCommand
from roboassembly.cli.export import ExportCommand
from roboassembly.cli.flags import CONFIG, command_registry
from roboassembly.cli.generate import GenerateCommand
from roboassembly.cli.importing import ImportCommand
from roboassembly.cli.manual import ManualCommand
from roboassembly.cli.output import FAILED, allow_closed_stdout, guard_terminal, plain, print_json, say, show
from roboassembly.cli.stability import StabilityCommand
from roboassembly.cli.train import TrainCommand
from roboassembly.cli.view import ViewCommand
from roboassembly.errors import InputError, RoboAssemblyError

Command = (
    Annotated[AssembleCommand, tyro.conf.subcommand("assemble")]
    | Annotated[ManualCommand, tyro.conf.subcommand("manual")]
    | Annotated[StabilityCommand, tyro.conf.subcommand("stability")]
    | Annotated[ViewCommand, tyro.conf.subcommand("view")]
    | Annotated[ImportCommand, tyro.conf.subcommand("import")]
    | Annotated[GenerateCommand, tyro.conf.subcommand("generate")]
    | Annotated[ExportCommand, tyro.conf.subcommand("export")]
    | Annotated[DatasetCommand, tyro.conf.subcommand("dataset")]
    | Annotated[DemosCommand, tyro.conf.subcommand("demos")]
    | Annotated[EvaluateCommand, tyro.conf.subcommand("evaluate")]
    | Annotated[TrainCommand, tyro.conf.subcommand("train")]
    | Annotated[BenchmarkCommand, tyro.conf.subcommand("benchmark")]
    | Annotated[BenchCommand, tyro.conf.subcommand("bench")]
)
"""All commands."""


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)
"""Errors of a disk that is full or read-only; they can occur in the middle of a command."""


def parse(arguments: Sequence[str] | None = None) -> Any:
    """Parse a command line and return the command, not run yet; exits with 0 after `--help` and with 2 after an error.

    Args:
        arguments: arguments after `roboassembly`; those of the process if None.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if all(plain(argument) == argument for argument in given):
        return _parse(given)
    # Errors of the parser repeat the arguments, with their control characters.
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            return _parse(given)
    finally:
        show(*out.getvalue().splitlines())
        say(*err.getvalue().splitlines())


def _parse(arguments: Sequence[str]) -> Any:
    with command_registry(), allow_closed_stdout():
        return tyro.cli(
            Command,  # pyright: ignore[reportArgumentType]
            prog="roboassembly",
            description="Plan, simulate and learn furniture assembly.",
            args=arguments,
            config=CONFIG,
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and exit with 0 (done), 1 (not solved, or not possible on this machine) or 2 (bad input)."""
    guard_terminal()
    command = parse(arguments)
    try:
        status = command.run()
    except RoboAssemblyError as error:
        status = _report_failure(command, str(error), 2 if isinstance(error, InputError) else FAILED)
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        status = _report_failure(command, f"cannot write {error.filename or 'the results'}: {error.strerror}", FAILED)
    except KeyboardInterrupt:
        say("interrupted")
        status = 130
    sys.exit(status)


def _report_failure(command: Any, reason: str, status: int) -> int:
    say(f"error: {reason}")
    if command.json:
        print_json({"success": False, "error": reason})
    return status
