"""The tables of results.md come out of what the commands print."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest
import trimesh

from roboassembly.cli import main

SCRIPT = Path(__file__).parents[1] / "docs" / "tables.py"
spec = importlib.util.spec_from_file_location("tables", SCRIPT)
assert spec is not None
assert spec.loader is not None
tables = importlib.util.module_from_spec(spec)
spec.loader.exec_module(tables)


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
    imports = run(capsys, "import", "folder", tmp_path / "in", "--out", tmp_path / "out", "--no-cache")
    search = run(capsys, "evaluate", "--policy", "search", "--set", f"folder:{tmp_path / 'out'}")
    totals, empty, *lines = tables.table(imports, search)
    assert totals.startswith("2 of 3 imported, 2 of them assembled, planning median 0.")
    assert empty == ""
    head, rule, high, low, odd = ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)
    assert (head, rule) == (list(tables.HEAD), ["---"] * len(head))
    assert len(high) == len(low) == len(odd) == len(head)
    assert (odd[0], odd[1]) == ("odd/one", "")
    assert odd[6].startswith("refused: ")
    for row, name in ((high, "high"), (low, "low")):
        assert (*row[:4], row[6]) == (name, "2", "1", "0.0", "yes")
        assert float(row[5]) > 0.0
        assert int(row[7].replace(",", "")) > 0


def test_nothing_solved_and_nothing_timed() -> None:
    item = {"name": "a", "parts": 2, "connections": 1, "displacement_max_mm": 0.0, "trimmed_max_percent": 0.0,
            "seconds": 0.01, "unholdable": ["x", "y"], "error": None, "cached": True}  # fmt: skip
    totals, _, _, _, line = tables.table({"items": [item]}, {"per_furniture": []})
    assert totals == "1 of 1 imported, 0 of them assembled"
    assert line == "| a | 2 | 1 | 0.0 | 0.0 | from the cache | not tried |  |  | x, y |"
