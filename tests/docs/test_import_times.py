"""Measurements of import times: each piece once, and a table that names what changed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model_files import IKEA_PLATE, IKEA_POST, write_ikea_env
from scripts import script

times = script("tools/import_times.py")


@pytest.mark.slow
def test_measurement_passes_over_what_it_has_and_equal_imports_have_equal_digests(tmp_path: Path) -> None:
    source, out = write_ikea_env(tmp_path, IKEA_POST, IKEA_PLATE).parent, tmp_path / "times.json"
    times.measure_all([f"ikea-env:{source}"], out)
    first = json.loads(out.read_text())
    (name,) = first
    assert first[name]["parts"] == 2
    assert first[name]["connections"] == 1
    assert first[name]["cpu_s"] > 0.0
    times.measure_all([f"ikea-env:{source}"], out)
    assert json.loads(out.read_text()) == first
    out.unlink()
    times.measure_all([f"ikea-env:{source}"], out)
    assert json.loads(out.read_text())[name]["digest"] == first[name]["digest"]


def test_table_has_ratios_and_names_changed_results() -> None:
    def item(seconds: float, digest: str) -> dict:
        return {"parts": 4, "connections": 3, "cpu_s": seconds, "read": True, "error": None, "digest": digest}

    unread = {**item(0.1, "c"), "read": False}
    old = {"a": item(6.0, "x"), "b": item(3.0, "y"), "c": unread}
    new = {"a": item(2.0, "x"), "b": item(2.0, "z"), "c": unread}
    lines = times.table(old, new)
    assert lines[0].startswith(
        "2 pieces, 1 of them the same byte for byte; CPU time median 4.5 s before and 2.0 s after"
    )
    assert lines[4:] == [
        "| a | 4 | 3 | 6.00 | 2.00 | 3.0 | the same |",
        "| b | 4 | 3 | 3.00 | 2.00 | 1.5 | DIFFERENT |",
    ]


def test_command_line_wants_two_files_or_an_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["import_times.py", "one.json"])
    with pytest.raises(SystemExit):
        times.main()
