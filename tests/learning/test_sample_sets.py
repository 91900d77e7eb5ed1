"""Training samples in files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.errors import InputError
from roboassembly.learning import archive
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.oracle_dataset import Labeler


def test_a_file_keeps_the_samples_and_a_broken_one_is_refused(tmp_path: Path) -> None:
    furniture = catalogue.make("cantilever", 1)
    clouds = np.array([surface_points(p.mesh, 64) for p in furniture.parts], np.float32)
    labeler = Labeler(furniture, clouds)
    plain = labeler.sample_set(labeler.rollout(np.random.default_rng(0)).states)
    file = tmp_path / "samples.npz"
    first, second, last = plain.samples
    n = int(second.free.sum())
    valued = replace(second, q_values=np.arange(n * n * 6, dtype=np.float16).reshape(n, n, 6))
    samples = replace(plain, samples=(first, valued, last))
    samples.save(file)
    loaded = SampleSet.load(file)
    assert loaded.name == plain.name
    for a, b in zip(loaded.samples, samples.samples, strict=True):
        for name in ("mates", "points", "poses", "free", "q_values"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(InputError, match="not a file of training samples"):
        SampleSet.load(file)


def test_a_file_of_another_format_is_refused_with_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "old.npz"
    archive.write(path, {"name": np.array("stool")})
    with pytest.raises(InputError, match="has format 1, this program reads 4; remove it and build it again"):
        SampleSet.load(path)
