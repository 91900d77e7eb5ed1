"""Folder of a data set while it is written: its description, and finished episodes that wait to be added.

A worker writes an episode into a folder `NAME.part` and renames it when all is there. So an episode is complete or
absent, whatever ends the process.
"""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError

DESCRIPTION = "demos.json"
"""File that says what the episodes of a data set have in common."""
_STAGING, _RECORD, _NUMBERS, _PART, _LOCK = ".staging", "episode.json", "numbers.npz", ".part", "lock"


class EpisodeRecord(msgspec.Struct, frozen=True):
    """Facts on one episode."""

    index: int
    """Number of the episode, from 0."""
    seed: int
    """Seed of `reset`, and of the planner unless the data set has one `layout`."""
    furniture: str
    """Name or folder of the piece, as the environment takes it."""
    merge: int
    """Number of the merge; -1 in the task `piece`."""
    task: str
    """Task in words."""
    frames: int
    failures: tuple[str, ...] = ()
    """Why earlier attempts at this episode, with other seeds, were not kept."""
    pictures: dict[str, dict[str, Any]] = {}
    """Statistics of each picture, by its feature."""


def staging_folder(folder: Path) -> Path:
    """Return the folder of all that is not complete yet."""
    return folder / _STAGING


def _episode_folder(folder: Path, index: int) -> Path:
    """Return the folder of an episode that waits to be added to the data set."""
    return folder / _STAGING / f"episode-{index:06d}"


def write_staged(part: Path, record: EpisodeRecord, numbers: dict[str, np.ndarray]) -> None:
    """Complete an episode whose pictures are in a folder already.

    Args:
        part: folder from `new_part`.
        record: facts on the episode.
        numbers: rows of each feature, a row a frame.
    """
    with (part / _NUMBERS).open("wb") as file:
        np.savez(file, **numbers)  # pyright: ignore[reportArgumentType]
    (part / _RECORD).write_bytes(msgspec.json.encode(record))
    part.replace(part.with_suffix(""))


@contextmanager
def new_part(folder: Path, index: int) -> Generator[Path]:
    """Yield a new folder for an episode; what is left of it after the block is deleted."""
    part = _episode_folder(folder, index).with_suffix(_PART)
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def read_staged(staged: Path) -> tuple[EpisodeRecord, dict[str, np.ndarray]]:
    """Return facts and numbers of a staged episode."""
    record = msgspec.json.decode((staged / _RECORD).read_bytes(), type=EpisodeRecord)
    with np.load(staged / _NUMBERS) as file:
        return record, {name: file[name] for name in file.files}


class DemoFolder:
    """Folder of a data set, locked for one process while it is open.

    Args:
        path: folder; it is made unless it exists.
        description: what the episodes have in common, as JSON.

    Raises:
        InputError: the folder holds something else, other episodes, or another process writes to it.
    """

    def __init__(self, path: Path, description: dict[str, Any]) -> None:
        self.path = path
        self._description = json.loads(json.dumps(description))
        _check_contents(path, self._description)

    @contextmanager
    def open(self) -> Generator[DemoFolder]:
        """Lock the folder inside the block.

        Raises:
            InputError: another process writes to it.
        """
        staging = self.path / _STAGING
        staging.mkdir(parents=True, exist_ok=True)
        with (staging / _LOCK).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"another command writes to '{self.path}'; wait for it, or choose another --out"
                ) from None
            if not (self.path / DESCRIPTION).is_file():
                with atomic_write(self.path / DESCRIPTION, staging) as unfinished:
                    unfinished.write_text(json.dumps(self._description, indent=2) + "\n")
            _remove_unfinished(staging)
            try:
                yield self
            finally:
                if not any(self.staged()):
                    shutil.rmtree(staging, ignore_errors=True)
                if [entry.name for entry in self.path.iterdir()] == [DESCRIPTION]:
                    # Nothing was recorded: other options may follow.
                    shutil.rmtree(self.path, ignore_errors=True)

    def staged_path(self, index: int) -> Path:
        """Return the folder in which an episode waits once it is complete."""
        return _episode_folder(self.path, index)

    def staged(self) -> Iterator[int]:
        """Yield the numbers of all episodes that wait, in order."""
        for path in sorted((self.path / _STAGING).glob("episode-??????")):
            yield int(path.name.removeprefix("episode-"))


def _remove_unfinished(staging: Path) -> None:
    """Delete what a killed process left: half an episode, half a file."""
    for entry in staging.iterdir():
        if entry.name.endswith(_PART):
            shutil.rmtree(entry, ignore_errors=True)
        elif entry.is_file() and entry.name != _LOCK:
            entry.unlink(missing_ok=True)


def read_description(path: Path) -> dict[str, Any]:
    """Return the description of a data set.

    Raises:
        InputError: there is none, or it is broken.
    """
    try:
        found: dict[str, Any] = json.loads((path / DESCRIPTION).read_text())
    except (OSError, ValueError):
        raise InputError(f"'{path}' holds no demonstrations: it has no valid {DESCRIPTION}") from None
    return found


def _check_contents(path: Path, description: dict[str, Any]) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise InputError(f"'{path}' is a file; --out must be a folder")
    if not (path / DESCRIPTION).exists():
        if any(entry.name != _STAGING for entry in path.iterdir()):
            raise InputError(f"'{path}' exists and holds no demonstrations; choose another --out")
        return
    found = read_description(path)
    for name in sorted({*found, *description}):
        if found.get(name) != description.get(name):
            here, there = (json.dumps(each.get(name)) for each in (description, found))
            raise InputError(f"'{path}' holds episodes with {name} {there:.80}, not {here:.80}; choose another --out")
