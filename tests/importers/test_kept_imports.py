"""Cache of imports: an import is repeated only if one of its inputs has changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import trimesh

from roboassembly.cli import main
from roboassembly.furniture import storage
from roboassembly.importers import kept, pipeline


def box(path: Path, extents: tuple[float, float, float], centre: tuple[float, float, float]) -> None:
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(centre)
    mesh.export(path)


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "models" / "parts"
    folder.mkdir(parents=True)
    box(folder / "top.stl", (0.4, 0.4, 0.02), (0, 0, 0.51))
    box(folder / "leg.stl", (0.05, 0.05, 0.5), (0, 0, 0.25))
    return folder


@pytest.fixture
def finished(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the pieces that were repaired and not taken from the cache."""
    done: list[str] = []
    finish = pipeline.finish

    def counting(name, raw, **options):
        done.append(name)
        return finish(name, raw, **options)

    monkeypatch.setattr(pipeline, "finish", counting)
    return done


def run(capsys: pytest.CaptureFixture[str], *arguments: object, kind: str = "folder") -> dict:
    with pytest.raises(SystemExit):
        main(["import", kind, *map(str, arguments), "--no-report", "--force", "--json"])
    return json.loads(capsys.readouterr().out)["items"][0]


def entry(tmp_path: Path) -> Path:
    (only,) = (tmp_path / "cache" / "imports").iterdir()
    return only


def test_the_second_import_comes_from_the_cache(source: Path, tmp_path: Path, finished: list[str], capsys) -> None:
    first = run(capsys, source, "--out", tmp_path / "a")
    second = run(capsys, source, "--out", tmp_path / "b")
    assert finished == ["parts"]
    assert (first.pop("cached"), second.pop("cached")) == (False, True)
    skip = {"seconds", "folder"}
    assert {k: v for k, v in first.items() if k not in skip} == {k: v for k, v in second.items() if k not in skip}
    assert {"name", "parts", "connections", "displacement_max_mm", "trimmed_max_percent", "seconds", "error"} <= {
        *first
    }
    assert storage.read_files(tmp_path / "a") == storage.read_files(tmp_path / "b")
    assert len(storage.load(tmp_path / "b").parts) == 2


def test_the_same_files_elsewhere_are_the_same(
    source: Path, tmp_path: Path, finished: list[str], capsys, monkeypatch
) -> None:
    run(capsys, source, "--out", tmp_path / "a")
    monkeypatch.chdir(source.parent)
    run(capsys, "parts", "--out", tmp_path / "a")
    (tmp_path / "elsewhere").mkdir()
    source.parent.rename(tmp_path / "elsewhere" / "models")
    for file in (tmp_path / "elsewhere").rglob("*.stl"):
        os.utime(file, (1e9, 1e9))
    run(capsys, tmp_path / "elsewhere" / "models" / "parts", "--out", tmp_path / "a")
    assert len(finished) == 1


@pytest.mark.parametrize(
    "change",
    [
        "content",
        "new file",
        "scale",
        "program",
        *(pytest.param(c, marks=pytest.mark.slow) for c in ("name", "category", "up", "library", "no cache")),
    ],
)
def test_a_change_of_any_input_repeats_the_import(
    change: str, source: Path, tmp_path: Path, finished: list[str], capsys, monkeypatch
) -> None:
    run(capsys, source, "--out", tmp_path / "a")
    arguments = []
    if change == "content":
        before = (source / "leg.stl").stat()
        box(source / "leg.stl", (0.06, 0.05, 0.5), (0, 0, 0.25))
        os.utime(source / "leg.stl", ns=(before.st_atime_ns, before.st_mtime_ns))
        assert (source / "leg.stl").stat().st_size == before.st_size
    elif change == "new file":
        box(source / "leg2.stl", (0.05, 0.05, 0.5), (0.15, 0, 0.25))
    elif change == "name":
        source = source.rename(source.parent / "others")
    elif change == "category":
        source = source.parent.rename(tmp_path / "tables") / "parts"
    elif change == "scale":
        arguments = ["--scale", "1.5"]
    elif change == "up":
        arguments = ["--up", "z"]
    elif change == "program":
        monkeypatch.setattr(kept, "program_hash", lambda: b"another")
    elif change == "library":
        monkeypatch.setattr(kept, "program_hash", kept.program_hash.__wrapped__)
        monkeypatch.setattr(kept, "library_version", lambda name: "0.0.0" if name == "manifold3d" else "1.0.0")
    else:
        arguments = ["--no-cache"]
    assert not run(capsys, source, "--out", tmp_path / "a", *arguments)["cached"]
    assert len(finished) == 2


