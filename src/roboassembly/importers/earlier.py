"""Filter that keeps earlier results of this program out of an import."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from roboassembly.errors import FurnitureError
from roboassembly.furniture import storage


def without_results(found: Sequence[Path], source: Path, out: Path) -> tuple[list[Path], list[Path]]:
    """Return the pieces that are not earlier results, and the folders of results that were skipped.

    Args:
        found: pieces at or below `source`.
        source: path that is imported.
        out: folder that results are written to; nothing inside it is a piece if it lies inside the source.

    Raises:
        FurnitureError: no piece is left.
    """
    here = source.resolve()
    within = here.parent if here.name == storage.MESHES else here
    if (within / storage.FILE_NAME).is_file():
        raise FurnitureError(f"'{within}' is a furniture folder already; commands take it as it is")
    pieces: list[Path] = []
    results: list[Path] = []
    for piece in found:
        result = next(_results(piece, source, out), None)
        if result is None:
            pieces.append(piece)
        elif result not in results:
            results.append(result)
    if not pieces:
        raise FurnitureError(f"'{source}' holds nothing but earlier results, '{results[0]}' for one; name the source")
    return pieces, results


def _results(piece: Path, source: Path, out: Path) -> Iterator[Path]:
    """Yield the result folders that a piece lies in."""
    piece, target = piece.resolve(), out.resolve()
    root = source.resolve() if source.is_dir() else source.resolve().parent
    if target != root and target.is_relative_to(root) and piece.is_relative_to(target):
        yield out
    for folder in (piece, *piece.parents):
        if not folder.is_relative_to(root):
            return
        # A hidden folder is left over from an import that was killed, or is hidden on purpose.
        hidden = folder != root and folder.name.startswith(".")
        if hidden or (folder / storage.FILE_NAME).is_file() or _is_exported(folder, piece):
            yield folder


def _is_exported(folder: Path, piece: Path) -> bool:
    """Return whether `roboassembly export` wrote the piece: a file of the folder, or the folder's meshes."""
    if piece.parent != folder:
        return False
    named = [piece] if piece.suffix == ".xml" else [*folder.glob("*.xml"), *folder.glob("*.urdf")]
    return any((folder / storage.MESHES / f"{file.stem}-00.stl").is_file() for file in named)
