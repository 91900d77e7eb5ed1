"""`roboassembly import`: real furniture, repaired and annotated, as furniture folders."""

from __future__ import annotations

import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs
from roboassembly.cli.output import DONE, print_json, progress_bar, say, show, writable_folder
from roboassembly.errors import InputError
from roboassembly.processes import workers

if TYPE_CHECKING:
    from roboassembly.furniture.importers.kept import Summary

Kind = Literal["partnet", "ikea-manual", "ikea-env", "furniture-bench", "folder"]
"""The names in `furniture.importers.IMPORTERS`."""
UpAxis = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(frozen=True)
class Piece:
    """One piece to import."""

    kind: Kind
    source: Path
    target: Path
    name: str
    scale: float | None
    up: UpAxis | None
    cache: bool
    allow_shortening: bool


@dataclass(frozen=True)
class Item:
    """What became of one piece."""

    name: str
    parts: int
    connections: int
    displacement_max_mm: float
    trimmed_max_percent: float
    seconds: float
    unholdable: tuple[str, ...]
    """Names of the parts that no Franka hand can hold."""
    size_change_mm: dict[str, float]
    """Largest change of each part's size, negative where it became smaller; by the part's name."""
    changes: tuple[str, ...]
    """Parts whose size changed, or that sit less deep in a neighbour, by more than 1 mm; a line each."""
    folder: str | None
    error: str | None
    cached: bool = False
    """Whether it was imported before, so that `seconds` are those of a look-up."""


@dataclass(frozen=True)
class Import:
    """Read real furniture, make its parts fit without touching, and save furniture folders."""

    kind: Annotated[Kind, tyro.conf.Positional]
    """The source's format. partnet: PartNet v0 folders. ikea-manual: IKEA-Manuals-at-Work part folders (NN.obj in
    assembled poses). ikea-env: MJCF of the IKEA Furniture Assembly Environment. furniture-bench: FurnitureBench meshes
    with assembled_poses.json. folder: OBJ, STL, PLY or GLB files, one a named part in its assembled pose, or one GLB
    scene."""
    source: Annotated[Path, tyro.conf.Positional]
    """One piece, or a folder of many."""
    out: Path = Path("furniture")
    """Folder that gets one furniture folder a piece."""
    scale: float | None = None
    """Metres per unit of the source's files; if not given, as the format says, or a typical size for the furniture."""
    up: UpAxis | None = None
    """Up axis of the files, for `folder` only; if not given, y for GLB and z for all else."""
    jobs: Jobs = CORES
    """Pieces at a time."""
    allow_shortening: bool = False
    """Accept parts that become more than 5 mm smaller, or sit more than 5 mm less deep in a neighbour, where the parts
    cannot clear each other in another way."""
    cache: bool = True
    """Use what an earlier import of the same files came to."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        from roboassembly.furniture.importers import IMPORTERS

        if self.scale is not None and not 1e-6 < self.scale < 1e6:
            raise InputError(f"--scale {self.scale} is absurd; metres per unit of the files, for instance 0.5")
        if self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}; 1 or more would do")
        if self.up is not None and self.kind != "folder":
            raise InputError(f"--up {self.up} is for 'folder'; the format '{self.kind}' says itself which way is up")
        folders = IMPORTERS[self.kind].find(self.source)
        single = len(folders) == 1
        names = _names(folders)
        targets = [self.out if single and self._fresh() else self.out / name for name in names]
        items: list[Item] = []
        with progress_bar(total=len(folders), desc="importing", unit="piece", disable=single) as progress:
            for item in self._each(folders, targets, names):
                items.append(item)
                progress.update()
        for item in items:
            say(f"{item.name}: {item.error}" if item.error else _summary(item))
        imported = sum(item.error is None for item in items)
        if self.json:
            print_json({"imported": imported, "refused": len(items) - imported, "items": [asdict(i) for i in items]})
        else:
            show(f"{imported} imported, {len(items) - imported} refused")
        return DONE if imported else 2

    def _fresh(self) -> bool:
        """Whether the output folder can itself be the furniture folder."""
        return not self.out.exists() or (self.out / "furniture.json").exists()

    def _each(self, folders: list[Path], targets: list[Path], names: list[str]):
        writable_folder(self.out.parent if self._fresh() else self.out)
        work = [
            Piece(self.kind, source, target, name, self.scale, self.up, self.cache, self.allow_shortening)
            for source, target, name in zip(folders, targets, names, strict=True)
        ]
        if self.jobs == 1 or len(folders) == 1:
            yield from map(import_piece, work)
            return
        with workers(min(self.jobs, len(folders))) as pool:
            for piece, future in [(piece, pool.submit(import_piece, piece)) for piece in work]:
                try:
                    yield future.result()
                except BrokenProcessPool:
                    lost = "not imported: a worker process died (out of memory?); try this piece again with --jobs 1"
                    yield Item(piece.name, 0, 0, 0.0, 0.0, 0.0, (), {}, (), None, lost)


def _summary(item: Item) -> str:
    text = f"{item.name}: {item.parts} parts -> {item.folder}"
    if item.cached:
        text += " (as imported before)"
    if item.unholdable:
        text += f" (no hand can hold {', '.join(item.unholdable)}: object-centric setting only)"
    name, change = max(item.size_change_mm.items(), key=lambda one: abs(one[1]))
    text += f"; largest change of size: {name} {change:+.2f} mm"
    text += "".join(f"\n  {change}" for change in item.changes)
    return text


def import_piece(piece: Piece) -> Item:
    """Read, repair, annotate and save one piece; what cannot be used ends up in the item's `error`."""
    from roboassembly.furniture.importers import kept

    started = time.perf_counter()
    place = _place(piece) if piece.cache else None
    try:
        summary = kept.recall(place, piece.source, piece.target) if place is not None else None
        cached = summary is not None
        if summary is None:
            summary = _import_anew(piece)
            # Files that were changed in the meantime may be other than those that were read.
            if place is not None and place == _place(piece):
                kept.keep(place, summary, piece.target)
    except InputError as error:
        summary, cached = kept.Summary(error=str(error)), False
    return Item(
        piece.name,
        summary.parts,
        summary.connections,
        summary.displacement_max_mm,
        summary.trimmed_max_percent,
        round(time.perf_counter() - started, 2),
        summary.unholdable,
        summary.parts_mm,
        summary.changes,
        None if summary.error else str(piece.target),
        summary.error,
        cached,
    )


