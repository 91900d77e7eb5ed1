"""Recording of one episode: attempts with one seed after the other until one succeeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from roboassembly.control.env import ControlEnv
from roboassembly.datasets import catalogue
from roboassembly.datasets.sets import FurnitureRef
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.feature_statistics import Statistics
from roboassembly.demonstrations.features import environment_state, robot_state
from roboassembly.demonstrations.planner import Demonstrator
from roboassembly.demonstrations.staging import EpisodeRecord, new_part, write_staged
from roboassembly.errors import InputError, RoboAssemblyError
from roboassembly.furniture.model import Furniture

MOST_ATTEMPTS = 20
"""Attempts at one episode, each with another seed, after which recording gives up."""
UNSUITABLE, NO_PLAN = "unsuitable", "no_plan"
"""Failures before anything was carried out: the piece does not suit the cell, or a merge cannot be planned."""


class PictureFiles(Protocol):
    """Files with the pictures of one episode."""

    def add(self, observation: Mapping[str, np.ndarray]) -> None:
        """Append the pictures of an observation."""
        ...

    def close(self) -> dict[str, Statistics]:
        """Complete the files; returns the statistics of each feature."""
        ...

    def abandon(self) -> None:
        """Stop writing; harmless after `close`."""
        ...


@dataclass(frozen=True)
class DemoPiece:
    """Piece of furniture of a data set; each process makes or loads it itself."""

    name: str
    """Name or folder, as `catalogue.find` takes it."""
    ref: FurnitureRef | None = None
    """Entry of a data set, whose hash is checked."""

    def furniture(self) -> Furniture:
        """Return the piece.

        Raises:
            InputError: there is no such piece.
        """
        return catalogue.find(self.name) if self.ref is None else self.ref.furniture()


@dataclass(frozen=True)
class Recorder:
    """Records episodes of a data set.

    The piece and the seed of an attempt depend only on the numbers of episode and attempt, so that it does not matter
    which process records which episode, and when.
    """

    folder: Path
    """Folder of the data set."""
    pieces: tuple[DemoPiece, ...]
    config: DemoConfig
    max_parts: int
    """Padding of the state."""
    open_pictures: Callable[[Path, DemoConfig], PictureFiles]
    """Function that opens the files of pictures in a folder."""

    def record(self, index: int) -> None:
        """Record one episode into its staging folder.

        Raises:
            InputError: the only piece does not suit the cell.
            RoboAssemblyError: no attempt succeeds, or this machine cannot draw.
        """
        failures: list[str] = []
        for attempt in range(MOST_ATTEMPTS):
            piece = self.pieces[(index + attempt) % len(self.pieces)]
            failure = self._attempt(index, attempt, piece, failures)
            if not failure:
                return
            failures.append(failure)
        counts = ", ".join(f"{n} {failure}" for failure, n in Counter(failures).items())
        raise RoboAssemblyError(
            f"episode {index}: none of {MOST_ATTEMPTS} attempts succeeded ({counts}); the episodes before it are kept"
        )

    def _attempt(self, index: int, attempt: int, piece: DemoPiece, failures: list[str]) -> str:
        """Return why an attempt failed; empty if the episode is recorded."""
        config = self.config
        seed = int(np.random.SeedSequence([config.seed, index, attempt]).generate_state(1)[0])
        try:
            env = _env(self, piece)
            observation, info = env.reset(seed=seed, options=config.reset_options())
        except InputError:
            if len(self.pieces) == 1:
                raise
            return UNSUITABLE
        with new_part(self.folder, index) as part:
            pictures = self.open_pictures(part, config)
            try:
                episode = _Episode(pictures)
                demonstrator = Demonstrator(env, config.planner_seed(seed))
                for action in demonstrator.actions():
                    following, reward, terminated, _, info = env.step(action)
                    episode.add(observation, action, reward, terminated, info["is_success"])
                    observation = following
                    if terminated:
                        break
                if not info["is_success"]:
                    return demonstrator.failure or info["failure"]
                episode.add_last(observation)
                statistics = {name: _as_lists(each) for name, each in pictures.close().items()}
            finally:
                pictures.abandon()
            merge = -1 if env.merge is None else env.merge.index
            task, frames = info["task_description"], len(episode.actions)
            record = EpisodeRecord(index, seed, piece.name, merge, task, frames, tuple(failures), statistics)
            write_staged(part, record, episode.numbers())
        return ""


_envs: dict[tuple[DemoPiece, DemoConfig, int], ControlEnv] = {}
"""Environment of this process, kept for the next episode of the same piece."""


def _env(recorder: Recorder, piece: DemoPiece) -> ControlEnv:
    key = piece, recorder.config, recorder.max_parts
    if key not in _envs:
        close_envs()
        _envs[key] = recorder.config.make_env(piece.furniture(), recorder.max_parts)
    return _envs[key]


def close_envs() -> None:
    """Close the environment that this process keeps."""
    for env in _envs.values():
        env.close()
    _envs.clear()


class _Episode:
    """Frames of an episode, as they come."""

    def __init__(self, pictures: PictureFiles) -> None:
        self._pictures = pictures
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []
        self._outcomes: list[tuple[float, bool, bool]] = []
        self.actions: list[np.ndarray] = []

    def add(
        self, observation: Mapping[str, np.ndarray], action: np.ndarray, reward: float, done: bool, success: bool
    ) -> None:
        """Append an observation, the action after it, and what came of that."""
        self._pictures.add(observation)
        self.add_last(observation)
        self.actions.append(action)
        self._outcomes.append((reward, done, success))

    def add_last(self, observation: Mapping[str, np.ndarray]) -> None:
        """Append the numbers of the observation after the last action."""
        self._seen.append((robot_state(observation), environment_state(observation)))

    def numbers(self) -> dict[str, np.ndarray]:
        """Return the rows of each feature; those of observations have one more, after the last action."""
        rewards, dones, successes = zip(*self._outcomes, strict=True)
        return {
            "observation.state": np.stack([state for state, _ in self._seen]),
            "observation.environment_state": np.stack([parts for _, parts in self._seen]),
            "action": np.stack(self.actions),
            "next.reward": np.array(rewards, np.float32),
            "next.done": np.array(dones, bool),
            "next.success": np.array(successes, bool),
        }


def _as_lists(statistics: Statistics) -> dict[str, Any]:
    return {name: each.tolist() for name, each in statistics.items()}
