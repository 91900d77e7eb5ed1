"""The mobile Franka: its kinematics against Pinocchio's, where it can stand, what its shapes are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from roboassembly.geometry.poses import SE3, rotation_angle
from roboassembly.robots.body import links, placed, tip_positions, world_from_tips
from roboassembly.robots.gripper import TIPS, panda_folder
from roboassembly.robots.kinematics import Poses, arm, rotation_vectors
from roboassembly.robots.platform import CLEARANCE, HEIGHT, PLATFORM_FROM_MOUNT
from roboassembly.robots.reach import reach


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def uniform(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(arm().low, arm().high, (n, 7))


def test_poses_and_jacobians_are_those_of_the_urdf(rng: np.random.Generator) -> None:
    model = pin.buildModelFromUrdf(str(panda_folder() / "urdf/panda.urdf"))
    data, frame = model.createData(), model.getFrameId(TIPS)
    q = uniform(rng, 20)
    poses, jacobians = arm().jacobians(q)
    for i in range(len(q)):
        whole = np.concatenate([q[i], [0.0, 0.0]])
        pin.framesForwardKinematics(model, data, whole)
        tips = data.oMf[frame]
        assert np.allclose(poses.rotation[i], tips.rotation, atol=1e-12)
        assert np.allclose(poses.translation[i], tips.translation, atol=1e-12)
        wanted = pin.computeFrameJacobian(model, data, whole, frame, pin.LOCAL_WORLD_ALIGNED)[:, :7]
        assert np.allclose(jacobians[i], wanted, atol=1e-12)


def test_inverse_kinematics_comes_back_to_the_pose_within_limits(rng: np.random.Generator) -> None:
    q = uniform(rng, 300)
    wanted = arm().poses(q)
    guess = np.clip(q + rng.normal(0.0, 0.1, q.shape), arm().low, arm().high)
    found, ok = arm().solve(wanted, guess)
    assert ok.mean() > 0.8
    poses = arm().poses(found[ok])
    assert np.linalg.norm(poses.translation - wanted.translation[ok], axis=1).max() < 1e-6
    assert (
        np.linalg.norm(rotation_vectors(poses.rotation @ wanted.rotation[ok].transpose(0, 2, 1)), axis=1).max() < 1e-6
    )
    assert (found[ok] >= arm().low).all()
    assert (found[ok] <= arm().high).all()


def test_unreachable_pose_has_no_solution(rng: np.random.Generator) -> None:
    q = uniform(rng, 50)
    near = arm().poses(q)
    far = Poses(near.rotation, near.translation + np.array([0.0, 0.0, 3.0]))
    _, ok = arm().solve(far, q)
    assert not ok.any()


def test_rotation_vectors_by_hand() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert rotation_vectors(np.array([quarter, np.eye(3), quarter.T])) == pytest.approx(
        np.array([[0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0], [0.0, 0.0, -np.pi / 2]])
    )


def test_every_solution_reaches_the_tip_pose(rng: np.random.Generator) -> None:
    for height in (0.5, 0.9, 1.3):
        turn = pin.Quaternion(rng.normal(size=4))
        turn.normalize()
        wanted = SE3(turn.toRotationMatrix(), np.array([*rng.uniform(-3.0, 3.0, 2), height]))
        ways = reach(wanted, 64, rng)
        assert len(ways) > 20
        for q in ways:
            tips = world_from_tips(q)
            assert np.linalg.norm(tips.translation - wanted.translation) < 1e-6
            assert rotation_angle(tips.rotation.T @ wanted.rotation) < 1e-6
            assert (q[3:] >= arm().low).all()
            assert (q[3:] <= arm().high).all()
    assert not len(reach(SE3(np.eye(3), np.array([0.0, 0.0, 3.0])), 64, rng))


def test_same_generator_gives_the_same_solutions() -> None:
    wanted = SE3(np.eye(3), np.array([0.3, 0.2, 0.9]))
    one, two = (reach(wanted, 32, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one, two)


def test_the_platform_carries_the_arm(rng: np.random.Generator) -> None:
    platform = next(link for link in links() if link.name == "platform")
    z = platform.mesh.vertices[:, 2]
    assert (z.min(), z.max()) == pytest.approx((CLEARANCE, HEIGHT))
    assert PLATFORM_FROM_MOUNT.translation[2] == HEIGHT
    # Turned by a quarter at (1, 2), the mount is ahead of the middle along y.
    q = np.array([1.0, 2.0, np.pi / 2, *uniform(rng, 1)[0]])
    where = {link.name: pose for link, pose in placed(q, 0.04)}
    assert where["platform"].act(PLATFORM_FROM_MOUNT.translation) == pytest.approx(
        [1.0, 2.0 + PLATFORM_FROM_MOUNT.translation[0], HEIGHT]
    )


def test_pads_have_the_given_opening_around_the_tips(rng: np.random.Generator) -> None:
    for opening in (0.0, 0.03, 0.08):
        q = np.array([0.5, -0.5, 0.7, *uniform(rng, 1)[0]])
        tips = world_from_tips(q)
        sides = []
        for link, pose in placed(q, opening):
            if link.name.endswith("finger"):
                # Near the tips, where the pads are; y is the way that the hand closes.
                points = _in(tips, pose, link.mesh.vertices)
                pads = points[np.abs(points[:, 2]) < 0.009]
                sides.append(pads[np.argmin(np.abs(pads[:, 1])), 1])
        assert sorted(np.sign(np.round(sides, 9))) in ([-1.0, 1.0], [0.0, 0.0])
        assert max(sides) - min(sides) == pytest.approx(opening, abs=2e-3)


def _in(frame: SE3, pose: SE3, points: np.ndarray) -> np.ndarray:
    local = frame.actInv(pose)
    return points @ local.rotation.T + local.translation


def test_tip_positions_are_those_of_one_after_the_other() -> None:
    rng = np.random.default_rng(5)
    q = np.concatenate([rng.uniform(-2.0, 2.0, (20, 3)), rng.uniform(arm().low, arm().high, (20, 7))], axis=1)
    one_by_one = np.array([world_from_tips(c).translation for c in q])
    assert np.allclose(tip_positions(q), one_by_one, atol=1e-12)
