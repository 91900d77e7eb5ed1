"""Meshes of several parts: separate bodies are found, reported and split."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

import shapes
from command_line import Run
from model_files import box
from roboassembly.datasets import catalogue
from roboassembly.errors import FurnitureError
from roboassembly.furniture import storage
from roboassembly.furniture.triangles import NamedTriangles, Triangles
from roboassembly.generate import FAMILIES, generate
from roboassembly.importers import bodies, folder
from roboassembly.solvers.search import solve

UNIT = (1.0, 1.0, 1.0)


def surface(*meshes: trimesh.Trimesh) -> Triangles:
    """Return all meshes as one, as an STL reader returns them: equal corners are merged."""
    whole = trimesh.util.concatenate(meshes)
    return Triangles(np.array(whole.vertices), np.array(whole.faces)).merged()


def volumes(*meshes: trimesh.Trimesh) -> list[float]:
    found = bodies.bodies(surface(*meshes))
    return [round(float(trimesh.Trimesh(b.points, b.faces, process=False).volume), 6) for b in found]


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


@pytest.mark.parametrize(
    ("meshes", "expected"),
    [
        ([box(UNIT, (0, 0, 0))], [1.0]),
        ([box(UNIT, (0, 0, 0)), box(UNIT, (3, 0, 0))], [1.0, 1.0]),
        ([box(UNIT, (0, 0, 0)), box(UNIT, (0, 0, 1))], [1.0, 1.0]),
        ([box(UNIT, (0, 0, 0)), box(UNIT, (1, 0, 1))], [1.0, 1.0]),
        ([box(UNIT, (0, 0, 0)), box(UNIT, (1, 1, 1))], [1.0, 1.0]),
        ([box(UNIT, (x, y, 0)) for x in range(3) for y in range(3)], [1.0] * 9),
        ([box((4, 4, 1), (0, 0, 2.5)), *(box((1, 1, 2), (x, y, 1)) for x in (-1.5, 1.5) for y in (-1.5, 1.5))],
         [16.0, 2.0, 2.0, 2.0, 2.0]),
        ([box(UNIT, (0, 0, 0)), inverted(box((0.5, 0.5, 0.5), (0, 0, 0)))], [0.875]),
        ([box(UNIT, (0, 0, 0)), inverted(box((0.5, 0.5, 0.5), (0, 0, 0))), box((0.2, 0.2, 0.2), (0, 0, 0))],
         [0.875, 0.008]),
        ([box((3, 3, 3), (0, 0, 0)), inverted(box((0.5, 0.5, 0.5), (1, 1, 1))), inverted(box(UNIT, (3, 0, 0)))],
         [26.875, -1.0]),
    ],
    ids=["one", "apart", "stacked", "along an edge", "at a corner", "a floor of nine", "table", "hollow", "captive",
         "turned inside out"],
)  # fmt: skip
def test_bodies(meshes: list[trimesh.Trimesh], expected: list[float]) -> None:
    assert volumes(*meshes) == pytest.approx(expected)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("family", FAMILIES)
def test_built_in_furniture_falls_into_its_parts(family: str, seed: int) -> None:
    parts = shapes.generated(family, seed)
    found = volumes(*(part.mesh.trimesh for part in parts))
    assert sorted(found) == pytest.approx(sorted(part.mesh.volume for part in parts), rel=1e-3, abs=1e-6)


def test_cracks_of_rounding_do_not_split(tmp_path: Path) -> None:
    """Text STL with six digits: corners of neighbouring triangles may differ in the last digit."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=250.0)
    corners = np.array(mesh.vertices)[mesh.faces].reshape(-1, 3)
    corners += np.random.default_rng(0).uniform(-2e-5, 2e-5, corners.shape)
    found = bodies.bodies(Triangles(corners, np.arange(len(corners)).reshape(-1, 3)))
    assert sum(len(body.faces) for body in found) == len(mesh.faces)
    whole = max(found, key=lambda body: len(body.faces))
    assert len(whole.faces) > 0.9 * len(mesh.faces)


