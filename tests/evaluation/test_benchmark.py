"""Tests of `roboassembly benchmark --quick`: all stages in a tiny size, resumed, and written into a document."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from roboassembly.cli import main
from roboassembly.errors import InputError
from roboassembly.evaluation import benchmark, report
from roboassembly.learning.progress import Progress


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """Run the command and return its JSON."""
    with pytest.raises(SystemExit) as end:
        main(["benchmark", "--quick", "--json", *arguments])
    printed = capsys.readouterr()
    assert end.value.code == 0, printed.err[-2000:]
    return json.loads(printed.out)


@pytest.mark.slow
def test_the_whole_table(as_built, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    as_built(
        easy=[("cantilever", 1), ("cantilever", 5)], hard=[("cantilever", 2)],
        test=[("cantilever", 3), ("three_legged", 4), ("splat", 1)],
    )  # fmt: skip
    out, document = tmp_path / "run", tmp_path / "results.md"
    document.write_text(f"# Figures\n\n{report.begin('object-centric', 'chairs-24')}\nold\n{report.END}\n\nThe rest.\n")
    # Together with pytest's workers more processes would only start for longer than they work.
    first = told(capsys, "--out", str(out), "--jobs", "1", "--write", str(document))

    rows = {(r["name"], r["on"]): r for r in first["rows"]}
    names = [r["name"] for r in first["rows"]]
    for name in ("experts", "RRT-Connect in 6M dimensions", "random", "preset paper",
                 "preset paper, aggregated", "relational", "relational with search", "search alone"):  # fmt: skip
        assert name in names
    # The paper's own figures: Table of success on easy and hard training chairs, on unseen ones, and of its baseline.
    assert rows["experts", "easy training chairs"]["paper"] == 79.4
    assert rows["preset paper", "chairs-24:test"]["paper"] == 74.5
    assert rows["RRT-Connect in 6M dimensions", "chairs-24:test"]["paper"] == 18.8
    for row in first["rows"]:
        figures = row["figures"]
        low, high = figures["ci95"]
        assert 0.0 <= low <= figures["success_rate"] <= high <= 1.0
    tests = rows["relational", "chairs-24:test"]["figures"]["per_furniture"]
    assert len(tests) == 3
    assert {e["furniture"] for e in tests} == {
        e["furniture"] for e in rows["search alone", "chairs-24:test"]["figures"]["per_furniture"]
    }
    assert rows["search alone", "chairs-24:test"]["figures"]["success_rate"] == 1.0
    assert rows["relational with search", "chairs-24:test"]["figures"]["success_rate"] == 1.0
    assert rows["random", "chairs-24:test"]["figures"]["success_rate"] == 0.0

    text = document.read_text()
    assert text.startswith("# Figures")
    assert text.endswith("The rest.\n")
    assert "old" not in text
    assert "| relational with search | chairs-24:test |" in text
    assert json.loads((out / "benchmark.json").read_text())["rows"] == first["rows"]

    # Killed in the middle of the last episodes, and once more after the end: the same table.
    episodes = out / "episodes" / "relational-chairs-24-test.jsonl"
    kept = episodes.read_text().splitlines(keepends=True)
    episodes.write_text("".join(kept[:3]) + kept[3][:40])
    (out / "episodes" / "random-chairs-24-test.jsonl").unlink()
    again = told(capsys, "--out", str(out), "--jobs", "2")
    assert without_times(again) == without_times(first)

    # Episodes of other weights do not count.
    shutil.copy(out / "relational" / "policy-0.npz", out / "relational" / "policy.npz")
    plan = benchmark.BenchmarkConfig.quick()
    measurement = next(m for m in benchmark.measurements(plan, out) if m.name == "relational")
    assert measurement.known_episodes(out) == []

    with pytest.raises(InputError, match="another seed"):
        next(benchmark.run(benchmark.BenchmarkConfig.quick(seed=1), out, 1))


@pytest.mark.slow
def test_the_whole_table_with_robots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    first = told(capsys, "--setting", "full", "--out", str(out))
    rows = {(r["name"], r["on"]): r for r in first["rows"]}
    assert rows["experts", "easy training chairs"]["paper"] == 59.3
    assert rows["preset paper", "chairs-24:test"]["paper"] == rows["relational", "chairs-24:test"]["paper"] == 50.0
    assert rows["search alone", "chairs-24:test"]["figures"]["success_rate"] == 1.0
    planned = rows["relational with search", "chairs-24:test"]["figures"]
    assert planned["success_rate"] == 1.0
    carried = rows["relational with search: its plans carried out in physics", "chairs-24:test"]["figures"]
    assert carried["n"] == planned["n"]
    for episode in rows["random", "chairs-24:test"]["figures"]["per_furniture"]:
        assert not episode["success"]
    again = told(capsys, "--setting", "full", "--out", str(out))
    assert without_times(again) == without_times(first)


def without_times(figures: dict[str, Any]) -> list[Any]:
    """Return the rows without times."""
    rows = json.loads(json.dumps(figures["rows"]))
    for row in rows:
        figures = row["figures"]
        for name in [n for n in figures if "seconds" in n]:
            del figures[name]
        for episode in figures.get("per_furniture", []):
            del episode["planning_seconds"], episode["policy_seconds"], episode["step_seconds"]
    return rows


def test_document_without_marks_is_refused_first(tmp_path: Path, capsys) -> None:
    document = tmp_path / "results.md"
    document.write_text("nothing\n")
    with pytest.raises(SystemExit) as end:
        main(["benchmark", "--quick", "--out", str(tmp_path / "run"), "--write", str(document)])
    assert end.value.code == 2
    assert "has no lines" in capsys.readouterr().err
    assert not (tmp_path / "run" / "about.json").exists()
    assert document.read_text() == "nothing\n"


@pytest.mark.parametrize(
    ("setting", "names"),
    [
        (
            "object-centric",
            ["RRT-Connect in 6M dimensions", "random", "relational", "relational with search", "search alone"],
        ),
        pytest.param(
            "full",
            ["random", "relational", "relational with search",
             "relational with search: its plans carried out in physics", "search alone"],
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_without_training_the_rows_of_trained_networks_are_left_out(
    setting: str, names: list[str], as_built, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_built(easy=[("cantilever", 1)], test=[("cantilever", 3)])
    result = told(capsys, "--no-train", "--setting", setting, "--out", str(tmp_path / "run"), "--jobs", "1")
    rows = {r["name"]: r["figures"] for r in result["rows"]}
    assert list(rows) == names
    assert all(figures["n"] == 1 for figures in rows.values())
    assert rows["search alone"]["success_rate"] == rows["relational with search"]["success_rate"] == 1.0
    assert not list((tmp_path / "run").glob("*.npz"))


def test_sets_that_are_not_generated_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="one of chairs-412"):
        next(benchmark.run(benchmark.BenchmarkConfig(set="folder"), tmp_path, 1))


def test_time_of_a_killed_run_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(benchmark.time, "monotonic", lambda: now[0])

    def steps() -> Iterator[Progress]:
        for done in range(3):
            now[0] += 10.0
            yield Progress("evaluation", done, 3, {})

    killed = benchmark.timed(tmp_path, "evaluation", steps())
    next(killed)
    next(killed)
    assert json.loads((tmp_path / "seconds.json").read_text()) == {"evaluation": 20.0}
    assert len(list(benchmark.timed(tmp_path, "evaluation", steps()))) == 3
    assert json.loads((tmp_path / "seconds.json").read_text()) == {"evaluation": 50.0}
