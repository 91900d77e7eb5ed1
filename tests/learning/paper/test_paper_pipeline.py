"""Training of the paper's policy on folders of samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import run_episode
from roboassembly.learning import checkpoint
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.pipeline import train_policy
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational.collect import collect


def test_the_papers_policy_is_trained_on_folders_of_samples(tmp_path: Path) -> None:
    list(collect(["cantilever:1"], tmp_path / "samples", episodes=1, seed=0, jobs=1))
    encoder = autoencoder.init(np.random.default_rng(0))
    extractor = tmp_path / "autoencoder.npz"
    checkpoint.save(extractor, checkpoint.Checkpoint(autoencoder.KIND, encoder, {}, {}))
    training = PaperTraining(steps=2, batch=4)
    progress = list(train_policy([tmp_path / "samples"], extractor, tmp_path / "run", training))
    assert [p.done for p in progress] == [1, 2]
    policy = load_policy(str(tmp_path / "run" / "policy.npz"))
    assert run_episode(policy, catalogue.make("cantilever", 1), 0).merges in range(4)
    # Other samples are another run.
    list(collect(["cantilever:5"], tmp_path / "samples", episodes=1, seed=0, jobs=1))
    with pytest.raises(InputError, match="other samples"):
        list(train_policy([tmp_path / "samples"], extractor, tmp_path / "run", training))
    with pytest.raises(InputError, match="no samples"):
        list(train_policy([tmp_path / "empty"], extractor, tmp_path / "other", training))
