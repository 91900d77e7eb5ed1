"""Checkpoints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.relational import network as relational


def test_a_checkpoint_keeps_its_arrays_and_other_files_are_refused(tmp_path: Path) -> None:
    params = relational.init(np.random.default_rng(0), relational.RelationalConfig(token=16, pair=8, layers=1, heads=2))
    file = tmp_path / "policy.npz"
    checkpoint.save(file, checkpoint.Checkpoint("relational", params, {"a": 1}, {}), half=True)
    loaded = checkpoint.load(file, "relational")
    assert loaded.config == {"a": 1}
    assert np.allclose(loaded.params["q"]["w"], params["q"]["w"], atol=2e-3)
    with pytest.raises(InputError, match="'relational' network where a 'paper'"):
        checkpoint.load(file, "paper")
    with pytest.raises(InputError, match="no checkpoint"):
        checkpoint.load(tmp_path / "none.npz")
    file.write_bytes(b"not a zip")
    with pytest.raises(InputError, match="not a checkpoint"):
        checkpoint.load(file)
