"""What `--help` says: every flag has a text, and the text says what the flag does."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Literal, get_args, get_origin, get_type_hints
from unittest import mock

import pytest
import tyro

from roboassembly import cli
from roboassembly.cli.flags import CONFIG, command_registry

NEGATIVE = ("Do not ", "Skip ", "Without ", "Never ")
SWITCHES = {
    "--no-film": "Do not render assembly.mp4.",
    "--no-browser": "Do not open a browser window.",
    "--no-search": "Do not search for another action if the policy's action fails.",
    "--no-report": "Do not write a page about each import: import-report.html in its folder, or NAME.refused.html "
    "if it is refused.",
    "--no-cache": "Do not reuse the result of an earlier import of the same files.",
    "--no-meshes": "Do not give the parts' meshes to a policy that acts alone and uses them; policies never get them "
    "with --clouds resampled or noise.",
    "--no-train": "Do not train experts and the paper's network, which takes hours and adds their rows.",
}


def classes() -> Iterator[type]:
    """The data classes of all commands."""
    todo: list[object] = [cli.Command]
    while todo:
        kind = todo.pop()
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            yield kind
            todo += [hint for name, hint in get_type_hints(kind, include_extras=True).items() if name == "what"]
        elif get_origin(kind) is not Literal:
            todo += [a for a in get_args(kind) if not isinstance(a, str)]


def words_of(*names: str) -> Iterator[tuple[str, ...]]:
    """Every command, those that have subcommands included."""
    yield names
    for name in re.findall(r"^ *• ([\w-]+) ", raw_help(names).replace("│", " "), re.MULTILINE):
        yield from words_of(*names, name)


@cache
def raw_help(names: tuple[str, ...]) -> str:
    """As a terminal of 100 columns shows it."""
    # No process of its own for each command: tests are collected from these texts, by each worker.
    shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    with (
        mock.patch.dict(os.environ, {"COLUMNS": "100", "NO_COLOR": "1"}),
        contextlib.redirect_stdout(shown),
        pytest.raises(SystemExit) as end,
    ):
        cli.parse([*names, "--help"])
    assert end.value.code == 0
    shown.seek(0)
    return shown.read()


@cache
def flags(names: tuple[str, ...]) -> dict[str, str]:
    """Flags of a command, and their texts."""
    out: dict[str, str] = {}
    flag = ""
    for line in raw_help(names).splitlines():
        inner = line.strip().strip("│╭╰╮╯─").rstrip()
        found = re.match(r" (-[\w-]+)(?:, (--[\w-]+))?(?: (?:\{[^}]*\}|\[[A-Z .\[\]]+\]|[A-Z]+))?(?:  +(.*))?$", inner)
        if found:
            flag = found[2] or found[1]
            out[flag] = (found[3] or "").strip()
        elif flag and inner.startswith("   "):
            out[flag] = f"{out[flag]} {inner.strip()}".strip()
        else:
            flag = ""
    return out


COMMANDS = list(words_of())


def test_all_commands_are_found() -> None:
    assert ("train", "expert") in COMMANDS
    assert len(COMMANDS) == len(set(COMMANDS)) >= 14
    found = {f.name for kind in classes() for f in dataclasses.fields(kind)}
    shown = {flag.lstrip("-").removeprefix("no-").replace("-", "_") for c in COMMANDS for flag in flags(c)}
    positional = {"furniture", "kind", "source", "family", "what", "name", "plan"}
    assert found - positional <= shown
    assert {"film", "cache", "force", "unit", "split"} <= shown


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_text_of_every_flag(command: tuple[str, ...]) -> None:
    for flag, text in flags(command).items():
        if flag == "--help":
            continue
        where = f"{' '.join(command)} {flag}: {text!r}"
        assert len(text) > 10, where
        assert text[0].isupper() or text[0] == "`" or text.split()[0].rstrip(":") in raw_help(command), where
        said = re.sub(r" \(default: .*?\)$", "", text)
        assert said.endswith(".") or "://" in said.split()[-1], where
        assert text.startswith(NEGATIVE) == flag.startswith("--no-"), where
        assert not re.match(r"(Of|In|By|To|As|From) ", text), f"{where}: what is it?"
        assert "None" not in text, f"{where}: what happens without it?"
        assert "(default: True)" not in text, where
        assert "(default: False)" not in text, where


def test_switches_have_help_texts() -> None:
    said = {flag: text for command in COMMANDS for flag, text in flags(command).items() if flag.startswith("--no-")}
    assert said == SWITCHES


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_a_description(command: tuple[str, ...]) -> None:
    text = raw_help(command)
    assert "STR]" not in text.split("options")[0], "a positional argument is named by what it is"
    assert re.search(r"\n\n[A-Z][^\n]{20,98}\.\n", text), "one sentence in one line"


@dataclasses.dataclass(frozen=True)
class Example:
    """A command as a module of commands might have it."""

    colour: bool = True
    """Print in
    colour."""
    size: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """How large it is. Without it: as large as can be."""


def test_help_text_of_a_new_switch(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("roboassembly.cli.flags.PACKAGE", __name__)
    monkeypatch.setenv("NO_COLOR", "1")
    with command_registry():
        assert tyro.cli(Example, args=["--no-colour"], config=CONFIG) == Example(colour=False)
        assert tyro.cli(Example, args=["--size", "3"], config=CONFIG) == Example(size=3)
        with pytest.raises(SystemExit):
            tyro.cli(Example, args=["--help"], config=CONFIG)
    text = capsys.readouterr().out
    assert re.search(r"--no-colour +Do not print in colour\. ", text)
    assert re.search(r"--size N +How large it is\. Without it: as large as can be\. ", text)
