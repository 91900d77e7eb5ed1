"""What can be opened: built-in families, data sets, folders of furniture, and files that someone brings."""

from __future__ import annotations

import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path, PurePosixPath

from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import RECIPES, FurnitureRef, furniture_refs, manifest_path
from roboassembly.errors import FurnitureError, InputError
from roboassembly.furniture import storage
from roboassembly.furniture.model import Furniture
from roboassembly.generate import FAMILIES
from roboassembly.importers import IMPORTERS
from roboassembly.importers.pipeline import finish
from roboassembly.studio.house import LARGEST_UPLOAD
from roboassembly.task.plans import plan_file
from roboassembly.task.plans.plan_file import Script

BUILT_IN = "built-in"
MOST_FILES = 500
"""In an archive."""
_ARCHIVE = ".zip"


@dataclass(frozen=True)
class Wares:
    """What there is to choose from.

    Args:
        folders: of furniture folders, as `roboassembly import` writes them.
    """

    folders: tuple[Path, ...] = ()

    def sources(self) -> dict[str, list[str]]:
        """The pieces by where they come from; data sets only if they are built."""
        sets = [name for name in RECIPES if manifest_path(name).is_file()]
        sets += [f"folder:{folder}" for folder in self.folders]
        return {BUILT_IN: list(FAMILIES)} | {source: [p.name for p in furniture_refs(source)] for source in sets}

    def open(self, source: str, piece: str, number: int = 0, *, with_grasps: bool = True) -> Furniture:
        """Make or load a piece.

        Args:
            source: one of `sources()`.
            piece: of it.
            number: which of a built-in family.
            with_grasps: as of `open_path`.

        Raises:
            InputError: there is no such piece, or it cannot be read.
        """
        sources = self.sources()
        if source not in sources:
            raise InputError(f"there is no source '{source}' here")
        if piece not in sources[source]:
            raise InputError(f"there is no piece '{piece}' in {source}")
        if source == BUILT_IN:
            return open_path(f"{piece}:{number}", with_grasps=with_grasps)
        return _of_set(source, piece, with_grasps=with_grasps)


@lru_cache(maxsize=16)
def open_path(name: str, scale: float | None = None, *, with_grasps: bool = True) -> Furniture:
    """Furniture by name, a furniture folder, or 3D files that are read, repaired and annotated first.

    Args:
        name: as `roboassembly assemble` takes it, or the path of a GLB file or of a folder of STL, OBJ, PLY or GLB
            files, one a part.
        scale: metres per unit of such files; guessed if None.
        with_grasps: find them on a built-in piece, which takes longer than all else; others come with theirs.

    Raises:
        InputError: neither, or files that are no furniture.
    """
    path = Path(name)
    if not path.exists() or (path / storage.FILE_NAME).is_file():
        return catalogue.find(name, with_grasps=with_grasps)
    importer = IMPORTERS["folder"]
    found = importer.find(path)
    if len(found) > 1:
        names = ", ".join(str(p.name) for p in found[:4])
        raise InputError(f"'{name}' holds {len(found)} pieces ({names}, ...); name one of them")
    return finish(found[0].stem, importer.read(found[0], scale=scale)).furniture


@lru_cache(maxsize=16)
def _of_set(source: str, piece: str, *, with_grasps: bool) -> Furniture:
    found: FurnitureRef | None = next((p for p in furniture_refs(source) if p.name == piece), None)
    if found is None:
        raise InputError(f"there is no piece '{piece}' in {source}")
    return found.furniture(with_grasps=with_grasps)


def find_below(roots: Sequence[Path], name: str) -> Path:
    """A folder or file that lies in one of some folders, links followed.

    Args:
        roots: folders.
        name: path, from one of them or absolute.

    Raises:
        InputError: there is none, or it or something in it leads out of them.
    """
    inside = [root.resolve() for root in roots]
    for root in inside:
        try:
            path = (root / name).resolve(strict=True)
            if path.is_relative_to(root) and all(p.resolve().is_relative_to(root) for p in _nearest(path)):
                return path
        except (OSError, RuntimeError, ValueError):
            continue
    allowed = ", ".join(map(str, roots))
    raise InputError(f"no '{name}' in {allowed}; only what lies there can be opened by name")


