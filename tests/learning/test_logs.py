"""Logs of a training run."""

from __future__ import annotations

from pathlib import Path

import pytest

from roboassembly.errors import InputError
from roboassembly.learning import logs


def test_logs_average_and_survive_a_broken_line(tmp_path: Path) -> None:
    with logs.TrainingLog(tmp_path) as log:
        for step in range(1, 101):
            log.add("policy 0", step, {"loss": float(step)})
        log.add("policy 0", 103, {"loss": 1.0}, last=True)
    with (tmp_path / logs.LINES).open("a") as file:
        file.write('{"stage": "pol')
    assert logs.read(tmp_path) == {"loss": {"policy 0": {50: 25.5, 100: 75.5, 103: 1.0}}}
    assert logs.draw(tmp_path).stat().st_size > 5_000
    assert len(list((tmp_path / "tensorboard").iterdir())) == 1
    with pytest.raises(InputError, match="holds no"):
        logs.read(tmp_path / "nowhere")
