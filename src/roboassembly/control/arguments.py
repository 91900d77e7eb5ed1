"""Checks of the arguments of `RoboAssembly/Control-v0`; errors name the value and what would do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import numpy as np

from roboassembly.envs.arguments import checked_index, reset_options, shortened
from roboassembly.errors import ArgumentError

TaskName = Literal["merge", "piece"]
ObservationName = Literal["state", "rgb", "rgbd", "state+rgb", "state+rgbd"]
RewardName = Literal["sparse", "dense"]
_LONGEST = 1e6
"""Largest time limit [s]."""


@dataclass(frozen=True)
class ControlOptions:
    """Arguments of an environment that stay the same in all its episodes."""

    task: TaskName
    obs: ObservationName
    reward: RewardName
    time_limit: float | None
    """Time after which an episode is truncated [s]; None for the usual one."""
    strict: bool
    """Whether collisions end an episode."""
    max_parts: int

    @property
    def sees_state(self) -> bool:
        """Whether the poses of parts are observed."""
        return self.obs.startswith("state")

    @property
    def sees_pictures(self) -> bool:
        """Whether the pictures of the cameras are observed."""
        return "rgb" in self.obs


def checked_choice(name: str, value: object, choices: Any) -> None:
    """Check that an argument is one of the strings of a `Literal`.

    Raises:
        ArgumentError: it is not.
    """
    known: tuple[str, ...] = get_args(choices)
    if value not in known:
        raise ArgumentError(f"{name} is {shortened(value)}; expected {', '.join(map(repr, known))}")


def checked_time_limit(value: object) -> float | None:
    """Return a time limit in seconds, or None.

    Raises:
        TypeError: no number.
        ArgumentError: not positive, or longer than anybody waits.
    """
    if value is None:
        return None
    if isinstance(value, np.generic):
        value = cast("np.generic[Any]", value).item()
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"time_limit is {shortened(value)}; expected a number of seconds, or None for 120 s a merge")
    if not 0.0 < float(value) <= _LONGEST:
        raise ArgumentError(f"time_limit is {shortened(value)}; expected more than 0 and at most {_LONGEST:g} seconds")
    return float(value)


def checked_options(options: object, merges: Sequence[int], task: TaskName) -> tuple[int | None, int | None]:
    """Return the indices of piece and merge in the options of `reset`; None for what they do not name.

    Args:
        options: options from the user.
        merges: number of merges of each piece.
        task: task of the environment.

    Raises:
        TypeError: the options are no dictionary.
        ArgumentError: an unknown option, no such piece or no such merge.
    """
    named = reset_options(options, ("furniture", "merge"))
    piece = checked_index(named, "furniture", len(merges))
    if named.get("merge") is not None and task != "merge":
        raise ArgumentError(f"options['merge'] is {shortened(named['merge'])}; only task='merge' takes it")
    if named.get("merge") is not None and piece is None and len(merges) > 1:
        raise ArgumentError("options['merge'] needs options['furniture'] where there are several pieces")
    return piece, checked_index(named, "merge", merges[piece or 0])
