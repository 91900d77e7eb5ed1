"""Training of the paper's policy on folders of samples."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import Run
from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import furniture_refs
from roboassembly.errors import InputError
from roboassembly.evaluation.rollout import run_episode
from roboassembly.furniture import storage
from roboassembly.learning import checkpoint
from roboassembly.learning.paper import autoencoder
from roboassembly.learning.paper.imitation import PaperTraining
from roboassembly.learning.paper.pipeline import (
    AggregationConfig,
    PipelineConfig,
    samples_folder,
    train_experts,
    train_policy,
)
from roboassembly.learning.registry import load_policy
from roboassembly.learning.relational.collect import collect


def _random_extractor(path: Path) -> Path:
    checkpoint.save(path, checkpoint.Checkpoint(autoencoder.KIND, autoencoder.init(np.random.default_rng(0)), {}, {}))
    return path


@pytest.mark.slow
def test_a_chair_taught_by_its_expert_is_finished_from_new_starts(tmp_path: Path) -> None:
    """The expert, its samples and the policy, as the commands make them; no start is one of those in the samples."""
    furniture = catalogue.make("cantilever", 1, with_grasps=False)
    storage.save(furniture, tmp_path / "chair")
    refs = furniture_refs(f"folder:{tmp_path / 'chair'}")
    extractor = _random_extractor(tmp_path / "autoencoder.npz")
    list(train_experts(refs, tmp_path, PipelineConfig(side_by_side=1), {}, jobs=1))
    training = PaperTraining(steps=400, batch=32)
    aggregation = AggregationConfig(refs, tmp_path / "experts", rounds=1, steps=50)
    steps = list(train_policy([samples_folder(tmp_path)], extractor, tmp_path / "paper", training, aggregation))
    assert [p.stage for p in steps[:: len(steps) - 1]] == ["paper", "paper 1"]
    assert {p.scalars["finished"] for p in steps if p.stage == "aggregation 1"} == {1.0}
    # A finished run is not done again.
    assert not list(train_policy([samples_folder(tmp_path)], extractor, tmp_path / "paper", training, aggregation))
    policy = load_policy(str(tmp_path / "paper" / "policy.npz"))
    assert [run_episode(policy, furniture, seed).success for seed in range(500, 510)].count(True) >= 9


@pytest.mark.slow
def test_the_papers_policy_is_trained_on_folders_of_samples(tmp_path: Path, run: Run) -> None:
    list(collect(["cantilever:1"], tmp_path / "samples", episodes=1, seed=0, jobs=1))
    extractor = _random_extractor(tmp_path / "autoencoder.npz")
    training = PaperTraining(steps=2, batch=4)
    progress = list(train_policy([tmp_path / "samples"], extractor, tmp_path / "run", training))
    assert [p.done for p in progress] == [1, 2]
    policy = load_policy(str(tmp_path / "run" / "policy.npz"))
    assert run_episode(policy, catalogue.make("cantilever", 1), 0).merges in range(4)
    # The report of the command names the samples, and no set: none was used.
    command = ("train", "multitask", "--preset", "paper", "--samples", tmp_path / "samples", "--extractor", extractor)
    status, out, _ = run(*map(str, command), "--steps", "1", "--out", str(tmp_path / "command"), "--json")
    assert status == 0
    assert json.loads(out)["samples"] == [str(tmp_path / "samples")]
    assert "set" not in json.loads(out)
    # Other samples are another run.
    list(collect(["cantilever:5"], tmp_path / "samples", episodes=1, seed=0, jobs=1))
    with pytest.raises(InputError, match="other samples"):
        list(train_policy([tmp_path / "samples"], extractor, tmp_path / "run", training))
    with pytest.raises(InputError, match="no samples"):
        list(train_policy([tmp_path / "empty"], extractor, tmp_path / "other", training))


def test_rounds_need_the_experts(tmp_path: Path, run: Run) -> None:
    list(collect(["cantilever:1"], tmp_path / "samples", episodes=1, seed=0, jobs=1))
    extractor = _random_extractor(tmp_path / "autoencoder.npz")
    command = ("train", "multitask", "--preset", "paper", "--samples", tmp_path / "samples", "--extractor", extractor)
    status, _, err = run(*map(str, command), "--rounds", "1", "--out", str(tmp_path / "out"))
    assert status == 2
    assert "--rounds 1 of --preset paper needs --experts FOLDER" in err
