"""Reader of STEP files: each solid product of the assembly, tessellated at its place by OpenCASCADE (`cascadio`).

OpenCASCADE runs in a process of its own: it may crash or hang on a broken file, and it prints on stdout.
"""

from __future__ import annotations

import re
import signal
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

from roboassembly.errors import FurnitureError
from roboassembly.furniture.triangles import NamedTriangles, Triangles
from roboassembly.geometry.units import METRES, NAMES, Unit
from roboassembly.importers.files import one_line, read_bytes
from roboassembly.importers.glb import decode_glb
from roboassembly.importers.scene import FileScene

DEFLECTION = 2.5e-4
"""Distance of the triangles from a curved surface, as a share of the largest part's size (0.25 mm of 1 m)."""
ANGLE = 0.25
"""Largest angle between neighbouring triangles of a curved surface [rad]."""
SECONDS, SECONDS_PER_MB = 30.0, 5.0
"""Processor time after which a file counts as one that OpenCASCADE cannot read: for each file, and for each megabyte of
it [s]. Some broken files keep it busy for ever."""
_TESSELLATE = """
import json, resource, struct, sys
import cascadio
source, target, share, angle = sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4])
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[5]), int(sys.argv[5]) + 5))
with open(source, "rb") as file:
    data = file.read()
# A first look, in steps relative to each edge, gives the size of the largest part, and with it the detail.
rough = cascadio.load(data, tol_linear=0.05, tol_angular=0.8, tol_relative=True, use_parallel=False)
document = json.loads(rough[20 : 20 + struct.unpack_from("<I", rough, 12)[0]]) if rough else {}
longest = 0.0
for mesh in document.get("meshes", ()):
    for primitive in mesh["primitives"]:
        points = document["accessors"][primitive["attributes"]["POSITION"]]
        longest = max(longest, *(high - low for low, high in zip(points["min"], points["max"])))
if longest > 0.0:
    scene = cascadio.load(data, tol_linear=1e3 * share * longest, tol_angular=angle, use_parallel=False)
    with open(target, "wb") as file:
        file.write(scene)
"""
_PROBLEM = re.compile(r"\*{2,}\s*ERR\s*(.*?)\s*\*{2,}|(Unresolved Reference[^*]*)|Error: (.*)")
_LENGTH_UNIT = re.compile(r"#(\d+)\s*=\s*\(([^;]*\bLENGTH_UNIT\b[^;]*)\)\s*;")
_ASSIGNED = re.compile(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)")
_SI = re.compile(r"SI_UNIT\s*\(\s*(\$|\.\w+\.)\s*,\s*\.METRE\.")
_CONVERTED = re.compile(r"CONVERSION_BASED_UNIT\s*\(\s*'([^']*)'")
_SYMBOLS = {
    "$": "m", ".MILLI.": "mm", ".CENTI.": "cm", "INCH": "in", "FOOT": "ft", "MILLIMETRE": "mm", "CENTIMETRE": "cm",
    "METRE": "m",
}  # fmt: skip
"""Units in `METRES` by their name in a file."""


def read_step(path: Path) -> FileScene:
    """Read each product of a STEP file that has a shape as a part: z up, in the unit of the file.

    Parts have the names of their instances, or else of their products; see `scene.part_names`.

    Raises:
        FurnitureError: the file is no STEP file, is broken, or has no solids; the message names the file.
    """
    text = read_bytes(path)
    if not text.lstrip()[:32].startswith(b"ISO-10303-21"):
        raise FurnitureError(
            f"'{path}' cannot be read as STEP: it does not begin with 'ISO-10303-21'; export it again as STEP (AP214 "
            "or AP242)"
        )
    if b"END-ISO-10303-21" not in text[-4096:]:
        raise FurnitureError(
            f"'{path}' cannot be read as STEP: it ends in the middle, after {len(text)} bytes; copy or export it again"
        )
    unit = stated_unit(text.decode("latin-1"))
    scene = _tessellated(path)
    # OpenCASCADE converts to metres.
    parts = [
        NamedTriangles(part.name, Triangles(part.triangles.points / unit.scale, part.triangles.faces))
        for part in scene.parts
    ]
    return FileScene(tuple(parts), "z", unit)


def count_parts(path: Path) -> int:
    """Count the parts that a STEP file seems to have, without reading its shapes; 0 for a file that is none."""
    try:
        text = read_bytes(path)
    except FurnitureError:
        return 0
    solids = len(re.findall(rb"=\s*(?:MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS|FACETED_BREP)\s*\(", text))
    return max(solids, text.count(b"NEXT_ASSEMBLY_USAGE_OCCURRENCE"))


def stated_unit(text: str) -> Unit:
    """Return the unit of length that a STEP file states; millimetres if it states none, or several."""
    units = {int(number): _symbol(body) for number, body in _LENGTH_UNIT.findall(text)}
    used = {units.get(int(n)) for listed in _ASSIGNED.findall(text) for n in re.findall(r"#(\d+)", listed)} - {None}
    if len(used) != 1:
        how = "no unit stated" if not used else "several units in the file"
        return Unit(METRES["mm"], f"{NAMES['mm']}, with {how}", "mm")
    symbol = used.pop() or "mm"
    return Unit(METRES[symbol], f"{NAMES[symbol]}, as the file states", symbol)


def _symbol(body: str) -> str | None:
    if found := _CONVERTED.search(body):
        return _SYMBOLS.get(found[1].strip().upper())
    return _SYMBOLS.get(found[1].upper()) if (found := _SI.search(body)) else None


def _tessellated(path: Path) -> FileScene:
    """Return the scene in metres."""
    with tempfile.TemporaryDirectory(prefix="roboassembly-") as scratch:
        out = Path(scratch) / "scene.glb"
        # -P: no module of the present folder is imported.
        command = [sys.executable, "-P", "-c", _TESSELLATE, str(path.resolve()), str(out)]
        seconds = SECONDS + SECONDS_PER_MB * path.stat().st_size / 1e6
        command += [str(DEFLECTION), str(ANGLE), str(int(seconds))]
        done = subprocess.run(command, capture_output=True, check=False, stdin=subprocess.DEVNULL)
        printed = re.sub(r"\x1b\[[\d;]*m", "", (done.stdout + done.stderr).decode("utf-8", "replace"))
        problem = _PROBLEM.search(printed)
        data = out.read_bytes() if out.is_file() else b""
    if done.returncode == -signal.SIGXCPU:
        raise FurnitureError(
            f"'{path}' cannot be read as STEP: OpenCASCADE does not finish within {seconds:.0f} s; repair it in a CAD "
            "program, or export fewer solids"
        )
    if done.returncode != 0 and not data:
        last = one_line(printed.strip().rsplit("\n", 1)[-1], 80) or "nothing"
        raise FurnitureError(
            f"'{path}' cannot be read as STEP: OpenCASCADE ended with status {done.returncode} ({last}); repair it in "
            "a CAD program, or export each part as STL"
        )
    if problem or not data:
        found = next(filter(None, problem.groups()), "") if problem else "no solids"
        raise FurnitureError(
            f"'{path}' cannot be read as STEP: {one_line(found)}; export it again from the CAD program"
        )
    try:
        return decode_glb(data, each_node=True, default=one_line(path.stem) or "part")
    except (FurnitureError, ValueError, IndexError, struct.error) as refusal:
        raise FurnitureError(f"'{path}' has no shapes that can be read as STEP: {one_line(str(refusal))}") from None