def test_version_of_a_missing_library_is_none() -> None:
    assert kept.library_version("numpy")
    assert kept.library_version("no-such-library") is None


def test_files_behind_links_count(tmp_path: Path, finished: list[str], capsys, monkeypatch) -> None:
    """PartNet's folders are often links to another disk."""
    monkeypatch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path / "cache"))
    shape, disk = tmp_path / "shape", tmp_path / "disk"
    shape.mkdir()
    disk.mkdir()
    (shape / "objs").symlink_to(disk)
    box(disk / "a.obj", (0.5, 0.04, 0.5), (0, 0.32, 0))
    box(disk / "b.obj", (0.1, 0.3, 0.1), (0, 0.15, 0))
    leaves = [{"name": "top", "objs": ["a"]}, {"name": "foot", "objs": ["b"]}]
    (shape / "result_after_merging.json").write_text(json.dumps([{"name": "Table", "children": leaves}]))
    first = run(capsys, shape, "--out", tmp_path / "a", kind="partnet")
    assert first["error"] is None
    box(disk / "b.obj", (0.2, 0.3, 0.1), (0, 0.15, 0))
    assert not run(capsys, shape, "--out", tmp_path / "a", kind="partnet")["cached"]
    assert run(capsys, shape, "--out", tmp_path / "a", kind="partnet")["cached"]


def test_refusals_of_repair_are_cached_with_their_text(
    source: Path, tmp_path: Path, finished: list[str], capsys
) -> None:
    box(source / "far.stl", (0.05, 0.05, 0.5), (3.0, 0, 0.25))
    first = run(capsys, source, "--out", tmp_path / "a")
    (tmp_path / "b").mkdir()
    source.parent.rename(tmp_path / "b" / "models")
    second = run(capsys, tmp_path / "b" / "models" / "parts", "--out", tmp_path / "a")
    assert len(finished) == 1
    assert (first["cached"], second["cached"]) == (False, True)
    assert first["error"] == second["error"]
    assert "far" in first["error"]
    assert not (tmp_path / "a").exists()


def test_refusals_that_name_the_path_hold_only_for_that_path(source: Path, tmp_path: Path, capsys) -> None:
    (source / "leg.stl").write_bytes(b"broken")
    first = run(capsys, source, "--out", tmp_path / "a")
    assert str(source) in first["error"]
    again = run(capsys, source, "--out", tmp_path / "a")
    assert (again["cached"], again["error"]) == (True, first["error"])
    (tmp_path / "b").mkdir()
    source.parent.rename(tmp_path / "b" / "models")
    moved = run(capsys, tmp_path / "b" / "models" / "parts", "--out", tmp_path / "a")
    assert not moved["cached"]
    assert str(tmp_path / "b") in moved["error"]


