"""The command line as a person meets it: results, exit statuses, one clear line for bad input."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_line import Run
from model_files import edit_furniture
from roboassembly.datasets import catalogue
from roboassembly.furniture import storage
from roboassembly.task.object_centric.task import ObjectCentricVerdict


@pytest.fixture(scope="module")
def stool(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return storage.save(catalogue.make("three_legged", 3), tmp_path_factory.mktemp("saved") / "stool")


def test_assemble_writes_the_files_of_its_report(run: Run, stool: Path, tmp_path: Path) -> None:
    status, out, err = run("assemble", stool, "--no-film", "--json", "--out", tmp_path / "a", "--seed", "3")
    assert status == 0
    report = json.loads(out)
    assert (report["success"], report["furniture"], report["parts"], report["merges"]) == (True, "three_legged-3", 5, 4)
    assert report["planning_steps"] > 0
    assert report["planning_seconds"] >= 0
    assert set(report["outputs"]) == {"plan", "timings", "furniture", "html"}
    assert all(Path(p).exists() for p in report["outputs"].values())
    assert "Traceback" not in err
    assert "nanobind" not in err

    plan = json.loads((tmp_path / "a" / "plan.json").read_text())
    assert plan["success"]
    assert (report["upright"], report["upright_reason"]) == (True, "")
    assert plan["upright"]["success"]
    assert "upright" in err
    assert len(plan["steps"]) == 4
    assert all(len(s["action"]) == 5 and len(s["path"]) >= 2 and s["planning_steps"] > 0 for s in plan["steps"])
    assert "seconds" not in (tmp_path / "a" / "plan.json").read_text()
    copy = storage.load(tmp_path / "a" / "furniture")
    assert [p.name for p in copy.parts] == plan["furniture"]["parts"]


@pytest.mark.slow
def test_the_same_seed_writes_the_same_plan_in_another_process(stool: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "roboassembly.cli", "assemble", str(stool), "--no-film", "--json", "--out"]
    running = [
        subprocess.Popen(
            [*command, str(tmp_path / hash_seed)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"PYTHONHASHSEED": hash_seed, "PATH": "/usr/bin:/bin"},
        )
        for hash_seed in "12"
    ]
    for process in running:
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert len(out.splitlines()) == 1
    assert (tmp_path / "1" / "plan.json").read_bytes() == (tmp_path / "2" / "plan.json").read_bytes()


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of the relational network that has learnt nothing."""
    from roboassembly.learning import checkpoint
    from roboassembly.learning.relational import network as relational

    config = relational.RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)
    params = relational.init(np.random.default_rng(0), config)
    # It believes in no pair: by chance it would lay a stool out rightly.
    params["fits"]["b"] = params["fits"]["b"] - 30.0
    path = tmp_path_factory.mktemp("policy") / "untrained.npz"
    checkpoint.save(path, checkpoint.Checkpoint(relational.KIND, params, {"network": asdict(config)}, {}))
    return path


def test_policy_without_grasps_is_refused_in_the_full_setting(run: Run, tmp_path: Path, untrained: Path) -> None:
    status, out, err = run("assemble", "stool", "--setting", "full", "--policy", untrained, "--out", tmp_path / "a")
    assert (status, out) == (2, "")
    assert err.strip().splitlines() == [line for line in err.splitlines() if "chooses no grasps" in line]
    assert not (tmp_path / "a").exists()


def test_assemble_with_a_policy_with_and_without_search(run: Run, stool: Path, tmp_path: Path, untrained: Path) -> None:
    arguments = ("assemble", stool, "--no-film", "--json", "--policy", untrained)
    status, out, err = run(*arguments, "--out", tmp_path / "a")
    report = json.loads(out)
    assert (status, report["success"], report["policy"], report["merges"]) == (0, True, str(untrained), 4)
    assert 0 <= report["guided_merges"] <= 4
    assert f"{report['guided_merges']} of them chosen by {untrained}" in err
    status, out, _ = run(*arguments, "--no-search", "--out", tmp_path / "b")
    report = json.loads(out)
    assert (status, report["success"]) == (1, False)
    # The same episode as `evaluate` plays: the failing merge is its last.
    (episode,) = json.loads(
        run("evaluate", "--set", f"folder:{stool}", "--jobs", "1", "--json", "--policy", untrained)[1]
    )["per_furniture"]
    assert episode["verdict"] != ObjectCentricVerdict.MERGED
    expected = f"merge {len(episode['actions'])} ended as {episode['verdict']}"
    assert report["reason"] == f"policy {untrained} without search: {expected}"
    status, out, _ = run("assemble", stool, "--no-film", "--json", "--policy", "none", "--out", tmp_path / "c")
    report = json.loads(out)
    assert (status, report["policy"], report["guided_merges"]) == (0, "none", 0)


