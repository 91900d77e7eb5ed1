"""Planned merges and their replay, which several tests of control share."""

from __future__ import annotations

from typing import Any

import numpy as np

from roboassembly.control.env import ControlEnv
from roboassembly.control.replay import commands_of
from roboassembly.solvers.options import grasping
from roboassembly.task.plans.full_plan import FullStep


def planned_merge(env: ControlEnv) -> FullStep:
    """Return a plan of the merge that the environment asks for, from its present state."""
    assert env.merge is not None
    task, state = env.task, env.state
    for leaving, staying in (env.merge.groups, env.merge.groups[::-1]):
        for action in grasping(task, state, state.groups, frozenset(leaving), frozenset(staying)):
            step = task.step(state, action, 0).step
            if step is not None:
                return step
    raise AssertionError("nothing merges; choose another seed")


def carry_out(env: ControlEnv, step: FullStep) -> tuple[list[np.ndarray], list[float], dict[str, Any]]:
    """Carry out a planned merge until the episode ends; return actions, rewards and the last information."""
    actions: list[np.ndarray] = []
    rewards: list[float] = []
    info: dict[str, Any] = {}
    for targets, openings in commands_of(step.segments, env.cell):
        actions.append(env.codec.encode(targets, openings, env.cell.physics.commands))
        _, reward, terminated, truncated, info = env.step(actions[-1])
        rewards.append(reward)
        if terminated or truncated:
            break
    return actions, rewards, info
