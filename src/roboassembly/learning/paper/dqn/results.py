"""Trained experts: their files, and what training reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.datasets.sets import FurnitureRef, furniture_hash
from roboassembly.errors import InputError
from roboassembly.learning import checkpoint
from roboassembly.learning.datasets import dataset_file
from roboassembly.learning.layers import Params
from roboassembly.learning.paper.dqn.memoized_env import MemoizedEnv
from roboassembly.learning.paper.dqn.network import KIND, ChairInputs, ExpertPolicy, chair_inputs
from roboassembly.learning.paper.dqn.replay_buffer import ReplayBuffer
from roboassembly.statistics import success
from roboassembly.task.full.task import FullTask
from roboassembly.task.object_centric.task import ObjectCentricTask


@dataclass(frozen=True)
class ExpertResult:
    """Result of one chair."""

    name: str
    """Name of the chair."""
    mastered: bool
    """Whether the chair was mastered within the steps allowed."""
    steps: int
    """Number of environment steps."""
    planned: int
    """Number of merges that were planned; all others were remembered."""
    success_rate: float
    """Success rate of the test episodes."""
    seconds: float
    """Training time, shared with the chairs trained beside it [s]."""
    demonstrated: bool = False
    """Whether the agent was shown how to assemble the chair; see `AgentConfig.demonstrate_after`."""
    refused: str = ""
    """Reason why the chair does not suit the setting and is not trained; empty if it does."""


def read(path: Path) -> ExpertResult:
    """Read the result of a chair.

    Raises:
        InputError: the file is not an expert's.
    """
    return ExpertResult(**checkpoint.load(path, KIND).config["result"])


def with_expert(refs: Sequence[FurnitureRef], experts: Path) -> list[FurnitureRef]:
    """Return the chairs that have an expert, without refused ones.

    Args:
        refs: chairs.
        experts: folder of the experts' files.
    """
    there = [r for r in refs if dataset_file(experts, r.name).is_file()]
    return [r for r in there if not read(dataset_file(experts, r.name)).refused]


def summary(results: Sequence[ExpertResult]) -> dict[str, Any]:
    """Return how many chairs were mastered, with the 95 % Wilson interval, and what it took; without refused chairs."""
    refused, results = sum(bool(r.refused) for r in results), [r for r in results if not r.refused]
    if not results:
        return {**success([]), "mastered": 0, "demonstrated": 0, "refused": refused}
    done = [r for r in results if r.mastered]
    return {
        **success([r.mastered for r in results]),
        "mastered": len(done),
        "demonstrated": sum(r.demonstrated for r in results),
        "refused": refused,
        "test_success_rate": sum(r.success_rate for r in results) / len(results),
        "steps_mean": sum(r.steps for r in results) / len(results),
        "steps_mean_mastered": sum(r.steps for r in done) / len(done) if done else None,
        "planned_mean": sum(r.planned for r in results) / len(results),
        "seconds": sum(r.seconds for r in results),
    }


def load(path: Path, task: ObjectCentricTask | FullTask) -> tuple[ExpertPolicy, ReplayBuffer]:
    """Load a trained expert, and the states and merges that it met.

    Raises:
        InputError: the file is not an expert's, or of another chair.
    """
    kept = checkpoint.load(path, KIND)
    if kept.config["furniture_hash"] != furniture_hash(task.furniture):
        raise InputError(f"'{path}' is an expert for {kept.config['furniture']}, which is not this furniture")
    part_features = np.zeros((len(task.furniture.parts), kept.extra["features"].shape[1] - 9), np.float32)
    inputs = replace(chair_inputs(task, part_features), features=kept.extra["features"])
    buffer = ReplayBuffer(MemoizedEnv(task, int(kept.extra["env_seed"])), inputs)
    buffer.env.restore(kept.params["agent"]["env"])
    buffer.restore(kept.params["agent"]["buffer"])
    return ExpertPolicy(inputs, kept.params["network"]), buffer


def load_relative(path: Path, inputs: ChairInputs) -> tuple[Params, Params] | None:
    """Return the weights and the agent of a near relative's expert.

    None if there is none, or if its chair has other parts or points.

    Args:
        path: file of the relative.
        inputs: inputs of the expert to start.
    """
    if not path.is_file():
        return None
    kept = checkpoint.load(path, KIND)
    # Files of refused chairs have no expert.
    if not kept.params or len(kept.params["agent"]["env"]["tried"][0]) != inputs.points:
        return None
    return kept.params["network"], kept.params["agent"]
