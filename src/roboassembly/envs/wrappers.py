"""Wrapper with flat actions, for learners that support only `Discrete`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Bool

from roboassembly.envs.arguments import checked_action, checked_number
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
        self._shape = tuple(int(n) for n in space.nvec)  # pyright: ignore[reportUnknownMemberType]
        self._names = getattr(env.unwrapped, "components", tuple(f"component {i}" for i in range(len(self._shape))))
        self._size = int(np.prod(self._shape))
        self.action_space = spaces.Discrete(self._size)

    def flatten(self, action: Sequence[int] | np.ndarray) -> int:
        """Return the number of an action.

        Raises:
            gymnasium.error.InvalidAction: an action that the wrapped environment does not have.
        """
        return int(np.ravel_multi_index(checked_action(action, self._shape, self._names), self._shape))

    def unflatten(self, number: np.ndarray | np.integer | int) -> tuple[int, ...]:
        """Return the action of a number.

        Raises:
            gymnasium.error.InvalidAction: a number that is no integer or out of range.
        """
        return tuple(int(i) for i in np.unravel_index(checked_number(number, self._size), self._shape))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the wrapped environment; the mask in its information becomes flat."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._flat(info)

    def step(self, action: np.ndarray | np.integer | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out the action of a number.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`, or after the end of the episode.
            gymnasium.error.InvalidAction: a number that is no integer or out of range.
        """
        observation, reward, terminated, truncated, info = self.env.step(np.array(self.unflatten(action)))
        return observation, float(reward), terminated, truncated, self._flat(info)

    def action_masks(self) -> Bool[np.ndarray, "n"]:
        """Return for each number whether its action exists."""
        return self.env.get_wrapper_attr("action_mask").ravel()

    def _flat(self, info: dict[str, Any]) -> dict[str, Any]:
        return {**info, "action_mask": info["action_mask"].ravel()}
