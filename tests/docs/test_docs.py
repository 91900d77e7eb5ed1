"""Checks what the documentation says: commands and options exist, their requirements come first, links lead somewhere.

`test_docs_run.py` runs the examples.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import resources
from typing import Any
from unittest.mock import MagicMock

import pytest

import documentation
from documentation import (
    EXTRAS,
    FENCE,
    PAGES,
    PROJECT,
    ROOT,
    SPAN,
    Command,
    commands,
    commands_in_prose,
    extras_needed,
    prose_of,
    text_of,
)
from roboassembly.cli import parse
from roboassembly.datasets.sets import RECIPES
from roboassembly.studio.panel import Panel
from scripts import script

LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.*)$", re.MULTILINE)
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
STAND_INS = {"KIND": "folder"}
"""Values for words in capitals that accept only some values."""

ALL_COMMANDS = [c for page in PAGES for c in commands(page)]
OF_OURS = [c for c in ALL_COMMANDS if c.arguments is not None]


@pytest.mark.parametrize("page", PAGES)
def test_every_example_is_parsed(page: str) -> None:
    """All fences are found, and a block holds only commands or none."""
    text = text_of(page)
    assert len(re.findall(r"^ *```", text, re.MULTILINE)) == 2 * len(FENCE.findall(text))
    blocks = [e for e in documentation.examples(page) if isinstance(e, documentation.Block)]
    assert text.count("```python\n") == len(blocks)
    assert not re.search(r"^ *\$ ", text, re.MULTILINE), "commands go without a prompt"
    for command in commands(page):
        assert documentation.is_command(command.text), f"{command}: a command? {documentation.PROGRAMS}"
    for language, block in FENCE.findall(text):
        if language != "python" and not documentation.holds_commands(block):
            assert not [line for line in block.splitlines() if documentation.is_command(line)], block


def test_pages_with_examples_are_found() -> None:
    assert {"README.md", "docs/furniture.md", "docs/quickstart.md", "examples/05_masked_ppo.py"} <= {
        c.page for c in ALL_COMMANDS
    }
    assert len(OF_OURS) > 30


@pytest.mark.parametrize("command", OF_OURS, ids=lambda c: f"{c.page}:{c.line}")
def test_commands_can_be_typed(command: Command) -> None:
    assert parse([STAND_INS.get(word, word) for word in command.arguments or []]).run


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_prose_can_be_typed(page: str) -> None:
    for command in commands_in_prose(page):
        words = command.arguments
        if words is None:
            continue
        if not any(word.startswith("-") for word in words) and STAND_INS.keys().isdisjoint(words):
            # The name alone.
            with pytest.raises(SystemExit) as end:
                parse([*words, "--help"])
            assert end.value.code == 0, str(command)
        else:
            assert parse([STAND_INS.get(word, word) for word in words]).run, str(command)


FOREIGN = {
    "--strict": "twine",
    "--head": "ray",
    "--address": "ray",
    "--dataset": "lerobot-train",
    "--output": "lerobot-train",
    "--batch": "lerobot-train",
    "--num": "lerobot-train",
    "--save": "lerobot-train",
    "--env": "lerobot-eval",
    "--eval": "lerobot-eval",
}
"""Options of other programs that pages mention."""


@cache
def options() -> set[str]:
    """Return the options of all commands, and of the scripts beside the package."""
    scripts = [p.read_text() for folder in ("tools", "examples") for p in (ROOT / folder).glob("*.py")]
    ours = OPTION.findall(script("tools/site.py").commands_page())
    return {*ours, *(o for text in scripts for o in re.findall(r'add_argument\("(--[a-z-]+)', text))}


@pytest.mark.parametrize("page", [p for p in PAGES if p != "CHANGELOG.md"])  # it names old options, too
def test_named_options_exist(page: str) -> None:
    named = set(OPTION.findall(text_of(page)))
    assert named <= options() | FOREIGN.keys()


def test_options_of_other_programs_are_still_named() -> None:
    named = {o for page in PAGES for o in OPTION.findall(text_of(page))}
    assert FOREIGN.keys() <= named
    assert options().isdisjoint(FOREIGN)


def pip_installs(command: Command) -> list[str] | None:
    """Return what a `pip install` installs; None for another command."""
    words = command.words
    if "install" not in words or "pip" not in words[: words.index("install")]:
        return None
    return [w for w in words[words.index("install") + 1 :] if not w.startswith("-")]


def extras_of(requirement: str) -> list[str]:
    found = re.fullmatch(r"\.\[([\w,-]+)\]", requirement)
    return found[1].split(",") if found else []


@pytest.mark.parametrize("page", PAGES)
def test_pip_commands_name_existing_packages(page: str) -> None:
    """The package comes from its folder, because it is in no index; everything else is a dependency of the project."""
    groups = [*EXTRAS.values(), PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"].values()]
    known = {re.split(r"[\s\[<>=;]", r)[0] for group in groups for r in group if isinstance(r, str)}
    for command in (*commands(page), *commands_in_prose(page)):
        for requirement in pip_installs(command) or []:
            if requirement.startswith("."):
                assert requirement == "." or extras_of(requirement), str(command)
                assert set(extras_of(requirement)) <= EXTRAS.keys(), str(command)
            else:
                assert requirement in known - {PROJECT["project"]["name"]}, str(command)
    assert f"{PROJECT['project']['name']}[" not in text_of(page)


UNNAMED = {("docs/furniture.md", "learn"): "the page has no line that installs Minari, for --export"}
"""Extras that a page does not install, and why."""


@pytest.mark.parametrize("page", PAGES)
def test_extras_are_installed_before_they_are_needed(page: str) -> None:
    named: set[str] = set()
    unnamed: set[tuple[str, str]] = set()
    for command in commands(page):
        named |= {extra for r in pip_installs(command) or [] for extra in extras_of(r)}
        unnamed |= {(page, extra) for extra in extras_needed(command) - named}
    assert unnamed == {key for key in UNNAMED if key[0] == page}


@pytest.mark.parametrize("page", PAGES)
def test_data_sets_are_built_before_they_are_used(page: str) -> None:
    built: set[str] = set()
    for command in commands(page):
        if command.arguments is None:
            continue
        parsed: Any = parse(command.arguments)
        if command.arguments[:2] == ["dataset", "build"]:
            built.add(parsed.name)
            continue
        used = getattr(getattr(parsed, "what", None), "set", None) or getattr(parsed, "set", None) or ""
        name = parsed.name if command.arguments[:2] == ["dataset", "show"] else used.partition(":")[0]
        assert name not in RECIPES.keys() - built, f"{command}: no `dataset build {name}` before it"


@cache
def files() -> tuple[str, ...]:
    """Return the paths of all files of the repository."""
    folders = (ROOT / name for name in ("src", "tests", "docs", "tools", "examples"))
    return tuple(f"/{p.relative_to(ROOT)}" for p in (*ROOT.glob("*.*"), *(p for f in folders for p in f.rglob("*.*"))))


OWN = {e.saved for page in PAGES for e in documentation.examples(page) if isinstance(e, documentation.Block)}
"""Files that pages ask readers to write."""


@pytest.mark.parametrize("page", [p for p in PAGES if p != "CHANGELOG.md"])
def test_named_files_exist(page: str) -> None:
    """Files are named by their path or its end: `learning/relational/tokens.py`, or `tokens.py`."""
    for span in SPAN.findall(prose_of(page)):
        for name in re.findall(r"(?<![\w/.<-])[\w./-]*[a-z_]\.(?:py|toml)(?!\w)", span):
            assert name in OWN or any(file.endswith(f"/{name}") for file in files()), f"{page}: `{name}`"
    for command in (*commands(page), *commands_in_prose(page)):
        for word in command.words:
            if re.match(r"(docs|tests|tools|examples|src|\.ci)/", word):
                assert (ROOT / word).is_file(), str(command)


@pytest.mark.parametrize("page", PAGES)
def test_named_tests_exist(page: str) -> None:
    for command in (*commands(page), *commands_in_prose(page)):
        words = command.words
        if words[0] == "pytest":
            (file,) = (w for w in words if w.endswith(".py"))
            names = re.findall(r"^def (test_\w+)", (ROOT / file).read_text(), re.MULTILINE)
            if "-k" in words:
                assert any(words[words.index("-k") + 1] in name for name in names), str(command)


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_exist(page: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for command in (*commands(page), *commands_in_prose(page)):
        if command.words[0] == "make":
            assert {w for w in command.words[1:] if "=" not in w} <= targets, str(command)


class Recorder:
    """Stands in for viser's controls, and records which labels a panel shows in which tab."""

    def __init__(self) -> None:
        self.tab_of: dict[str, str | None] = {}
        self.tabs: list[str] = []
        self._tab: str | None = None

    def add_tab_group(self) -> Recorder:
        return self

    @contextmanager
    def add_tab(self, label: str, **_: Any) -> Iterator[None]:
        self.tabs.append(label)
        self._tab = label
        yield
        self._tab = None

    def __getattr__(self, name: str) -> Any:
        def add(label: Any = None, *_: Any, **__: Any) -> MagicMock:
            if isinstance(label, str) and name != "add_markdown":
                self.tab_of[label] = self._tab
            return MagicMock()

        return add if name.startswith("add_") else MagicMock()


