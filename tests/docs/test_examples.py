"""The examples run: the scripts with small arguments, the notebook cell by cell."""

from __future__ import annotations

import json
import re
import runpy
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import Run
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


@pytest.mark.slow
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


def cloning() -> dict[str, Any]:
    """Names of the example that clones a merge."""
    pytest.importorskip("sklearn")
    pytest.importorskip("pyarrow")
    return runpy.run_path(str(EXAMPLES / "06_behaviour_cloning.py"), run_name="example")


def test_commands_in_frames_of_parts_become_actions_again() -> None:
    names = cloning()
    frames = [names["Shift"](0.3, 0.02, -0.01), names["Shift"](-2.0, -0.5, 0.4)]
    actions = np.random.default_rng(0).uniform(-0.8, 0.8, (20, 22)).astype(np.float32)
    actions[::2, [10, 21]] = -1.0
    back = [names["action_of"](row, frames) for row in names["canonical"](actions, frames)]
    np.testing.assert_allclose(back, actions, atol=1e-6)
    # The motion of a part takes its robot along.
    moved = names["action_of"](names["canonical"](actions, [names["NOWHERE"]] * 2)[0], frames)
    (x, y), c, s = 10.0 * actions[0, :2], np.cos(0.3), np.sin(0.3)
    np.testing.assert_allclose(10.0 * moved[:2], [c * x - s * y + 0.02, s * x + c * y - 0.01], atol=1e-5)
    np.testing.assert_allclose(moved[3:11], actions[0, 3:11], atol=1e-6)


def test_ways_of_a_phase_are_not_mixed() -> None:
    """Sixty demonstrations pass a post on one side, forty on the other; a single one does something else."""
    model, rng = cloning()["PhaseModel"], np.random.default_rng(0)
    chunks = []
    for index in range(101):
        features = rng.uniform(-1.0, 1.0, 6)
        features[0] = (0.2 + abs(features[0])) * (1.0 if index < 60 else -1.0)
        chunk = np.zeros((30 + index % 2, 24))
        chunk[5:, 0] = 1.0 if index < 60 else -1.0 if index < 100 else 50.0
        chunk[:, 1] = 0.1 * features[1]
        chunks.append((features, chunk))
    fitted = model(chunks)
    for side in (1.0, -1.0):
        commands = fitted.predict(np.array([0.7 * side, 0.25, 0.0, 0.0, 0.0, 0.0]))
        assert commands.shape == (31, 24)
        np.testing.assert_allclose(commands[5:, 0], side, atol=0.02)
        np.testing.assert_allclose(commands[:, 1], 0.025, atol=0.01)


@pytest.mark.slow
def test_behaviour_cloning(monkeypatch: pytest.MonkeyPatch, run: Run, capfd: pytest.CaptureFixture[str]) -> None:
    """As its header says; at least 40 of 50 starts succeed, none of which was recorded."""
    cloning()
    ranges = ("--layout", "1", "--part-position", "0.02", "--part-angle", "0.2")
    options = ("--task", "merge", "--merge", "0", *ranges, "--control", "joint_position", "--episodes", "100")
    assert run("demos", "stool", *options, "--out", "merges")[0] == 0
    run_script("06_behaviour_cloning.py", "merges", monkeypatch=monkeypatch)
    found = re.search(r"^(\d+) of 50 new starts succeed$", capfd.readouterr().out, re.MULTILINE)
    assert found
    assert int(found[1]) >= 40


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


@pytest.mark.slow
@pytest.mark.skipif(not can_draw(), reason="the notebook shows pictures; nothing can draw them here")
def test_notebook_runs(capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {"__name__": "__main__"}
    for number, source in enumerate(cells()):
        exec(compile(source, f"quickstart.ipynb, cell {number}", "exec"), namespace)
    out = capsys.readouterr().out
    assert "merged 5.0\nsuccess: True" in out
    assert "success True" in out
