"""Collecting samples: once, reproducibly, with a policy that acts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from relational_cases import TINY

from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import load_samples
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.collect import collect


def test_samples_are_collected_once_and_are_reproducible(tmp_path: Path) -> None:
    names = ["cantilever:1", "three_legged:1"]
    first = list(collect(names, tmp_path / "0", episodes=2, seed=0, jobs=1))
    assert [g.name for g in first] == names
    assert not list(collect(names, tmp_path / "0", episodes=2, seed=0, jobs=1))
    sets = load_samples(tmp_path / "0", names)
    assert [len(c.samples) for c in sets] == [g.states for g in first]
    # Another run gives the same; a policy that knows nothing errs and is corrected: every episode still ends well.
    again = list(collect(names, tmp_path / "again", episodes=2, seed=0, jobs=1))
    assert [g.states for g in again] == [g.states for g in first]
    fresh = relational.init(np.random.default_rng(0), TINY)
    policy = tmp_path / "policy.npz"
    checkpoint.save(policy, checkpoint.Checkpoint(relational.KIND, fresh, {}, {}))
    results = list(collect(names[:1], tmp_path / "1", episodes=1, seed=0, jobs=1, policy=policy))
    assert results[0].choices == 3  # four parts
    assert 0 < results[0].mistakes <= 3
