"""Actions of continuous control: what a number means in each mode, and that encoding undoes decoding."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.control.controls import (
    CONTROLS,
    ELBOW_SPEED,
    JOINT_SPEEDS,
    NUMBERS,
    PLACE_RANGE,
    PLATFORM_SPEED,
    ActionCodec,
    ControlName,
)  # fmt: skip
from roboassembly.robots.kinematics import arm
from roboassembly.robots.limits import TIP_SPEED
from roboassembly.robots.tip_motion import elbow_motion, follow_tip_motion, tip_motion
from roboassembly.task.full.segments import TUCKED

HERE = np.array([[-0.6, 0.1, 3.1, *TUCKED], [0.6, 0.0, -1.0, *TUCKED]])


def action(robot: int = 0, **numbers: float) -> np.ndarray:
    """Return an action of zeros but for some numbers of one robot, by their index after an underscore."""
    out = np.zeros(2 * NUMBERS)
    for name, value in numbers.items():
        out[robot * NUMBERS + int(name.removeprefix("_"))] = value
    return out


def test_joint_delta_is_a_change_of_the_command_within_the_speeds() -> None:
    codec = ActionCodec("joint_delta")
    reached, openings = codec.decode(action(1, _0=1.0, _4=-0.5, _10=1.0), HERE)
    assert reached[1, 0] - HERE[1, 0] == pytest.approx(PLATFORM_SPEED[0] / 20.0)
    assert reached[1, 4] - HERE[1, 4] == pytest.approx(-0.5 * JOINT_SPEEDS[1] / 20.0)
    np.testing.assert_array_equal(reached[0], HERE[0])
    np.testing.assert_allclose(openings, [0.04, 0.08])
    _, closed = codec.decode(action(0, _10=-1.0), HERE)
    assert closed[0] == 0.0


def test_joint_position_names_a_place_and_angles_that_are_reached_at_the_largest_speeds() -> None:
    codec = ActionCodec("joint_position")
    middle = 0.5 * (arm().low + arm().high)
    wanted = action(0)
    wanted[0], wanted[2] = -0.6 / PLACE_RANGE, -3.1 / np.pi
    commands = HERE.copy()
    for _ in range(60):
        commands, _ = codec.decode(wanted, commands)
    np.testing.assert_allclose(commands[0, 3:], middle, atol=1e-9)
    assert commands[0, :2] == pytest.approx([-0.6, 0.0])
    # The nearest turn with this yaw, across π and not back around.
    assert commands[0, 2] == pytest.approx(2.0 * np.pi - 3.1)
    one, _ = codec.decode(wanted, HERE)
    assert np.abs(one - HERE).max(axis=0)[3:] == pytest.approx(
        np.minimum(JOINT_SPEEDS / 20.0, np.abs(middle - TUCKED)), abs=1e-9
    )


def test_end_effector_delta_moves_the_tips_and_the_elbow_alone() -> None:
    codec = ActionCodec("end_effector_delta")
    before = arm().poses(HERE[:1, 3:])
    reached, _ = codec.decode(action(0, _3=0.1, _5=-0.2), HERE)
    after = arm().poses(reached[:1, 3:])
    moved = np.array([0.1, 0.0, -0.2]) * TIP_SPEED / 20.0
    np.testing.assert_allclose(after.translation - before.translation, moved[None], atol=1e-6)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-6)

    reached, _ = codec.decode(action(0, _9=0.4), HERE)
    after = arm().poses(reached[:1, 3:])
    np.testing.assert_allclose(after.translation, before.translation, atol=1e-6)
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-6)
    assert np.linalg.norm(reached[0, 3:] - HERE[0, 3:]) == pytest.approx(0.4 * ELBOW_SPEED / 20.0, rel=0.02)


def test_the_elbow_moves_in_the_null_space_of_the_jacobian() -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(arm().low, arm().high, (20, 7)):
        _, jacobian = arm().jacobians(q[None])
        np.testing.assert_allclose(jacobian[0] @ elbow_motion(q), 0.0, atol=1e-9)
        assert np.linalg.norm(elbow_motion(q)) == pytest.approx(1.0)


def test_tip_motion_and_its_inverse() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = TUCKED + rng.uniform(-0.3, 0.3, 7)
        goal = q + rng.uniform(-0.08, 0.08, 7)
        np.testing.assert_allclose(follow_tip_motion(q, tip_motion(q, goal)), goal, atol=2e-3)


@pytest.mark.parametrize("control", CONTROLS)
def test_encoding_undoes_decoding_along_a_path(control: ControlName) -> None:
    """Commands follow a path of both robots to a tenth of a millimetre and milliradian, in every mode."""
    codec, commands = ActionCodec(control), HERE.copy()
    rng = np.random.default_rng(2)
    ends = HERE + np.concatenate([rng.uniform(-0.5, 0.5, (2, 3)), rng.uniform(-0.4, 0.4, (2, 7))], axis=1)
    tips = 0.0
    for share in np.linspace(0.0, 1.0, 40):
        target = HERE + share * (ends - HERE)
        numbers = codec.encode(target, np.array([0.0, 0.05]), commands)
        assert numbers.dtype == np.float32
        assert np.abs(numbers).max() <= 1.0
        commands, openings = codec.decode(numbers.astype(float), commands)
        off = arm().poses(commands[:, 3:]).translation - arm().poses(target[:, 3:]).translation
        tips = max(tips, float(np.abs(off).max()))
        np.testing.assert_allclose(commands[:, :3], target[:, :3], atol=1e-5)
        np.testing.assert_allclose(openings, [0.0, 0.05], atol=1e-8)
    assert tips < 1e-4
    np.testing.assert_allclose(commands[:, 3:], ends[:, 3:], atol=1e-3)


def test_joints_stay_within_their_limits() -> None:
    for control in CONTROLS:
        codec, commands = ActionCodec(control), HERE.copy()
        rng = np.random.default_rng(3)
        for _ in range(200):
            commands, _ = codec.decode(np.sign(rng.uniform(-1.0, 1.0, 22)), commands)
            assert arm().within(commands[:, 3:] * (1.0 - 1e-12)).all()
