"""The documentation as data: its pages, and the commands and blocks of Python that they show."""

from __future__ import annotations

import ast
import re
import shlex
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from roboassembly.rendering import gl

ROOT = Path(__file__).parents[1]
PAGES = {
    str(p.relative_to(ROOT)): p
    for p in (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("examples/*.py")))
}
"""Pages for people, including the docstrings of examples."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS: dict[str, list[str]] = PROJECT["project"]["optional-dependencies"]
"""Requirements of each extra of the package."""
PROGRAMS = ("roboassembly", "make", "python", "pip", "pytest", "bash", "ray", "uv", "git", "export", "cd")
"""Programs that commands begin with, with or without a folder before them."""

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`]+)`")
_SAVED = re.compile(r"`(\w+\.py)`[^`]*:\s*\Z")
_INDENTED = re.compile(r"(?:^    .*\n|^\n(?=    ))+", re.MULTILINE)


@dataclass(frozen=True)
class Command:
    """A command line."""

    page: str
    line: int
    """Line number in the page; 0 in prose."""
    text: str
    """The command without its comment."""
    comment: str = ""

    @property
    def words(self) -> list[str]:
        """The program and its arguments, without redirections."""
        words = shlex.split(self.text)
        return words[: words.index(">") if ">" in words else None]

    @property
    def target(self) -> str | None:
        """File that receives the output; None without a redirection."""
        words = shlex.split(self.text)
        return words[words.index(">") + 1] if ">" in words else None

    @property
    def arguments(self) -> list[str] | None:
        """Arguments of `roboassembly`; None for another program."""
        return self.words[1:] if self.words[0] == "roboassembly" else None

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


@dataclass(frozen=True)
class Block:
    """A block of Python."""

    page: str
    line: int
    text: str
    saved: str | None
    """File that the page says to write the block to."""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


@cache
def text_of(page: str) -> str:
    """Return a page as Markdown; for an example its docstring, with indented lines as a block."""
    text = PAGES[page].read_text()
    if not page.endswith(".py"):
        return text
    header = ast.get_docstring(ast.parse(text)) or ""
    return _INDENTED.sub(lambda found: f"```\n{textwrap.dedent(found[0]).strip()}\n```\n", header + "\n")


@cache
def prose_of(page: str) -> str:
    """Return a page without its blocks."""
    return FENCE.sub("", text_of(page))


@cache
def examples(page: str) -> tuple[Command | Block, ...]:
    """Return all commands and blocks of Python, in the order of the page."""
    return tuple(_examples(page, text_of(page)))


def commands(page: str) -> list[Command]:
    """Return the commands of the blocks of a page, in order."""
    return [e for e in examples(page) if isinstance(e, Command)]


def _examples(page: str, text: str) -> Iterator[Command | Block]:
    for block in FENCE.finditer(text):
        first = text.count("\n", 0, block.start(2)) + 1
        if block[1] == "python":
            saved = _SAVED.search(text[: block.start()])
            yield Block(page, first, block[2], saved[1] if saved else None)
        elif holds_commands(block[2]):
            for number, line in enumerate(_joined(block[2]).splitlines()):
                if line.strip() and not line.lstrip().startswith("#"):
                    yield _command(page, first + number, line)


def holds_commands(block: str) -> bool:
    """Return whether a block without a language holds commands."""
    return is_command(_joined(block).lstrip().partition("\n")[0])


def is_command(text: str) -> bool:
    """Return whether text begins with a program and has arguments."""
    program, _, rest = text.strip().partition(" ")
    return program.rpartition("/")[2] in PROGRAMS and bool(rest.strip())


def commands_in_prose(page: str) -> list[Command]:
    """Return the commands between back quotes."""
    spans = (" ".join(found.split()) for found in SPAN.findall(prose_of(page)))
    return [_command(page, 0, span) for span in spans if is_command(span)]


def extras_needed(command: Command) -> set[str]:
    """Return the extras that a command needs."""
    needed = {"rl"} if "examples/05_masked_ppo.py" in command.words else set()
    needed |= {"imitation"} if "examples/06_behaviour_cloning.py" in command.words else set()
    needed |= {"learn"} if "examples/04_paper_method_small.py" in command.words else set()
    words = command.arguments or [""]
    needed |= {"learn"} if words[0] in ("train", "benchmark") or "--export" in words else set()
    needed |= {"bench"} if words[0] == "bench" or "--audit" in words else set()
    needed |= {"demos"} if words[0] == "demos" else set()
    needed |= {"usd"} if words[:2] == ["export", "usd"] else set()
    needed |= {"mcap"} if words[:2] == ["export", "trajectory"] and "--format" not in words else set()
    return needed | ({"ray"} if "--ray" in words else set())


def _command(page: str, line: int, text: str) -> Command:
    bare = shlex.split(text, comments=True)
    hash_ = text.find(" #")
    assert hash_ < 0 or shlex.split(text[:hash_]) == bare, f"{page}:{line}: what is a comment here?"
    return Command(page, line, text[: hash_ if hash_ >= 0 else None].strip(), text[hash_ + 2 :] if hash_ >= 0 else "")


def _joined(block: str) -> str:
    """Join commands that continue in the next line; the number of lines stays."""
    return re.sub(r"((?:[^\n]*\\\n)+)([^\n]*\n)", lambda m: _one(m[1]) + m[2] + "\n" * m[1].count("\n"), block)


def _one(lines: str) -> str:
    return lines.replace("\\\n", " ")


def can_draw() -> bool:
    """Return whether this machine can render pictures off screen."""
    try:
        gl.context_module()
    except gl.RenderingUnavailableError:
        return False
    return True
