"""`roboassembly import`: import real furniture, repair and annotate it, and save it as furniture folders."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import tyro

from roboassembly.cli.import_lines import report_lines
from roboassembly.cli.options import CORES, Jobs, require_at_least
from roboassembly.cli.output import DONE, check_writable, print_json, progress_bar, refuse_existing, say, show
from roboassembly.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from roboassembly.importers.kept import Summary

Kind = Literal["partnet", "ikea-manual", "ikea-env", "furniture-bench", "folder"]
"""Names of the formats in `importers.IMPORTERS`."""
FORMATS: tuple[Kind, ...] = get_args(Kind)
UnitName = Literal["mm", "cm", "m", "in", "ft"]
"""Names of the units in `geometry.units.METRES`."""
DEFAULT_OUT = Path("furniture")
"""Folder for pieces without --out."""
UpAxis = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(frozen=True)
class ImportJob:
    """Import of one piece: its source, its target and the options."""

    kind: Kind
    source: Path
    target: Path
    name: str
    scale: float | None
    up: UpAxis | None
    cache: bool
    allow_shortening: bool
    split: bool
    report: bool
    fastener: tuple[str, ...] = ()
    announced: bool = False
    """Print each stage: for a piece that is imported alone, for which no progress bar moves."""

    def announce(self, stage: str) -> None:
        """Print a stage."""
        if self.announced:
            say(f"{stage} ...")


@dataclass(frozen=True)
class ImportResult:
    """Result of the import of one piece."""

    name: str
    parts: int
    connections: int
    displacement_max_mm: float
    trimmed_max_percent: float
    seconds: float
    unholdable: tuple[str, ...]
    """Names of the parts that no Franka gripper can hold."""
    size_change_mm: dict[str, float]
    """Largest change of size of each part [mm] by the name of the part; negative if the part became smaller."""
    changes: tuple[str, ...]
    """One line for each part whose size, or whose depth in a neighbour, changed by more than 1 mm."""
    folder: str | None
    error: str | None
    cached: bool = False
    """Whether the result comes from the cache; `seconds` is then the time of the look-up."""
    unit: str | None = None
    """Unit of the files: mm, cm, m, in or ft; None for another scale, or if nothing was read."""
    unit_guessed: bool = False
    unit_others: tuple[str, ...] = ()
    """Units that are nearly as likely as the estimated one."""
    unit_text: str = ""
    """Explanation of the unit, for the user."""
    scale: float | None = None
    """Scale of the files [m per unit]."""
    size_m: tuple[float, float, float] | None = None
    """Size of the piece in the files along x, y and z (up) [m]."""
    remarks: tuple[str, ...] = ()
    """Remarks on the files for the user, one line each."""
    findings: tuple[str, ...] = ()
    """Findings worth a look, the most important first."""
    report: str | None = None
    """Path of the report page."""


@dataclass(frozen=True)
class ImportCommand:
    """Import real furniture, repair it so that no parts overlap, and save furniture folders."""

    kind: Annotated[str, tyro.conf.Positional]
    """Format of the source; may be left out for your own files. folder: your own files, a STEP, 3MF, GLB or glTF file
    of the whole piece, or a folder with one OBJ, STL or PLY file per part in its assembled pose. partnet: PartNet v0
    folders. ikea-manual: part folders of IKEA-Manuals-at-Work. ikea-env: MJCF of the IKEA Furniture Assembly
    Environment. furniture-bench: FurnitureBench meshes with assembled_poses.json."""
    source: Annotated[Path | None, tyro.conf.Positional] = None
    """A piece, or a folder with many pieces in subfolders. Furniture folders of this program in it are skipped."""
    out: Path | None = None
    """Folder for the furniture. For a single piece, a new folder becomes the furniture folder itself; otherwise each
    piece gets a subfolder. Without --out: `furniture/`."""
    force: bool = False
    """Replace existing furniture. If the import fails, the old furniture is kept."""
    unit: UnitName | None = None
    """Unit of length of the files. Without --unit and --scale: as the file or the format states, or estimated from
    typical sizes of furniture; the unit is printed."""
    scale: float | None = None
    """Scale of the files in metres per unit, if --unit has no name for it."""
    up: UpAxis | None = None
    """Up axis of the files; for `folder` only. Without it: y for GLB and glTF files, z for other files."""
    split: bool = False
    """Make a part of each separate body of every mesh; for `folder` only. A single mesh is split without it."""
    fastener: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Names of parts that are fasteners, as patterns with * and ?, such as 'screw*'. KIND=PATTERN says of which kind:
    dowel, screw or cam; otherwise the name does. May be given several times."""
    jobs: Jobs = CORES
    """Number of processes."""
    allow_shortening: bool = False
    """Accept repairs that shorten a part, or its depth in a neighbour, by more than 5 mm, if overlaps cannot be removed
    in another way."""
    report: bool = True
    """Write a page about each import: import-report.html in its folder, or NAME.refused.html if it is refused."""
    cache: bool = True
    """Reuse the result of an earlier import of the same files."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        from roboassembly.furniture.fasteners import parse_pattern
        from roboassembly.geometry import units
        from roboassembly.importers import IMPORTERS
        from roboassembly.importers.earlier import without_results

        if self.scale is not None and not 1e-6 < self.scale < 1e6:
            raise InputError(f"--scale {self.scale} is not plausible; give metres per unit of the files, such as 0.5")
        scale = units.scale_of(self.unit, self.scale)
        for text in self.fastener:
            parse_pattern(text)
        require_at_least(1, jobs=self.jobs)
        kind, given = self._kind_and_source()
        if self.up is not None and kind != "folder":
            raise InputError(f"--up {self.up} is for the format 'folder'; the format '{kind}' defines the up axis")
        if self.split and kind != "folder":
            raise InputError(f"--split is for the format 'folder'; the format '{kind}' defines the parts")
        out = self.out or DEFAULT_OUT
        check_writable(out)
        found, skipped = without_results(IMPORTERS[kind].find(given), given, out)
        pieces = [
            ImportJob(
                kind,
                source,
                target,
                name,
                scale,
                self.up,
                self.cache,
                self.allow_shortening,
                self.split,
                self.report,
                self.fastener,
                announced=len(found) == 1,
            )
            for source, target, name in zip(found, self._targets(found), piece_names(found), strict=True)
        ]
        if skipped:
            listed = ", ".join(map(str, skipped[:5])) + ", ..." * bool(skipped[5:])
            say(f"skipped furniture folders of this program: {listed}")
        if len(pieces) == 1 and not self.force:
            refuse_existing(pieces[0].target)
        items: list[ImportResult] = []
        with progress_bar(total=len(pieces), desc="importing", unit="piece", disable=len(pieces) == 1) as progress:
            for item in self._each(pieces):
                items.append(item)
                progress.update()
        for item in items:
            say(*report_lines(item))
        imported = sum(item.error is None for item in items)
        if self.json:
            print_json({
                "imported": imported, "refused": len(items) - imported, "skipped": [str(s) for s in skipped],
                "items": [asdict(i) for i in items],
            })  # fmt: skip
        else:
            show(f"{imported} imported, {len(items) - imported} refused")
        return DONE if imported else 2

    def _kind_and_source(self) -> tuple[Kind, Path]:
        """Return the format and the source; a single argument is a source of the format `folder`.

        Raises:
            InputError: the source is missing, or there is no such format.
        """
        known: Kind | None = next((kind for kind in FORMATS if kind == self.kind), None)
        if self.source is None:
            if known is not None and not Path(self.kind).exists():
                raise InputError(f"name the source too: roboassembly import {known} SOURCE")
            return "folder", Path(self.kind)
        if known is None:
            raise UnknownNameError("format", self.kind, FORMATS)
        return known, self.source

    def _targets(self, found: list[Path]) -> list[Path]:
        """Return the folder for each piece."""
        new = self.out is not None and (not self.out.exists() or (self.out / "furniture.json").exists())
        if self.out is not None and len(found) == 1 and new:
            return [self.out]
        return [(self.out or DEFAULT_OUT) / name for name in piece_names(found)]

    def _each(self, pieces: list[ImportJob]) -> Iterator[ImportResult]:
        """Yield the result of each piece in order; a piece that exists already is not imported."""
        refused = {} if self.force else {p: str(e) for p in pieces if (e := _existing(p.target))}
        work = [piece for piece in pieces if piece not in refused]
        done = self._imported(work)
        for piece in pieces:
            yield _failed(piece, refused[piece]) if piece in refused else next(done)

    def _imported(self, work: list[ImportJob]) -> Iterator[ImportResult]:
        if self.jobs == 1 or len(work) < 2:
            yield from map(import_piece, work)
            return
        from concurrent.futures.process import BrokenProcessPool

        from roboassembly.parallel.processes import worker_pool

        with worker_pool(min(self.jobs, len(work))) as pool:
            for piece, future in [(piece, pool.submit(import_piece, piece)) for piece in work]:
                try:
                    yield future.result()
                except BrokenProcessPool:
                    reason = (
                        "not imported: a worker process died (out of memory?); import this piece again with --jobs 1"
                    )
                    yield _failed(piece, reason)


def _existing(target: Path) -> InputError | None:
    try:
        refuse_existing(target)
    except InputError as error:
        return error
    return None


def _failed(piece: ImportJob, reason: str) -> ImportResult:
    return ImportResult(piece.name, 0, 0, 0.0, 0.0, 0.0, (), {}, (), None, reason)


def import_piece(piece: ImportJob) -> ImportResult:
    """Read, repair, annotate and save one piece; the result's `error` says why it was refused."""
    from roboassembly.importers import kept

    started = time.perf_counter()
    place = _place(piece) if piece.cache else None
    refused_page = kept.report_path(piece.target, refused=True)
    with suppress(OSError):
        refused_page.unlink()  # that of an earlier import
    try:
        summary = kept.recall(place, piece.source, piece.target) if place is not None else None
        cached = summary is not None
        if summary is None:
            summary = _import(piece)
            # Do not cache the result if the files changed in the meantime.
            if place is not None and place == _place(piece):
                kept.keep(place, summary, piece.target)
        page = kept.report_path(piece.target, refused=summary.error is not None)
        if not piece.report:
            page.unlink(missing_ok=True)  # that of an earlier import
    except InputError as error:
        summary, cached, page = kept.Summary(error=str(error)), False, refused_page
    unit = summary.unit
    return ImportResult(
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
        findings=summary.findings,
        report=str(page) if page.is_file() else None,
    )


