"""What commands write, and what they leave alone: nothing is overwritten unasked, and nothing is begun in vain."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import trimesh

import shapes
from command_line import Run
from roboassembly.datasets import catalogue
from roboassembly.datasets import sets as datasets
from roboassembly.furniture import storage
from roboassembly.importers import pipeline


def state(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def table(folder: Path, height: float = 0.5) -> Path:
    """A top on a foot."""
    folder.mkdir(parents=True)
    for name, extents, middle in (("top", (0.5, 0.5, 0.04), height + 0.02), ("foot", (0.1, 0.1, height), height / 2)):
        mesh = trimesh.creation.box(extents)
        mesh.apply_translation((0, 0, middle))
        mesh.export(folder / f"{name}.stl")
    return folder


def the_one_line(err: str) -> str:
    (line,) = [line for line in err.splitlines() if line]
    assert line.startswith("error: ")
    return line


# import


def test_import_refuses_a_name_that_exists(run: Run, tmp_path: Path) -> None:
    source, out = table(tmp_path / "table"), tmp_path / "out"
    assert run("import", "folder", "--no-report", source, "--out", out)[0] == 0
    before = state(out)
    other = table(tmp_path / "other", 0.6)
    status, printed, err = run("import", "folder", "--no-report", other, "--out", out)
    assert (status, printed) == (2, "")
    assert the_one_line(err) == f"error: '{out}' exists already; replace it with --force or choose another --out"
    assert state(out) == before
    assert run("import", "folder", "--no-report", other, "--out", out, "--force")[0] == 0
    assert storage.load(out).provenance.identifier == "other"


def test_import_without_out_keeps_pieces_apart(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second import used to replace the first."""
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        table(tmp_path / "mine" / name)
        assert run("import", "folder", "--no-report", Path("mine") / name)[0] == 0
    assert sorted(p.name for p in (tmp_path / "furniture").iterdir()) == ["one", "two"]
    assert the_one_line(run("import", "folder", "mine/one")[2]).startswith("error: 'furniture/one' exists already")
    status, _, err = run("evaluate", "--policy", "search", "--set", "folder:furniture", "--jobs", "1", "--json")
    assert status == 0, err


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_many_pieces_of_which_some_exist(jobs: str, run: Run, tmp_path: Path) -> None:
    """Those that are there are refused, the others imported: as after an import that was stopped."""
    for name in ("one", "two", "three"):
        table(tmp_path / "in" / name)
    out = tmp_path / "out"
    assert run("import", "folder", "--no-report", tmp_path / "in" / "two", "--out", out / "two")[0] == 0
    before = state(out / "two")
    status, printed, _ = run("import", "folder", "--no-report", tmp_path / "in", "--out", out, "--jobs", jobs, "--json")
    report = json.loads(printed)
    assert (status, report["imported"], report["refused"]) == (0, 2, 1)
    errors = {item["name"]: item["error"] for item in report["items"]}
    assert errors == {"one": None, "three": None, "two": f"'{out / 'two'}' exists already; replace it with --force "
                      "or choose another --out"}  # fmt: skip
    assert state(out / "two") == before
    status, printed, _ = run("import", "folder", "--no-report", tmp_path / "in", "--out", out, "--jobs", "1")
    assert (status, printed.strip()) == (2, "0 imported, 3 refused")
    assert (
        run("import", "folder", "--no-report", tmp_path / "in", "--out", out, "--jobs", "1", "--force")[1]
        .strip()
        .startswith("3 imp")
    )


