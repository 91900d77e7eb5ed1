"""Checks the words of the package: names, docstrings, sizes. Part of `make lint`.

    python tools/check_names.py [FOLDER ...]

Reports, one line each:

- an identifier, or a word in one, that the project has replaced by the field's term;
- a public class name that stands for two things;
- a docstring that begins with a preposition or "That";
- a module of more than 400 lines;
- a module that nothing imports.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "roboassembly"
MAX_LINES = 400

NOWHERE = frozenset(
    "apprentice apprentices chooser course courses curate daring lesson lessons mastery prober pupil pupils "
    "rehearsal rehearsals rehearse schooling tableau teacher teachers told visitor visitors wares".split()
)
"""Words that no identifier contains."""
NEVER_ALONE = frozenset(
    "apart as_done bridges dear every fetch flying gather goes good hands held hold holds house in_order "
    "in_the_mind joints_of kinds late leg legs let_go loops made_ahead marks meet moment moments one play player "
    "players playing plays practice proof relations room screen situation situations spread standing "
    "strange take taken takes two views wanted ways went with_robots words worth".split()
)
"""Words that are no identifier by themselves."""
CLASSES = frozenset(
    "Flying Held Joint Joints Leg Legs Moment Pick Registry Rehearsal Situation Standing Wanted".split()
)
SPOKEN_OF = {"generate": frozenset({"leg", "legs"})}
"""Words that are right in a room: chairs have legs."""
PREPOSITIONS = frozenset(
    "about above after against along among around as at before behind below beside between beyond by during for from "
    "in inside into of off on onto outside over per since that through to toward towards under until upon with within "
    "without".split()
)
_PART = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
"""One word of an identifier in snake or camel case."""


def identifiers(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of everything that the module names itself."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.lineno, node.name
            case ast.arg():
                yield node.lineno, node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr
            case ast.alias(asname=str(name)):
                yield node.lineno, name
            case _:
                pass


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of every docstring, those of attributes included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def bad_word(name: str) -> str | None:
    """Return the word of an identifier that the field does not use; None if there is none."""
    if name in CLASSES:
        return name
    words = [word.lower() for word in _PART.findall(name)]
    if name.strip("_").lower() in NEVER_ALONE:
        return name
    return next((word for word in words if word in NOWHERE), None)


def problems(path: Path) -> Iterator[str]:
    """Yield what is wrong with one module."""
    text = path.read_text()
    tree = ast.parse(text)
    place = path.relative_to(ROOT)
    if (lines := text.count("\n")) > MAX_LINES:
        yield f"{place}: {lines} lines; {MAX_LINES} at most"
    if bad_word(path.stem):
        yield f"{place}: the file's name '{path.stem}' is a replaced word"
    for line, name in identifiers(tree):
        if (word := bad_word(name)) and word not in SPOKEN_OF.get(path.relative_to(PACKAGE).parts[0], ()):
            yield f"{place}:{line}: '{name}' has the replaced word '{word}'"
    for line, docstring in docstrings(tree):
        first = docstring.split(maxsplit=1)[0].rstrip(",.:;") if docstring.split() else ""
        if first.lower() in PREPOSITIONS:
            yield f"{place}:{line}: a docstring begins with '{first}'"


def shared_classes(paths: list[Path]) -> Iterator[str]:
    """Yield public class names that several modules define."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in paths:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    for name, where in sorted(places.items()):
        if len(where) > 1:
            yield f"class {name} stands for several things: {', '.join(where)}"


def unimported(paths: list[Path]) -> Iterator[str]:
    """Yield modules that no other module, command or documented entry point imports."""
    text = "\n".join(path.read_text() for path in paths)
    for path in paths:
        if path.stem in ("__init__", "__main__"):
            continue
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        package, _, name = module.rpartition(".")
        named = re.search(rf"from {re.escape(package)} import [^\n]*\b{name}\b", text)
        listed = re.search(rf"from {re.escape(package)} import \([^)]*\b{name}\b", text)
        if not (named or listed or re.search(rf"{re.escape(module)}\b", text)):
            yield f"{path.relative_to(ROOT)}: nothing imports it"


def main(folders: list[str]) -> int:
    """Print all problems; returns 1 if there are any."""
    paths = sorted(PACKAGE.rglob("*.py"))
    chosen = [p for p in paths if not folders or any(p.is_relative_to(Path(f).resolve()) for f in folders)]
    found = [problem for path in chosen for problem in problems(path)]
    found += [*shared_classes(paths), *unimported(paths)]
    print("\n".join(found) if found else "names: all good")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
