"""`--policy` on a file that is no policy: one line that names the file and what is expected, and exit status 2."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_line import Run
from roboassembly.datasets import catalogue
from roboassembly.furniture import storage

WOULD_DO = "name a checkpoint (.npz) that `roboassembly train` wrote, or a Python file (.py) that defines policy(seed)"


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=True, **arrays)
    return file.getvalue()


def npy(header: str) -> bytes:
    text = header.encode() + b" " * (117 - len(header)) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def archive(flags: int = 0, method: int = zipfile.ZIP_STORED, **files: bytes) -> bytes:
    """A ZIP archive whose entries say that they are encrypted (`flags` 1), or packed in another way."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packed:
        for name, data in files.items():
            packed.writestr(name.replace("_json", ".json"), data)
    data = bytearray(file.getvalue())
    for head, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = data.find(head)
        while place >= 0:
            struct.pack_into("<HH", data, place + at, flags, method)
            place = data.find(head, place + 4)
    return bytes(data)


META = json.dumps({"format": 2, "version": "0", "kind": "relational", "config": {}}).encode()
HUGE = npy("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000000,)}")
WHOLE = npz(**{"meta.json": np.frombuffer(META, np.uint8), "params/w": np.zeros(3, np.float32)})
FILES: dict[str, tuple[str, bytes | None, str]] = {
    "an STL": ("chair.stl", trimesh.creation.box().export(file_type="stl"), WOULD_DO),
    "text": ("notes.txt", b"my notes\n", WOULD_DO),
    "text, named like one": ("policy.npz", b"my notes\n", WOULD_DO),
    "a folder": ("folder", None, WOULD_DO),
    "a folder named like one": ("folder.npz", None, WOULD_DO),
    "a folder named like Python": ("folder.py", None, "name a Python file that defines policy(seed)"),
    "nothing": ("empty.npz", b"", WOULD_DO),
    "one array": ("array.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}") + bytes(8), WOULD_DO),
    "other arrays": ("other.npz", npz(points=np.zeros((3, 3))), WOULD_DO),
    "pickled objects": ("objects.npz", npz(a=np.array([{}], dtype=object)), WOULD_DO),
    "an archive of other things": ("photos.zip", archive(a=b"x"), WOULD_DO),
    "half a file": ("half.npz", WHOLE[: len(WHOLE) // 2], WOULD_DO),
    "without its end": ("cut.npz", WHOLE[:-10], WOULD_DO),
    "meta that is no JSON": ("meta.npz", npz(**{"meta.json": np.frombuffer(b"{", np.uint8)}), WOULD_DO),
    "meta nested deeply": ("deep.npz", npz(**{"meta.json": np.frombuffer(b"[" * 100_000, np.uint8)}), WOULD_DO),
    "encrypted": ("secret.npz", archive(1, meta_json=META), WOULD_DO),
    "packed otherwise": ("packed.npz", archive(0, 99, meta_json=META), WOULD_DO),
    "an array of 800 TB": ("huge.npz", archive(meta_json=HUGE), WOULD_DO),
    "arrays that do not fit": ("unfit.npz", WHOLE, "config['network']"),
    "Python without a policy": ("mine.py", b"x = 1\n", "expected a function policy(seed) that returns a policy"),
    "Python that fails": ("fails.py", b"import sys\n\nraise ValueError('no weights here')\n", "line 3: ValueError"),
    "Python that exits": ("exits.py", b"raise SystemExit(0)\n", "line 1: SystemExit"),
    "Python that is none": ("broken.py", b"def policy(:\n", "line 1: SyntaxError"),
    "bytes named like Python": ("bytes.py", bytes(range(256)), "bytes.py'"),
    "Python that makes none": ("none.py", b"def policy(seed):\n    return 3\n", "which is no policy"),
}


@pytest.fixture(scope="module")
def pieces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of one stool."""
    folder = tmp_path_factory.mktemp("pieces")
    storage.save(catalogue.make("stool", with_grasps=False), folder / "stool")
    return folder


@pytest.mark.parametrize("case", FILES)
@pytest.mark.parametrize("command", ["assemble", "evaluate"])
def test_a_file_that_is_no_policy(run: Run, pieces: Path, tmp_path: Path, command: str, case: str) -> None:
    name, content, would_do = FILES[case]
    path = tmp_path / name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    more = ["stool", "--out", tmp_path / "out"] if command == "assemble" else ["--set", f"folder:{pieces}"]
    status, out, err = run(command, *more, "--policy", path, "--json")
    assert status == 2, err
    (line,) = [line for line in err.splitlines() if line]
    assert line.startswith("error: ")
    assert f"'{path}'" in line
    assert would_do in line
    assert "pickle" not in line, "what NumPy says of its own options helps nobody"
    assert json.loads(out) == {"success": False, "error": line.removeprefix("error: ")}
    assert [p.name for p in tmp_path.iterdir()] == [name]
