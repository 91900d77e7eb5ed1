"""Base of both environments: episodes of one or several pieces, rewards, masks, pictures and errors."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Generic, NoReturn, TypeVar, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from jaxtyping import Bool, UInt8

from roboassembly.datasets import catalogue
from roboassembly.envs.arguments import (
    RGB_ARRAY,
    checked_action,
    checked_integer,
    checked_piece,
    checked_render_mode,
    may_render,
    shortened,
)  # fmt: skip
from roboassembly.envs.observation import Observation, ObservationConfig, Observer, observation_space
from roboassembly.envs.pictures import EpisodePictures, Item
from roboassembly.errors import ArgumentError
from roboassembly.furniture.model import MOST_PARTS, Furniture
from roboassembly.rendering.colors import Role
from roboassembly.task.rules.groups import TaskState
from roboassembly.task.setting import Outcome, Task

FurnitureLike = Furniture | str | os.PathLike[str]
"""Furniture, its name as in `roboassembly assemble`, or its folder."""
MERGE_REWARD = 1.0
COMPLETION_REWARD = 4.0
"""Reward in addition to that of the last merge, when all parts are in one group."""
LARGEST_CLOUD = 65_536
"""Largest number of points of a part's cloud."""
State = TypeVar("State")
ATask = TypeVar("ATask", bound=Task[Any, Any])
AnOutcome = TypeVar("AnOutcome", bound=Outcome[Any, Any])


