"""`RoboAssembly/Control-v0` as an environment of LeRobot: `--env.type=roboassembly`.

Observations have LeRobot's keys and the numbers of the data sets of `roboassembly demos`:

| key | shape | becomes |
|---|---|---|
| `agent_pos` | (64,) | `observation.state` |
| `environment_state` | (18 P + 7,) | `observation.environment_state` |
| `pixels/NAME` | (height, width, 3) | `observation.images.NAME` |
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from roboassembly.control.observation import REACH
from roboassembly.datasets import catalogue
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.features import (
    environment_state,
    environment_state_names,
    robot_state,
    robot_state_names,
)
from roboassembly.simulation.control_physics import CONTROL_RATE

GYM_ID = "lerobot_env_roboassembly/RoboAssembly-v0"
"""Name of the environment in Gymnasium's registry."""
ACTIONS = 22
"""Numbers of an action."""


@EnvConfig.register_subclass("roboassembly")
@dataclass
class RoboAssemblyEnv(EnvConfig):
    """Options of the environment; those that a data set has, too, must be the same."""

    task: str | None = "piece"
    """`piece` for a whole piece, `merge` for one merge."""
    fps: int = CONTROL_RATE
    furniture: str = "stool"
    """Name or folder of the piece."""
    merge: int | None = None
    """Number of the merge in the task `merge`; each episode draws one if None."""
    control: str = "joint_delta"
    """Mode of control."""
    cameras: list[str] = field(default_factory=list)
    """Cameras that are observed."""
    width: int = 128
    """Width of the pictures [pixels]."""
    height: int = 128
    """Height of the pictures [pixels]."""
    randomize: float = 0.0
    """Strength of the randomization, from 0 to 1."""
    layout: int | None = None
    """Seed of one layout for all episodes; each has its own if None."""
    part_position: float | None = None
    """Largest shift of each part at the start [m]; None for what `randomize` says."""
    part_angle: float | None = None
    """Largest turn of each part at the start [rad]; None for what `randomize` says."""
    max_parts: int | None = None
    """Padding of the state; the number of parts of the piece if None."""
    episode_length: int | None = None
    """Control steps after which an episode is truncated; 120 s a merge if None."""
    render_mode: str = "rgb_array"
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parts = len(catalogue.find(self.furniture).parts)
        self.max_parts = self.max_parts or parts
        self.episode_length = self.episode_length or 120 * CONTROL_RATE * (1 if self.task == "merge" else parts - 1)
        numbers = len(environment_state_names(self.max_parts))
        self.features = {
            "action": PolicyFeature(FeatureType.ACTION, (ACTIONS,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(robot_state_names()),)),
            "environment_state": PolicyFeature(FeatureType.ENV, (numbers,)),
        }
        self.features_map = {
            "action": "action", "agent_pos": "observation.state", "environment_state": "observation.environment_state",
        }  # fmt: skip
        for camera in self.cameras:
            self.features[f"pixels/{camera}"] = PolicyFeature(FeatureType.VISUAL, (self.height, self.width, 3))
            self.features_map[f"pixels/{camera}"] = f"observation.images.{camera}"

    @property
    def gym_id(self) -> str:
        """Name of the environment for `gymnasium.make`."""
        return GYM_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `gymnasium.make`."""
        return {
            "furniture": self.furniture, "task": self.task, "merge": self.merge, "control": self.control,
            "cameras": tuple(self.cameras), "width": self.width, "height": self.height, "randomize": self.randomize,
            "layout": self.layout, "part_position": self.part_position, "part_angle": self.part_angle,
            "max_parts": self.max_parts, "render_mode": self.render_mode, "max_episode_steps": self.episode_length,
        }  # fmt: skip


class LeRobotView(gymnasium.Wrapper[dict[str, Any], np.ndarray, dict[str, np.ndarray], np.ndarray]):
    """`RoboAssembly/Control-v0` with the observations that LeRobot expects.

    Args:
        furniture: name or folder of the piece.
        max_parts: padding of the state.
        render_mode: `rgb_array` or None.
        options: fields of `DemoConfig`.
    """

    def __init__(self, furniture: str, max_parts: int, render_mode: str | None = None, **options: Any) -> None:
        self._config = DemoConfig(**options)
        super().__init__(self._config.make_env(catalogue.find(furniture), max_parts, render_mode=render_mode))
        numbers = {
            "agent_pos": len(robot_state_names()), "environment_state": len(environment_state_names(max_parts)),
        }  # fmt: skip
        seen: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(-REACH, REACH, (size,), np.float32) for name, size in numbers.items()
        }
        shape = (self._config.height, self._config.width, 3)
        if self._config.cameras:
            seen["pixels"] = spaces.Dict({c: spaces.Box(0, 255, shape, np.uint8) for c in self._config.cameras})
        self.observation_space = spaces.Dict(seen)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; LeRobot's own options mean nothing here."""
        observation, info = self.env.reset(seed=seed, options=self._config.reset_options())
        return self._seen(observation), info

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Carry out one command."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._seen(observation), float(reward), terminated, truncated, info

    def _seen(self, observation: dict[str, np.ndarray]) -> dict[str, Any]:
        out: dict[str, Any] = {
            "agent_pos": robot_state(observation), "environment_state": environment_state(observation),
        }  # fmt: skip
        if self._config.cameras:
            out["pixels"] = {camera: observation[f"rgb_{camera}"] for camera in self._config.cameras}
        return out


def make_view(**arguments: Any) -> LeRobotView:
    """Return the environment; Gymnasium wants metadata of a class, which a wrapper's class does not have."""
    return LeRobotView(**arguments)


gymnasium.register(GYM_ID, entry_point=make_view)
