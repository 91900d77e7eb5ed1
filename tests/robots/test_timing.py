"""Timed paths: within the limits of the robots, on the path, as quick as they can be."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from roboassembly.robots.body import tip_positions
from roboassembly.robots.dynamics import motion_forces
from roboassembly.robots.kinematics import arm
from roboassembly.robots.limits import JOINT_TORQUES, LIMITS, MOTION_SHARE, TIP_SPEED, magnitudes
from roboassembly.robots.timing import TICK, TimedPath
from roboassembly.simulation.mobile_arms import NAMES, model_of

HOME = np.array([0.0, 0.0, 0.0, 0.0, -1.2, 0.0, -2.6, 0.0, 2.0, 0.785])
AXES = np.eye(10)
FULL = np.array([LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk])


def used(timed: TimedPath) -> np.ndarray:
    """Largest shares of the limits of velocity, acceleration and jerk, by differences of positions from tick to tick.

    A difference of order k is a mean of the k-th derivative over k ticks: it is at most the derivative's maximum.
    """
    q = timed.ticks().position
    still = np.tile(timed.start, (3, 1)), np.tile(timed.end, (3, 1))
    q = np.vstack([still[0], q, still[1]])
    return np.array([(magnitudes(np.diff(q, k, axis=0) / TICK**k) / FULL[k - 1]).max() for k in (1, 2, 3)])


def random_paths(count: int) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(0)
    low, high = np.r_[-2.0, -2.0, -3.0, arm().low], np.r_[2.0, 2.0, 3.0, arm().high]
    corners = [list(rng.uniform(low, high, (rng.integers(2, 5), 10))) for _ in range(count)]
    bows = []
    for _ in range(count):
        a, b = rng.uniform(low, high, (2, 10))
        s = np.linspace(0.0, 1.0, 9)[:, None]
        bows.append(list(a + s * 0.2 * (b - a) + 0.01 * s * (1.0 - s) * rng.normal(size=10)))
    return corners + bows


def test_a_metre_takes_what_it_takes_by_hand() -> None:
    """Speed 1.2 m/s, reached at 3 m/s² and 50 m/s³: distance / speed + speed / acceleration + acceleration / jerk."""
    timed = TimedPath([HOME, HOME + AXES[0]])
    expected = 1.0 / 1.2 + 1.2 / 3.0 + 3.0 / 50.0
    assert timed.seconds == pytest.approx(expected, abs=TICK)
    assert timed.seconds >= expected - 1e-9
    middle = timed.states(np.array([0.5 * timed.seconds]))
    assert middle.position[0, 0] == pytest.approx(0.5)
    assert middle.velocity[0, 0] == pytest.approx(1.2, rel=1e-2)
    # The same way in any direction takes the same time: the platform has one speed, not one for x and one for y.
    across = TimedPath([HOME, HOME + np.sqrt(0.5) * (AXES[0] + AXES[1])])
    assert across.seconds == pytest.approx(timed.seconds)
    # 1 rad of joint 5 at 2.61 rad/s, 15 rad/s² and 7500 rad/s³.
    turned = TimedPath([HOME, HOME + AXES[7]])
    assert turned.seconds == pytest.approx(1.0 / 2.61 + 2.61 / 15.0 + 15.0 / 7500.0, abs=TICK)


@pytest.mark.parametrize("index", range(24))
def test_differences_of_the_samples_keep_all_limits(index: int) -> None:
    timed = TimedPath(random_paths(12)[index])
    shares = used(timed)
    assert shares.max() <= 1.0 + 1e-6
    # Velocity, acceleration, jerk, torque or the tips' speed: something is always at its limit.
    states = timed.ticks()
    torques = motion_forces(states.position, states.velocity, states.acceleration)[:, 3:]
    torque = (np.abs(torques) / (MOTION_SHARE * np.array(JOINT_TORQUES))).max()
    assert torque <= 1.01
    tips = tip_positions(np.vstack([timed.start, states.position]))
    speed = np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / TICK / TIP_SPEED
    assert speed < 1.01
    assert max(*shares, torque, speed) > 0.97


def test_a_robot_stays_on_its_path_and_stops_where_it_bends() -> None:
    path = [HOME, HOME + AXES[0], HOME + AXES[0] + AXES[1]]
    timed = TimedPath(path)
    states = timed.ticks()
    off = np.minimum(np.abs(states.position[:, 1]), np.abs(states.position[:, 0] - 1.0))
    assert off.max() < 1e-9
    at = int(np.argmin(np.linalg.norm(states.position - path[1], axis=1)))
    assert np.linalg.norm(states.velocity[at]) < 1e-6
    assert np.allclose(states.position[-1], path[-1])
    assert np.abs(states.velocity[-1]).max() < 1e-6
    assert timed.seconds == pytest.approx(2.0 * TimedPath(path[:2]).seconds)
    straight = TimedPath([HOME, HOME + 0.5 * AXES[0], HOME + AXES[0]])
    # A curve keeps a little more distance from its limits than a line.
    assert straight.seconds == pytest.approx(TimedPath(path[:2]).seconds, rel=0.02)
    assert np.linalg.norm(straight.ticks().velocity[50:-50], axis=1).min() > 0.01


def test_a_motion_that_goes_nowhere_takes_no_time() -> None:
    for path in ([HOME], [HOME, HOME], [HOME, HOME + 1e-12]):
        timed = TimedPath(path)
        assert timed.seconds == 0.0
        assert len(timed.ticks().position) == 0
        assert np.array_equal(timed.states(np.array([-1.0, 0.0, 5.0])).position, np.tile(HOME, (3, 1)))


def test_tips_keep_their_speed() -> None:
    path = [HOME, HOME + 0.4 * AXES[0] + 0.2 * AXES[4] + 0.3 * AXES[6]]
    timed = TimedPath(path, replace(LIMITS, tip_speed=0.25))
    tips = tip_positions(np.vstack([HOME, timed.ticks().position]))
    speed = np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / TICK
    assert 0.2 < speed < 0.2505
    assert timed.seconds > TimedPath(path).seconds


def test_a_load_slows_motions_by_its_inertia() -> None:
    """Three kilograms 0.3 m beside the hand: the wrist's 12 N·m limit the motion."""
    path = [HOME, HOME + 0.5 * AXES[7] - AXES[8]]
    load = pin.Inertia(3.0, np.array([0.3, 0.0, 0.0]), 0.05 * np.eye(3))
    empty, laden = TimedPath(path), TimedPath(path, payload=load)
    assert laden.seconds > 1.1 * empty.seconds
    states = laden.ticks()
    torques = np.abs(motion_forces(states.position, states.velocity, states.acceleration, load)[:, 3:])
    share = (torques / (MOTION_SHARE * np.array(JOINT_TORQUES))).max()
    assert 0.97 < share < 1.01


