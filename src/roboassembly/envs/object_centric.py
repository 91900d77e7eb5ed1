"""`RoboAssembly/ObjectCentric-v0`: the paper's object-centric setting as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Bool

from roboassembly.envs.observation import Observation, Observer, observation_space
from roboassembly.errors import InputError
from roboassembly.furniture import catalogue
from roboassembly.furniture.model import MAX_PARTS, MAX_POINTS, Furniture
from roboassembly.planning.problem import Budget
from roboassembly.task.groups import TaskState
from roboassembly.task.object_centric import ObjectCentricTask, Outcome, Verdict
from roboassembly.task.rules import UP_AXES

MERGE_REWARD = 1.0
COMPLETION_REWARD = 4.0
"""On top of the last merge's reward, when all parts are in one group."""


class ObjectCentricEnv(gymnasium.Env[Observation, np.ndarray]):
    """Join parts until the furniture stands; one wrong or infeasible choice ends the episode.

    **Observation**: the `Dict` described in `roboassembly.envs.observation`.

    **Action** `(u, v, k, l, w)`, `MultiDiscrete([P, P, K, K, 6])`: point `k` of part `u` is brought onto point `l` of
    part `v`, whose group waits with axis `w` of the furniture's frame up: 0 +z, 1 -z, 2 +x, 3 -x, 4 +y, 5 -y.

    **Reward**: 1 for a merge, 4 more for the last one, else 0 and the episode ends.

    **Info**: `verdict` (a value of `Verdict`: why the step ended as it did), `success`, `planning_steps` of the step,
    `groups` (how many are left), `furniture` (its name), and `action_mask`, which tells the actions that exist; it
    says nothing about which are right. All of it is reproducible; how long the planner took is in `last_outcome`.

    Args:
        furniture: what to assemble: furniture, or a name or folder as in `roboassembly assemble`. Of several, each
            episode draws one, or takes the one that `reset(options={"furniture": index})` asks for.
        max_parts: padding P of spaces, 20 as in the paper by default. Smaller spaces suit small furniture.
        max_points: padding K, 10 as in the paper by default.
        cloud_points: points C of each part's cloud.
        budget: of the planner, for each step.

    Raises:
        InputError: furniture that exceeds the paddings, or none at all.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(
        self,
        furniture: Furniture | str | Sequence[Furniture | str] = catalogue.DEFAULT,
        *,
        max_parts: int = MAX_PARTS,
        max_points: int = MAX_POINTS,
        cloud_points: int = 128,
        budget: Budget | None = None,
    ) -> None:
        several = [furniture] if isinstance(furniture, Furniture | str) else list(furniture)
        if not several:
            raise InputError("no furniture given; name at least one piece")
        pieces = [catalogue.find(f) if isinstance(f, str) else f for f in several]
        for piece in pieces:
            _check_padding(piece, max_parts, max_points)
        self.tasks = tuple(ObjectCentricTask(piece, budget) for piece in pieces)
        self._observers = tuple(Observer(piece, max_parts, max_points, cloud_points) for piece in pieces)
        self._padding = (max_parts, max_points)
        self._current = 0
        self._state: TaskState | None = None
        self._outcome: Outcome | None = None
        self._mask: Bool[np.ndarray, "P P K K 6"] | None = None
        self.observation_space = observation_space(max_parts, max_points, cloud_points)  # pyright: ignore[reportAttributeAccessIssue]
        self.action_space = spaces.MultiDiscrete([max_parts, max_parts, max_points, max_points, len(UP_AXES)])

    @property
    def task(self) -> ObjectCentricTask:
        """The rules for the current episode's furniture."""
        return self.tasks[self._current]

    @property
    def state(self) -> TaskState:
        """The current state, for planners; policies see the observation.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() before anything else")
        return self._state

    @property
    def last_outcome(self) -> Outcome | None:
        """What the last step led to, with its path and planning time; None right after a reset."""
        return self._outcome

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Scatter the parts on the ground. `options={"furniture": index}` picks the piece."""
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
        outcome = self.task.step(self.state, names, int(self.np_random.integers(2**31 - 1)))
        merged = outcome.verdict is Verdict.MERGED
        observation = self._enter(outcome.state)
        done = merged and outcome.state.complete
        reward = MERGE_REWARD * merged + COMPLETION_REWARD * done
        info = self._info(outcome.verdict.value, outcome.planning_steps)
        self._outcome = outcome
        return observation, float(reward), done or not merged, False, info

    def action_masks(self) -> Bool[np.ndarray, "P P K K 6"]:
        """Which actions exist: both parts there and in different groups, both points there and free."""
        if self._mask is None:
            self._mask = existing_actions(self.task, self.state, *self._padding)
        return self._mask.copy()

    def _enter(self, state: TaskState) -> Observation:
        if state is not self._state:
            self._state, self._mask = state, None
        return self._observers[self._current].observe(state)

    def _info(self, verdict: str, planning_steps: int) -> dict[str, Any]:
        return {
            "verdict": verdict,
            "success": self.state.complete,
            "planning_steps": planning_steps,
            "groups": len(self.state.groups),
            "furniture": self.task.furniture.name,
            "action_mask": self.action_masks(),
        }


def existing_actions(
    task: ObjectCentricTask, state: TaskState, max_parts: int = MAX_PARTS, max_points: int = MAX_POINTS
) -> Bool[np.ndarray, "P P K K 6"]:
    """The mask of actions that exist in a state, indexed by `(u, v, k, l, w)`."""
    free = task.free_points(state)[:max_parts, :max_points]
    group = np.full(max_parts, -1)
    for part, index in state.group_of.items():
        group[part] = index
    apart = group[:, None] != group[None]
    pairs = apart[:, :, None, None] & free[:, None, :, None] & free[None, :, None, :]
    return np.repeat(pairs[..., None], len(UP_AXES), axis=-1)


def _check_padding(piece: Furniture, max_parts: int, max_points: int) -> None:
    points = max(len(p.points) for p in piece.parts)
    if not (1 <= max_parts <= MAX_PARTS and 1 <= max_points <= MAX_POINTS):
        raise InputError(f"max_parts {max_parts} and max_points {max_points}: 1 to {MAX_PARTS} and 1 to {MAX_POINTS}")
    if len(piece.parts) > max_parts or points > max_points:
        raise InputError(
            f"'{piece.name}' has {len(piece.parts)} parts and up to {points} points a part; "
            f"max_parts={max_parts}, max_points={max_points} are too small"
        )
