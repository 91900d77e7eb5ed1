"""A flat view of the actions, for learners that know only `Discrete`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Bool

from roboassembly.errors import InputError


class DiscreteActions(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Number a `MultiDiscrete` environment's actions from 0, the last component fastest (NumPy's C order).

    `action_masks()` and `info["action_mask"]` become flat, the form that sb3-contrib's `MaskablePPO` takes.

    Raises:
        InputError: the environment's actions are not `MultiDiscrete`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        space = env.action_space
        if not isinstance(space, spaces.MultiDiscrete):
            raise InputError(f"DiscreteActions wraps MultiDiscrete actions; got {space}")
        self._shape = tuple(int(n) for n in space.nvec)
        self.action_space = spaces.Discrete(int(np.prod(self._shape)))

    def flatten(self, action: tuple[int, ...]) -> int:
        """The number of an action."""
        return int(np.ravel_multi_index(action, self._shape))

    def unflatten(self, number: int) -> tuple[int, ...]:
        """The action of a number."""
        return tuple(int(i) for i in np.unravel_index(int(number), self._shape))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """As the wrapped environment's."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._flat(info)

    def step(self, action: np.integer | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """As the wrapped environment's, by number."""
        observation, reward, terminated, truncated, info = self.env.step(np.array(self.unflatten(int(action))))
        return observation, float(reward), terminated, truncated, self._flat(info)

    def action_masks(self) -> Bool[np.ndarray, "n"]:
        """Which numbers are actions that exist."""
        return self.env.get_wrapper_attr("action_masks")().ravel()

    def _flat(self, info: dict[str, Any]) -> dict[str, Any]:
        return {**info, "action_mask": info["action_mask"].ravel()}