def test_evaluate_reports_and_exports(run: Run, stool: Path, tmp_path: Path, untrained: Path) -> None:
    pytest.importorskip("minari")
    arguments = ("evaluate", "--set", f"folder:{stool}", "--jobs", "1", "--json")
    status, out, _ = run(*arguments, "--episodes", "2", "--seed", "3", "--export", tmp_path / "stool-v0")
    report = json.loads(out)
    assert (status, report["policy"], report["n"], report["success_rate"]) == (0, "search", 2, 1.0)
    assert (report["seed"], report["unseen"]) == (3, None)
    assert report["exported"] == {"path": str(tmp_path / "stool-v0"), "episodes": 2, "steps": 8, "refused": 0}
    assert (tmp_path / "stool-v0" / "data" / "metadata.json").is_file()
    status, out, _ = run(*arguments, "--policy", untrained)
    report = json.loads(out)
    assert (status, report["success_rate"], report["search"]) == (0, 0.0, False)
    assert report["per_furniture"][0]["verdict"] != "merged"
    status, out, _ = run(*arguments, "--policy", untrained, "--search")
    assert json.loads(out)["success_rate"] == 1.0
    status, out, err = run(*arguments, "--policy", "relatonal")
    assert status == 2
    assert "did you mean relational?" in err


def test_evaluation_resumes_from_its_file(run: Run, stool: Path, tmp_path: Path) -> None:
    kept = tmp_path / "new" / "episodes.jsonl"
    arguments = ("evaluate", "--policy", "random", "--set", f"folder:{stool}", "--jobs", "1", "--json", "--out", kept)
    first = json.loads(run(*arguments, "--episodes", "3")[1])
    head, *lines = kept.read_text().splitlines()
    assert len(lines) == first["n"] == 3

    # Stopped in the middle of the second line. That the first is not played again shows by what it says.
    marked = json.dumps(json.loads(lines[0]) | {"planning_steps": 123_456})
    kept.write_text(f"{head}\n{marked}\n{lines[1][:40]}")
    second = json.loads(run(*arguments, "--episodes", "3")[1])
    assert second["per_furniture"][0]["planning_steps"] == 123_456
    for one, other in zip(first["per_furniture"][1:], second["per_furniture"][1:], strict=True):
        assert {k: v for k, v in one.items() if "seconds" not in k} == {
            k: v for k, v in other.items() if "seconds" not in k
        }
    assert len(kept.read_text().splitlines()) == 4

    # What is something else's stays as it is.
    before = kept.read_bytes()
    status, _, err = run(*arguments, "--episodes", "3", "--seed", "1")
    assert (status, kept.read_bytes()) == (2, before)
    assert "choose another file" in err
    notes = tmp_path / "notes.txt"
    notes.write_text("my notes\n")
    assert run(*arguments, "--out", notes)[0] == 2
    assert notes.read_text() == "my notes\n"
    assert "cannot write" in run(*arguments, "--out", tmp_path)[2]


def test_episodes_of_other_furniture_are_not_taken_for_those_of_this(run: Run, stool: Path, tmp_path: Path) -> None:
    kept, folder = tmp_path / "episodes.jsonl", shutil.copytree(stool, tmp_path / "stool")
    arguments = ("evaluate", "--policy", "random", "--set", f"folder:{folder}", "--jobs", "1", "--out", kept)
    assert run(*arguments)[0] == run(*arguments)[0] == 0
    before = kept.read_bytes()

    # Of the same name and the same meshes, but not everything that could be swapped can be now.
    described = folder / "furniture.json"
    told = json.loads(described.read_text())
    told["classes"][0]["symmetries"] = told["classes"][0]["symmetries"][:1]
    described.write_text(json.dumps(told))
    status, _, err = run(*arguments)
    assert status == 2
    assert str(kept) in err
    assert kept.read_bytes() == before


def test_another_seed_gives_another_plan(run: Run, stool: Path, tmp_path: Path) -> None:
    for seed in "12":
        assert run("assemble", stool, "--no-film", "--out", tmp_path / seed, "--seed", seed)[0] == 0
    assert (tmp_path / "1" / "plan.json").read_bytes() != (tmp_path / "2" / "plan.json").read_bytes()


def test_furniture_that_cannot_be_assembled_exits_with_1(run: Run, tmp_path: Path, captive: Path) -> None:
    status, out, err = run("assemble", captive, "--no-film", "--json", "--out", tmp_path / "a")
    report = json.loads(out)
    assert (status, report["success"]) == (1, False)
    assert "merges tried" in report["reason"]
    assert report["reason"] in err
    assert (report["upright"], report["upright_reason"]) == (False, "not assembled")
    plan = json.loads((tmp_path / "a" / "plan.json").read_text())
    assert not plan["success"]
    assert "upright" not in plan


