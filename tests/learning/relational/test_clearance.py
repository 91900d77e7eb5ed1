"""Clearance of grippers in clouds, against cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.learning.relational.clearance import (
    ARM_CUTOFF,
    CUTOFF,
    NearPoints,
    PlacedGrasps,
    arm_clearance,
    hand_clearance,
)
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


def test_placed_grasp_by_hand() -> None:
    """One grasp, its tips 0.1 m up and pointing down at a rod that is 20 mm wide."""
    poses = np.zeros((GRASPS, 6))
    poses[2] = 0.0, 0.0, 0.1, np.pi, 0.0, 0.0
    rod = np.array([[x, y, 0.1] for x in np.linspace(-0.1, 0.1, 41) for y in (-0.01, 0.01)])
    placed = PlacedGrasps.place(poses, np.eye(3), np.zeros(3), rod)
    assert placed.exists.tolist() == [g == 2 for g in range(GRASPS)]
    assert placed.opening[2] == pytest.approx(0.02)
    assert placed.position[2] == pytest.approx([0.0, 0.0, 0.1])
    np.testing.assert_allclose(placed.rotation[2], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    # A point 20 mm above the tips lies between the fingers, one 80 mm above in the palm; from a metre off neither does.
    for height, blocked in ((0.12, False), (0.18, True), (0.05, False)):
        near = placed.near(np.array([[0.0, 0.0, height]]))
        assert (hand_clearance(near, placed.opening)[2] < 0.0) == blocked, height
        far = placed.near(np.array([[0.0, 0.0, height - 1.0]]))
        assert hand_clearance(far, placed.opening)[2] == CUTOFF