def test_names_and_fragments() -> None:
    legs = NamedTriangles("legs", surface(*(box((0.05, 0.05, 0.5), (x, 0, 0.25)) for x in (0.0, 0.3))), "leg")
    top = surface(box((0.5, 0.5, 0.04), (0, 0, 0.53)), box((0.001, 0.001, 0.001), (1, 0, 0)))
    parts, remarks = bodies.split([legs, NamedTriangles("top", top)])
    assert [(p.name, p.label) for p in parts] == [("legs_1", "leg"), ("legs_2", "leg"), ("top", "")]
    assert remarks == ["legs: split into 2 bodies", "top: 1 fragment smaller than 0.5% of the piece left out"]


def test_thousands_of_bodies_are_refused() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(size=(3 * 2_500, 3))
    shards = Triangles(corners, np.arange(len(corners)).reshape(-1, 3))
    with pytest.raises(FurnitureError, match="falls into 2500 separate bodies; at most 2000"):
        bodies.bodies(shards)
    assert bodies.count_closed(shards) == 1


def as_one(furniture_name: str, path: Path, seed: int = 0) -> Path:
    """A built-in piece as a single STL file, in millimetres."""
    meshes = [part.mesh.trimesh for part in generate(furniture_name, seed)]
    whole = trimesh.util.concatenate(meshes)
    whole.apply_scale(1000.0)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(whole.export(file_type="stl"))
    return path


@pytest.mark.slow
def test_a_stool_in_one_file_is_recognized_split_and_assembled(run: Run, tmp_path: Path) -> None:
    path = as_one("stool", tmp_path / "my_stool.stl")
    with pytest.raises(FurnitureError, match="one mesh of 9 separate bodies; --split makes a part of each"):
        folder.read(path, split=False)

    status, out, err = run("import", path, "--out", tmp_path / "a", "--json")
    assert status == 0, err
    (item,) = json.loads(out)["items"]
    assert (item["name"], item["parts"], item["unit"]) == ("my_stool", 9, "mm")
    assert item["remarks"] == ["my_stool: split into 9 bodies"]
    assert "  my_stool: split into 9 bodies" in err.splitlines()
    made, original = storage.load(tmp_path / "a"), catalogue.make("stool", with_grasps=False)
    assert [p.name for p in made.parts] == [f"my_stool_{k}" for k in range(1, 10)]
    volume = [sorted(p.mesh.volume for p in f.parts) for f in (made, original)]
    assert volume[0] == pytest.approx(volume[1], rel=0.01)
    assert len(made.connections) == len(original.connections)

    status, out, _ = run("assemble", tmp_path / "a", "--no-film", "--out", tmp_path / "b", "--json")
    report = json.loads(out)
    assert (status, report["success"], report["merges"]) == (0, True, 8)


def test_a_folder_with_all_legs_in_one_file(run: Run, tmp_path: Path) -> None:
    """The legs touch the top exactly, as CAD programs export them."""
    source = tmp_path / "table"
    source.mkdir()
    box((0.6, 0.6, 0.03), (0, 0, 0.515)).export(source / "top.stl")
    spots = [(x, y) for x in (-0.275, 0.275) for y in (-0.275, 0.275)]
    trimesh.util.concatenate([box((0.05, 0.05, 0.5), (x, y, 0.25)) for x, y in spots]).export(source / "legs.obj")
    raw = folder.read(source)
    assert raw.remarks == ("legs: one part of 4 separate bodies; --split would make each a part",)
    status, _, err = run("import", "folder", "--no-report", source, "--split", "--out", tmp_path / "a")
    assert status == 0, err
    assert "  legs: split into 4 bodies" in err.splitlines()
    assert [p.name for p in storage.load(tmp_path / "a").parts] == ["legs_1", "legs_2", "legs_3", "legs_4", "top"]


