"""`roboassembly import` and the registry of importers."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import get_args

import pytest
import trimesh

from roboassembly.cli import main
from roboassembly.cli.importing import Kind, piece_names
from roboassembly.cli.output import writable_folder
from roboassembly.furniture import storage
from roboassembly.importers import IMPORTERS


def test_import_command_has_every_importer():
    assert set(get_args(Kind)) == set(IMPORTERS)
    assert all(name == importer.name and importer.description for name, importer in IMPORTERS.items())


def table(root: Path) -> Path:
    root.mkdir(parents=True)
    for name, extents, centre in (("top", (0.5, 0.5, 0.04), 0.32), ("foot", (0.1, 0.1, 0.3), 0.15)):
        mesh = trimesh.creation.box(extents)
        mesh.apply_translation((0, 0, centre))
        (root / f"{name}.obj").write_text(mesh.export(file_type="obj"))
    return root


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def test_a_folder_of_parts(tmp_path, capsys):
    table(tmp_path / "in" / "one")
    (tmp_path / "in" / "two").mkdir()
    (tmp_path / "in" / "two" / "a.stl").write_bytes(b"broken")
    before = sorted(p for p in tmp_path.rglob("*"))
    assert (
        run("import", "folder", "--no-report", tmp_path / "in", "--out", tmp_path / "out", "--jobs", "1", "--json") == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert (report["imported"], report["refused"]) == (1, 1)
    assert {item["name"]: item["parts"] for item in report["items"]} == {"one": 2, "two": 0}
    loaded = storage.load(tmp_path / "out" / "one")
    assert sorted(p.name for p in loaded.parts) == ["foot", "top"]
    assert loaded.provenance.source == "folder"
    after = sorted(p for p in tmp_path.rglob("*") if not p.is_relative_to(tmp_path / "out"))
    assert after == before, "nothing is written outside the output folder"


def test_stages_of_a_piece_alone_are_announced(tmp_path, capsys):
    table(tmp_path / "in" / "one")
    table(tmp_path / "in" / "two")
    out, options = tmp_path / "out", ("--no-report", "--no-cache", "--jobs", "1")
    assert run("import", tmp_path / "in" / "one", "--out", out / "one", *options) == 0
    said = capsys.readouterr().err
    stages = ("reading one ...", "repairing 2 parts", "order in which two robot hands join")
    assert [said.count(stage) for stage in stages] == [1, 1, 1]
    assert sorted(stages, key=said.index) == list(stages)
    # A progress bar shows those of many.
    assert run("import", tmp_path / "in", "--out", out / "both", *options) == 0
    assert "..." not in capsys.readouterr().err


def test_up_is_for_folders(tmp_path, capsys):
    assert run("import", "partnet", tmp_path, "--up", "y") == 2
    assert "--up y is for the format 'folder'" in capsys.readouterr().err
    table(tmp_path / "in")
    assert run("import", "folder", "--no-report", tmp_path / "in", "--up=-z", "--out", tmp_path / "out", "--json") == 0
    slots = storage.load(tmp_path / "out")
    top = next(k for k, part in enumerate(slots.parts) if part.name == "top")
    assert slots.assembled[top].translation[2] == pytest.approx(0.02, abs=1e-3)


def test_an_output_folder_that_holds_something_else_is_one_refusal(tmp_path, capsys):
    table(tmp_path / "in" / "one")
    table(tmp_path / "in" / "two")
    (tmp_path / "out" / "one").mkdir(parents=True)
    (tmp_path / "out" / "one" / "precious.txt").write_text("mine")
    assert (
        run("import", "folder", "--no-report", tmp_path / "in", "--out", tmp_path / "out", "--jobs", "1", "--json") == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert [item["error"] is None for item in report["items"]] == [False, True]
    assert (tmp_path / "out" / "one" / "precious.txt").read_text() == "mine"


def test_a_folder_is_tried_by_many_at_once(tmp_path):
    def work(_: int) -> Path:
        return writable_folder(tmp_path / "out")

    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(work, range(400))) == [tmp_path / "out"] * 400
    assert not list((tmp_path / "out").iterdir())


def test_names_are_different(tmp_path):
    paths = [tmp_path / a / "p" / name for a in "xy" for name in ("chair.xml", "stool.xml")]
    paths.append(tmp_path / "z" / "q" / "chair")
    for path in paths[:4]:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert piece_names(paths) == ["p_chair", "p_stool", "p_chair_2", "p_stool_2", "q_chair"]
