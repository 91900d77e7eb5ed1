"""An import done before is not done again, unless anything that matters has changed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import trimesh

from roboassembly.cli import importing, main
from roboassembly.furniture import storage
from roboassembly.furniture.importers import kept, pipeline


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path / "cache"))
    kept._content.cache_clear()
    folder = tmp_path / "parts"
    folder.mkdir()
    for name, height in (("top", 0.51), ("leg", 0.25)):
        box = trimesh.creation.box([0.4, 0.4, 0.02] if name == "top" else [0.05, 0.05, 0.5])
        box.apply_translation([0, 0, height])
        box.export(folder / f"{name}.stl")
    return folder


@pytest.fixture
def finished(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the pieces that were really repaired."""
    done: list[str] = []
    finish = pipeline.finish

    def counting(name, raw):
        done.append(name)
        return finish(name, raw)

    monkeypatch.setattr(pipeline, "finish", counting)
    return done


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    kept._content.cache_clear()  # as in a new process
    with pytest.raises(SystemExit):
        main(["import", "folder", *arguments, "--json"])
    return json.loads(capsys.readouterr().out)["items"][0]


def test_the_second_time_is_a_copy(source: Path, tmp_path: Path, finished: list[str], capsys) -> None:
    first = run(capsys, str(source), "--out", str(tmp_path / "a"))
    second = run(capsys, str(source), "--out", str(tmp_path / "b"))
    assert finished == ["parts"]
    skip = {"seconds", "folder"}
    assert {k: v for k, v in first.items() if k not in skip} == {k: v for k, v in second.items() if k not in skip}
    assert (tmp_path / "a" / "furniture.json").read_bytes() == (tmp_path / "b" / "furniture.json").read_bytes()
    assert len(storage.load(tmp_path / "b").parts) == 2


@pytest.mark.parametrize("change", ["content", "new file", "scale", "program", "no cache"])
def test_anything_that_matters_makes_it_anew(
    change: str, source: Path, tmp_path: Path, finished: list[str], capsys, monkeypatch
) -> None:
    run(capsys, str(source), "--out", str(tmp_path / "a"))
    arguments = []
    if change == "content":
        trimesh.creation.box([0.06, 0.05, 0.5]).apply_translation([0, 0, 0.25]).export(source / "leg.stl")
    elif change == "new file":
        trimesh.creation.box([0.05, 0.05, 0.5]).apply_translation([0.15, 0, 0.25]).export(source / "leg2.stl")
    elif change == "scale":
        arguments = ["--scale", "1.5"]
    elif change == "program":
        monkeypatch.setattr(kept, "_program", lambda: b"another")
    else:
        arguments = ["--no-cache"]
    run(capsys, str(source), "--out", str(tmp_path / "a"), *arguments)
    assert len(finished) == 2


def test_refusals_are_remembered_word_for_word(source: Path, tmp_path: Path, finished: list[str], capsys) -> None:
    far = trimesh.creation.box([0.05, 0.05, 0.5])
    far.apply_translation([3.0, 0, 0.25])
    far.export(source / "far.stl")
    first = run(capsys, str(source), "--out", str(tmp_path / "a"))
    second = run(capsys, str(source), "--out", str(tmp_path / "a"))
    assert len(finished) == 1
    assert first["error"] == second["error"]
    assert "far" in first["error"]
    assert not (tmp_path / "a").exists()


def test_a_broken_entry_is_made_anew_and_a_file_in_its_place_is_no_error(
    source: Path, tmp_path: Path, finished: list[str], capsys
) -> None:
    run(capsys, str(source), "--out", str(tmp_path / "a"))
    (entry,) = (tmp_path / "cache" / "imports").iterdir()
    (entry / "summary.json").write_text("{")
    run(capsys, str(source), "--out", str(tmp_path / "a"))
    assert len(finished) == 2
    shutil.rmtree(tmp_path / "cache")
    (tmp_path / "cache").write_text("not a folder")
    assert run(capsys, str(source), "--out", str(tmp_path / "a"))["error"] is None


def test_what_was_not_used_for_longest_makes_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    monkeypatch.setattr(kept, "MAX_BYTES", 250)
    for age, name in enumerate(["new", "older", "oldest"]):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_bytes(b"x" * 100)
        os.utime(tmp_path / name, (1_000_000 - age, 1_000_000 - age))
    kept._make_room(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "older"]


def test_workers_agree_on_places(source: Path) -> None:
    assert importing.import_piece  # spawned by name
    assert kept.place_of(source, 1, None) == kept.place_of(source, 1, None) != kept.place_of(source, 2, None)