@pytest.fixture
def captive(tmp_path: Path) -> Path:
    """A ball in a box without a lid to open: two parts, one of them shut in."""
    from roboassembly.furniture.annotate import annotate
    from roboassembly.furniture.model import Provenance, RawPart
    from roboassembly.geometry.meshes import Mesh

    outer, inner = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.08, 0.08, 0.08))
    inner.invert()
    shell = trimesh.util.concatenate([outer, inner])
    core = trimesh.creation.box((0.079, 0.079, 0.079))
    raw = [RawPart("shell", Mesh.from_trimesh(shell)), RawPart("core", Mesh.from_trimesh(core))]
    return storage.save(annotate("captive", raw, Provenance("test")), tmp_path / "captive")


def _broken(stool: Path, tmp_path: Path, change: Callable[[Path], None]) -> Path:
    folder = tmp_path / "broken"
    shutil.copytree(stool, folder)
    change(folder)
    return folder


def _mesh(folder: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    trimesh.Trimesh(vertices, faces, process=False).export(folder / "meshes" / "00.ply")


def _keep_one_part(document: dict) -> None:
    document["parts"] = document["parts"][:1]


def _many_parts(document: dict) -> None:
    document["parts"] = [{**document["parts"][0], "name": f"p{i}"} for i in range(1001)]


def _part_away(document: dict) -> None:
    """A leg a metre off, with its connections taken out: the rest does not touch it."""
    document["parts"][0]["assembled_pose"][0] += 1.0
    document["connections"] = [c for c in document["connections"] if 0 not in (c[0], c[2])]


BOX = trimesh.creation.box((0.1, 0.1, 0.1))
BROKEN = {
    "broken JSON": (lambda f: (f / "furniture.json").write_text('{"format": '), "furniture.json"),
    "not furniture": (lambda f: (f / "furniture.json").write_text("[1, 2]"), "furniture.json"),
    "NaN": (lambda f: _mesh(f, np.where(BOX.vertices > 0, np.nan, BOX.vertices), BOX.faces), "not finite"),
    "zero area": (lambda f: _mesh(f, np.zeros((8, 3)), BOX.faces), "zero area"),
    "no faces": (lambda f: _mesh(f, BOX.vertices, np.empty((0, 3), int)), "no faces"),
    "no mesh": (lambda f: (f / "meshes" / "00.ply").unlink(), "missing"),
    "garbage mesh": (lambda f: (f / "meshes" / "00.ply").write_bytes(b"ply\nformat wrong\x00\xff"), "00.ply"),
    "one part": (lambda f: edit_furniture(f, _keep_one_part), "1 part;"),
    "1001 parts": (lambda f: edit_furniture(f, _many_parts), "1001 parts"),
    "apart": (lambda f: edit_furniture(f, _part_away), "do not touch"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_bad_furniture_prints_one_line_and_exits_with_2(run: Run, stool: Path, tmp_path: Path, case: str) -> None:
    change, words = BROKEN[case]
    folder = _broken(stool, tmp_path, change)
    status, out, err = run("assemble", folder, "--json", "--out", tmp_path / "out")
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    assert err.startswith("error: ")
    assert words in err
    assert json.loads(out)["success"] is False
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["assemble", "laddr"], "did you mean ladder?"),
        (["assemble", "xyzzy"], "known: "),
        (["assemble", "ladder:many"], "not a whole number"),
        (["assemble", "no/such/folder"], "no furniture folder"),
        (["assemble", "stool", "--seed", "-1"], "--seed -1 is too small; it must be 0 or more"),
        (["generate", "winsor"], "did you mean windsor?"),
        (["import", "ikea-manual", "no/such/folder"], "not a folder"),
        (["import", "ikea-manual", ".", "--scale", "0"], "--scale 0.0 is not plausible"),
        (["import", "ikea-manual", ".", "--jobs", "0"], "--jobs 0"),
        (["bench", "planning", "--chairs", "0"], "--chairs 0"),
        (["bench", "robots", "--furniture", "stol"], "did you mean stool"),
        (["assemble", "stool", "--execution", "dynamic"], "takes --setting full"),
        (["export", "mjcf", "rokcer"], "did you mean rocker"),
        (["dataset", "show", "chairs-413"], "did you mean chairs-412"),
        (["evaluate", "--set", "folder:nowhere"], "holds no furniture folders"),
        (["evaluate", "--set", "folder:nowhere", "--limit", "0"], "--limit 0 is too small; it must be 1 or more"),
        (["evaluate", "--set", "folder:nowhere", "--episodes", "0"], "--episodes 0 is too small"),
        (["evaluate", "--set", "folder:nowhere", "--limit", "1", "--sample", "1"], "give only one of them"),
        (["evaluate", "--setting", "full", "--export", "x-v0"], "--export does not support --setting full"),
        (["evaluate", "--policy", "joint-rrt", "--export", "x-v0"], "'joint-rrt', which has no actions"),
        (["benchmark", "--sample", "0"], "--sample 0 is too small"),
        (["benchmark", "--experts", "-1"], "--experts -1 is too small"),
        (["benchmark", "--experts", "3", "--no-train"], "--experts and --no-train contradict each other"),
        (["benchmark", "--retrain", "--no-train"], "--retrain and --no-train contradict each other"),
        (["assemble", "stool", "--policy", "none", "--no-search"], "--no-search needs a policy"),
        (["assemble", "stool", "--policy", "relatonal"], "did you mean relational?"),
        (["assemble", "stool", "--policy", "gone.npz"], "no checkpoint at 'gone.npz'"),
        (["assemble", "stool", "--policy", "random"], "'random' does not value actions"),
    ],
)
def test_bad_arguments_print_one_line_and_exit_with_2(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_output_that_cannot_be_written(run: Run, stool: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    status, _, err = run("assemble", stool, "--no-film", "--out", tmp_path / "file")
    assert status == 2
    assert "cannot write" in err
    assert (tmp_path / "file").read_text() == "mine"


def test_generate_then_assemble(run: Run, tmp_path: Path) -> None:
    status, out, _ = run("generate", "three_legged", "--seed", "3", "--out", tmp_path / "s", "--json")
    assert status == 0
    assert json.loads(out)["outputs"] == {"furniture": str(tmp_path / "s")}
    assert run("assemble", tmp_path / "s", "--no-film", "--out", tmp_path / "a")[0] == 0


def test_generate_never_overwrites_what_is_not_furniture(run: Run, tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "love.txt").write_text("dear")
    status, _, err = run("generate", "stool", "--out", tmp_path / "letters")
    assert status == 2
    assert "not a furniture folder" in err
    assert (tmp_path / "letters" / "love.txt").read_text() == "dear"


def _write_obj(path: Path, mesh: trimesh.Trimesh) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(mesh.export(file_type="obj"))


def _table(folder: Path) -> None:
    """Five boxes, y up, touching exactly: a table as IKEA-Manuals gives it."""
    top = trimesh.creation.box((1.0, 0.05, 1.0))
    top.apply_translation((0, 0.525, 0))
    _write_obj(folder / "00.obj", top)
    for i, (x, z) in enumerate([(-0.4, -0.4), (0.4, -0.4), (-0.4, 0.4), (0.4, 0.4)]):
        leg = trimesh.creation.box((0.06, 0.5, 0.06))
        leg.apply_translation((x, 0.25, z))
        _write_obj(folder / f"0{i + 1}.obj", leg)


def test_import_then_assemble(run: Run, tmp_path: Path) -> None:
    _table(tmp_path / "in" / "Table" / "plain")
    _write_obj(tmp_path / "in" / "Table" / "alone" / "00.obj", BOX)
    source, out_folder = tmp_path / "in", tmp_path / "furniture"
    status, out, _ = run("import", "ikea-manual", "--no-report", source, "--out", out_folder, "--json", "--jobs", "1")
    report = json.loads(out)
    assert status == 0
    assert (report["imported"], report["refused"]) == (1, 1)
    good, bad = sorted(report["items"], key=lambda i: i["error"] is not None)
    assert (good["name"], good["parts"], good["connections"]) == ("plain", 5, 4)
    assert "1 part" in bad["error"]
    assert sorted(p.name for p in out_folder.iterdir()) == ["plain"]
    assert run("assemble", out_folder / "plain", "--no-film", "--out", tmp_path / "a")[0] == 0


def test_import_of_one_bad_piece_exits_with_2(run: Run, tmp_path: Path) -> None:
    (tmp_path / "piece").mkdir()
    for i in range(2):
        (tmp_path / "piece" / f"0{i}.obj").write_text("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n")
    status, out, err = run("import", "ikea-manual", "--no-report", tmp_path / "piece", "--out", tmp_path / "out")
    assert status == 2
    assert "not finite" in err
    assert "Traceback" not in err
    assert "0 imported, 1 refused" in out
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("expert", "--limit", "0"), "--limit 0 is too small"),
        (("expert", "--episodes", "0"), "--episodes 0 is too small"),
        (("autoencoder", "--set", "chairs-413"), "unknown data set 'chairs-413'; did you mean chairs-412"),
        (("multitask", "--rounds", "-1"), "--rounds -1 is too small"),
        (("multitask", "--preset", "paper"), "--samples FOLDER"),
        (("multitask", "--set", "folder:here"), "the oracle labels generated furniture"),
    ],
)
def test_training_refuses_in_one_line(run: Run, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    status, out, err = run("train", *arguments, "--out", tmp_path / "run", "--json")
    assert status == 2
    assert said in err
    assert said in json.loads(out)["error"]
    assert "Traceback" not in err
