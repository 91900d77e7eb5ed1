"""Exceptions of this package. Each message is one line: what is wrong, where, and what is valid."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


class RoboAssemblyError(Exception):
    """Base class of the errors of this package."""

    def __reduce__(self) -> tuple[object, ...]:
        # Unpickling, as after an error in a worker process, would call `__init__` with the message alone.
        return _restore, (type(self), *self.args), self.__dict__ or None


def _restore(kind: type[RoboAssemblyError], *args: object) -> RoboAssemblyError:
    return kind.__new__(kind, *args)


class InputError(RoboAssemblyError):
    """Input is not valid; the command line exits with status 2."""


class ArgumentError(InputError, ValueError):
    """An argument of a class or function has an invalid value."""


class FurnitureError(InputError):
    """Furniture, or a file of furniture, violates the format or a geometric rule.

    Args:
        message: what is wrong, where, and what is valid.
        parts: names of the parts that the message is about.
    """

    def __init__(self, message: str, parts: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.parts = tuple(parts)


class PolicyError(InputError):
    """A policy returns no valid action, or no valid values of actions."""


class UnknownNameError(InputError):
    """A name is unknown; the message lists similar names, or all names."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        offer = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(names)}"
        super().__init__(f"unknown {kind} '{name}'; {offer}")


class MissingExtraError(RoboAssemblyError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"'{package}' is not installed; run in the source folder: python -m pip install '.[{extra}]'")


class MissingRobotError(RoboAssemblyError):
    """The package with the meshes of the robot is not installed, or not complete."""

    def __init__(self, wheel: str, folder: Path | None = None) -> None:
        lacks = f"has no urdf/panda.urdf in {folder}" if folder else "is not installed"
        super().__init__(f"the robot's shapes are missing: '{wheel}' {lacks}; install it with: pip install {wheel}")