@cache
def controls() -> Recorder:
    """Record the whole panel of the studio."""
    gui = Recorder()
    rest = {name: MagicMock() for name in inspect.signature(Panel).parameters if name != "gui"}
    Panel(gui=gui, **rest)  # pyright: ignore[reportArgumentType]
    return gui


@cache
def shown_over_the_scene() -> set[str]:
    """Return the labels of what the page shows over the scene."""
    shell = (resources.files("roboassembly.studio.page") / "shell.html").read_text(encoding="utf-8")
    return {text.strip() for text in re.findall(r">([^<>]+)<", shell) if text.strip()}


QUOTED = re.compile(r"(?<![*\w])\*([^*\s][^*]*)\*(?!\*)")
"""Labels on the screen, as pages write them."""


def quoted(text: str) -> list[str]:
    return [" ".join(found.split()) for found in QUOTED.findall(text)]


def test_tabs_of_controls_are_parsed() -> None:
    assert {"Steps", "Assemble"} <= set(controls().tabs)
    assert controls().tab_of["Policy and search"] == "Assemble"
    assert controls().tab_of["Policy"] == "Assemble"
    assert "My own furniture" in shown_over_the_scene()


@pytest.mark.parametrize("page", PAGES)
def test_controls_of_the_studio_have_these_names_and_are_in_these_tabs(page: str) -> None:
    """A page about the studio quotes only labels that exist, and names their tab.

    The studio's own page has a section for each tab.
    """
    over = shown_over_the_scene()
    names = {*controls().tab_of, *controls().tabs, *over}
    whole = page == "docs/studio.md"
    for paragraph in re.split(r"\n\s*\n", prose_of(page)):
        if not (whole or "roboassembly view" in paragraph):
            continue
        labels = quoted(paragraph)
        assert set(labels) <= names, f"{page}: {sorted(set(labels) - names)} on no control"
        tabs = {tab for name in labels if name not in {*controls().tabs, *over} and (tab := controls().tab_of[name])}
        assert whole or tabs <= set(labels), f"{page}: which tab? {sorted(tabs)}"


@pytest.mark.parametrize("page", PAGES)
def test_links_have_targets(page: str) -> None:
    """Links work on a code host, where pages are the files themselves; `make docs` checks those of the site."""
    for target in LINK.findall(prose_of(page)):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (PAGES[page].parent / name).resolve() if name else PAGES[page]
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in {_anchor(h) for h in HEADING.findall(FENCE.sub("", file.read_text()))}, f"{page}: {target}"


def _anchor(heading: str) -> str:
    """Return the anchor that code hosts and the site make of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")
