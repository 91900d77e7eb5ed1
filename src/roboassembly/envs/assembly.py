"""What both environments share: episodes of one or several pieces, rewards, masks and what they tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Bool

from roboassembly.envs.observation import Observation, Observer, observation_space
from roboassembly.errors import InputError
from roboassembly.furniture import catalogue
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.task.groups import TaskState
from roboassembly.task.rules import Rules
from roboassembly.task.setting import Outcome, Task

MERGE_REWARD = 1.0
COMPLETION_REWARD = 4.0
"""On top of the last merge's reward, when all parts are in one group."""
State = TypeVar("State")


ATask = TypeVar("ATask", bound=Task[Any, Any])
AnOutcome = TypeVar("AnOutcome", bound=Outcome[Any, Any])


class AssemblyEnv(gymnasium.Env[Observation, np.ndarray], Generic[ATask, State, AnOutcome]):
    """Join parts until the furniture stands; one wrong or infeasible choice ends the episode.

    Args:
        tasks: one a piece of furniture.
        ways: how many values each component of an action after `(u, v, k, l)` has.
        max_parts: padding P of spaces.
        max_points: padding K.
        cloud_points: points C of each part's cloud.

    Raises:
        InputError: furniture that exceeds the paddings.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(
        self, tasks: Sequence[ATask], ways: tuple[int, ...], max_parts: int, max_points: int, cloud_points: int
    ) -> None:
        for task in tasks:
            _check_padding(task.furniture, max_parts, max_points)
        self.tasks = tuple(tasks)
        self._observers = tuple(Observer(t.furniture, max_parts, max_points, cloud_points) for t in tasks)
        self._padding = (max_parts, max_points)
        self._current = 0
        self._state: State | None = None
        self._outcome: AnOutcome | None = None
        self._mask: Bool[np.ndarray, "P P K K ..."] | None = None
        self.observation_space = observation_space(max_parts, max_points, cloud_points)  # pyright: ignore[reportAttributeAccessIssue]
        self.action_space = spaces.MultiDiscrete([max_parts, max_parts, max_points, max_points, *ways])

    @property
    def task(self) -> ATask:
        """The rules for the current episode's furniture."""
        return self.tasks[self._current]

    @property
    def state(self) -> State:
        """The current state, for planners; policies see the observation.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before anything else")
        return self._state

    @property
    def last_outcome(self) -> AnOutcome | None:
        """What the last step led to, with its paths and planning time; None right after a reset."""
        return self._outcome

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Lay the parts out anew. `options={"furniture": index}` picks the piece.

        Raises:
            InputError: no such piece, or it does not suit the setting.
        """
        super().reset(seed=seed)
        wanted = (options or {}).get("furniture")
        if wanted is None:
            self._current = int(self.np_random.integers(len(self.tasks)))
        elif isinstance(wanted, int | np.integer) and 0 <= wanted < len(self.tasks):
            self._current = int(wanted)
        else:
            raise InputError(f"options['furniture'] is {wanted!r}; an index from 0 to {len(self.tasks) - 1} would do")
        self._outcome = None
        return self._enter(self.task.initial_state(self.np_random)), self._info("", 0)

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action."""
        names = tuple(int(a) for a in action)
        outcome: Any = self.task.step(self.state, names, int(self.np_random.integers(2**31 - 1)))
        self._outcome = outcome
        merged = outcome.step is not None
        observation = self._enter(outcome.state)
        done = merged and self._joined.complete
        reward = MERGE_REWARD * merged + COMPLETION_REWARD * done
        info = self._info(str(outcome.verdict), outcome.planning_steps)
        return observation, float(reward), done or not merged, False, info

    def action_masks(self) -> Bool[np.ndarray, "P P K K ..."]:
        """Which actions exist: both parts there and in different groups, both points there and free."""
        if self._mask is None:
            self._mask = self._existing(self.task, self.state)
        return self._mask.copy()

    def _existing(self, task: ATask, state: State) -> Bool[np.ndarray, "P P K K ..."]:
        """The mask of a state."""
        raise NotImplementedError

    @property
    def _joined(self) -> TaskState:
        return self.task.joined(self.state)

    def _enter(self, state: State) -> Observation:
        if state is not self._state:
            self._state, self._mask = state, None
        return self._observers[self._current].observe(self._joined)

    def _info(self, verdict: str, planning_steps: int) -> dict[str, Any]:
        return {
            "verdict": verdict,
            "success": self._joined.complete,
            "planning_steps": planning_steps,
            "groups": len(self._joined.groups),
            "furniture": self.task.furniture.name,
            "action_mask": self.action_masks(),
        }


def pieces_of(furniture: Furniture | str | Sequence[Furniture | str]) -> list[Furniture]:
    """Furniture, or names or folders as in `roboassembly assemble`; one or several.

    Raises:
        InputError: none, or something that is not there.
    """
    several = [furniture] if isinstance(furniture, Furniture | str) else list(furniture)
    if not several:
        raise InputError("no furniture given; name at least one piece")
    return [catalogue.find(f) if isinstance(f, str) else f for f in several]


def existing_pairs(
    rules: Rules, state: TaskState, max_parts: int = MAX_PARTS, max_points: int = MAX_POINTS
) -> Bool[np.ndarray, "P P K K"]:
    """Which `(u, v, k, l)` name free points of parts in different groups."""
    free = rules.free_points(state)[:max_parts, :max_points]
    group = np.full(max_parts, -1)
    for part, index in state.group_of.items():
        group[part] = index
    apart = group[:, None] != group[None]
    return apart[:, :, None, None] & free[:, None, :, None] & free[None, :, None, :]


def _check_padding(piece: Furniture, max_parts: int, max_points: int) -> None:
    points = max(len(p.points) for p in piece.parts)
    if not (1 <= max_parts <= MAX_PARTS and 1 <= max_points <= MAX_POINTS):
        raise InputError(f"max_parts {max_parts} and max_points {max_points}: 1 to {MAX_PARTS} and 1 to {MAX_POINTS}")
    if len(piece.parts) > max_parts or points > max_points:
        raise InputError(
            f"'{piece.name}' has {len(piece.parts)} parts and up to {points} points a part; "
            f"max_parts={max_parts}, max_points={max_points} are too small"
        )
