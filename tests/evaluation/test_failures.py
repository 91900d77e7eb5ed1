"""Tests of the pictures of failed episodes: the groups that were joined, and where they belong."""

from __future__ import annotations

import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from roboassembly.cli import main
from scripts import script

failures = script("tools/failures.py")


@pytest.fixture
def episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Evaluate a random policy that fails on two pieces."""
    for family in ("stool", "plank"):
        with pytest.raises(SystemExit):
            main(["generate", family, "--out", str(tmp_path / "set" / family)])
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["evaluate", "--policy", "random", "--set", f"folder:{tmp_path / 'set'}", "--jobs", "1", "--json"])
    path = tmp_path / "episodes.json"
    path.write_text(capsys.readouterr().out)
    return path


def share(picture: np.ndarray, color: tuple[float, float, float]) -> float:
    """Return the share of pixels with about the hue of a colour."""
    unit = picture / np.maximum(np.linalg.norm(picture.astype(float), axis=2, keepdims=True), 1.0)
    return float((unit @ (np.array(color) / np.linalg.norm(color)) > 0.985).mean())


@pytest.mark.slow
def test_one_row_per_failed_episode(episodes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = [e["furniture"] for e in json.loads(episodes.read_text())["per_furniture"]]
    failures.main(episodes, tmp_path / "picture.png", names)
    printed = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in printed] == names
    assert "merge 1 of " in printed[0]
    picture = iio.imread(tmp_path / "picture.png")
    assert picture.shape == (2 * failures.HEIGHT, 3 * failures.WIDTH, 3)
    for row in np.split(picture, 2):
        for panel in np.split(row, 3, axis=1):
            assert share(panel, failures.MOVED) > 1e-4
            assert share(panel, failures.WAITING) > 1e-4


def test_names_without_a_failure_are_refused(episodes: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="failed are: "):
        failures.main(episodes, tmp_path / "picture.png", ["nothing"])
