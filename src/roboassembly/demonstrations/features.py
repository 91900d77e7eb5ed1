"""Numbers that demonstrations record in each frame, with their names.

| feature | numbers |
|---|---|
| `observation.state` | `robots` of the state observation, R_a's row, then R_b's |
| `observation.environment_state` | `parts`, `groups`, `held`, `assembled`, `goal` and `goal_pose` of it in turn |
| `action` | an action of the environment |
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32

from roboassembly.control.observation import ROBOT_FIELDS

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_OF_PARTS = ("parts", "groups", "held", "assembled", "goal", "goal_pose")
"""Keys of a state observation that describe the parts, in the order of `observation.environment_state`."""


def robot_state(observation: Mapping[str, np.ndarray]) -> Float32[np.ndarray, "64"]:
    """Return `observation.state`: what both robots feel."""
    return observation["robots"].ravel()


def robot_state_names() -> list[str]:
    """Return the names of the numbers of `observation.state`."""
    return [f"{robot}/{field}" for robot in "ab" for field in ROBOT_FIELDS]


def environment_state(observation: Mapping[str, np.ndarray]) -> Float32[np.ndarray, "n"]:
    """Return `observation.environment_state`: where parts are, who holds them, and where they belong."""
    return np.concatenate([observation[key].ravel() for key in _OF_PARTS])


def environment_state_names(max_parts: int) -> list[str]:
    """Return the names of the numbers of `observation.environment_state`.

    Args:
        max_parts: padding of the state.
    """
    parts = range(max_parts)
    return [
        *(f"part{p}/{axis}" for p in parts for axis in _POSE),
        *(f"part{p}/group" for p in parts),
        *(f"part{p}/held_by_{robot}" for p in parts for robot in "ab"),
        *(f"part{p}/assembled_{axis}" for p in parts for axis in _POSE),
        *(f"part{p}/goal" for p in parts),
        *(f"goal_pose/{axis}" for axis in _POSE),
    ]
