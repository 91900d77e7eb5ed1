"""Small cases that the tests of the relational policy share."""

from __future__ import annotations

import numpy as np

import shapes
from roboassembly.datasets import catalogue
from roboassembly.envs.object_centric import ObjectCentricEnv
from roboassembly.envs.observation import Observer, surface_points
from roboassembly.furniture.model import PAPER_POINTS, Furniture
from roboassembly.learning.datasets import SampleSet
from roboassembly.learning.relational.network import RelationalConfig
from roboassembly.learning.relational.oracle_dataset import Labeler
from roboassembly.learning.relational.policy_view import PolicyView
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.groups import Group, TaskState

TINY = RelationalConfig(token=16, pair=8, layers=1, heads=2, conflict_inputs=4, conflicts=2)
"""Sizes of a network for tests."""


def labeled(name: str, cloud_points: int = 64) -> SampleSet:
    """Return the samples of one episode of a generated piece, `family:seed`."""
    family, seed = name.split(":")
    furniture = catalogue.make(family, int(seed))
    clouds = np.array([surface_points(p.mesh, cloud_points) for p in furniture.parts], np.float32)
    labeler = Labeler(furniture, clouds)
    return labeler.sample_set(labeler.rollout(np.random.default_rng(0)).states)


def observed(seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the first observation of an episode of a stool, and its mask."""
    env = ObjectCentricEnv("three_legged:1", cloud_points=64)
    observation, info = env.reset(seed=seed)
    return observation, info["action_mask"]


def grasp_view(furniture: Furniture, state: TaskState, cloud_points: int = 2048) -> PolicyView:
    """Return the view of a state with grasps, without padding."""
    n = len(furniture.parts)
    observation = Observer(furniture, n, PAPER_POINTS, cloud_points).observe(state)
    free = FullTask(furniture).rules.free_points(state, n, PAPER_POINTS)
    # The view reads its free points from the mask.
    mask = np.broadcast_to(free[:, None, :, None, None], (n, n, PAPER_POINTS, PAPER_POINTS, 6))
    return PolicyView.from_observation(observation, mask)


def scattered(furniture: Furniture, rng: np.random.Generator) -> TaskState:
    """Return a state with every part alone at a random pose."""
    return TaskState(
        tuple(
            Group((i,), (i,), (a,), shapes.random_pose(rng, 2.0) * a.inverse())
            for i, a in enumerate(furniture.assembled)
        )
    )