def _place(piece: ImportJob) -> Path | None:
    from roboassembly.importers import IMPORTERS, kept

    reads = IMPORTERS[piece.kind].reads(piece.source)
    return kept.place_of(
        piece.source, reads, piece.kind, piece.name, piece.scale, piece.up, piece.allow_shortening, piece.split,
        piece.report, piece.fastener,
    )  # fmt: skip


def _import(piece: ImportJob) -> Summary:
    from roboassembly.errors import FurnitureError
    from roboassembly.furniture import storage
    from roboassembly.furniture.fasteners import parse_pattern, separate_fasteners
    from roboassembly.geometry import units
    from roboassembly.importers import IMPORTERS, folder
    from roboassembly.importers.findings import findings
    from roboassembly.importers.kept import Summary, report_path, write_report
    from roboassembly.importers.pipeline import finish
    from roboassembly.solvers.grasp_choice import choose_grasps
    from roboassembly.viewer.import_report import import_report, refusal_report

    piece.announce(f"reading {piece.source.name}")
    try:
        if piece.kind == "folder":
            raw = folder.read(piece.source, scale=piece.scale, up=piece.up, split=piece.split or None)
        else:
            raw = IMPORTERS[piece.kind].read(piece.source, scale=piece.scale)
        raw = separate_fasteners(raw, [parse_pattern(text) for text in piece.fastener])
    except FurnitureError as refusal:
        return Summary(error=str(refusal), refused_at=str(piece.source))
    unit = raw.unit or units.of_format(raw.provenance.scale, piece.scale)
    x, y, z = (round(side, 4) for side in raw.size)
    reading: dict[str, Any] = {"unit": unit, "size_m": (x, y, z), "remarks": raw.remarks}
    piece.announce(f"repairing {len(raw.parts)} parts and finding their joints")
    try:
        imported = finish(piece.name, raw, allow_shortening=piece.allow_shortening)
    except FurnitureError as refusal:
        if piece.report:
            write_report(
                refusal_report(piece.name, piece.source, raw, refusal).encode(), report_path(piece.target, refused=True)
            )
        return Summary(error=str(refusal), **reading)
    piece.announce("looking for an order in which two robot hands join the parts")
    choice = choose_grasps(imported.furniture)
    imported = replace(imported, furniture=choice.furniture)
    found = findings(raw, imported.furniture, imported.repairs, hands_find_order=choice.order_exists)
    storage.save(imported.furniture, piece.target)
    if piece.report:
        page = import_report(piece.name, piece.source, raw, imported, found)
        write_report(page.encode(), report_path(piece.target, refused=False))
    return Summary(
        len(imported.furniture.parts),
        len(imported.furniture.connections),
        round(1e3 * max(r.displacement for r in imported.repairs), 3),
        round(1e2 * max(r.trimmed for r in imported.repairs), 3),
        {r.name: round(1e3 * r.size_change, 2) for r in imported.repairs},
        tuple(f"{r.name}: {', '.join(r.changes)}" for r in imported.repairs if r.changes),
        imported.furniture.unholdable,
        findings=tuple(finding.text for finding in found),
        **reading,
    )


def piece_names(sources: list[Path]) -> list[str]:
    """Return a unique name per source: its own, with that of its parent or a number if several are the same."""
    resolved = [source.resolve() for source in sources]
    own = [(source.stem if source.is_file() else source.name) or "furniture" for source in resolved]
    names = [
        f"{source.parent.name}_{name}".lower() if own.count(name) > 1 else name
        for source, name in zip(resolved, own, strict=True)
    ]
    return [f"{name}_{names[:k].count(name) + 1}" if name in names[:k] else name for k, name in enumerate(names)]
