"""Repeats recorded episodes in `RoboAssembly/Control-v0`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float32

from roboassembly.datasets import catalogue
from roboassembly.demonstrations import lerobot_dataset, robomimic_file
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.extras import FormatName, check_format
from roboassembly.demonstrations.staging import DESCRIPTION, EpisodeRecord, read_description
from roboassembly.errors import ArgumentError, InputError


class Demonstrations:
    """Data set of demonstrations, in any format.

    Args:
        folder: its folder, the `--out` of `roboassembly demos`.

    Raises:
        InputError: the folder holds no demonstrations, or a file is broken.
        MissingExtraError: a package is not installed.
    """

    def __init__(self, folder: Path | str) -> None:
        folder = Path(folder)
        about = read_description(folder)
        options = {field.name: about.get(field.name) for field in fields(DemoConfig)}
        try:
            self.config = msgspec.convert(options, DemoConfig)
            """Options of the recording."""
            self.max_parts = msgspec.convert(about.get("max_parts"), int)
            """Padding of the state."""
            form = msgspec.convert(about.get("format"), FormatName)
        except (msgspec.ValidationError, ArgumentError) as error:
            raise InputError(f"'{folder / DESCRIPTION}' is not valid: {error}") from None
        check_format(form)
        read = {"lerobot": lerobot_dataset, "hdf5": robomimic_file}[form].read_episodes
        self._episodes: list[tuple[EpisodeRecord, Float32[np.ndarray, "n 22"]]] = read(folder)

    @property
    def episodes(self) -> list[EpisodeRecord]:
        """Facts on each episode."""
        return [record for record, _ in self._episodes]

    def actions(self, index: int) -> Float32[np.ndarray, "n 22"]:
        """Return the actions of an episode."""
        return self._episodes[index][1]

    def replay(self, indices: Sequence[int] | None = None) -> Iterator[bool]:
        """Carry out the actions of episodes from their seeds; yields whether each succeeds.

        Args:
            indices: numbers of episodes; all if None.

        Raises:
            gymnasium.error.InvalidAction: a recorded action has a wrong shape, or numbers that are not finite.
            InputError: a piece is not there.
        """
        env, made = None, ""
        for index in range(len(self._episodes)) if indices is None else indices:
            record, actions = self._episodes[index]
            if env is None or made != record.furniture:
                made = record.furniture
                env = self.config.make_env(catalogue.find(made), self.max_parts, pictures=False)
            env.reset(seed=record.seed, options=self.config.reset_options())
            success = False
            for action in actions:
                *_, terminated, truncated, info = env.step(action)
                success = bool(info["is_success"])
                if terminated or truncated:
                    break
            yield success
