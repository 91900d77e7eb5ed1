"""The exceptions users meet. Each message is one line: what is wrong, where, and what would do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class RoboAssemblyError(Exception):
    """Base of every error that this package raises on purpose."""

    def __reduce__(self) -> tuple[object, ...]:
        # Worker processes hand errors over pickled, and would call `__init__` with the message alone.
        return _again, (type(self), *self.args)


def _again(kind: type[RoboAssemblyError], *args: object) -> RoboAssemblyError:
    return kind.__new__(kind, *args)


class InputError(RoboAssemblyError):
    """Something handed in cannot be used; the command line answers with exit status 2."""


class ArgumentError(InputError, ValueError):
    """An argument of a class or function has a value that it cannot have."""


class FurnitureError(InputError):
    """Furniture, or a file that should hold some, breaks a rule of the format or of geometry."""


class PolicyError(InputError):
    """What a policy answers is no answer: not an action, or not a value for each."""


class UnknownNameError(InputError):
    """A name that is not registered; the message offers near misses, or everything there is."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        offer = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(names)}"
        super().__init__(f"unknown {kind} '{name}'; {offer}")


class MissingExtraError(RoboAssemblyError):
    """An optional dependency is needed and not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"'{package}' is not installed; run in the source folder: python -m pip install '.[{extra}]'")


class MissingRobotError(RoboAssemblyError):
    """The wheel with the robot's shapes is not installed, or not whole."""

    def __init__(self, wheel: str, folder: Path | None = None) -> None:
        lacks = f"has no urdf/panda.urdf in {folder}" if folder else "is not installed"
        super().__init__(f"the robot's shapes are missing: '{wheel}' {lacks}; install it with: pip install {wheel}")
