"""Pose conventions, by numbers that can be checked by hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from roboassembly.errors import InputError
from roboassembly.geometry.poses import (
    BOX_ROTATIONS,
    SE3,
    align_axis,
    euler_from_rotations,
    from_quaternion,
    interpolate,
    orthonormal,
    pose_from_seven,
    pose_to_euler,
    pose_to_rotation_6d,
    pose_to_seven,
    poses_to_configurations,
    rotation_angle,
    rotation_from_quaternion,
    rotations_from_euler,
    storable,
    transform_points,
)

HALF = np.sqrt(0.5)
QUARTER_ABOUT_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

finite = st.floats(-10, 10)
rotations = st.tuples(finite, finite, finite).map(lambda v: Rotation.from_rotvec(np.array(v)).as_matrix())
poses = st.builds(lambda r, t: SE3(r, np.array(t)), rotations, st.tuples(finite, finite, finite))


def close(a: SE3, b: SE3, tolerance: float = 1e-9) -> bool:
    return bool(np.abs(a.homogeneous - b.homogeneous).max() < tolerance)


def test_seven_numbers_are_position_then_w_x_y_z() -> None:
    pose = pose_from_seven([1, 2, 3, HALF, 0, 0, HALF])
    assert np.allclose(pose.translation, [1, 2, 3])
    assert np.allclose(pose.rotation, QUARTER_ABOUT_Z)
    # The pose's x axis is the world's y.
    assert np.allclose(transform_points(pose, np.array([[1.0, 0.0, 0.0]])), [[1, 3, 3]])
    assert np.allclose(pose_to_seven(pose), [1, 2, 3, HALF, 0, 0, HALF])


def test_configurations_are_position_then_x_y_z_w_in_columns() -> None:
    columns = poses_to_configurations([SE3.Identity(), SE3(QUARTER_ABOUT_Z, np.array([1.0, 2.0, 3.0]))])
    assert np.allclose(columns.T, [[0, 0, 0, 0, 0, 0, 1], [1, 2, 3, 0, 0, HALF, HALF]])
    assert columns.flags.f_contiguous


def test_euler_turns_about_x_first_and_z_last() -> None:
    pose = from_quaternion([1, 2, 3], Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_quat(scalar_first=True))
    assert np.allclose(pose_to_euler(pose), [1, 2, 3, 0.1, 0.2, 0.3])
    roll = SE3(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))
    assert np.allclose(pose_to_euler(roll), [0, 0, 0, np.pi / 2, 0, 0])


def test_euler_angles_of_many_rotations_are_those_of_pinocchio() -> None:
    rng = np.random.default_rng(0)
    turns = np.concatenate(
        [Rotation.random(500, rng).as_matrix(), BOX_ROTATIONS, Rotation.from_euler("y", [[1.5707]]).as_matrix()]
    )
    found = euler_from_rotations(turns)
    # Pinocchio gives -pi for some half turns, and a yaw of 0 at a pitch of 90 degrees.
    expected = [pin.rpy.matrixToRpy(np.round(turn, 9) + 0.0) for turn in turns]
    assert np.allclose(found, np.where(np.isclose(expected, -np.pi), np.pi, expected), atol=1e-12)
    assert np.allclose(rotations_from_euler(found), turns, atol=1e-8)
    assert np.array_equal(euler_from_rotations(turns[:6].reshape(2, 3, 3, 3)), found[:6].reshape(2, 3, 3))


def test_rotation_6d_is_the_first_two_columns() -> None:
    numbers = pose_to_rotation_6d(SE3(QUARTER_ABOUT_Z, np.array([1.0, 2.0, 3.0])))
    assert np.allclose(numbers, [1, 2, 3, 0, 1, 0, -1, 0, 0])


@given(poses)
def test_seven_numbers_there_and_back(pose: SE3) -> None:
    seven = pose_to_seven(pose)
    assert seven[3] >= 0
    assert np.linalg.norm(seven[3:]) == pytest.approx(1.0, abs=1e-12)
    assert close(pose_from_seven(seven), pose)


@given(poses)
def test_rotation_6d_keeps_the_rotation(pose: SE3) -> None:
    numbers = pose_to_rotation_6d(pose)
    x, y = numbers[3:6], numbers[6:9]
    assert np.allclose(np.column_stack([x, y, np.cross(x, y)]), pose.rotation, atol=1e-9)


@given(poses)
def test_euler_keeps_the_rotation(pose: SE3) -> None:
    numbers = pose_to_euler(pose)
    assert np.allclose(Rotation.from_euler("xyz", numbers[3:]).as_matrix(), pose.rotation, atol=1e-6)


@given(st.lists(st.tuples(finite, finite, finite), min_size=1, max_size=5), poses)
def test_transform_points_is_the_group_action(points: list[tuple[float, float, float]], pose: SE3) -> None:
    moved = transform_points(pose, np.array(points))
    assert np.allclose(moved, [pose.act(np.array(p)) for p in points])


def test_quaternion_is_normalised() -> None:
    assert np.allclose(rotation_from_quaternion([5, 0, 0, 5]), QUARTER_ABOUT_Z)


@pytest.mark.parametrize("wxyz", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_quaternion_without_direction_is_refused(wxyz: list[float]) -> None:
    with pytest.raises(InputError, match="no direction"):
        rotation_from_quaternion(wxyz)


@pytest.mark.parametrize("numbers", [[1, 2, 3], [0, 0, 0, 1, 0, 0, 0, 0], [np.nan, 0, 0, 1, 0, 0, 0]])
def test_not_seven_finite_numbers_are_refused(numbers: list[float]) -> None:
    with pytest.raises(InputError, match="seven finite numbers"):
        pose_from_seven(numbers)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.3, np.pi / 2, 3.0, np.pi - 1e-6, np.pi])
def test_rotation_angle(angle: float) -> None:
    axis = np.array([1.0, 2.0, -2.0]) / 3
    assert rotation_angle(Rotation.from_rotvec(angle * axis).as_matrix()) == pytest.approx(angle, abs=1e-7)


def test_interpolation_by_hand() -> None:
    start, end = SE3.Identity(), SE3(QUARTER_ABOUT_Z, np.array([2.0, 0.0, -4.0]))
    states = interpolate(start, end, np.array([0.0, 0.5, 1.0]))
    eighth = np.pi / 8
    assert np.allclose(
        states.T,
        [[0, 0, 0, 0, 0, 0, 1], [1, 0, -2, 0, 0, np.sin(eighth), np.cos(eighth)], [2, 0, -4, 0, 0, HALF, HALF]],
    )


@given(poses, poses, st.floats(0, 1))
def test_interpolation_is_linear_and_spherical_linear(start: SE3, end: SE3, fraction: float) -> None:
    state = interpolate(start, end, np.array([0.0, fraction, 1.0]))
    assert np.allclose(np.linalg.norm(state[3:], axis=0), 1.0, atol=1e-9)
    assert np.allclose(state[:3, 1], start.translation + fraction * (end.translation - start.translation))
    turned = Rotation.from_quat(state[3:].T)
    ends = Rotation.from_matrix(np.array([start.rotation, end.rotation]))
    assert (turned[[0, 2]] * ends.inv()).magnitude().max() < 1e-7
    if (ends[0].inv() * ends[1]).magnitude() < 3.1:  # at half a turn there are two ways
        assert (turned[1] * Slerp([0, 1], ends)(fraction).inv()).magnitude() < 1e-6


def test_interpolation_takes_the_short_way_round() -> None:
    start = SE3(Rotation.from_rotvec([0, 0, 3.0]).as_matrix(), np.zeros(3))
    end = SE3(Rotation.from_rotvec([0, 0, -3.0]).as_matrix(), np.zeros(3))
    middle = Rotation.from_quat(interpolate(start, end, np.array([0.5]))[3:, 0])
    assert middle.magnitude() == pytest.approx(np.pi)


vectors = st.tuples(finite, finite, finite).filter(lambda v: np.linalg.norm(v) > 1e-3)


@settings(max_examples=60)
@given(vectors, vectors)
def test_align_axis_is_the_smallest_rotation(source: tuple[float, ...], target: tuple[float, ...]) -> None:
    a, b = np.array(source) / np.linalg.norm(source), np.array(target) / np.linalg.norm(target)
    rotation = align_axis(a, b)
    assert np.allclose(rotation @ a, b, atol=1e-6)
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert rotation_angle(rotation) == pytest.approx(np.arccos(np.clip(a @ b, -1, 1)), abs=1e-5)


@pytest.mark.parametrize("axis", np.eye(3))
def test_align_axis_turns_right_over(axis: np.ndarray) -> None:
    rotation = align_axis(axis, -axis)
    assert np.allclose(rotation @ axis, -axis)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-2])
def test_align_axis_stays_a_rotation_near_the_opposite(off: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        a = rng.normal(size=3)
        a /= np.linalg.norm(a)
        b = off * rng.normal(size=3) - a
        b /= np.linalg.norm(b)
        rotation = align_axis(a, b)
        assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-12
        assert np.abs(rotation @ a - b).max() < 1e-5


def test_orthonormal_takes_rounding_away() -> None:
    drifted = SE3(QUARTER_ABOUT_Z * (1 + 1e-5), np.array([1.0, 2.0, 3.0]))
    pose = orthonormal(drifted)
    assert np.abs(pose.rotation.T @ pose.rotation - np.eye(3)).max() < 1e-14
    assert np.allclose(pose.rotation, QUARTER_ABOUT_Z, atol=1e-5)
    assert np.array_equal(pose.translation, [1, 2, 3])


def test_a_storable_pose_survives_any_number_of_round_trips() -> None:
    rng = np.random.default_rng(0)
    rotations = [*Rotation.random(300, rng).as_matrix(), *Rotation.create_group("O").as_matrix()]
    # Nearly exact rotations, as found by matching shapes.
    rotations += [r + rng.normal(0.0, 1e-15, (3, 3)) for r in Rotation.create_group("O").as_matrix() for _ in range(20)]
    for rotation in rotations:
        pose = storable(SE3(rotation, np.array([0.1, 0.2, 0.3])))
        assert np.abs(pose.rotation - rotation).max() < 5e-14
        again = pose_from_seven(pose_to_seven(pose))
        assert np.array_equal(again.homogeneous, pose.homogeneous)


def test_rounding_errors_do_not_change_euler_angles() -> None:
    rng = np.random.default_rng(1)
    for rotation in Rotation.create_group("O").as_matrix():
        exact = np.round(rotation)
        expected = pose_to_euler(SE3(exact, np.zeros(3)))
        assert (expected > -np.pi + 1e-6).all()
        for _ in range(20):
            noisy = exact + rng.normal(0.0, 1e-13, (3, 3))
            assert np.allclose(pose_to_euler(SE3(noisy, np.zeros(3))), expected, atol=1e-9)
            assert np.allclose(euler_from_rotations(noisy[None])[0], expected[3:], atol=1e-9)
