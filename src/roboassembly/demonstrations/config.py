"""Options of a set of demonstrations, and the environments that they stand for."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, get_args

from roboassembly.control.arguments import ObservationName, TaskName, checked_choice
from roboassembly.control.cameras import checked_cameras
from roboassembly.control.controls import ActionCodec, ControlName
from roboassembly.control.env import LARGEST_LAYOUT, ControlEnv
from roboassembly.control.randomization import Randomization
from roboassembly.envs.arguments import shortened
from roboassembly.errors import ArgumentError, InputError
from roboassembly.furniture.model import Furniture

TASKS: tuple[TaskName, ...] = get_args(TaskName)
_NO_LIMIT = 1e6
"""Time limit of an episode [s]: a planned episode ends by itself."""


@dataclass(frozen=True)
class DemoConfig:
    """Options that all episodes of a data set share.

    Raises:
        ArgumentError: a value out of range.
        TypeError: a size that is no integer, or cameras that are no list of names.
    """

    task: TaskName = "piece"
    """Task of each episode: `merge` for one merge, `piece` for a whole piece."""
    merge: int | None = None
    """Number of the merge in the task `merge`; None to draw one for each episode."""
    control: ControlName = "joint_delta"
    """Mode of control of the actions."""
    cameras: tuple[str, ...] = ()
    """Cameras whose pictures are recorded."""
    width: int = 128
    """Width of the pictures [pixels], even."""
    height: int = 128
    """Height of the pictures [pixels], even."""
    depth: bool = False
    """Whether distances are recorded, too."""
    randomize: float = 0.0
    """Strength from 0 to 1 of the randomization of everything: see `Randomization.full`."""
    layout: int | None = None
    """Seed of the layout of all episodes. The planner's seed is then the same in all, too: demonstrations are alike,
    and starts differ by `part_position` and `part_angle`. None for a layout and a planner's seed for each episode."""
    part_position: float | None = None
    """Largest shift of each part along each axis at the beginning [m]; None for what `randomize` says."""
    part_angle: float | None = None
    """Largest turn of each part about the vertical at the beginning [rad]; None for what `randomize` says."""
    seed: int = 0
    """Seed of all starts and of the planner."""

    def __post_init__(self) -> None:
        checked_choice("task", self.task, TaskName)
        ActionCodec(self.control)
        if self.cameras:
            checked_cameras(self.cameras, self.width, self.height)
        if self.width % 2 or self.height % 2:
            raise ArgumentError(f"picture size {self.width} x {self.height}: H.264 needs an even width and height")
        if self.depth and not self.cameras:
            raise ArgumentError("depth needs cameras; name at least one")
        if self.merge is not None and (self.task != "merge" or self.merge < 0):
            raise ArgumentError(f"merge is {shortened(self.merge)}; expected 0 or more, with the task 'merge' only")
        if not 0.0 <= self.randomize <= 1.0:
            raise ArgumentError(f"randomize is {shortened(self.randomize)}; expected a number from 0 to 1")
        if self.layout is not None and not 0 <= self.layout <= LARGEST_LAYOUT:
            raise ArgumentError(f"layout is {shortened(self.layout)}; expected an integer from 0 to {LARGEST_LAYOUT}")
        self.randomization()
        if self.seed < 0:
            raise ArgumentError(f"seed is {shortened(self.seed)}; expected 0 or more")

    @property
    def obs(self) -> ObservationName:
        """Kind of observation that is recorded."""
        if not self.cameras:
            return "state"
        return "state+rgbd" if self.depth else "state+rgb"

    def randomization(self) -> Randomization:
        """Return what differs from episode to episode.

        Raises:
            ArgumentError: a range out of range.
        """
        ranges = {"part_position": self.part_position, "part_angle": self.part_angle}
        given = {name: value for name, value in ranges.items() if value is not None}
        return replace(Randomization.full(self.randomize), **given)

    def planner_seed(self, seed: int) -> int:
        """Return the planner's seed in the episode with a seed."""
        return seed if self.layout is None else self.seed

    def env_arguments(self, max_parts: int) -> dict[str, Any]:
        """Return the arguments of `RoboAssembly/Control-v0` but for the furniture and `randomization`; JSON.

        Args:
            max_parts: padding of the state.
        """
        pictures: dict[str, Any] = {}
        if self.cameras:
            pictures = {"cameras": list(self.cameras), "camera_width": self.width, "camera_height": self.height}
        layout = {} if self.layout is None else {"layout": self.layout}
        return {
            "task": self.task, "control": self.control, "obs": self.obs, "max_parts": max_parts, **layout, **pictures,
        }  # fmt: skip

    def make_env(
        self, furniture: Furniture, max_parts: int, *, pictures: bool = True, render_mode: str | None = None
    ) -> ControlEnv:
        """Return an environment of one piece, in which the episodes of that piece happen.

        Args:
            furniture: the piece.
            max_parts: padding of the state.
            pictures: whether pictures are observed; they change nothing else.
            render_mode: see `ControlEnv`.

        Raises:
            InputError: the piece has no such merge.
        """
        self.check_merge(furniture)
        arguments = self.env_arguments(max_parts)
        if not pictures:
            arguments["obs"] = "state"
        ranges = self.randomization()
        return ControlEnv(furniture, **arguments, time_limit=_NO_LIMIT, randomization=ranges, render_mode=render_mode)

    def check_merge(self, furniture: Furniture) -> None:
        """Check that a piece has the merge that is asked for, if any is.

        Raises:
            InputError: it does not.
        """
        most = len(furniture.parts) - 2
        if self.merge is not None and self.merge > most:
            raise InputError(f"{furniture.name} has no merge {self.merge}; expected 0 to {most}")

    def reset_options(self) -> dict[str, Any]:
        """Return the options of `reset`."""
        return {} if self.merge is None else {"merge": self.merge}

    def to_json(self) -> dict[str, Any]:
        """Return all options as JSON."""
        return {**asdict(self), "cameras": list(self.cameras)}
