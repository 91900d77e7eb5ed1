"""Makes the gallery of the site (`make gallery`): a film, a page and a picture of each piece, in build/gallery."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from roboassembly.furniture import storage
from roboassembly.viewer.film import render_furniture

OUT = Path(__file__).parents[1] / "build" / "gallery"
PIECES = {
    "ladder": "assemble ladder",
    "windsor": "assemble windsor:3 --seed 7",
    "rocker": "assemble rocker",
    "folding": "assemble folding:2",
    "table": "assemble table_trestle",
    "bookcase": "assemble shelf_bookcase",
    "two-robots": "assemble stool --setting full",
}
"""Command whose results each folder holds."""

shutil.rmtree(OUT, ignore_errors=True)
shown = []
for name, command in PIECES.items():
    folder = OUT / name
    folder.mkdir(parents=True)
    words = [*shlex.split(command), "--out", str(folder), "--json"]
    done = subprocess.run([sys.executable, "-m", "roboassembly.cli", *words], stdout=subprocess.PIPE, check=True)
    report = json.loads(done.stdout)
    picture = folder / "finished.png"
    render_furniture(storage.load(folder / "furniture"), picture, width=960, height=540)
    figures = f"{report['parts']} parts, {report['merges']} merges, {report['planning_steps']:,} states checked in "
    shown.append(
        {
            "title": report["furniture"] + ", by two robots" * (report["setting"] == "full"),
            "command": f"roboassembly {command}",
            "figures": f"{figures}{report['planning_seconds']:.2f} s",
            "film": str(Path(report["outputs"]["film"]).relative_to(OUT)),
            "page": str(Path(report["outputs"]["html"]).relative_to(OUT)),
            "picture": str(picture.relative_to(OUT)),
        }
    )
(OUT / "gallery.json").write_text(json.dumps(shown, indent=1) + "\n")
