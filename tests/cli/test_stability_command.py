"""`roboassembly stability` and `roboassembly assemble --stable`, as a user runs them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from command_line import Run


@pytest.fixture(scope="module")
def assembled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from roboassembly.cli import main

    out = tmp_path_factory.mktemp("results") / "chair"
    with pytest.raises(SystemExit) as end:
        main(["assemble", "cantilever", "--no-film", "--policy", "none", "--out", str(out)])
    assert end.value.code == 0
    return out


def test_stability_names_what_to_hold_and_marks_the_page(assembled: Path, run: Run) -> None:
    before = (assembled / "assembly.html").read_text()
    assert "; hold " not in before
    status, out, err = run("stability", assembled / "plan.json", "--page", "--json")
    assert (status, "stand on their own in 3 of 4 steps" in err, "step 1: hold " in err) == (0, True, True)
    report = json.loads(out)
    assert report["steps_held"] == [1]
    held = [g for g in report["groups"] if not g["stable"]]
    assert [g["role"] for g in held] == ["joined"]
    assert held[0]["tilt_deg"] > 5.0
    after = (assembled / "assembly.html").read_text()
    assert f"; hold {held[0]['parts'][0]} (+1)" in after
    assert after.count("; hold ") == 1


def test_a_stable_order_is_found_and_told(tmp_path: Path, run: Run) -> None:
    status, out, err = run("assemble", "cantilever", "--stable", "--no-film", "--out", tmp_path / "out", "--json")
    assert status == 0
    assert "every group stands on its own in all 4 steps" in err
    report = json.loads(out)
    assert (report["policy"], report["stability"]["stable"]) == ("none", True)
    assert '"stability"' in (tmp_path / "out" / "plan.json").read_text()


def test_stable_is_not_for_robots_nor_without_search(run: Run) -> None:
    assert run("assemble", "stool", "--stable", "--setting", "full")[0] == 2
    status, _, err = run("assemble", "stool", "--stable", "--no-search")
    assert (status, "--stable searches for an order" in err) == (2, True)
    assert run("stability", "no_such_plan.json")[0] == 2
