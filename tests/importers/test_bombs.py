"""Small files that claim or unpack to huge data are refused quickly, with little memory and a one-line message.

Each is opened in a process of its own that may take 600 MB more than it has, so that a reader that believes the claim
fails, and says how much it took and for how long.
"""

from __future__ import annotations

import io
import json
import resource
import select
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from model_files import PART_PAIR, box, export, glb_accessors, write_glb, write_table
from roboassembly.importers.glb import MAX_NODES

ALLOWED = 600 * 2**20
"""Memory limit above the use of the program before it opens a file [bytes]."""
_OPEN = """
import json, os, resource, sys, time, traceback
from pathlib import Path
from roboassembly.errors import InputError
from roboassembly.importers import folder
from roboassembly.learning import checkpoint
from roboassembly.learning import registry as loading
from roboassembly.studio.uploads import unpack

def opened(how, path, place, allowed):
    read = {
        "folder": lambda: folder.read(path),
        "policy": lambda: loading.load_policy(str(path)),
        "archive": lambda: unpack(path.name, path.read_bytes(), place),
    }[how]
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    taken = int(status["VmSize"].split()[0]) << 10
    resource.setrlimit(resource.RLIMIT_AS, (taken + allowed, taken + allowed))
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    try:
        read()
        said = ""
    except InputError as error:
        said = str(error)
    return said, time.monotonic() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before

for line in sys.stdin:
    how, path, place, allowed = json.loads(line)
    child = os.fork()
    if not child:
        try:
            print(json.dumps(opened(how, Path(path), Path(place), allowed)), flush=True)
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    if os.waitpid(child, 0)[1]:
        print("null", flush=True)
"""
"""Reads lines of what to open and forks a process for each, so that the package is imported once."""


class Opened(NamedTuple):
    said: str
    seconds: float
    megabytes: float


Open = Callable[[str, Path, Path], Opened]


@pytest.fixture(scope="module")
def opened() -> Iterator[Open]:
    """`opened(how, path, place)`: opens a file in a process whose memory is limited."""
    with subprocess.Popen(
        [sys.executable, "-c", _OPEN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        into, out = server.stdin, server.stdout

        def ask(how: str, path: Path, place: Path) -> Opened:
            into.write(json.dumps([how, str(path), str(place), ALLOWED]) + "\n")
            into.flush()
            assert select.select([out], [], [], 60.0)[0], "no answer after a minute"
            answer = json.loads(out.readline())
            assert answer is not None, "the process that opens the file ended"
            said, seconds, kilobytes = answer
            return Opened(said, seconds, kilobytes / 1024)

        try:
            yield ask
        finally:
            server.kill()


def stl_header(path: Path) -> None:
    path.write_bytes(b"\0" * 80 + struct.pack("<I", 2**31) + b"\0" * 500)


def ply_header(path: Path, vertices: int, faces: int, form: str = "binary_little_endian") -> None:
    path.write_text(
        f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
    )


def ply_ring(path: Path) -> None:
    """Return a file with one face that claims 2^31 corners."""
    header = (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 0\n"
        b"property float x\nproperty float y\nproperty float z\nelement face 1\n"
        b"property list uint int vertex_indices\nend_header\n"
    )
    path.write_bytes(header + struct.pack("<I3i", 2**31, 0, 1, 2))


def obj_far(path: Path) -> None:
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {2**40}\n")


def obj_ring(path: Path) -> None:
    """Two hundred faces of half a million corners each."""
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + ("f" + " 1 2 3" * 170_000 + "\n") * 5)


def glb(path: Path, **changes: object) -> None:
    write_glb(path, PART_PAIR, **changes)


def glb_of_primitives(path: Path) -> None:
    """Ten thousand primitives of one triangle each, and each names the same list of a million points."""
    points = np.zeros((1_000_000, 3), "<f4")
    points[:3] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    binary = points.tobytes() + struct.pack("<3I", 0, 1, 2)
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": PART_PAIR,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}] * 10_000}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteLength": 12, "byteOffset": points.nbytes},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)


def glb_lengths(path: Path) -> None:
    """Return chunks that claim 4 GB."""
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 2**32 - 1) + struct.pack("<II", 2**32 - 9, 0x4E4F534A) + b"{}")


def glb_of_nodes(path: Path) -> None:
    """As many nodes as a file may have, each with the same mesh of a thousand cubes."""
    nodes = [{"children": list(range(1, MAX_NODES))}, *({"name": "a", "mesh": 0} for _ in range(MAX_NODES - 1))]
    cube = {"attributes": {"POSITION": 0}, "indices": 1}
    write_glb(path, nodes, meshes=[{"primitives": [cube] * 1000}])


