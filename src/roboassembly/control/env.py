"""`RoboAssembly/Control-v0`: two mobile Frankas under continuous control in physics, as a Gymnasium environment."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from jaxtyping import UInt8

from roboassembly.control.arguments import (
    ControlOptions,
    ObservationName,
    RewardName,
    TaskName,
    checked_choice,
    checked_options,
    checked_time_limit,
)  # fmt: skip
from roboassembly.control.cameras import CAMERAS, checked_cameras
from roboassembly.control.cell import CellEvents, ControlCell
from roboassembly.control.collisions import CollisionTest
from roboassembly.control.controls import ActionCodec, ControlName, checked_numbers
from roboassembly.control.observation import Goal, StateObserver, state_space
from roboassembly.control.pictures import EpisodeCameras, PictureConfig, picture_space
from roboassembly.control.randomization import NONE, Randomization, Variation
from roboassembly.control.reward import NextMerge
from roboassembly.control.starts import MergeTask, goal_pose, merge_tasks, shifted, start_of_merge
from roboassembly.datasets import catalogue
from roboassembly.envs.arguments import RGB_ARRAY, checked_integer, checked_render_mode, may_render, shortened
from roboassembly.envs.assembly import FurnitureLike, pieces_of, reward_of
from roboassembly.errors import ArgumentError
from roboassembly.furniture.model import MOST_PARTS, PAPER_PARTS
from roboassembly.rendering.offscreen import check_size
from roboassembly.simulation.control_physics import CONTROL_RATE
from roboassembly.task.full.task import FullTask
from roboassembly.task.plans.full_plan import FullState

SECONDS_A_MERGE = 120.0
"""Time limit of an episode for each merge, unless `time_limit` says otherwise [s]."""
LARGEST_LAYOUT = 2**31 - 1
"""Largest seed of a layout."""
Observation = dict[str, np.ndarray]


class ControlFailure(StrEnum):
    """Reason why an episode ended without success."""

    NONE = ""
    DROPPED = "dropped"
    """Nothing holds a group: it lies on the floor, or for a second elsewhere."""
    WRONG_MERGE = "wrong_merge"
    """A joint closed that is right for the piece, but not the one that the task `merge` asks for."""
    COLLISION = "collision"
    """A robot or what it holds touched something that it must not touch; only with `strict`."""
    TIME_LIMIT = "time_limit"
    UNSTABLE = "unstable"
    """The physics left all bounds."""


class ControlEnv(gymnasium.Env[Observation, np.ndarray]):
    """Drive two mobile arms that pick parts from posts, join them, and set them down, until the furniture stands.

    Physics runs at 500 Hz, control at 20 Hz. A hand grips what both of its pads press; a joint closes when two groups
    are within 2 mm and 2° of it and nearly at rest; a group that a hand lets go of near the height of the posts gets
    posts beneath it, else it falls. Nothing else is fixed to anything.

    **Action**: `Box(-1, 1, (22,))`, eleven numbers for each robot: see `roboassembly.control.controls`.

    **Observation**: a `Dict`. With `obs="state"` the arrays of `roboassembly.control.observation`. With `"rgb"` only
    `robots` of these, and `rgb_NAME` for each camera, (height, width, 3) bytes; with `"rgbd"` also `depth_NAME`,
    (height, width) in metres; with `segmentation` also `segmentation_NAME`, (height, width): 0 background, 1 floor,
    2 posts, 3 R_a, 4 R_b, 5 + p for part p. `"state+rgb"` and `"state+rgbd"` have all of both.

    **Reward**: 1 for a merge, 4 more for the last one of the task `piece`. `reward="dense"` adds the change of the
    progress of the next merge, from 0 to 1: see `roboassembly.control.reward`.

    **Info**: `is_success` and `success`; `failure`, a value of `ControlFailure`; `furniture`; `task_description`;
    `groups` and `merges`, numbers of groups left and of joints closed; `seconds` simulated; `holds`, the lowest part of
    what each robot holds or -1; `contact`, whether a robot touches something with more than its pads;
    `joint_error_mm` and `joint_error_deg` of the joint that closed in this step, else 0.

    **Errors**: an action that has a wrong shape, no numbers, or numbers that are not finite raises
    `gymnasium.error.InvalidAction`; numbers beyond [-1, 1] are cut. A step before `reset` or after the end of an
    episode raises `gymnasium.error.ResetNeeded`.

    Args:
        furniture: what to assemble: furniture, or a name or folder as in `roboassembly assemble`. With several, each
            episode draws one, or takes the one that `reset(options={"furniture": index})` asks for.
        task: `piece`: all parts are to be joined. `merge`: one merge, drawn for each episode or named by
            `reset(options={"merge": index})`; all earlier ones are made.
        control: `joint_position`, `joint_delta` or `end_effector_delta`.
        obs: `state`, `rgb`, `rgbd`, `state+rgb` or `state+rgbd`.
        reward: `sparse` or `dense`.
        cameras: names of the cameras that are observed, of `wrist_a`, `wrist_b`, `overview` and `overview_back`.
        camera_width: width of their pictures [pixels].
        camera_height: height of their pictures [pixels].
        segmentation: whether it is observed what each pixel shows.
        time_limit: simulated time after which an episode is truncated [s]; 120 s a merge if None.
        layout: seed of the layout that all episodes have: which part stands on which post and how, and how the robots
            are turned. Starts then differ by `part_position` and `part_angle` of `randomization` only. Each episode has
            a layout of its own if None.
        strict: whether an episode fails when a robot, or what it holds, touches something that it must not touch: in
            physics or by the exact geometry (`roboassembly.control.collisions`).
        randomization: what differs from episode to episode; nothing if None.
        max_parts: padding P of the state.
        render_mode: None, or `"rgb_array"`: `render` returns a picture of the cell.
        width: width of these pictures [pixels].
        height: height of these pictures [pixels].

    Raises:
        TypeError: furniture that is None or something else that is no furniture, or an argument of another type.
        ArgumentError: a value out of range (it is a `ValueError`), or furniture that exceeds the padding.
        InputError: furniture that is not there. `reset` raises it for furniture that does not suit the cell.
        gymnasium.error.UnsupportedMode: an unknown render mode.
    """

    metadata = {"render_modes": [RGB_ARRAY], "render_fps": CONTROL_RATE}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(
        self,
        furniture: FurnitureLike | Iterable[FurnitureLike] = catalogue.DEFAULT,
        *,
        task: TaskName = "piece",
        control: ControlName = "joint_delta",
        obs: ObservationName = "state",
        reward: RewardName = "sparse",
        cameras: Sequence[str] = CAMERAS,
        camera_width: int = 128,
        camera_height: int = 128,
        segmentation: bool = False,
        time_limit: float | None = None,
        layout: int | None = None,
        strict: bool = False,
        randomization: Randomization | None = None,
        max_parts: int = PAPER_PARTS,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        checked_choice("task", task, TaskName)
        checked_choice("obs", obs, ObservationName)
        checked_choice("reward", reward, RewardName)
        self.codec = ActionCodec(control)
        """Turns actions into commands and back."""
        names = checked_cameras(cameras, camera_width, camera_height)
        max_parts = checked_integer("max_parts", max_parts, 1, MOST_PARTS)
        if randomization is not None and not isinstance(randomization, Randomization):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise TypeError(f"randomization is {shortened(randomization)}; expected a Randomization or None")
        check_size(width, height)
        self.tasks = [FullTask(piece) for piece in pieces_of(furniture)]
        for full in self.tasks:
            if len(full.furniture.parts) > max_parts:
                raise ArgumentError(
                    f"'{full.furniture.name}' has {len(full.furniture.parts)} parts; max_parts={max_parts} is too "
                    f"small: give max_parts={len(full.furniture.parts)}"
                )
        self._options = ControlOptions(task, obs, reward, checked_time_limit(time_limit), strict, max_parts)
        self._ranges = randomization or NONE
        self._layout = None if layout is None else checked_integer("layout", layout, 0, LARGEST_LAYOUT)
        self.render_mode = checked_render_mode(render_mode)
        self._pictures = EpisodeCameras(
            PictureConfig(names, camera_width, camera_height, obs.endswith("rgbd"), segmentation, width, height)
        )
        self._merges: dict[int, list[MergeTask]] = {}
        self._current = 0
        self._cell: ControlCell | None = None
        self._merge: MergeTask | None = None
        self._queue: deque[Observation] = deque(maxlen=1)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.codec.names),), np.float32)
        seen = state_space(max_parts)
        if not self._options.sees_state:
            seen = {"robots": seen["robots"]}
        if self._options.sees_pictures:
            seen |= picture_space(self._pictures.config, max_parts)
        self.observation_space = spaces.Dict(seen)  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def task(self) -> FullTask:
        """Rules of the current episode's furniture."""
        return self.tasks[self._current]

    @property
    def cell(self) -> ControlCell:
        """Robots and groups of the current episode, for planners and tests; policies see the observation.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
        """
        if self._cell is None:
            raise ResetNeeded("the environment has no state yet; call reset() first")
        return self._cell

    @property
    def state(self) -> FullState:
        """Present state of the cell, from which `FullTask.step` plans while both hands are empty.

        `roboassembly.control.replay` turns a planned merge into commands.
        """
        return self.cell.state()

    @property
    def merge(self) -> MergeTask | None:
        """Merge that is to be made; None in the task `piece`."""
        return self._merge

    @property
    def observation_delay(self) -> int:
        """Age of observations in this episode [control steps]."""
        return (self._queue.maxlen or 1) - 1

    @property
    def task_description(self) -> str:
        """Task in words."""
        furniture = self.task.furniture
        if self._merge is None:
            return f"Assemble {furniture.name}: join its {len(furniture.parts)} parts."
        first, second = (_in_words([furniture.parts[p].name for p in group]) for group in self._merge.groups)
        return f"Join {first} to {second}."

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; `options={"furniture": index, "merge": index}` selects the piece and, in the task `merge`,
        the merge.

        Raises:
            ArgumentError: an unknown option, no such piece or no such merge.
            TypeError: options that are no dictionary.
            InputError: the piece does not suit the cell.
        """
        counts = [len(task.furniture.parts) - 1 for task in self.tasks]
        piece, merge = checked_options(options, counts, self._options.task)
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(len(self.tasks)))
        self._current = drawn if piece is None else piece
        self._cell, self._ending = None, ControlFailure.NONE
        task, rng = self.task, self.np_random
        layout = rng if self._layout is None else np.random.default_rng(self._layout)
        if self._options.task == "merge":
            merges = self._merges_of(self._current)
            index = int(rng.integers(len(merges)))
            self._merge = merges[index if merge is None else merge]
            start = start_of_merge(task, merges, self._merge.index, layout)
        else:
            self._merge, start = None, task.initial_state(layout)
        variation = self._ranges.draw(rng)
        self._cell = ControlCell(task.furniture, task.rules, shifted(start, variation, rng), variation)
        self._begin(variation)
        return self._observe(CellEvents())

    def _merges_of(self, index: int) -> list[MergeTask]:
        if index not in self._merges:
            self._merges[index] = merge_tasks(self.tasks[index].furniture)
        return self._merges[index]

    def _begin(self, variation: Variation) -> None:
        cell, furniture, merge = self.cell, self.task.furniture, self._merge
        goal = None if merge is None else Goal(merge.first, merge.second, goal_pose(furniture, merge))
        self._state = StateObserver(cell, self._options.max_parts, goal, variation)
        self._pictures.start(cell, variation)
        self._queue = deque(maxlen=variation.delay + 1)
        self._count, self._closed, self._success, self._over = 0, 0, False, False
        merges = 1 if merge is not None else len(furniture.parts) - 1
        limit = self._options.time_limit or SECONDS_A_MERGE * merges
        self._last_step = max(1, round(limit * CONTROL_RATE))
        self._collisions = CollisionTest(cell) if self._options.strict else None
        self._next = NextMerge(cell, merge) if self._options.reward == "dense" else None

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one command, 50 ms of simulated time.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`, or after the end of the episode.
            gymnasium.error.InvalidAction: an action of a wrong shape, or numbers that are not finite.
        """
        cell = self.cell
        if self._over:
            ending = "success" if self._success else str(self._ending)
            raise ResetNeeded(f"the episode is over (it ended with '{ending}'); call reset() first")
        numbers = checked_numbers(action, self.codec.names)
        targets, openings = self.codec.decode(numbers, cell.physics.commands)
        targets[:, :2] = np.clip(targets[:, :2], -cell.cell.floor, cell.cell.floor)
        before = 0.0 if self._next is None else self._next.progress()
        events = cell.advance(targets, openings)
        self._count += 1
        self._closed += len(events.joined)
        self._success = self._succeeds(events)
        reward = reward_of(bool(events.joined), self._success and self._merge is None)
        self._ending = ControlFailure.NONE if self._success else self._failure(events)
        if self._ending is ControlFailure.WRONG_MERGE:
            reward = 0.0
        if self._next is not None and self._ending not in (ControlFailure.WRONG_MERGE, ControlFailure.UNSTABLE):
            reward += self._next.change(before, bool(events.joined))
        truncated = not self._success and self._ending is ControlFailure.NONE and self._count >= self._last_step
        if truncated:
            self._ending = ControlFailure.TIME_LIMIT
        terminated = self._success or self._ending not in (ControlFailure.NONE, ControlFailure.TIME_LIMIT)
        self._over = terminated or truncated
        observation, info = self._observe(events)
        return observation, float(reward), terminated, truncated, info

    def _succeeds(self, events: CellEvents) -> bool:
        if self._merge is None:
            return self.cell.complete
        return any({j.first, j.second} == set(self._merge.groups) for j in events.joined)

    def _failure(self, events: CellEvents) -> ControlFailure:
        if not self.cell.physics.stable:
            return ControlFailure.UNSTABLE
        if events.dropped:
            return ControlFailure.DROPPED
        if events.joined and self._merge is not None:
            return ControlFailure.WRONG_MERGE
        if self._collisions is not None and not events.joined and self._collisions.touches():
            return ControlFailure.COLLISION
        return ControlFailure.NONE

    def _observe(self, events: CellEvents) -> tuple[Observation, dict[str, Any]]:
        if self._ending is not ControlFailure.UNSTABLE or not self._queue:
            seen = self._state.observe() if self._options.sees_state else {"robots": self._state.robots()}
            if self._options.sees_pictures:
                seen |= self._pictures.observe(self.cell)
            self._queue.append(seen)
        cell, joined = self.cell, events.joined
        grasped = [cell.physics.grasped(robot) for robot in (0, 1)]
        info = {
            "is_success": self._success,
            "success": self._success,
            "failure": str(self._ending),
            "furniture": self.task.furniture.name,
            "task_description": self.task_description,
            "groups": len(cell.groups),
            "merges": self._closed,
            "seconds": self._count / CONTROL_RATE,
            "holds": np.array([-1 if key is None else cell.groups[key].parts[0] for key in grasped]),
            "contact": cell.physics.touching,
            "joint_error_mm": 1e3 * joined[-1].position if joined else 0.0,
            "joint_error_deg": float(np.degrees(joined[-1].angle)) if joined else 0.0,
        }
        return {name: array.copy() for name, array in self._queue[0].items()}, info

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture of the cell as the camera `overview` sees it.

        Returns:
            The picture; None if the environment was made without a render mode.

        Raises:
            gymnasium.error.ResetNeeded: before the first `reset`.
            RenderingUnavailableError: this machine cannot draw off screen; the message says what to install.
        """
        if not may_render(self.render_mode):
            return None
        return self._pictures.render(self.cell)

    def close(self) -> None:
        """Free the graphics resources."""
        self._pictures.close()


def _in_words(names: Sequence[str]) -> str:
    """Return names of parts as words of a sentence."""
    spaced = [name.replace("_", " ") for name in names]
    return spaced[0] if len(spaced) == 1 else f"{', '.join(spaced[:-1])} and {spaced[-1]}"
