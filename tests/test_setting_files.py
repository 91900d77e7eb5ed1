"""The files that ask which setting they are in: the table of the settings, and two that it cannot reach."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import pytest

import roboassembly
from roboassembly.settings import Setting
from roboassembly.task.setting import SettingName

PACKAGE = Path(roboassembly.__file__).parent
NAMES = get_args(SettingName)
ASKING = {"settings/__init__.py", "task/plans/plan_file.py", "viewer/playback.py"}
NETWORKS = {"learning/paper/imitation.py", "learning/paper/network.py", "learning/relational/policy.py"}
"""Files that ask whether weights, samples or a mask have grasps: a policy plays what it is shown."""
PREFIXES = ("Full", "ObjectCentric")
OF_ONE_SETTING = {"Plan", "PlanAnimator", "PlanStep", "HandOracle"}
"""Classes of one setting whose names do not say so."""


def conditions(node: ast.AST) -> Iterator[ast.expr]:
    """What a node decides by."""
    match node:
        case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test):
            yield test
        case ast.comprehension(ifs=ifs):
            yield from ifs
        case ast.BoolOp(values=values):
            yield from values
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield operand
        case ast.Compare():
            yield node
        case ast.Match(subject=subject):
            yield subject
        case _:
            pass


def words(node: ast.AST) -> Iterator[str]:
    """All names and attributes below a node."""
    for inner in ast.walk(node):
        match inner:
            case ast.Name(id=word) | ast.Attribute(attr=word):
                yield word
            case _:
                pass


def named(node: ast.AST | None) -> bool:
    """Whether a node is, or lists, the name of a setting."""
    match node:
        case ast.Constant(value=value):
            return value in NAMES
        case ast.Name(id="DEFAULT") | ast.Attribute(attr="DEFAULT"):
            return True
        case ast.Tuple(elts=elements) | ast.List(elts=elements) | ast.Set(elts=elements):
            return any(named(e) for e in elements)
        case _:
            return False


def asks(node: ast.AST, flags: set[str]) -> bool:
    """Whether a node compares with the name of a setting, looks up by it, tells classes apart, or tests the table."""
    match node:
        case ast.Compare(left=left, comparators=others) if any(named(n) for n in (left, *others)):
            return True
        case ast.Dict(keys=keys) if any(isinstance(k, ast.Constant) and named(k) for k in keys):
            return True
        case ast.Subscript(slice=ast.Constant() as key) if named(key):
            return True
        case ast.MatchValue(value=value) if named(value):
            return True
        case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, kinds]) if one_setting(kinds):
            return True
        case ast.Compare(comparators=[kind]) if one_setting(kind):
            return True
        case ast.MatchClass(cls=kind) if one_setting(kind):
            return True
        case _:
            return any("SETTINGS" in found or flags & found for found in map(set, map(words, conditions(node))))


def one_setting(kinds: ast.AST) -> bool:
    """Whether classes of one setting are among those that a node names."""
    return any(word.startswith(PREFIXES) or word in OF_ONE_SETTING for word in words(kinds) if word[:1].isupper()) and (
        not any(word.endswith("Verdict") for word in words(kinds))
    )


def asks_for_grasps(node: ast.AST) -> bool:
    """Whether a node decides by something that is called full."""
    return any("full" in word.lower().split("_") for test in conditions(node) for word in words(test))


@pytest.fixture(scope="module")
def nodes() -> dict[str, list[ast.AST]]:
    """Nodes of each file of the package."""
    return {
        path.relative_to(PACKAGE).as_posix(): list(ast.walk(ast.parse(path.read_text())))
        for path in PACKAGE.rglob("*.py")
    }


def files(nodes: dict[str, list[ast.AST]], asked: Callable[[ast.AST], bool]) -> set[str]:
    """Files of the package with a node that asks."""
    return {name for name, inside in nodes.items() if any(map(asked, inside))}


def test_three_files_ask_for_the_setting(nodes: dict[str, list[ast.AST]]) -> None:
    flags = {field.name for field in fields(Setting) if field.type == "bool"}
    assert flags == {"needs_grasps"}
    assert files(nodes, lambda node: asks(node, flags)) == ASKING


def test_in_learning_only_networks_ask_for_grasps(nodes: dict[str, list[ast.AST]]) -> None:
    inside = {name: found for name, found in nodes.items() if name.startswith("learning/")}
    assert files(inside, asks_for_grasps) == NETWORKS


@pytest.mark.parametrize(
    "line",
    [
        "x = 1 if setting == 'full' else 2",
        "x = setting in ('full',)",
        "x = f'-{s}' * (s != DEFAULT)",
        "x = {'object-centric': 6, 'full': 4}[setting]",
        "x = SETTINGS['full'].solve",
        "if SETTINGS[s].needs_grasps: pass",
        "if not setting.needs_grasps: pass",
        "x = SETTINGS[s].execute is None",
        "x = isinstance(plan, FullPlan)",
        "x = type(plan) is Plan",
        "match plan:\n    case FullPlan(): pass",
        "match setting:\n    case 'full': pass",
    ],
)
def test_questions_are_found(line: str) -> None:
    assert any(asks(node, {"needs_grasps"}) for node in ast.walk(ast.parse(line)))


@pytest.mark.parametrize(
    "line",
    [
        "x = SETTINGS[s].solve(furniture)",
        "x = open_path(name, with_grasps=SETTINGS[s].needs_grasps)",
        "x: SettingName = 'full'",
        "x = script.setting != self.setting",
        "x = verdict is FullVerdict.NO_PATH",
    ],
)
def test_looking_up_is_no_question(line: str) -> None:
    assert not any(asks(node, {"needs_grasps"}) for node in ast.walk(ast.parse(line)))


def test_a_plan_without_robots_loads_no_robots() -> None:
    code = (
        "import sys\n"
        "from roboassembly.cli import main\n"
        "try: main(['assemble', 'cantilever', '--no-film', '--json', '--out', sys.argv[1]])\n"
        "except SystemExit as stop: assert not stop.code\n"
        "loaded = [m for m in sys.modules if m.startswith(('roboassembly.settings.full', 'roboassembly.task.full.task',"
        " 'roboassembly.robots.kinematics', 'roboassembly.repair', 'roboassembly.audit', 'jax.', 'tqdm', 'imageio',"
        " 'gymnasium', 'glfw', 'matplotlib', 'ray.', 'roboassembly.rendering.offscreen'))]\n"
        "assert not loaded, loaded\n"
    )
    with TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-c", code, folder], check=True, stdout=subprocess.DEVNULL)
