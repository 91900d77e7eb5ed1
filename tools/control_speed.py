"""Measures `RoboAssembly/Control-v0`: control steps a second of processor time, on a stool of nine parts.

`python tools/control_speed.py` prints one line for each kind of observation: steps with random small motions, and, with
state observations, the steps of a planned merge, with grips and a joint. Processor time counts all threads, so that
other work on the machine disturbs it little.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from roboassembly.control.env import ControlEnv
from roboassembly.control.replay import commands_of
from roboassembly.solvers.options import grasping

STEPS = 400


def steps_a_second(**arguments: Any) -> float:
    """Return the control steps a second of processor time of random small motions."""
    env = ControlEnv("stool", **arguments)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    env.step(np.zeros(22))
    begun = time.process_time()
    for _ in range(STEPS):
        env.step(0.1 * rng.uniform(-1.0, 1.0, 22))
    spent = time.process_time() - begun
    env.close()
    return STEPS / spent


def steps_a_second_of_a_merge(control: Any) -> float:
    """Return the control steps a second of processor time of a planned merge, from start to joint."""
    env = ControlEnv("stool", task="merge", control=control)
    env.reset(seed=0, options={"merge": 0})
    assert env.merge is not None
    task, state = env.task, env.state
    actions = grasping(task, state, state.groups, *(frozenset(group) for group in env.merge.groups))
    step = next(step for action in actions if (step := task.step(state, action, 0).step) is not None)
    recorded: list[np.ndarray] = []
    for targets, openings in commands_of(step.segments, env.cell):
        recorded.append(env.codec.encode(targets, openings, env.cell.physics.commands))
        if env.step(recorded[-1])[2]:
            break
    env.reset(seed=0, options={"merge": 0})
    begun = time.process_time()
    for action in recorded:
        *_, info = env.step(action)
    spent = time.process_time() - begun
    assert info["is_success"]
    return len(recorded) / spent


def main() -> None:
    """Print all figures."""
    for control in ("joint_position", "joint_delta", "end_effector_delta"):
        print(f"state, {control}: {steps_a_second(control=control):.0f} random, "
              f"{steps_a_second_of_a_merge(control):.0f} in a planned merge")  # fmt: skip
    for obs in ("rgb", "rgbd"):
        for cameras in (["wrist_a", "overview"], ["wrist_a", "wrist_b", "overview", "overview_back"]):
            print(f"{obs}, {len(cameras)} cameras of 128 x 128: {steps_a_second(obs=obs, cameras=cameras):.0f}")


if __name__ == "__main__":
    main()
