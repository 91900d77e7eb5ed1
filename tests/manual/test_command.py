"""`roboassembly manual` and `roboassembly assemble --manual`, as a user runs them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from command_line import Run


@pytest.fixture(scope="module")
def assembled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from roboassembly.cli import main

    out = tmp_path_factory.mktemp("results") / "stool"
    with pytest.raises(SystemExit) as end:
        main(["assemble", "three_legged:3", "--manual", "--no-film", "--policy", "none", "--out", str(out)])
    assert end.value.code == 0
    return out


def test_assemble_writes_a_manual_beside_the_plan(assembled: Path) -> None:
    assert (assembled / "manual.pdf").read_bytes().startswith(b"%PDF")
    assert (assembled / "manual.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_a_manual_of_a_plan_is_the_same(assembled: Path, tmp_path: Path, run: Run) -> None:
    status, out, _ = run("manual", str(assembled / "plan.json"), "--out", str(tmp_path / "new"), "--json")
    assert status == 0
    report = json.loads(out)
    assert report["success"] is True
    assert report["parts"] >= 4
    assert report["steps"] >= 1
    assert report["pages"] >= 4
    for kind, name in (("manual_pdf", "manual.pdf"), ("manual_html", "manual.html")):
        assert Path(report["outputs"][kind]).read_bytes() == (assembled / name).read_bytes()


def test_a_plan_of_two_robots_has_a_manual_too(assembled: Path, tmp_path: Path, run: Run) -> None:
    plan = json.loads((assembled / "plan.json").read_text())
    plan["setting"] = "full"
    for step in plan["steps"]:
        step["action"] = [*step["action"][:4], 0, 0]
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    shutil.copytree(assembled / "furniture", tmp_path / "furniture")
    status, _, err = run("manual", str(tmp_path / "plan.json"))
    assert (status, "error" in err) == (0, False)
    assert "two robots join the parts" in " ".join((tmp_path / "manual.html").read_text().split())


def test_an_earlier_manual_does_not_stay_beside_a_new_plan(assembled: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "again"
    shutil.copytree(assembled, out)
    status, _, _ = run("assemble", "three_legged:3", "--no-film", "--policy", "none", "--out", str(out))
    assert status == 0
    assert not (out / "manual.pdf").exists()
    assert not (out / "manual.html").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda plan: plan["steps"].pop(), "ends with 2 separate groups"),
        (lambda plan: plan["steps"].clear(), "separate groups"),
        (lambda plan: plan["steps"][0].update(action=[0, 0, 0, 0, 0]), "step 0: action"),
        (lambda plan: plan["furniture"]["parts"].reverse(), "whose parts differ"),
        (lambda plan: plan.update(version=99), "version 99"),
    ],
)
def test_bad_plans_are_refused_in_one_line(assembled: Path, tmp_path: Path, run: Run, change, message: str) -> None:
    plan = json.loads((assembled / "plan.json").read_text())
    change(plan)
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    shutil.copytree(assembled / "furniture", tmp_path / "furniture")
    status, out, err = run("manual", str(tmp_path / "plan.json"))
    assert status == 2
    assert out == ""
    assert message in err.splitlines()[-1]
    assert "Traceback" not in err
    assert not (tmp_path / "manual.pdf").exists()


def test_a_missing_plan_is_named(run: Run) -> None:
    status, _, err = run("manual", "nowhere/plan.json")
    assert status == 2
    assert "nowhere/plan.json" in err
