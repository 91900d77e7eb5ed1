"""Measures the CPU time of imports, or prints the table of two measurements.

Run this in a folder with the unpacked samples:

    python tools/import_times.py ikea-manual:ikea_manuals_at_work ikea-env:clvrai_furniture \\
        furniture-bench:furniture_bench --out new.json
    python tools/import_times.py old.json new.json

Each piece is read, repaired and annotated in a process of its own, without the cache, one after another, on one
thread. A piece that is in the file already is passed over, so the same command continues after an interruption. CPU
time depends on what else the machine does: compare measurements of one sitting. The digest covers the furniture folder,
or the reason for a refusal; two measurements with equal digests gave the same furniture byte for byte.
"""

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_ONE = "--one"
"""Argument with which the script measures one piece and prints its figures."""
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def measure(kind: str, path: Path) -> dict:
    """Import one piece in this process; returns its figures."""
    from roboassembly.errors import FurnitureError
    from roboassembly.furniture import annotate, storage  # noqa: F401 - loading it is not part of an import
    from roboassembly.importers import IMPORTERS
    from roboassembly.importers.pipeline import finish

    found: dict = {"parts": None, "connections": None, "classes": None, "error": None}
    started = time.process_time()
    raw = False
    try:
        read = IMPORTERS[kind].read(path)
        raw = True
        piece = finish(path.stem, read).furniture
    except FurnitureError as refusal:
        seconds = time.process_time() - started
        return {
            **found,
            "cpu_s": seconds,
            "read": raw,
            "error": str(refusal),
            "digest": digest([str(refusal).encode()]),
        }
    seconds = time.process_time() - started
    with tempfile.TemporaryDirectory() as folder:
        files = storage.read_files(storage.save(piece, Path(folder) / "furniture"))
    return {
        "parts": len(piece.parts),
        "connections": len(piece.connections),
        "classes": [list(c.members) for c in piece.classes],
        "cpu_s": seconds,
        "read": raw,
        "error": None,
        "digest": digest([name.encode() + files[name] for name in sorted(files)]),
    }


def digest(parts: list[bytes]) -> str:
    """Return a short hash."""
    return hashlib.blake2b(b"".join(parts), digest_size=8).hexdigest()


def measure_all(sources: list[str], out: Path) -> None:
    """Import every piece below `KIND:SOURCE`, each in a child process, and add its figures to the file."""
    from roboassembly.importers import IMPORTERS

    for source in sources:
        kind, root = source.split(":", 1)
        for path in IMPORTERS[kind].find(Path(root)):
            known = json.loads(out.read_text()) if out.exists() else {}
            name = f"{kind} {path.resolve().relative_to(Path(root).resolve())}"
            if name in known:
                continue
            # A process of its own: neither kept results nor the memory of one piece count for the next.
            run = subprocess.run([sys.executable, __file__, _ONE, kind, str(path)], stdout=subprocess.PIPE, check=False)
            if run.returncode != 0:
                sys.exit(f"{name}: the import crashed")
            known[name] = json.loads(run.stdout)
            out.write_text(json.dumps(known, indent=1))
            print(f"{name}: {known[name]['cpu_s']:.2f} s", file=sys.stderr)


def table(old: dict, new: dict) -> list[str]:
    """Return the lines of totals and table, of all pieces whose files could be read."""
    both = [name for name in new if name in old and new[name]["read"]]
    before, after = ([items[name]["cpu_s"] for name in both] for items in (old, new))
    same = sum(old[name]["digest"] == new[name]["digest"] for name in both)
    lines = [
        f"{len(both)} pieces, {same} of them the same byte for byte; CPU time median {statistics.median(before):.1f} s "
        f"before and {statistics.median(after):.1f} s after, at most {max(before):.1f} s and {max(after):.1f} s, "
        f"{sum(before):.0f} s and {sum(after):.0f} s together",
        "",
        "| piece | parts | connections | before, s | after, s | ratio | result |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, x, y in zip(both, before, after, strict=True):
        item = new[name]
        result = "the same" if old[name]["digest"] == item["digest"] else "DIFFERENT"
        result += ", refused" if item["error"] else ""
        shape = f"{item['parts'] or ''} | {item['connections'] or ''}"
        lines.append(f"| {name} | {shape} | {x:.2f} | {y:.2f} | {x / y:.1f} | {result} |")
    return lines


def main() -> None:
    """Measure, or print the table of the two files named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", help="KIND:SOURCE to measure, or two files to compare")
    parser.add_argument("--out", type=Path, help="file to write measurements to")
    options = parser.parse_args()
    if options.out is not None:
        measure_all(options.sources, options.out)
    elif len(options.sources) == 2:
        print("\n".join(table(*(json.loads(Path(name).read_text()) for name in options.sources))))
    else:
        parser.error("give --out FILE to measure, or two files to compare")


if __name__ == "__main__":
    if sys.argv[1:2] == [_ONE]:
        print(json.dumps(measure(sys.argv[2], Path(sys.argv[3]))))
    else:
        main()