def _nearest(path: Path) -> Iterator[Path]:
    """What a furniture folder or a folder of 3D files consists of: two levels."""
    yield from path.glob("*")
    yield from path.glob("*/*")


def open_plan(path: Path) -> tuple[Script, Furniture]:
    """A plan and its furniture, as `roboassembly assemble` writes them side by side.

    Args:
        path: of `plan.json`; `furniture/` lies beside it, or its furniture is a built-in one.

    Raises:
        InputError: one of them is not there, or cannot be read.
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
    raise InputError(f"'{path}' is of '{script.furniture}', and there is no '{beside}' that holds it")


def unpack(name: str, content: bytes, folder: Path) -> Path:
    """Write what someone brings into a folder that is empty.

    Args:
        name: of the file, as the browser tells it; only its last component counts.
        content: of a ZIP archive of a furniture folder or of 3D files, or of one 3D file.
        folder: gets it.

    Returns:
        What `open_path` takes.

    Raises:
        InputError: too large, no such archive, or one whose entries would lie elsewhere.
    """
    plain = PurePosixPath(name.replace("\\", "/")).name
    if not plain or plain in (".", "..") or "\0" in plain:
        raise InputError(f"'{name}' is no name of a file")
    if len(content) > LARGEST_UPLOAD:
        raise InputError(f"'{plain}' has {len(content):,} bytes; at most {LARGEST_UPLOAD:,} would do")
    if not plain.lower().endswith(_ARCHIVE):
        # A folder of its own, named after the piece.
        target = folder / PurePosixPath(plain).stem / plain
        target.parent.mkdir()
        target.write_bytes(content)
        return target.parent
    target = folder / plain[: -len(_ARCHIVE)] if plain[: -len(_ARCHIVE)] else folder / "furniture"
    target.mkdir()
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            _extract(archive, plain, target)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise InputError(f"'{plain}' is no archive that can be read: {error}") from None
    # Archives of a folder have that folder as their only entry.
    inside = [p for p in target.iterdir() if not p.name.startswith(("__MACOSX", "."))]
    return inside[0] if len(inside) == 1 and inside[0].is_dir() else target


def _extract(archive: zipfile.ZipFile, name: str, target: Path) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_FILES:
        raise InputError(f"'{name}' holds {len(entries)} files; at most {MOST_FILES} would do")
    left = LARGEST_UPLOAD
    for entry in entries:
        inner = PurePosixPath(entry.filename.replace("\\", "/"))
        linked = stat.S_ISLNK(entry.external_attr >> 16)
        if inner.is_absolute() or ".." in inner.parts or ":" in entry.filename or linked:
            raise InputError(f"'{name}': entry '{entry.filename}' would not lie inside; pack the folder itself")
        path = target.joinpath(*inner.parts)
        if entry.is_dir():
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as packed, path.open("wb") as file:
            # What an archive says of its sizes need not be true.
            content = packed.read(left + 1)
            left -= len(content)
            if left < 0:
                raise InputError(f"'{name}' unpacks to more than {LARGEST_UPLOAD:,} bytes")
            file.write(content)


def open_upload(name: str, content: bytes, scale: float | None = None) -> Furniture:
    """Read furniture that someone brings; nothing of it stays on the disk.

    Args:
        name: of the file.
        content: as of `unpack`.
        scale: metres per unit of 3D files; guessed if None.

    Raises:
        InputError: it is no furniture, or there is no room to unpack it.
    """
    with tempfile.TemporaryDirectory(prefix="roboassembly-") as folder:
        try:
            return open_path.__wrapped__(str(unpack(name, content, Path(folder))), scale)
        except FurnitureError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except OSError as error:
            raise InputError(f"'{name}' could not be unpacked: {error.strerror or error}") from None
