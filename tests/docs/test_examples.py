"""The examples run: the scripts with small arguments, the notebook cell by cell."""

from __future__ import annotations

import json
import runpy
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from documentation import ROOT, can_draw
from roboassembly.furniture import storage

EXAMPLES = ROOT / "examples"


def run_script(name: str, *arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run an example as `python examples/NAME ARGUMENTS` would, in this process."""
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_plan_and_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run_script("01_plan_and_view.py", "--furniture", "three_legged:3", "--out", "seen", monkeypatch=monkeypatch)
    out = capsys.readouterr().out
    assert "three_legged-3: 5 parts" in out
    assert "4. " in out
    assert len(json.loads((tmp_path / "seen" / "plan.json").read_text())["steps"]) == 4
    assert (tmp_path / "seen" / "assembly.html").stat().st_size > 10_000
    assert (tmp_path / "seen" / "steps.png").exists() == can_draw()


def test_your_own_furniture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_script("02_your_own_furniture.py", monkeypatch=monkeypatch)
    table = storage.load(tmp_path / "my_table")
    assert sorted(part.name for part in table.parts)[-1] == "top"
    out = capsys.readouterr().out
    assert "interchangeable: leg_left_back, leg_left_front, leg_right_back, leg_right_front" in out
    assert "4 merges, assembled: True" in out


def test_custom_policy(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run_script("03_custom_policy.py", "--furniture", "three_legged:3", monkeypatch=monkeypatch)
    assert "of 4 merges alone" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("jax"), reason="needs JAX")
def test_paper_method_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_script("04_paper_method_small.py", "--out", "small", monkeypatch=monkeypatch)
    assert "the policy solves 2 of 2 chairs" in capsys.readouterr().out
    assert (tmp_path / "small" / "policy.npz").exists()


def cells() -> list[str]:
    """The notebook's code, cell by cell."""
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_notebook_is_kept_without_outputs() -> None:
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text())
    assert notebook["nbformat"] == 4
    for cell in notebook["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None


@pytest.mark.skipif(not can_draw(), reason="the notebook shows pictures; nothing can draw them here")
def test_notebook_runs(capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {"__name__": "__main__"}
    for number, source in enumerate(cells()):
        exec(compile(source, f"quickstart.ipynb, cell {number}", "exec"), namespace)
    out = capsys.readouterr().out
    assert "merged 5.0\nsuccess: True" in out
    assert "success True" in out
