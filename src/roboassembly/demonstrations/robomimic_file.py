"""HDF5 file in robomimic's layout: `data/demo_0`, `data/demo_1` and so on, each with actions, rewards, dones and obs.

The file is written anew, whole, when all episodes are recorded; until then they wait in the staging folder.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from roboassembly.atomic_file import atomic_write
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.feature_statistics import Statistics
from roboassembly.demonstrations.staging import EpisodeRecord, read_staged, staging_folder
from roboassembly.envs import CONTROL
from roboassembly.errors import InputError

FILE = "demos.hdf5"
"""Name of the file in the folder of the data set."""
_PICTURES = "pictures.hdf5"
_GYM = 2
"""Kind of environment in `env_args`, as robomimic numbers them."""
_RECORD = "episode"
"""Attribute of an episode with all facts, as JSON."""
_COMPRESSION: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}


class PictureDatasets:
    """Pictures of one episode in an HDF5 file of its own.

    Args:
        folder: where it is made.
        config: cameras and sizes.
    """

    def __init__(self, folder: Path, config: DemoConfig) -> None:
        import h5py

        self._file = h5py.File(folder / _PICTURES, "w") if config.cameras else None
        self._sets: dict[str, h5py.Dataset] = {}
        pictures = [(f"rgb_{camera}", f"{camera}_image", 3, np.uint8) for camera in config.cameras]
        if config.depth:
            pictures += [(f"depth_{camera}", f"{camera}_depth", 1, np.float32) for camera in config.cameras]
        for seen, name, channels, dtype in pictures:
            assert self._file is not None
            shape = (config.height, config.width, channels)
            self._sets[seen] = self._file.create_dataset(
                name, (0, *shape), dtype, maxshape=(None, *shape), chunks=(1, *shape), **_COMPRESSION
            )

    def add(self, observation: Mapping[str, np.ndarray]) -> None:
        """Append the pictures of an observation."""
        for seen, rows in self._sets.items():
            rows.resize(len(rows) + 1, axis=0)
            rows[-1] = observation[seen].reshape(rows.shape[1:])

    def close(self) -> dict[str, Statistics]:
        """Complete the file; this format keeps no statistics."""
        self.abandon()
        return {}

    def abandon(self) -> None:
        """Stop writing; harmless after `close`."""
        if self._file is not None:
            self._file.close()


class RobomimicFile:
    """File of episodes that is written when `finish` is called.

    Args:
        folder: of the data set.
        config: what is recorded.
        max_parts: padding of the state.

    Raises:
        InputError: the file is broken.
    """

    def __init__(self, folder: Path, config: DemoConfig, max_parts: int) -> None:
        self._path = folder / FILE
        self._arguments = config.env_arguments(max_parts)
        self._written = len(_records(self._path))
        self._waiting: list[Path] = []

    @property
    def count(self) -> int:
        """Number of episodes, those included that `finish` adds."""
        return self._written + len(self._waiting)

    def add(self, staged: Path) -> EpisodeRecord:
        """Take note of the next episode, which waits in a folder; returns the facts on it."""
        record, _ = read_staged(staged)
        assert record.index == self.count
        self._waiting.append(staged)
        return record

    def finish(self) -> None:
        """Write the file with all episodes.

        Raises:
            OSError: the disk is full; the episodes go on waiting.
        """
        if not self._waiting:
            return
        import h5py

        with atomic_write(self._path, staging_folder(self._path.parent)) as unfinished:
            if self._written:
                shutil.copyfile(self._path, unfinished)
            with h5py.File(unfinished, "a") as file:
                data = file.require_group("data")
                for staged in self._waiting:
                    _write_demo(data, staged)
                data.attrs["total"] = sum(int(data[name].attrs["num_samples"]) for name in data)
                names = list(dict.fromkeys(str(data[name].attrs["furniture"]) for name in data))
                furniture = names[0] if len(names) == 1 else names
                arguments = {"furniture": furniture, **self._arguments}
                kind = {"env_name": CONTROL, "type": _GYM, "env_kwargs": arguments}
                data.attrs["env_args"] = json.dumps(kind)
        for staged in self._waiting:
            shutil.rmtree(staged, ignore_errors=True)
        self._written, self._waiting = self.count, []


def read_episodes(folder: Path) -> list[tuple[EpisodeRecord, np.ndarray]]:
    """Return the facts and the actions of all episodes.

    Raises:
        InputError: the file is broken.
    """
    import h5py

    records = _records(folder / FILE)
    if not records:
        return []
    with h5py.File(folder / FILE, "r") as file:
        return [(record, np.array(file[f"data/demo_{record.index}/actions"])) for record in records]


def _records(path: Path) -> list[EpisodeRecord]:
    import h5py

    if not path.is_file():
        return []
    try:
        with h5py.File(path, "r") as file:
            data = file["data"]
            texts = [data[f"demo_{index}"].attrs[_RECORD] for index in range(len(data))]
        return [msgspec.json.decode(text, type=EpisodeRecord) for text in texts]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"'{path}' is broken: {str(error).partition(chr(10))[0]:.120}") from None


def _write_demo(data: Any, staged: Path) -> None:
    import h5py

    record, numbers = read_staged(staged)
    demo, n = data.create_group(f"demo_{record.index}"), record.frames
    demo.attrs["num_samples"] = n
    demo.attrs["seed"], demo.attrs["furniture"], demo.attrs["merge"] = record.seed, record.furniture, record.merge
    demo.attrs["task"], demo.attrs[_RECORD] = record.task, msgspec.json.encode(record).decode()
    demo["actions"], demo["rewards"] = numbers["action"], numbers["next.reward"]
    demo["dones"], demo["successes"] = numbers["next.done"].astype(np.int64), numbers["next.success"].astype(np.int64)
    for name in ("state", "environment_state"):
        rows = numbers[f"observation.{name}"]
        demo.create_dataset(f"obs/{name}", data=rows[:n], **_COMPRESSION)
        demo.create_dataset(f"next_obs/{name}", data=rows[1:], **_COMPRESSION)
    if (staged / _PICTURES).is_file():
        with h5py.File(staged / _PICTURES, "r") as file:
            for name in file:
                file.copy(name, demo["obs"])
