"""States and samples that several tests of learning share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import shapes
from roboassembly.datasets import catalogue
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import PAPER_POINTS
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.grasps.dataset import GraspLabeler, GraspSamples
from roboassembly.learning.relational.oracle_dataset import Labeler
from roboassembly.task.full.task import FullTask


@pytest.fixture(scope="session")
def first_state() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Observation and action mask of a chair before its first merge."""
    observation, info = ObjectCentricEnv("cantilever:1", cloud_points=512).reset(seed=0)
    return observation, info["action_mask"]


@pytest.fixture(scope="session")
def chair_samples() -> SampleSet:
    """Labeled states of one episode of a chair; the second one has Q-values of an expert as well."""
    furniture = catalogue.make("three_legged", 1, with_grasps=True)
    clouds = np.array([surface_points(p.mesh, 96) for p in furniture.parts], np.float32)
    grasps = Observer(furniture, len(furniture.parts), PAPER_POINTS, 1).grasp_poses
    states = Labeler(furniture, clouds).rollout(np.random.default_rng(0)).states
    n = int(states[1].free.sum())
    valued = replace(states[1], q_values=np.random.default_rng(1).normal(size=(n, n, 6)).astype(np.float16))
    return SampleSet(furniture.name, clouds, (states[0], valued, *states[2:]), grasps)


@pytest.fixture(scope="session")
def stand_grasps() -> GraspSamples:
    """Labeled grasps of one episode of a small stand."""
    return GraspLabeler(FullTask(shapes.stand()), tries=1).collect(np.random.default_rng(0), episodes=1)