def _place(piece: Piece) -> Path | None:
    from roboassembly.furniture.importers import IMPORTERS, kept

    reads = IMPORTERS[piece.kind].reads(piece.source)
    return kept.place_of(piece.source, reads, piece.kind, piece.name, piece.scale, piece.up, piece.allow_shortening)


def _import_anew(piece: Piece) -> Summary:
    from roboassembly.errors import FurnitureError
    from roboassembly.furniture import storage
    from roboassembly.furniture.importers import IMPORTERS, folder
    from roboassembly.furniture.importers.kept import Summary
    from roboassembly.furniture.importers.pipeline import finish

    try:
        if piece.up is not None:
            raw = folder.read(piece.source, scale=piece.scale, up=piece.up)
        else:
            raw = IMPORTERS[piece.kind].read(piece.source, scale=piece.scale)
    except FurnitureError as refusal:
        return Summary(error=str(refusal), refused_at=str(piece.source))
    try:
        imported = finish(piece.name, raw, allow_shortening=piece.allow_shortening)
    except FurnitureError as refusal:
        return Summary(error=str(refusal))
    storage.save(imported.furniture, piece.target)
    return Summary(
        len(imported.furniture.parts),
        len(imported.furniture.connections),
        round(1e3 * max(r.displacement for r in imported.repairs), 3),
        round(1e2 * max(r.trimmed for r in imported.repairs), 3),
        {r.name: round(1e3 * r.size_change, 2) for r in imported.repairs},
        tuple(f"{r.name}: {', '.join(r.changes)}" for r in imported.repairs if r.changes),
        imported.furniture.unholdable,
    )


def _names(sources: list[Path]) -> list[str]:
    """Each piece's own name, with its parent's before it where two would be the same, and a number if need be."""
    resolved = [source.resolve() for source in sources]
    own = [(source.stem if source.is_file() else source.name) or "furniture" for source in resolved]
    names = [
        f"{source.parent.name}_{name}".lower() if own.count(name) > 1 else name
        for source, name in zip(resolved, own, strict=True)
    ]
    return [f"{name}_{names[:k].count(name) + 1}" if name in names[:k] else name for k, name in enumerate(names)]