def test_files_that_change_during_the_import_are_not_cached(source: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    finish = pipeline.finish

    def slow(name, raw, **options):
        box(source / "leg.stl", (0.06, 0.05, 0.5), (0, 0, 0.25))
        return finish(name, raw, **options)

    monkeypatch.setattr(pipeline, "finish", slow)
    assert run(capsys, source, "--out", tmp_path / "a")["error"] is None
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(
    "damage",
    ["cut short", "a bit", *(pytest.param(d, marks=pytest.mark.slow) for d in ("empty", "the end", "a folder"))],
)
def test_a_damaged_entry_repeats_the_import(
    damage: str, source: Path, tmp_path: Path, finished: list[str], capsys
) -> None:
    run(capsys, source, "--out", tmp_path / "a")
    path = entry(tmp_path)
    data = path.read_bytes()
    if damage == "a folder":
        path.unlink()
        path.mkdir()
    else:
        flipped = data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
        path.write_bytes({"empty": b"", "cut short": data[:500], "a bit": flipped, "the end": data + b"x"}[damage])
    assert run(capsys, source, "--out", tmp_path / "b")["error"] is None
    assert len(finished) == 2
    assert len(storage.load(tmp_path / "b").parts) == 2
    if damage != "a folder":
        assert run(capsys, source, "--out", tmp_path / "b")["cached"]


def test_an_entry_of_another_format_repeats_the_import(
    source: Path, tmp_path: Path, finished: list[str], capsys
) -> None:
    run(capsys, source, "--out", tmp_path / "a")
    entry(tmp_path).write_bytes(kept.checksum(b"\x01") + b"\x01")
    assert run(capsys, source, "--out", tmp_path / "b")["error"] is None
    assert len(finished) == 2


def test_a_cache_that_cannot_be_written_is_no_error(source: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    (tmp_path / "cache").write_text("not a folder")
    assert run(capsys, source, "--out", tmp_path / "a")["error"] is None
    (tmp_path / "cache").unlink()
    run(capsys, source, "--out", tmp_path / "a")

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "utime", refuse)
    assert run(capsys, source, "--out", tmp_path / "a")["cached"], "one that may only be read still serves"


def test_a_full_disk_leaves_nothing_behind(source: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", refuse)
    assert run(capsys, source, "--out", tmp_path / "a")["error"] is None
    assert not list((tmp_path / "cache" / "imports").iterdir())


def test_an_output_folder_of_something_else_stays_as_it_is(source: Path, tmp_path: Path, capsys) -> None:
    run(capsys, source, "--out", tmp_path / "a")
    (tmp_path / "b" / "parts").mkdir(parents=True)
    (tmp_path / "b" / "parts" / "precious.txt").write_text("mine")
    refused = run(capsys, source, "--out", tmp_path / "b")
    assert "not a furniture folder" in refused["error"]
    assert (tmp_path / "b" / "parts" / "precious.txt").read_text() == "mine"


def test_many_at_once(source: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    """Concurrent writers, readers and evictions each see a whole entry or none."""
    run(capsys, source, "--out", tmp_path / "a")
    path = entry(tmp_path)
    files = storage.read_files(tmp_path / "a")
    summary = kept.Summary(parts=2)

    def work(k: int) -> bool:
        if k % 3 == 0:
            kept.keep(path, summary, tmp_path / "a")
        elif k % 7 == 1:
            path.unlink(missing_ok=True)
        found = kept.recall(path, source, tmp_path / f"out{k}")
        return found is None or storage.read_files(tmp_path / f"out{k}") == files

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(120)))
    assert not list(path.parent.glob(".new-*"))


def test_the_least_recently_used_entries_are_evicted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "MAX_BYTES", 250)
    now = time.time()
    for age, name in enumerate(["new.import", "older.import", "oldest.import", ".new-half", ".new-abandoned"]):
        (tmp_path / name).write_bytes(b"x" * 100)
        at = now - (2 * 86_400 if name == ".new-abandoned" else age)
        os.utime(tmp_path / name, (at, at))
    kept.evict(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [".new-half", "new.import", "older.import"]


def test_a_large_source_is_not_hashed(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (source / "loop").symlink_to(source)
    (source / "knot").symlink_to(source)
    started = time.perf_counter()
    assert kept.place_of(source, source) is None
    assert time.perf_counter() - started < 5.0
    (source / "loop").unlink()
    (source / "knot").unlink()
    assert kept.place_of(source, source)
    with monkeypatch.context() as patch:
        patch.setattr(kept, "MAX_FILES", 2)
        assert kept.place_of(source, source) is None
    with monkeypatch.context() as patch:
        patch.setattr(kept, "MAX_READ", 1000)
        assert kept.place_of(source, source) is None


def test_pipes_and_broken_links_do_not_block(source: Path) -> None:
    before = kept.place_of(source, source)
    os.mkfifo(source / "pipe.stl")
    (source / "gone.stl").symlink_to(source / "nowhere")
    assert kept.place_of(source, source) not in (None, before)


def test_looking_up_loads_no_mesh_library() -> None:
    code = "import sys; from roboassembly.importers import kept; sys.exit('trimesh' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=30, check=False).returncode == 0