MESHES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "STL of 2^31 faces": ("a.stl", stl_header, "2147483648 triangles need"),
    "PLY of 2^33 points": ("a.ply", lambda p: ply_header(p, 2**33, 1), "the file ends before"),
    "PLY of 2^33 faces": ("a.ply", lambda p: ply_header(p, 1, 2**33), "faces announced"),
    "PLY of 2^33 points as text": ("a.ply", lambda p: ply_header(p, 2**33, 1, "ascii"), "announced"),
    "PLY of 2^31 corners": ("a.ply", ply_ring, "ends in the middle"),
    "OBJ of vertex 2^40": ("a.obj", obj_far, "but there are 3 vertices"),
    "OBJ of faces with 510,000 corners": ("a.obj", obj_ring, "more than 2000000 faces"),
    "GLB of 2^60 points": ("a.glb", lambda p: glb(p, accessors=glb_accessors(count=2**60)), "beyond"),
    "GLB of a buffer of 2^60 bytes": (
        "a.glb",
        lambda p: glb(p, bufferViews=[{"buffer": 0, "byteLength": 2**60}] * 2, accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 2**55, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"}]),
        "beyond its buffer",
    ),
    "GLB of chunks of 4 GB": ("a.glb", glb_lengths, "it ends after"),
    "GLB of 10,000 million points": ("a.glb", glb_of_primitives, "more than 8000000 points and corners"),
    "GLB of 20 million cubes": ("a.glb", glb_of_nodes, "more than 2000000 faces"),
}  # fmt: skip


@pytest.mark.parametrize("case", MESHES)
def test_meshes_that_claim_too_much(opened: Open, case: str, tmp_path: Path) -> None:
    name, write, words = MESHES[case]
    folder = tmp_path / "piece"
    folder.mkdir()
    write(folder / name)
    export(box((1, 1, 1)), folder / "b.obj")
    source = folder / name if name.endswith("glb") else folder
    found = opened("folder", source, tmp_path)
    assert words in found.said
    assert name in found.said
    assert found.seconds < 10.0
    assert found.megabytes < ALLOWED / 2**20


def packed(**files: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for entry, content in files.items():
            archive.writestr(entry.replace("_", "."), content)
    return file.getvalue()


def test_archives_that_unpack_to_much_more(opened: Open, tmp_path: Path) -> None:
    """Archives unpack to a thousand times their size; one declares a false size."""
    zeros = bytes(60 * 2**20)
    bomb = packed(**{f"part{k}_stl": zeros for k in range(4)})
    lying = bomb.replace(struct.pack("<I", len(zeros)), struct.pack("<I", 100))
    assert lying != bomb
    for k, content in enumerate((bomb, lying)):
        assert len(content) < len(zeros) / 200
        (tmp_path / "bomb.zip").write_bytes(content)
        place = tmp_path / f"place{k}"
        place.mkdir()
        found = opened("archive", tmp_path / "bomb.zip", place)
        assert "bomb.zip" in found.said
        assert found.seconds < 10.0
        assert found.megabytes < 300
        assert sum(p.stat().st_size for p in place.rglob("*") if p.is_file()) <= 50_000_000


def test_policies_that_unpack_to_much_more(opened: Open, tmp_path: Path) -> None:
    """One file holds weights of 400 MB in 0.4 MB; another claims an array of 800 TB."""
    path = tmp_path / "policy.npz"
    meta = json.dumps({"format": 1, "version": "0", "kind": "relational", "config": {}}).encode()
    file = io.BytesIO()
    np.savez_compressed(
        file, **{"meta.json": np.frombuffer(meta, np.uint8), "params/w": np.zeros(400 * 2**20, np.uint8)}
    )
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000000,)}".ljust(117) + b"\n"
    huge = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    for content, words in ((file.getvalue(), "unpacks to"), (packed(meta_json=huge), "Unable to allocate")):
        path.write_bytes(content)
        found = opened("policy", path, tmp_path)
        assert f"'{path}'" in found.said
        assert words in found.said
        assert found.seconds < 5.0
        assert found.megabytes < 100


def test_ordinary_files_open_within_the_limit(opened: Open, tmp_path: Path) -> None:
    """Ordinary files are read within the limit."""
    folder = write_table(tmp_path / "table")
    found = opened("folder", folder, tmp_path)
    assert found.said == ""
    assert found.megabytes < 100
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY, "only the process that opens is limited"
