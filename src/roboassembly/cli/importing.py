"""`roboassembly import`: real furniture, repaired and annotated, as furniture folders."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.options import CORES, Jobs
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, refuse_existing, say, show
from roboassembly.errors import InputError
from roboassembly.parallel.processes import worker_pool

if TYPE_CHECKING:
    from roboassembly.importers.kept import Summary

Kind = Literal["partnet", "ikea-manual", "ikea-env", "furniture-bench", "folder"]
"""The names in `furniture.importers.IMPORTERS`."""
UnitName = Literal["mm", "cm", "m", "in", "ft"]
"""The names in `furniture.importers.units.METRES`."""
USUAL_OUT = Path("furniture")
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
    split: bool


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
    unit: str | None = None
    """Of the files: mm, cm, m, in or ft; None where the scale is that of none of them, or where nothing was read."""
    unit_guessed: bool = False
    unit_others: tuple[str, ...] = ()
    """Units that are nearly as likely as the guessed one."""
    unit_text: str = ""
    """How the piece got its size, for people."""
    scale: float | None = None
    """Metres per unit of the files."""
    size_m: tuple[float, float, float] | None = None
    """Of the piece as read: along x, y and z (up), in metres."""
    remarks: tuple[str, ...] = ()
    """What a person should know of the reading, one line each."""


@dataclass(frozen=True)
class Import:
    """Read real furniture, make its parts fit without touching, and save furniture folders."""

    kind: Annotated[Kind, tyro.conf.Positional]
    """Format of the source. folder: your own OBJ, STL, PLY or GLB files, each a part in its assembled place, or one GLB
    scene. partnet: PartNet v0 folders. ikea-manual: part folders of IKEA-Manuals-at-Work. ikea-env: MJCF of the IKEA
    Furniture Assembly Environment. furniture-bench: FurnitureBench meshes with assembled_poses.json."""
    source: Annotated[Path, tyro.conf.Positional]
    """A piece, or a folder with many pieces below it. Results of this program in it are passed over."""
    out: Path | None = None
    """Folder to write. A single piece becomes this folder itself if it is new; else each piece gets a folder of its own
    name in it. Without --out they go to `furniture/`."""
    force: bool = False
    """Replace furniture that is there already. The old one stays if the import fails."""
    unit: UnitName | None = None
    """Unit of length of the files. Without it and --scale: as the format says, or guessed from typical sizes of
    furniture, and the guess is printed."""
    scale: float | None = None
    """Metres per unit of the files, where it is none of --unit."""
    up: UpAxis | None = None
    """Up axis of the files, for `folder` only. Without it: y for GLB files, z for all others."""
    split: bool = False
    """Make a part of each separate body of a mesh, for `folder` only: for one file that holds all parts."""
    jobs: Jobs = CORES
    """Number of pieces to import at the same time."""
    allow_shortening: bool = False
    """Accept parts that become more than 5 mm smaller, or sit more than 5 mm less deep in a neighbour, where the parts
    cannot clear each other in another way."""
    cache: bool = True
    """Take over the result of an earlier import of the same files."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        from roboassembly.geometry import units
        from roboassembly.importers import IMPORTERS
        from roboassembly.importers.earlier import without_results

        if self.scale is not None and not 1e-6 < self.scale < 1e6:
            raise InputError(f"--scale {self.scale} is absurd; metres per unit of the files, for instance 0.5")
        scale = units.scale_of(self.unit, self.scale)
        if self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}; 1 or more would do")
        if self.up is not None and self.kind != "folder":
            raise InputError(f"--up {self.up} is for 'folder'; the format '{self.kind}' says itself which way is up")
        if self.split and self.kind != "folder":
            raise InputError(f"--split is for 'folder'; the format '{self.kind}' says itself what the parts are")
        out = self.out or USUAL_OUT
        check_writable(out)
        found, skipped = without_results(IMPORTERS[self.kind].find(self.source), self.source, out)
        pieces = [
            Piece(self.kind, source, target, name, scale, self.up, self.cache, self.allow_shortening, self.split)
            for source, target, name in zip(found, self._targets(found), _names(found), strict=True)
        ]
        if skipped:
            say(f"passed over earlier results: {', '.join(map(str, skipped[:5]))}{', ...' if skipped[5:] else ''}")
        if len(pieces) == 1 and not self.force:
            refuse_existing(pieces[0].target)
        items: list[Item] = []
        with progress_bar(total=len(pieces), desc="importing", unit="piece", disable=len(pieces) == 1) as progress:
            for item in self._each(pieces):
                items.append(item)
                progress.update()
        for item in items:
            say(*_report(item))
        imported = sum(item.error is None for item in items)
        if self.json:
            print_json({
                "imported": imported, "refused": len(items) - imported, "skipped": [str(s) for s in skipped],
                "items": [asdict(i) for i in items],
            })  # fmt: skip
        else:
            show(f"{imported} imported, {len(items) - imported} refused")
        return DONE if imported else 2

    def _targets(self, found: list[Path]) -> list[Path]:
        """Where each piece goes."""
        new = self.out is not None and (not self.out.exists() or (self.out / "furniture.json").exists())
        if self.out is not None and len(found) == 1 and new:
            return [self.out]
        return [(self.out or USUAL_OUT) / name for name in _names(found)]

    def _each(self, pieces: list[Piece]) -> Iterator[Item]:
        """What became of each piece, in order; those that are there already are not imported."""
        refused = {} if self.force else {p: str(e) for p in pieces if (e := _existing(p.target))}
        work = [piece for piece in pieces if piece not in refused]
        done = self._imported(work)
        for piece in pieces:
            yield _failed(piece, refused[piece]) if piece in refused else next(done)

    def _imported(self, work: list[Piece]) -> Iterator[Item]:
        if self.jobs == 1 or len(work) < 2:
            yield from map(import_piece, work)
            return
        with worker_pool(min(self.jobs, len(work))) as pool:
            for piece, future in [(piece, pool.submit(import_piece, piece)) for piece in work]:
                try:
                    yield future.result()
                except BrokenProcessPool:
                    lost = "not imported: a worker process died (out of memory?); try this piece again with --jobs 1"
                    yield _failed(piece, lost)


