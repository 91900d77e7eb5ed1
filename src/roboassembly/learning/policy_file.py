"""Policies from a Python file that defines `policy(seed)`. The file is executed."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast, get_args

import numpy as np

from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.learning.policy import MAKER, Policy
from roboassembly.task.setting import SettingName

SUFFIX = ".py"
_SETTINGS = get_args(SettingName)
Made = TypeVar("Made")


def load(path: Path) -> Callable[[int], Policy]:
    """Execute a file; returns a function that makes its policy for the episode with a seed.

    The file's `policy` gets a seed derived from the episode's: a generator with the episode's seed itself would draw
    the numbers that the layout of the parts was drawn from.

    Raises:
        InputError: there is no such file, it fails, or it does not define `policy`. The returned function raises it if
            `policy` fails or makes something that is no policy.
    """
    if not path.is_file():
        raise InputError(f"no policy file at '{path}'; name a Python file that defines {MAKER}(seed)")
    module = _tried(path, lambda: _executed(path))
    make = getattr(module, MAKER, None)
    if not callable(make):
        found = "defines no" if make is None else f"has a {type(make).__name__} as its"
        raise InputError(f"'{path}' {found} {MAKER}; expected a function {MAKER}(seed) that returns a policy")

    def made(seed: int) -> Policy:
        state = np.random.SeedSequence([seed, 1]).generate_state(1)
        return _tried(path, lambda: _checked(make(int(state[0] >> 1)), path))

    return made


def _executed(path: Path) -> ModuleType:
    """Return the file as a module, without writing byte code beside it.

    Its name follows from its path, so that workers can pickle objects of its classes.
    """
    name = f"{__name__}_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    code = compile(path.read_bytes(), str(path), "exec", dont_inherit=True)
    # Data classes look their module up while it is executed.
    sys.modules[name] = module
    try:
        exec(code, module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _tried(path: Path, what: Callable[[], Made]) -> Made:
    """Call a function; errors from outside this package become one line that names the line of the file."""
    try:
        return what()
    except RoboAssemblyError:
        raise
    except (Exception, SystemExit) as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        line, text = lines[-1] if lines else None, " ".join(str(error).split())
        if isinstance(error, SyntaxError) and error.filename == str(path):
            line, text = error.lineno, error.msg
        message = f"{type(error).__name__}: {text}" if text else type(error).__name__
        raise InputError(f"'{path}'{f', line {line}' if line else ''}: {message}") from error


def _checked(policy: Any, path: Path) -> Policy:
    """Check that a policy has what `Policy` asks for.

    Raises:
        InputError: names what it lacks.
    """

    def bad(what: str) -> InputError:
        return InputError(f"'{path}': {MAKER}(seed) returned {what}")

    if policy is None or isinstance(policy, type):
        raise bad("nothing" if policy is None else f"the class {policy.__name__}, not an object of it")
    kind = type(policy).__name__
    expected = {"name": "a text", "cloud_points": "a whole number, 1 or more", "act": "a method (observation, mask)"}
    lacks = [f"`{name}`, {what}" for name, what in expected.items() if not hasattr(policy, name)]
    if lacks:
        raise bad(f"a {kind}, which is no policy: it lacks {', and '.join(lacks)}")
    points, settings = policy.cloud_points, getattr(policy, "settings", _SETTINGS[:1])
    whole = isinstance(points, int | np.integer) and not isinstance(points, bool)
    if not isinstance(policy.name, str) or not policy.name:
        raise bad(f"a {kind} whose `name` is {policy.name!r}; expected {expected['name']}")
    if not whole or points < 1:
        raise bad(f"a {kind} whose `cloud_points` is {points!r}; expected {expected['cloud_points']}")
    if (
        not isinstance(settings, tuple | list)
        or not settings
        or any(s not in _SETTINGS for s in cast("Iterable[object]", settings))
    ):
        raise bad(f"a {kind} whose `settings` is {settings!r}; expected some of {_SETTINGS!r}")
    if not callable(policy.act):
        raise bad(f"a {kind} whose `act` is {policy.act!r}; expected {expected['act']}")
    return policy