def test_forces_are_those_of_the_physics() -> None:
    model = model_of([])
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    dofs = [model.joint(f"a/{name}").dofadr[0] for name in NAMES]
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, v, a = HOME + rng.uniform(-0.5, 0.5, 10), rng.uniform(-1.0, 1.0, 10), rng.uniform(-5.0, 5.0, 10)
        data.qpos[dofs], data.qvel[dofs], data.qacc[dofs] = q, v, a
        mujoco.mj_inverse(model, data)
        expected = (data.qfrc_inverse + data.qfrc_passive)[dofs]
        # Physics has fingers of 0.1 kg at the tips, the URDF of 0.015 kg behind them.
        fingers = pin.Inertia(0.17, np.zeros(3), 2e-4 * np.eye(3))
        assert np.allclose(motion_forces(q[None], v[None], a[None], fingers)[0], expected, rtol=0.01, atol=0.2)


def test_half_the_speed_takes_a_quarter_of_the_force() -> None:
    rng = np.random.default_rng(2)
    q, v, a = rng.uniform(-0.5, 0.5, (3, 4, 10))
    load = pin.Inertia(2.0, np.array([0.0, 0.1, 0.05]), 0.02 * np.eye(3))
    whole = motion_forces(q, v, a, load)
    assert np.allclose(motion_forces(q, 0.5 * v, 0.25 * a, load), 0.25 * whole)
    # The load of one call is not left for the next.
    assert not np.allclose(motion_forces(q, v, a), whole)
    assert np.allclose(motion_forces(q, v, a, load), whole)
