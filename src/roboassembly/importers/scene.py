"""Contents of a file that holds a whole piece: parts with names, their unit and their up axis."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from roboassembly.furniture.triangles import NamedTriangles, Up, unique_names
from roboassembly.geometry.units import Unit
from roboassembly.importers.files import one_line

MAX_NAME = 80
"""Largest length of a part's name without the names of its groups."""
_GENERATED = re.compile(
    r"NAUO\d+|=>\[[\d:]+\]|\d+(:\d+)+|COMPOUND|COMPSOLID|SOLID|SHELL|Open CASCADE STEP translator .*"
)
"""Names that CAD programs give to what has none."""


@dataclass(frozen=True, eq=False)
class FileScene:
    """Parts of one file, at their places."""

    parts: tuple[NamedTriangles, ...]
    """Parts in the file's own unit."""
    up: Up
    """Up axis by the standard of the format."""
    unit: Unit | None = None
    """Unit that the file states; None if the format has none or programs ignore it."""


@dataclass(frozen=True)
class Node:
    """Node of a scene's hierarchy."""

    number: int
    """Number of the node, unique in the scene."""
    name: str
    """Name of the node; empty if it has none."""


def given_name(name: str) -> str:
    """Return a name as one printable line; empty if a program made it up."""
    text = one_line(name, MAX_NAME)
    return "" if _GENERATED.fullmatch(text) else text


def part_names(paths: Sequence[Sequence[Node]], default: str = "part") -> list[str]:
    """Return a unique name for each part: its own, after those of as many groups as set it off from its namesakes.

    Two legs `leg` of one group become `leg` and `leg_2`, those of two groups `left/leg` and `right/leg`. Groups of the
    same name within one group are numbered like parts.

    Args:
        paths: nodes from the root to each part.
        default: name of parts without one.
    """
    numbered = _numbered(paths)
    chains = [[numbered[node.number] for node in path if node.name] for path in paths]
    for chain, path in zip(chains, paths, strict=True):
        if not path[-1].name:
            # A part without a name takes that of its group.
            chain.append(chain[-1] if chain else default)
    names = [chain[-1] for chain in chains]
    parents: dict[str, set[str]] = {}
    for path, chain in zip(paths, chains, strict=True):
        parents.setdefault(path[-1].name, set()).add("/".join(chain[:-1]))
    repeated = [len(parents[path[-1].name]) > 1 for path in paths]
    for depth in range(2, max(map(len, chains), default=1) + 1):
        names = ["/".join(chain[-depth:]) if r else n for r, n, chain in zip(repeated, names, chains, strict=True)]
        repeated = [names.count(name) > 1 for name in names]
    return unique_names(names)


def _numbered(paths: Sequence[Sequence[Node]]) -> dict[int, str]:
    """Return the names of all nodes, numbered where several below one node have the same."""
    below: dict[int, dict[int, str]] = {}
    for path in paths:
        for parent, node in zip((None, *path), path, strict=False):
            if node.name:
                below.setdefault(-1 if parent is None else parent.number, {})[node.number] = node.name
    return {
        number: name
        for names in below.values()
        for number, name in zip(names, unique_names(list(names.values())), strict=True)
    }