@pytest.mark.parametrize("how", ["refused by repair", "disk full while writing", "swap fails"])
def test_failed_replacement_keeps_the_old_folder(
    how: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = table(tmp_path / "table"), tmp_path / "all" / "out"
    assert run("import", "folder", "--no-report", source, "--out", out)[0] == 0
    (out / "notes.txt").write_text("mine")
    before = state(tmp_path / "all")
    changed = table(tmp_path / "changed" / "table", 0.6)
    if how == "refused by repair":
        far = trimesh.creation.box((0.1, 0.1, 0.1))
        far.apply_translation((0, 0, 3))
        far.export(changed / "far.stl")
    elif how == "disk full while writing":

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(storage, "to_document", full)
    else:
        rename = Path.rename

        def failing(path: Path, target: Path) -> Path:
            if Path(target) == out and path.name.endswith("-old") is False:
                raise OSError(5, "Input/output error")
            return rename(path, target)

        monkeypatch.setattr(Path, "rename", failing)
    status, printed, err = run("import", "folder", changed, "--out", out, "--force")
    assert (status, printed.strip()) == (2, "0 imported, 1 refused"), err
    pages = ["out.refused.html"] if how == "refused by repair" else []
    assert {name: data for name, data in state(tmp_path / "all").items() if name not in pages} == before
    assert sorted(p.name for p in (tmp_path / "all").iterdir()) == ["out", *pages]


def test_replacing_keeps_other_files(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("import", "folder", "--no-report", table(tmp_path / "a" / "table"), "--out", out)[0] == 0
    (out / "notes.txt").write_text("mine")
    (out / "photos").mkdir()
    (out / "photos" / "1.jpg").write_bytes(b"jpg")
    assert run("import", "folder", "--no-report", table(tmp_path / "b" / "table", 0.6), "--out", out, "--force")[0] == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert (out / "photos" / "1.jpg").read_bytes() == b"jpg"
    assert storage.load(out).parts
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_force_replaces_furniture_only(run: Run, tmp_path: Path) -> None:
    (tmp_path / "out" / "table").mkdir(parents=True)
    (tmp_path / "out" / "table" / "love.txt").write_text("dear")
    source = table(tmp_path / "table")
    for more in ((), ("--force",)):
        status, _, err = run("import", "folder", "--no-report", source, "--out", tmp_path / "out", *more)
        assert status == 2
        assert "exists and is not a furniture folder" in err
        assert "--force" not in err
    assert state(tmp_path / "out") == {"table/love.txt": b"dear"}


def test_importing_a_parent_folder_passes_over_earlier_results(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Furniture folders, exports, assemblies, the output folder, and what a killed import left."""
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "parts" / "table")
    assert run("import", "folder", "--no-report", "parts/table", "--out", "made/table")[0] == 0
    assert run("export", "urdf", "made/table", "--out", "exported")[0] == 0
    assert run("export", "mjcf", "made/table", "--out", "exported")[0] == 0
    assert run("assemble", "made/table", "--no-film", "--policy", "none", "--out", "assembled")[0] == 0
    table(tmp_path / ".killed-x1y2" / "meshes")
    table(tmp_path / "new" / "stray")
    finished: list[str] = []
    finish = pipeline.finish

    def counting(name: str, *rest: object, **more: object) -> object:
        finished.append(name)
        return finish(name, *rest, **more)  # pyright: ignore

    monkeypatch.setattr(pipeline, "finish", counting)
    status, printed, err = run(
        "import", "folder", "--no-report", ".", "--out", "new", "--no-cache", "--jobs", "1", "--json"
    )
    report = json.loads(printed)
    assert status == 0
    assert [item["name"] for item in report["items"]] == finished == ["table"]
    assert {Path(p).name for p in report["skipped"]} == {"table", "exported", "furniture", ".killed-x1y2", "new"}
    assert "skipped furniture folders of this program: " in err
    before = state(tmp_path / "new")
    status, _, err = run("import", "folder", "--no-report", ".", "--out", "new", "--jobs", "1")
    assert (status, state(tmp_path / "new")) == (2, before)
    assert "'new/table' exists already" in err
    assert run("import", "ikea-env", ".", "--out", "new2")[0] == 2


def test_a_furniture_folder_is_no_source(run: Run, tmp_path: Path) -> None:
    folder = storage.save(catalogue.make("stool", with_grasps=False), tmp_path / "stool")
    for path in (folder, folder / "meshes"):
        status, _, err = run("import", "folder", "--no-report", path, "--out", tmp_path / "out")
        assert status == 2
        assert f"'{folder}' is a furniture folder already" in the_one_line(err)


# The other commands


def test_generate_refuses_what_exists(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("generate", "stool")[0] == 0
    before = state(tmp_path)
    for more in ((), ("--out", "stool-0")):
        status, printed, err = run("generate", "stool", *more)
        assert (status, printed, state(tmp_path)) == (2, "", before)
        assert "'stool-0' exists already; replace it with --force" in the_one_line(err)
    assert run("generate", "stool", "--seed", "1", "--out", "stool-0", "--force")[0] == 0
    assert storage.load(tmp_path / "stool-0").name == "stool-1"
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "love.txt").write_text("dear")
    assert "exists and is not" in run("generate", "stool", "--out", "letters", "--force")[2]


def test_export_refuses_what_exists(run: Run, tmp_path: Path) -> None:
    """A data set's own file of the same name, for instance."""
    (tmp_path / "stool-0.xml").write_text("<mujoco/>")
    status, printed, err = run("export", "mjcf", "stool", "--out", tmp_path)
    assert (status, printed) == (2, "")
    assert f"'{tmp_path / 'stool-0.xml'}' exists already; replace it with --force" in the_one_line(err)
    assert state(tmp_path) == {"stool-0.xml": b"<mujoco/>"}
    assert run("export", "urdf", "stool", "--out", tmp_path)[0] == 0
    assert run("export", "mjcf", "stool", "--out", tmp_path, "--force")[0] == 0
    assert (tmp_path / "stool-0.xml").read_text() != "<mujoco/>"
    folder = storage.save(catalogue.make("stool", with_grasps=False), tmp_path / "stool")
    before = state(folder)
    assert "is a furniture folder" in the_one_line(run("export", "mjcf", folder, "--out", folder)[2])
    assert state(folder) == before


def test_assemble_replaces_its_own_results_and_nothing_else(run: Run, tmp_path: Path) -> None:
    table(tmp_path / "parts" / "table")
    made = tmp_path / "made"
    assert run("import", "folder", "--no-report", tmp_path / "parts" / "table", "--out", made)[0] == 0
    command = ("assemble", made, "--no-film", "--policy", "none", "--out")
    before = state(made)
    assert "is a furniture folder" in the_one_line(run(*command, made)[2])
    assert state(made) == before

    # A folder in which `furniture` is what `import` wrote.
    (tmp_path / "desk").mkdir()
    made.rename(tmp_path / "desk" / "furniture")
    command = ("assemble", tmp_path / "desk" / "furniture", "--no-film", "--policy", "none", "--out")
    status, printed, err = run(*command, tmp_path / "desk")
    assert (status, printed) == (2, "")
    assert f"'{tmp_path / 'desk' / 'furniture'}' is not a result of an earlier run" in the_one_line(err)
    assert state(tmp_path / "desk" / "furniture") == before

    (tmp_path / "plans").mkdir()
    (tmp_path / "plans" / "plan.json").write_text('{"holiday": "Crete"}')
    assert "is not a plan of this program" in the_one_line(run(*command, tmp_path / "plans")[2])
    assert state(tmp_path / "plans") == {"plan.json": b'{"holiday": "Crete"}'}

    for _ in range(2):
        assert run(*command, tmp_path / "results")[0] == 0


def test_built_set_is_not_rebuilt_with_another_seed(
    run: Run, as_built: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    as_built(easy=[("stool", 1)], hard=[("stool", 2)], test=[("stool", 3)])
    path = datasets.manifest_path("chairs-24")
    before = path.read_bytes()
    monkeypatch.setattr("roboassembly.solvers.dataset_builder.build_dataset", lambda *_: iter([(1, 1)]))
    status, printed, err = run("dataset", "build", "chairs-24", "--seed", "7")
    assert (status, printed) == (2, "")
    assert the_one_line(err) == "error: data set chairs-24 was built with seed 0, not 7; replace it with --force"
    assert path.read_bytes() == before
    assert run("dataset", "build", "chairs-24")[0] == 0
    assert run("dataset", "build", "chairs-24", "--seed", "7", "--force")[0] == 0
    path.write_bytes(msgspec.json.encode({"format": "old"}))
    assert "was built with seed" not in run("dataset", "build", "chairs-24", "--seed", "7")[2]


# Folders that cannot be written

UNWRITABLE = ["a file", "below a file", "/proc", "a dead link", "a name too long"]
COMMANDS: dict[str, tuple[str, ...]] = {
    "assemble": ("assemble", "stool", "--no-film"),
    "assemble full": ("assemble", "stool", "--setting", "full"),
    "import": ("import", "folder", "SOURCE"),
    "generate": ("generate", "stool"),
    "export": ("export", "mjcf", "stool"),
    "evaluate": ("evaluate", "--policy", "search", "--set", "folder:PIECES"),
    "train autoencoder": ("train", "autoencoder", "--set", "folder:PIECES"),
    "train expert": ("train", "expert", "--set", "folder:PIECES"),
    "train multitask": ("train", "multitask"),
    "benchmark": ("benchmark", "--quick"),
}


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A folder of STL files, and one of furniture folders."""
    root = tmp_path_factory.mktemp("given")
    stool = catalogue.make("stool", with_grasps=False)
    shapes.write_stl(stool, root / "source")
    storage.save(stool, root / "pieces" / "stool")
    return {"SOURCE": str(root / "source"), "folder:PIECES": f"folder:{root / 'pieces'}"}


@pytest.mark.parametrize("place", UNWRITABLE)
@pytest.mark.parametrize("command", COMMANDS)
def test_an_out_that_cannot_be_written_is_found_before_the_work(
    command: str, place: str, run: Run, given: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere" / "at" / "all")
    out = {
        "a file": tmp_path / "file" if command != "evaluate" else tmp_path,
        "below a file": tmp_path / "file" / "deeper" / "out",
        "/proc": Path("/proc/no/such"),
        "a dead link": tmp_path / "link" if command != "evaluate" else tmp_path / "link" / "episodes",
        "a name too long": tmp_path / ("x" * 300) / "out",
    }[place]
    worked: list[str] = []
    for what in (
        "roboassembly.solvers.forward.Search.run",
        "roboassembly.importers.pipeline.finish",
        "roboassembly.furniture.annotate.annotate",
        "roboassembly.learning.paper.pipeline.train_autoencoder",
        "roboassembly.learning.relational.pipeline.run_pipeline",
        "roboassembly.evaluation.benchmark.run",
        "roboassembly.evaluation.rollout.rollout",
    ):
        monkeypatch.setattr(what, lambda *_, what=what, **__: worked.append(what))
    begun = time.monotonic()
    status, printed, err = run(*[given.get(word, word) for word in COMMANDS[command]], "--out", out)
    assert (status, printed) == (2, ""), err
    assert "cannot write to" in the_one_line(err)
    assert str(out.parent if command == "evaluate" and place != "a file" else out)[:100] in err
    assert worked == []
    assert time.monotonic() - begun < 10.0
    assert state(tmp_path) == {"file": b"mine"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root ignores modes")
def test_a_folder_without_permission(run: Run, tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o555)
    status, _, err = run("assemble", "stool", "--no-film", "--out", tmp_path / "locked" / "a")
    assert (status, "Permission denied" in err) == (2, True)


def test_a_table_that_cannot_be_written_is_found_before_the_benchmark(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roboassembly.evaluation import benchmark, report

    document = tmp_path / "results.md"
    text = f"{report.begin('object-centric', 'chairs-24')}\n{report.END}\n"
    document.write_text(text)
    monkeypatch.setattr(benchmark, "run", lambda *_: pytest.fail("begun"))

    def refuse(path: Path, mode: str = "r", *rest: object) -> object:
        raise OSError(30, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(
        Path, "read_text", lambda path: f"{report.begin('object-centric', 'chairs-24')}\n{report.END}\n"
    )
    status, _, err = run("benchmark", "--quick", "--out", tmp_path / "run", "--write", document)
    assert (status, f"cannot write {document}: Read-only file system" in err) == (2, True)
