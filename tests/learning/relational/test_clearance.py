"""Clearance of grippers in clouds, against cases worked out by hand and against the exact oracle."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.datasets import catalogue
from roboassembly.envs.observation import surface_points
from roboassembly.learning.relational.clearance import (
    ARM_CUTOFF,
    CUTOFF,
    NearPoints,
    PartGrasps,
    PlacedGrasps,
    arm_clearance,
    box_distances,
    hand_clearance,
)
from roboassembly.learning.relational.oracle_dataset import Labeler
from roboassembly.learning.relational.tokens import TokenCache, tokens_of_sample
from roboassembly.solvers.hand_oracle import HandOracle
from roboassembly.task.full.task import FullTask
from roboassembly.task.rules.connections import GRASPS


def near_points(*clouds: np.ndarray) -> NearPoints:
    """Points of shape (3, n) near one gripper after the other."""
    points = np.concatenate(clouds, axis=1)
    gripper = np.repeat(np.arange(len(clouds)), [cloud.shape[1] for cloud in clouds])
    return NearPoints(points, gripper, np.arange(len(gripper)))


def test_distances_to_the_gripper_by_hand() -> None:
    """A point between the open pads is free, one in the palm is not, and the palm's approach sweeps what is behind."""
    between, in_palm, behind = np.zeros((3, 1)), np.array([[0.0], [0.0], [-0.08]]), np.array([[0.0], [0.0], [-0.25]])
    near = near_points(between, in_palm, np.zeros((3, 0)), behind, between)
    wide = hand_clearance(near, np.array([0.08, 0.08, 0.08, 0.08, 0.0]))
    assert 0.0 < wide[0] < CUTOFF
    assert wide[1] < 0.0
    assert list(wide[2:4]) == [CUTOFF, CUTOFF]
    assert wide[4] < 0.0
    assert hand_clearance(near_points(behind), np.array([0.08]), retreat=0.15)[0] < 0.0
    # Points together are as near as the nearest of them.
    together = near_points(np.concatenate([between, behind, in_palm], axis=1))
    assert hand_clearance(together, np.array([0.08]))[0] == wide[1]
    # The boxes contain the bodies.
    points = np.random.default_rng(0).uniform(-0.15, 0.15, (3, 500))
    boxes = box_distances(points[None].astype(np.float32), np.array([0.04]))[0]
    exact = hand_clearance(near_points(*np.split(points, 500, axis=1)), np.full(500, 0.04))
    assert (np.minimum(boxes, CUTOFF) <= exact + 1e-6).all()
    assert (exact < 0.0).any()


def test_distances_to_the_arm_by_hand() -> None:
    """A section from 0.1 to 0.3 m behind the tips: points beside it, beyond its end, far away and none."""
    beside, beyond, away = ([0.05, 0.0, -0.2], [0.0, 0.03, -0.34], [2.0, 0.0, 0.0])
    near = near_points(*(np.array(point)[:, None] for point in (beside, beyond, away)))
    assert arm_clearance(near, 4, 0.1, 0.3) == pytest.approx([0.05, 0.05, ARM_CUTOFF, ARM_CUTOFF])


def test_points_near_a_gripper_are_in_its_frame() -> None:
    """Of two grasps, one exists: it looks down at a point 20 mm below its tips, and another one is far away."""
    down = np.diag([1.0, -1.0, -1.0])
    placed = PlacedGrasps(
        np.array([False, True]), np.stack([np.eye(3), down]), np.array([[0.0] * 3, [0.1, 0.0, 0.5]]), np.full(2, 0.03)
    )
    cloud = np.array([[5.0, 0.0, 0.0], [0.1, 0.0, 0.48]])
    near = placed.near(cloud)
    assert near.gripper.tolist() == [1]
    assert near.index.tolist() == [1]
    assert near.points[:, 0] == pytest.approx([0.0, 0.0, 0.02])
    assert placed.near(cloud, reach=False).index.tolist() == [0, 1]
    moved = near.shifted(np.array([[9.0] * 3, [0.0, 0.0, 0.1]]))
    assert moved.points[:, 0] == pytest.approx([0.0, 0.0, 0.12])


def test_features_of_a_grasp_by_hand() -> None:
    """One grasp, its tips 0.1 m up and pointing down at a rod that is 20 mm wide; obstacles come from the side."""
    poses = np.zeros((GRASPS, 6))
    poses[2] = 0.0, 0.0, 0.1, np.pi, 0.0, 0.0
    rod = np.array([[x, y, 0.1] for x in np.linspace(-0.1, 0.1, 41) for y in (-0.01, 0.01)])
    grasps = PartGrasps(poses, rod, np.zeros((0, 3)), np.eye(3), np.zeros(3))
    assert grasps.placed.exists.tolist() == [g == 2 for g in range(GRASPS)]
    assert grasps.placed.opening[2] == pytest.approx(0.02)
    features = grasps.features(np.array([0.1, 0.0, 0.1]), np.eye(3))
    assert not features[[0, 1, 3, 4, 5, 6, 7]].any()
    # 0.1 m from the point, times four; coming down; closing across.
    np.testing.assert_allclose(features[2, :9], [-0.4, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0], atol=2e-3)
    rotations, translations = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    # A point 20 mm above the tips lies between the fingers, one 80 mm above in the palm; from a metre off neither does.
    for height, blocked in ((0.12, False), (0.18, True), (0.05, False)):
        here, far = grasps.mate_clearance(rotations, translations, np.array([[0.0, 0.0, height]]))
        assert (here[2] < 0.0) == blocked, height
        assert far[2] > 0.99


@pytest.mark.slow
def test_pairs_without_clearance_cannot_mate() -> None:
    task = FullTask(catalogue.make("panel", 13))
    clouds = np.array([surface_points(p.mesh, 2048) for p in task.furniture.parts], np.float32)
    labeler = Labeler(task.furniture, clouds, HandOracle(task))
    cache, episodes = TokenCache(), [labeler.rollout(np.random.default_rng(seed)) for seed in (2, 3, 4)]
    samples = labeler.sample_set([s for e in episodes for s in (*e.states, *e.dead_ends)])
    mating, tight = 0, 0
    for sample in samples.samples:
        tokens = tokens_of_sample(samples, sample, cache)
        assert tokens.clearance is not None
        index = np.full(sample.free.shape, -1)
        index[tokens.part, tokens.point] = np.arange(len(tokens.part))
        best: dict[tuple[int, int], tuple[float, bool]] = {}
        for u, k, v, l, _, *feasible in sample.mates.tolist():  # noqa: E741
            row, column = index[u, k], index[v, l]
            clearance = float(min(tokens.clearance[row, column, 0], tokens.clearance[column, row, 0]))
            groups = int(tokens.group[row]), int(tokens.group[column])
            before, mates = best.get(groups, (-1.0, False))
            best[groups] = max(before, clearance), mates or any(feasible)
        mating += sum(mates for _, mates in best.values())
        # Boxes are somewhat larger than a gripper: two millimetres, at a scale of ten.
        tight += sum(clearance < -0.2 for clearance, _ in best.values())
        assert not any(mates for clearance, mates in best.values() if clearance < -0.2)
    assert mating > 10
    assert tight > 0