class AssemblyEnv(gymnasium.Env[Observation, np.ndarray], Generic[ATask, State, AnOutcome]):
    """Join parts until the furniture stands; one wrong or infeasible choice ends the episode.

    Args:
        tasks: one for each piece of furniture.
        action_branches: number of values of each component of an action after `(u, v, k, l)`.
        max_parts: padding P of spaces.
        max_points: padding K.
        cloud_points: number C of points in each part's cloud.
        render_mode: None, or `"rgb_array"` for pictures.
        width: width of pictures [pixels].
        height: height of pictures [pixels].
        observes: configuration of the observations.

    Raises:
        ArgumentError: a value that is out of range, or furniture that exceeds the paddings.
        TypeError: a padding or number of points that is no integer.
        gymnasium.error.UnsupportedMode: an unknown render mode.
    """

    metadata = {"render_modes": [RGB_ARRAY], "render_fps": 2}  # noqa: RUF012 (Gymnasium's own form)
    components: ClassVar[tuple[str, ...]]
    """Names of an action's components."""

    def __init__(
        self, tasks: Sequence[ATask], action_branches: tuple[int, ...], max_parts: int, max_points: int,
        cloud_points: int, render_mode: str | None, width: int, height: int, observes: ObservationConfig,
    ) -> None:  # fmt: skip
        max_parts = checked_integer("max_parts", max_parts, 1, MOST_PARTS)
        max_points = checked_integer("max_points", max_points, 1, MOST_PARTS)
        cloud_points = checked_integer("cloud_points", cloud_points, 1, LARGEST_CLOUD)
        for task in tasks:
            _check_padding(task.furniture, max_parts, max_points)
        self.render_mode = checked_render_mode(render_mode)
        self.tasks = list(tasks)
        self._padding = (max_parts, max_points)
        self._cloud_points, self._observes = cloud_points, observes
        self._observers = [self._observer(task, None) for task in tasks]
        self._sizes = (max_parts, max_parts, max_points, max_points, *action_branches)
        self._current = 0
        self._state: State | None = None
        self._outcome: AnOutcome | None = None
        self._ending: str | None = None
        self._mask: Bool[np.ndarray, "P P K K ..."] | None = None
        self._roles: dict[int, Role] = {}
        self._pictures = EpisodePictures(width, height)
        self.observation_space = observation_space(max_parts, max_points, cloud_points)  # pyright: ignore[reportAttributeAccessIssue]
        self.action_space = spaces.MultiDiscrete(list(self._sizes))

    @property
    def task(self) -> ATask:
        """Task of the current episode's furniture."""
        return self.tasks[self._current]

    @property
    def state(self) -> State:
        """Current state, for planners; policies see the observation.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        if self._state is None:
            raise ResetNeeded("the environment has no state yet; call reset() first")
        return self._state

    @property
    def last_outcome(self) -> AnOutcome | None:
        """Outcome of the last step, with its paths and planning time; None after a reset."""
        return self._outcome

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with a new layout of the parts; `options={"furniture": index}` selects the piece.

        Raises:
            ArgumentError: an unknown option, or no such piece.
            TypeError: options that are no dictionary.
            InputError: the piece does not suit the setting.
        """
        index = checked_piece(options, len(self.tasks))
        super().reset(seed=seed)
        self._current = int(self.np_random.integers(len(self.tasks))) if index is None else index
        self._state, self._outcome, self._ending, self._roles = None, None, None, {}
        self._pictures.start()
        state = self.task.initial_state(self.np_random)
        if not self._observes.is_default:
            observer = self._observer(self.task, self.np_random)
            self._observers[self._current] = observer
            self.tasks[self._current] = self.task.with_frames(observer.frames)
        return self._enter(state), self._info("", 0)

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action. An action of the action space that does not exist ends the episode.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`, or after the end of the episode.
            gymnasium.error.InvalidAction: an action that is not within the action space.
        """
        state = self.state
        if self._ending is not None:
            raise ResetNeeded(f"the episode is over (its last verdict is '{self._ending}'); call reset() first")
        choice = checked_action(action, self._sizes, self.components)
        roles = self._roles_of(choice)
        outcome: Any = self.task.step(state, choice, int(self.np_random.integers(2**31 - 1)))
        self._outcome, self._roles = outcome, roles
        merged = outcome.step is not None
        observation = self._enter(outcome.state)
        done = merged and self._joined.complete
        over = done or not merged
        self._ending = str(outcome.verdict) if over else None
        reward = reward_of(merged, done)
        info = self._info(str(outcome.verdict), outcome.planning_steps)
        return observation, reward, over, False, info

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the present state; the group that the last action moved is orange, the group it moved to is green.

        Returns:
            The picture; None if the environment was made without a render mode.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
            RenderingUnavailableError: this machine cannot draw off screen; the message says what to install.
        """
        if not may_render(self.render_mode):
            return None
        _ = self.state
        return self._pictures.draw(self._items())

    def close(self) -> None:
        """Free the renderer."""
        self._pictures.close()

    @property
    def action_mask(self) -> Bool[np.ndarray, "P P K K ..."]:
        """Mask of the actions that exist: parts in different groups, and free points of these parts."""
        if self._mask is None:
            self._mask = self.task.existing_actions(self.task.groups_of(self.state), *self._padding)
        return self._mask.copy()

    def action_masks(self) -> NoReturn:
        """Tell learners that ask for masks to wrap the environment.

        Raises:
            gymnasium.error.Error: always. MaskablePPO of sb3-contrib calls this method and takes a mask for each
                component of a `MultiDiscrete` action alone, which cannot say which combinations exist.
        """
        raise gymnasium.error.Error(
            f"masks of {type(self).__name__} are for whole actions, not for single components; wrap the environment: "
            "roboassembly.envs.wrappers.DiscreteActions(env), which has action_masks(); or read info['action_mask']"
        )

    @property
    def _joined(self) -> TaskState:
        return self.task.groups_of(self.state)

    def _observer(self, task: ATask, rng: np.random.Generator | None) -> Observer:
        return Observer(task.furniture, *self._padding, self._cloud_points, self._observes, rng)

    def _enter(self, state: State) -> Observation:
        if state is not self._state:
            self._state, self._mask = state, None
            if self.render_mode is not None:
                self._pictures.add(self._items())
        return self._observers[self._current].observe(self._joined)

    def _roles_of(self, action: tuple[int, ...]) -> dict[int, Role]:
        """Return the roles of the parts of both groups that an action names; empty unless it names two."""
        joined = self._joined
        u, v = (joined.group_of.get(part) for part in action[:2])
        if u is None or v is None or u == v:
            return {}
        groups = (joined.groups[u].parts, Role.MOVING), (joined.groups[v].parts, Role.WAITING)
        return {part: role for parts, role in groups for part in parts}

    def _items(self) -> list[Item]:
        """Return the items in a picture of the present state."""
        parts = zip(self.task.furniture.parts, self._joined.part_poses, strict=True)
        return [Item(part.mesh, pose, self._roles.get(p, Role.IDLE)) for p, (part, pose) in enumerate(parts)]

    def _info(self, verdict: str, planning_steps: int) -> dict[str, Any]:
        return {
            "verdict": verdict,
            "success": self._joined.complete,
            "planning_steps": planning_steps,
            "groups": len(self._joined.groups),
            "furniture": self.task.furniture.name,
            "action_mask": self.action_mask,
        }


def reward_of(merged: bool, complete: bool) -> float:
    """Return the reward of a step that merged two groups or not, and left the furniture complete or not."""
    return MERGE_REWARD * merged + COMPLETION_REWARD * complete


def pieces_of(furniture: FurnitureLike | Iterable[FurnitureLike]) -> list[Furniture]:
    """Return one or several pieces, given as furniture, or as names or folders as in `roboassembly assemble`.

    Raises:
        TypeError: something else.
        ArgumentError: none.
        InputError: a name or folder that is not there, or a folder without valid furniture.
    """
    single = isinstance(furniture, Furniture | str | os.PathLike)
    several: object = cast("object", [furniture] if single else furniture)
    if not isinstance(several, Iterable):
        raise TypeError(
            f"furniture is {shortened(furniture)}; expected a name, a folder, a Furniture, or a list of them"
        )
    pieces: list[Furniture] = []
    for piece in cast("Iterable[object]", several):
        if not isinstance(piece, Furniture | str | os.PathLike):
            raise TypeError(f"furniture contains {shortened(piece)}; expected names, folders and objects of Furniture")
        pieces.append(piece if isinstance(piece, Furniture) else catalogue.find(os.fspath(piece)))
    if not pieces:
        raise ArgumentError("no furniture given; name at least one piece")
    return pieces


def _check_padding(piece: Furniture, max_parts: int, max_points: int) -> None:
    points = piece.most_points
    if len(piece.parts) > max_parts or points > max_points:
        raise ArgumentError(
            f"'{piece.name}' has {len(piece.parts)} parts and up to {points} points a part; "
            f"max_parts={max_parts}, max_points={max_points} are too small: give max_parts={piece.padding[0]}, "
            f"max_points={piece.padding[1]}"
        )
