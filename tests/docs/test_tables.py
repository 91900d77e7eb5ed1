"""The tables of results.md come out of what the commands print."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from roboassembly.cli import main
from scripts import script

tables = script("tools/tables.py")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    with pytest.raises(SystemExit):
        main([*map(str, arguments), "--jobs", "1", "--json"])
    return json.loads(capsys.readouterr().out)


def test_three_pieces(tmp_path: Path, capsys) -> None:
    for name, foot in (("low", 0.2), ("high", 0.5), ("odd|one", 0.3)):
        (tmp_path / "in" / name).mkdir(parents=True)
        for part, extents, centre in (("top", (0.4, 0.4, 0.02), foot + 0.01), ("foot", (0.05, 0.05, foot), foot / 2)):
            mesh = trimesh.creation.box(extents)
            mesh.apply_translation((0, 0, centre))
            mesh.export(tmp_path / "in" / name / f"{part}.stl")
    (tmp_path / "in" / "odd|one" / "top.stl").write_bytes(b"broken")
    imports = run(capsys, "import", "folder", "--no-report", tmp_path / "in", "--out", tmp_path / "out", "--no-cache")
    search = run(capsys, "evaluate", "--policy", "search", "--set", f"folder:{tmp_path / 'out'}")
    totals, empty, *lines = tables.table(imports, search)
    assert totals.startswith("2 of 3 imported, 2 of them assembled, planning median 0.")
    assert empty == ""
    head, rule, high, low, odd = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    assert (head, rule) == (list(tables.HEAD), ["---"] * len(head))
    assert len(high) == len(low) == len(odd) == len(head)
    assert (odd[0], odd[1]) == ("odd/one", "")
    assert odd[7].startswith("refused: ")
    for row, name in ((high, "high"), (low, "low")):
        assert (*row[:4], row[7]) == (name, "2", "1", "0.0", "yes")
        assert float(row[6]) > 0.0
        assert int(row[8].replace(",", "")) > 0


def test_tables_without_solved_pieces_or_times() -> None:
    item = {"name": "a", "parts": 2, "connections": 1, "displacement_max_mm": 0.0, "trimmed_max_percent": 0.0,
            "size_change_mm": {"x": 1.0, "y": -3.24}, "seconds": 0.01,
            "unholdable": ["x", "y"], "error": None, "cached": True}  # fmt: skip
    totals, _, _, _, line = tables.table({"items": [item]}, {"per_furniture": []})
    assert totals == "1 of 1 imported, 0 of them assembled"
    assert line == "| a | 2 | 1 | 0.0 | 0.0 | -3.2 | from the cache | not tried |  |  | x, y |"


def test_assemblies_by_robots() -> None:
    blank = {"furniture": "a|b", "parts": 3, "success": False, "verdict": "refused", "reason": "too large",
             "planning_seconds": 0.0, "step_seconds": [], "executed": None, "violations": None}  # fmt: skip
    done = {"success": True, "simulated_seconds": 81.3, "tracking_error_mm": 1.25, "joint_error_mm": 0.54, "reason": ""}
    good = {**blank, "furniture": "c", "success": True, "verdict": "merged", "planning_seconds": 3.04,
            "step_seconds": [0.5, 1.5, 0.7], "executed": done, "violations": 0}  # fmt: skip
    strayed = {**good, "success": False, "violations": 2,
               "executed": {**done, "success": False, "reason": "merge 2: off_the_path in 'mate'"}}  # fmt: skip
    report = {"execution": "dynamic", "merge_seconds_median": 0.7, "per_furniture": [blank, good, strayed]}
    totals, _, _, _, *rows = tables.full_table(report)
    assert totals == (
        "2 of 3 planned, 1 of them carried out, planning median 3.0 s a piece, 0.70 s a merge, "
        "2 violations found by the audit"
    )
    assert rows[0] == "| a/b | 3 | refused: too large |  |  |  |  |  |  |  |"
    assert rows[1] == "| c | 3 | yes | 3.0 | 0.70 | yes | 81 | 1.2 | 0.5 | nothing |"
    assert "off_the_path in 'mate'" in rows[2]
    assert rows[2].endswith("2 violations |")
    kinematic = {**report, "execution": "kinematic", "per_furniture": [{**good, "executed": None, "violations": None}]}
    totals, _, _, _, row = tables.full_table(kinematic)
    assert totals == "1 of 1 planned, planning median 3.0 s a piece, 0.70 s a merge"
    assert row == "| c | 3 | yes | 3.0 | 0.70 |  |  |  |  |  |"