def _existing(target: Path) -> InputError | None:
    try:
        refuse_existing(target)
    except InputError as error:
        return error
    return None


def _failed(piece: Piece, reason: str) -> Item:
    return Item(piece.name, 0, 0, 0.0, 0.0, 0.0, (), {}, (), None, reason)


def _report(item: Item) -> list[str]:
    """Lines for people."""
    lines = [f"{item.name}: {item.error}" if item.error else _summary(item)]
    if item.size_m is not None and item.scale is not None:
        lines.append(f"  unit: {item.unit_text}; {_size(item.size_m)}")
        lines += [_other(item, other) for other in item.unit_others]
    lines += [f"  {line}" for line in (*item.remarks, *item.changes)]
    return lines


def _other(item: Item, unit: str) -> str:
    from roboassembly.geometry.units import METRES, NAMES

    assert item.size_m is not None
    assert item.scale is not None
    size = [METRES[unit] / item.scale * side for side in item.size_m]
    return f"  it may be in {NAMES[unit]} as well: {_size(size)}; if so, import it with --unit {unit}"


def _size(sides: Sequence[float]) -> str:
    return " x ".join(f"{side:.2f}" if side >= 0.1 else f"{side:.3f}" for side in sides) + " m"


def _summary(item: Item) -> str:
    text = f"{item.name}: {item.parts} parts -> {item.folder}"
    if item.cached:
        text += " (as imported before)"
    if item.unholdable:
        text += f" (no hand can hold {', '.join(item.unholdable)}: object-centric setting only)"
    name, change = max(item.size_change_mm.items(), key=lambda one: abs(one[1]))
    return f"{text}; largest change of size: {name} {change:+.2f} mm"


def import_piece(piece: Piece) -> Item:
    """Read, repair, annotate and save one piece; what cannot be used ends up in the item's `error`."""
    from roboassembly.importers import kept

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
    unit = summary.unit
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
        unit=None if unit is None else unit.name,
        unit_guessed=unit is not None and unit.guessed,
        unit_others=() if unit is None else unit.others,
        unit_text="" if unit is None else unit.text,
        scale=None if unit is None else unit.scale,
        size_m=summary.size_m,
        remarks=summary.remarks,
    )


def _place(piece: Piece) -> Path | None:
    from roboassembly.importers import IMPORTERS, kept

    reads = IMPORTERS[piece.kind].reads(piece.source)
    return kept.place_of(
        piece.source, reads, piece.kind, piece.name, piece.scale, piece.up, piece.allow_shortening, piece.split
    )


def _import_anew(piece: Piece) -> Summary:
    from roboassembly.errors import FurnitureError
    from roboassembly.furniture import storage
    from roboassembly.geometry import units
    from roboassembly.importers import IMPORTERS, folder
    from roboassembly.importers.kept import Summary
    from roboassembly.importers.pipeline import finish

    try:
        if piece.kind == "folder":
            raw = folder.read(piece.source, scale=piece.scale, up=piece.up, split=piece.split)
        else:
            raw = IMPORTERS[piece.kind].read(piece.source, scale=piece.scale)
    except FurnitureError as refusal:
        return Summary(error=str(refusal), refused_at=str(piece.source))
    unit = raw.unit or units.of_format(raw.provenance.scale, piece.scale)
    x, y, z = (round(side, 4) for side in raw.size)
    reading = {"unit": unit, "size_m": (x, y, z), "remarks": raw.remarks}
    try:
        imported = finish(piece.name, raw, allow_shortening=piece.allow_shortening)
    except FurnitureError as refusal:
        return Summary(error=str(refusal), **reading)
    storage.save(imported.furniture, piece.target)
    return Summary(
        len(imported.furniture.parts),
        len(imported.furniture.connections),
        round(1e3 * max(r.displacement for r in imported.repairs), 3),
        round(1e2 * max(r.trimmed for r in imported.repairs), 3),
        {r.name: round(1e3 * r.size_change, 2) for r in imported.repairs},
        tuple(f"{r.name}: {', '.join(r.changes)}" for r in imported.repairs if r.changes),
        imported.furniture.unholdable,
        **reading,
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
