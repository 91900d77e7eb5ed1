"""Sources of furniture: built-in families, data sets, folders of furniture, 3D files and plans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import RECIPES, FurnitureRef, furniture_refs, manifest_path
from roboassembly.errors import InputError
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.generate import FAMILIES
from roboassembly.importers import IMPORTERS
from roboassembly.importers.pipeline import finish
from roboassembly.solvers.grasp_choice import choose_grasps
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan_file import Script

BUILT_IN = "built-in"


@dataclass(frozen=True)
class Sources:
    """Sources that a client can choose from.

    Args:
        folders: folders of furniture folders, as `roboassembly import` writes them.
    """

    folders: tuple[Path, ...] = ()

    def pieces(self) -> dict[str, list[str]]:
        """Return the names of the pieces by source. Data sets are included if they are built."""
        sets = [name for name in RECIPES if manifest_path(name).is_file()]
        sets += [f"folder:{folder}" for folder in self.folders]
        return {BUILT_IN: list(FAMILIES)} | {source: [p.name for p in furniture_refs(source)] for source in sets}

    def open(self, source: str, piece: str, number: int = 0, *, with_grasps: bool = True) -> Furniture:
        """Make or load a piece.

        Args:
            source: one of the sources of `pieces`.
            piece: one of the pieces of the source.
            number: seed of a piece of a built-in family.
            with_grasps: see `open_path`.

        Raises:
            InputError: the source or the piece does not exist, or the piece cannot be read.
        """
        pieces = self.pieces()
        if source not in pieces:
            raise InputError(f"unknown source '{source}'")
        if piece not in pieces[source]:
            raise InputError(f"unknown piece '{piece}' of {source}")
        if source == BUILT_IN:
            return open_path(f"{piece}:{number}", with_grasps=with_grasps)
        return _open_from_set(source, piece, with_grasps=with_grasps)


@lru_cache(maxsize=16)
def open_path(name: str, scale: float | None = None, *, with_grasps: bool = True) -> Furniture:
    """Open furniture by name, from a furniture folder, or from 3D files, which are repaired and annotated.

    Args:
        name: furniture as for `roboassembly assemble`, or the path of a GLB file or of a folder with one STL, OBJ, PLY
            or GLB file per part.
        scale: scale of 3D files [m per unit]; estimated if None.
        with_grasps: compute the grasps of a built-in piece, and choose those of 3D files so that two hands find an
            order of merges, which takes most of the time. All but built-in pieces have grasps without it, too.

    Raises:
        InputError: the name is unknown, or the files do not make up furniture.
    """
    path = Path(name)
    if not path.exists() or (path / storage.FILE_NAME).is_file():
        return catalogue.find(name, with_grasps=with_grasps)
    importer = IMPORTERS["folder"]
    found = importer.find(path)
    if len(found) > 1:
        names = ", ".join(str(p.name) for p in found[:4])
        raise InputError(f"'{name}' contains {len(found)} pieces ({names}, ...); choose one of them")
    furniture = finish(found[0].stem, importer.read(found[0], scale=scale)).furniture
    return choose_grasps(furniture).furniture if with_grasps else furniture


@lru_cache(maxsize=16)
def _open_from_set(source: str, piece: str, *, with_grasps: bool) -> Furniture:
    found: FurnitureRef | None = next((p for p in furniture_refs(source) if p.name == piece), None)
    if found is None:
        raise InputError(f"unknown piece '{piece}' of {source}")
    return found.furniture(with_grasps=with_grasps)


def find_below(roots: Sequence[Path], name: str) -> Path:
    """Return the real path of a folder or file that lies in one of the roots.

    Args:
        roots: folders of which the contents may be opened.
        name: path, absolute or relative to a root.

    Raises:
        InputError: the path does not exist, or the path or something in it leads out of the roots.
    """
    inside = [root.resolve() for root in roots]
    for root in inside:
        try:
            path = (root / name).resolve(strict=True)
            if path.is_relative_to(root) and all(p.resolve().is_relative_to(root) for p in _contents(path)):
                return path
        except (OSError, RuntimeError, ValueError):
            continue
    allowed = ", ".join(map(str, roots))
    raise InputError(f"there is no '{name}' in {allowed}; only the contents of these folders can be opened by name")


def _contents(path: Path) -> Iterator[Path]:
    """Yield the contents of a folder and of its subfolders: all that is read of furniture or of 3D files."""
    yield from path.glob("*")
    yield from path.glob("*/*")


def open_plan(path: Path) -> tuple[Script, Furniture]:
    """Read a plan and its furniture, as `roboassembly assemble` writes them.

    Args:
        path: path of `plan.json`. Its furniture is `furniture/` beside it, or else a built-in piece.

    Raises:
        InputError: the plan or its furniture does not exist or cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}") from None
    script = plan_file.decode(content, str(path))
    beside = path.parent / "furniture"
    if beside.is_dir():
        return script, storage.load(beside)
    family, _, number = script.furniture.rpartition("-")
    if family in FAMILIES and number.isdigit():
        return script, catalogue.make(family, int(number))
    raise InputError(
        f"'{path}' is a plan for '{script.furniture}', which is not built in; put its furniture folder at '{beside}'"
    )
