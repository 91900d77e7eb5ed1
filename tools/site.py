"""Gathers the pages of the site in build/pages, for mkdocs.yml (`make docs`).

Most pages are the files in docs/. README, CONTRIBUTING and CHANGELOG come from the root, the help of the commands from
the command line, and the gallery from `make gallery`. Equations (`$...$` and `$$...$$`, the form of code hosts) become
SVG: MathJax or KaTeX would need a script, and MathML a font that not everybody has.
"""

from __future__ import annotations

import contextlib
import html
import io
import json
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import ziamath

from roboassembly.cli import parse

ROOT = Path(__file__).parents[1]
DOCS, PAGES, GALLERY = ROOT / "docs", ROOT / "build" / "pages", ROOT / "build" / "gallery"
AT_THE_ROOT = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Files beside docs/, and the pages that they become."""
EXAMPLES, CITATION = "examples", "CITATION.cff"
"""A folder and a file beside docs/ that pages link to."""
COLUMNS = 80
"""Width of the help of a command [characters]."""

_SUBCOMMAND = re.compile(r"^ *• ([\w-]+) ", re.MULTILINE)
_CODE_OR_EQUATION = re.compile(
    r"(?P<code>^```.*?^```$|`[^`]+`)|\$\$(?P<block>.+?)\$\$|\$(?P<inline>[^$\n]+)\$", re.MULTILINE | re.DOTALL
)
_MARKDOWN = str.maketrans({c: f"&#{ord(c)};" for c in "*_[]|\\`"})
"""Characters with a meaning in Markdown, as entities."""
EQUATION_SIZE = 17.5
"""Font size of equations [pixel]; looks as large as the text."""


def gather() -> None:
    """Write all pages."""
    shutil.rmtree(PAGES, ignore_errors=True)
    shutil.copytree(DOCS, PAGES)
    shutil.copytree(ROOT / EXAMPLES, PAGES / EXAMPLES, ignore=shutil.ignore_patterns("__pycache__"))
    made = {page: moved((ROOT / name).read_text()) for name, page in AT_THE_ROOT.items()}
    made |= {"commands.md": commands_page(), "gallery.md": gallery_page()}
    for name, text in made.items():
        (PAGES / name).write_text(text)
    shutil.copy(ROOT / CITATION, PAGES / CITATION)
    for path in PAGES.rglob("*.md"):
        path.write_text(with_equations(moved(path.read_text())))


def moved(text: str) -> str:
    """Return a page with its links to the root, or from the root, as they are in the folder of all pages."""
    for name, page in AT_THE_ROOT.items():
        text = text.replace(f"](../{name}", f"]({page}").replace(f"]({name}", f"]({page}")
    return text.replace("](docs/", "](").replace(f"](../{EXAMPLES}/", f"]({EXAMPLES}/")


def with_equations(text: str) -> str:
    """Return Markdown with its equations as SVG, in the colour of the text; code stays as it is."""

    def drawn(found: re.Match[str]) -> str:
        if found["code"]:
            return found["code"]
        latex = " ".join((found["block"] or found["inline"]).split())
        equation = ziamath.Latex(latex, size=EQUATION_SIZE, color="currentColor", inline=bool(found["inline"]))
        label = f'role="img" aria-label="{html.escape(latex).translate(_MARKDOWN)}"'
        if found["block"]:
            return f'<div {label} style="overflow-x: auto; text-align: center">{equation.svg()}</div>'
        below = f"display: inline-block; vertical-align: {equation.getyofst():.2f}px; line-height: 0"
        return f'<span {label} style="{below}">{equation.svg()}</span>'

    return _CODE_OR_EQUATION.sub(drawn, text)


def commands_page() -> str:
    """Return the page with every command and its help."""
    os.environ.update(COLUMNS=str(COLUMNS), NO_COLOR="1")
    commands = dict(_help([]))
    if len(commands) < 2:
        raise ValueError(f"no subcommands found in the help:\n{commands}")
    intro = "# Commands\n\nThe output of `--help` for each command.\n"
    return intro + "".join(f"\n## {' '.join(words)}\n\n```text\n{text}```\n" for words, text in commands.items())


def _help(words: Sequence[str]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield a command and its help, then those of its subcommands."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        parse([*words, "--help"])
    lines = (line.rstrip().removeprefix(" ") for line in said.getvalue().splitlines())
    text = "\n".join(lines).strip() + "\n"
    yield ("roboassembly", *words), text
    for name in _SUBCOMMAND.findall(text):
        yield from _help([*words, name])


def gallery_page() -> str:
    """Return the page of the gallery: films and pages that exist, copied beside it, then pictures of other pages."""
    text = "# Gallery\n"
    made = GALLERY / "gallery.json"
    if not made.exists():
        text += "\nBuilt without films: `make gallery` makes them, then `make docs` shows them here.\n"
    for piece in json.loads(made.read_text()) if made.exists() else ():
        film, page, picture = (_copied(piece[what]) for what in ("film", "page", "picture"))
        text += f"""
## {piece["title"]}

<video controls muted preload="none" width="100%" poster="{picture}" src="{film}"></video>

`{piece["command"]}`: {piece["figures"]}. [Turn it and scrub through it]({page}).
"""
    pictures = {"Built-in families": "families.webp", "Sixty chairs": "sixty.webp", "Grasps": "grasps.png"}
    return text + "".join(f"\n## {title}\n\n![{title}](images/{name})\n" for title, name in pictures.items())


def _copied(name: str) -> str:
    """Copy a file of the gallery beside the pages, and return its name there."""
    place = PAGES / "gallery" / name
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(GALLERY / name, place)
    return str(place.relative_to(PAGES))


if __name__ == "__main__":
    gather()
