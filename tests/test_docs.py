"""What the documentation shows is so: examples run, commands exist, links lead somewhere."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import test_import_folder
import test_import_ikea_env
from roboassembly.cli import main, parse

ROOT = Path(__file__).parents[1]
PAGES = {str(p.relative_to(ROOT)): p for p in (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")))}

FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`(roboassembly [^`]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.*)$", re.MULTILINE)
STAND_INS = {"KIND": "folder"}
"""What a word in capitals may stand for, where not every word would do."""
BRIEFLY = {"assemble": ["--no-film"], "evaluate": ["--jobs", "1"], "import": ["--jobs", "1"]}
"""Added where examples are run among the quick tests: no film, no further processes."""


@dataclass(frozen=True)
class Example:
    """A line of a command, or a block of Python."""

    page: str
    line: int
    text: str
    python: bool = False

    @property
    def words(self) -> list[str]:
        """Of a command, after `roboassembly` and before what a shell would do with its output."""
        words = shlex.split(self.text, comments=True)[1:]
        return [STAND_INS.get(word, word) for word in words[: words.index(">") if ">" in words else None]]

    @property
    def endless(self) -> bool:
        """Takes hours, needs a data set or weights that take as long to make, or runs until it is stopped."""
        if "examples/" in self.text:
            return True
        if self.words[0] == "evaluate":
            return "--set folder:" not in self.text
        return self.words[0] in ("train", "benchmark", "bench", "dataset", "view")

    @property
    def slow(self) -> bool:
        """Takes more than seconds."""
        return "--setting full" in self.text

    def run(self, namespace: dict[str, object], extra: list[str]) -> None:
        """In the current folder."""
        if self.python:
            exec(compile(self.text, f"{self.page}:{self.line}", "exec"), namespace)
            return
        with pytest.raises(SystemExit) as end:
            main([*self.words, *extra])
        assert end.value.code == 0, f"{self.page}:{self.line}: {self.text}"


def examples(page: str) -> list[Example]:
    """Of a page's fenced blocks, in order."""
    return list(_examples(page, PAGES[page].read_text()))


def _examples(page: str, text: str) -> Iterator[Example]:
    for block in FENCE.finditer(text):
        first = text.count("\n", 0, block.start(2)) + 1
        if block[1] == "python":
            yield Example(page, first, block[2], python=True)
        else:
            # A command that goes on in the next line is told as one.
            for number, line in enumerate(block[2].replace("\\\n", " ").splitlines()):
                if line.startswith("roboassembly "):
                    yield Example(page, first + number, line)


def in_prose(page: str) -> list[Example]:
    """Commands between back quotes."""
    text = FENCE.sub("", PAGES[page].read_text())
    return [Example(page, 0, " ".join(found.split())) for found in SPAN.findall(text)]


COMMANDS = [e for page in PAGES for e in examples(page) if not e.python]
WITH_EXAMPLES = [page for page in PAGES if any(e.python or not e.endless for e in examples(page))]


def test_no_example_is_overlooked() -> None:
    assert {"README.md", "docs/furniture.md", "docs/quickstart.md"} <= set(WITH_EXAMPLES)
    for page, path in PAGES.items():
        text = path.read_text()
        assert len(re.findall(r"^ *```", text, re.MULTILINE)) == 2 * len(FENCE.findall(text)), page
        assert text.count("```python\n") == sum(e.python for e in examples(page)), page
        assert not re.search(r"^ *\$ ", text, re.MULTILINE), f"{page}: commands go without a prompt"


@pytest.mark.parametrize("example", COMMANDS, ids=lambda e: f"{e.page}:{e.line}")
def test_commands_can_be_typed(example: Example) -> None:
    assert parse(example.words).run


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_prose_can_be_typed(page: str) -> None:
    for example in in_prose(page):
        words = example.words
        if not any(word.startswith("-") for word in words) and STAND_INS.keys().isdisjoint(example.text.split()):
            # The name alone.
            with pytest.raises(SystemExit) as end:
                parse([*words, "--help"])
            assert end.value.code == 0, example.text
        else:
            assert parse(words).run, example.text


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder but for the files of one's own that pages speak of."""
    monkeypatch.chdir(tmp_path)
    test_import_folder.write(tmp_path / "my_files", unit=0.001, suffixes=("stl", "stl", "stl"))
    (tmp_path / "chair_agne_0010").mkdir()
    test_import_ikea_env.write(tmp_path / "chair_agne_0010", test_import_ikea_env.POST, test_import_ikea_env.PLATE)
    policies = [e.text for e in examples("docs/your-own-policy.md") if e.python]
    (tmp_path / "my_policy.py").write_text(policies[-1])
    return tmp_path


@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_examples_run(page: str) -> None:
    namespace: dict[str, object] = {}
    for example in examples(page):
        if example.python:
            example.run(namespace, [])
        elif not (example.endless or example.slow):
            example.run(namespace, BRIEFLY.get(example.words[0], []))


@pytest.mark.slow
@pytest.mark.usefixtures("there")
@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_examples_run_to_the_letter(page: str) -> None:
    namespace: dict[str, object] = {}
    for example in examples(page):
        if example.python or not example.endless:
            example.run(namespace, [])


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    """On a code host, where pages are the files themselves; `make docs` checks the site's."""
    for target in LINK.findall(FENCE.sub("", PAGES[page].read_text())):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (PAGES[page].parent / name).resolve() if name else PAGES[page]
        assert file.exists(), f"{page}: {target}"
        if anchor:
            assert anchor in {_anchor(h) for h in HEADING.findall(FENCE.sub("", file.read_text()))}, f"{page}: {target}"


def _anchor(heading: str) -> str:
    """As code hosts and the site make it of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_exist(page: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    text = PAGES[page].read_text()
    named = re.findall(r"^make ([\w-]+)", text, re.MULTILINE) + re.findall(r"`make ([\w-]+)", text)
    assert set(named) <= targets