def test_table_whose_parts_touch(run: Run, tmp_path: Path) -> None:
    """Legs flush with the corners of the top, in one file: they share corners and lie in each other's faces."""
    top = box((0.6, 0.6, 0.03), (0, 0, 0.515))
    legs = [box((0.05, 0.05, 0.5), (x, y, 0.25)) for x in (-0.275, 0.275) for y in (-0.275, 0.275)]
    trimesh.util.concatenate([top, *legs]).export(tmp_path / "table.stl")
    status, _, err = run("import", "folder", "--no-report", tmp_path / "table.stl", "--split", "--out", tmp_path / "a")
    assert status == 0, err
    assert len(storage.load(tmp_path / "a").parts) == 5
    assert run("assemble", tmp_path / "a", "--no-film", "--out", tmp_path / "b")[0] == 0


@pytest.mark.slow
def test_more_parts_than_in_the_paper(run: Run, tmp_path: Path) -> None:
    source = tmp_path / "wall"
    source.mkdir()
    bricks = [box((0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(26)]
    for k, brick in enumerate(bricks):
        brick.export(source / f"{k:02}.stl")
    for path, more in ((source, []), (tmp_path / "wall.stl", ["--split"])):
        if more:
            trimesh.util.concatenate(bricks).export(path)
        status, out, err = run("import", "folder", "--no-report", path, *more, "--out", tmp_path / "a")
        assert (status, out.strip()) == (0, "1 imported, 0 refused"), err
        (imported,) = (tmp_path / "a").glob("**/furniture.json")
        wall = storage.load(imported.parent)
        assert len(wall.parts) == 26
        # Each brick touches the next one.
        assert sorted(map(len, wall.neighbours)) == [1, 1] + [2] * 24
        assert solve(wall, 0).plan.success
        shutil.rmtree(tmp_path / "a")


def test_split_is_for_folders(run: Run, tmp_path: Path) -> None:
    status, _, err = run("import", "partnet", tmp_path, "--split")
    assert (status, "--split is for the format 'folder'" in err) == (2, True)


def test_a_single_body_is_refused(run: Run, tmp_path: Path) -> None:
    box(UNIT, (0, 0, 0)).export(tmp_path / "a.stl")
    for more in ([], ["--split"]):
        status, _, err = run("import", "folder", "--no-report", tmp_path / "a.stl", *more, "--out", tmp_path / "out")
        assert (status, "1 part; furniture has 2 or more" in err) == (2, True)
        assert "--split makes" not in err


@pytest.mark.parametrize("name", ["chair.iges", "chair.F3D", "chair.blend", "chair.fbx"])
@pytest.mark.parametrize("command", ["import", "import a folder", "assemble", "view", "export"])
def test_cad_files_are_refused_with_a_remedy(run: Run, tmp_path: Path, name: str, command: str) -> None:
    (tmp_path / "cad").mkdir()
    path = tmp_path / "cad" / name
    path.write_text("x")
    arguments = {
        "import": ["import", "folder", path],
        "import a folder": ["import", "folder", path.parent],
        "assemble": ["assemble", path],
        "view": ["view", path, "--no-browser"],
        "export": ["export", "mjcf", path],
    }[command]
    status, _, err = run(*arguments)
    assert status == 2
    (line,) = err.splitlines()
    assert f"'{path}' is a" in line
    assert "save the whole piece as STEP, 3MF or GLB" in line
    assert "roboassembly import FILE" in line


def test_mesh_files_are_refused_with_a_hint_to_import_them(run: Run, tmp_path: Path) -> None:
    source = shapes.write_stl(catalogue.make("stool", with_grasps=False), tmp_path / "my_files")
    for path in (source, source / "seat.stl"):
        status, _, err = run("assemble", path, "--out", tmp_path / "a")
        assert status == 2
        (line,) = err.splitlines()
        assert f"roboassembly import {path} --out" in line
