"""Records the episodes of a data set in processes, and adds them in their order."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.extras import FormatName, check_format
from roboassembly.demonstrations.lerobot_dataset import LeRobotDataset, VideoFiles
from roboassembly.demonstrations.recording import DemoPiece, PictureFiles, Recorder, close_envs
from roboassembly.demonstrations.robomimic_file import PictureDatasets, RobomimicFile
from roboassembly.demonstrations.staging import DemoFolder, EpisodeRecord
from roboassembly.errors import RoboAssemblyError
from roboassembly.parallel.processes import map_unordered
from roboassembly.rendering.gl import context_module, skip_trial


class DemoDataset(Protocol):
    """Data set that grows episode by episode."""

    @property
    def count(self) -> int:
        """Number of episodes."""
        ...

    def add(self, staged: Path) -> EpisodeRecord:
        """Add the next episode, which waits in a folder."""
        ...

    def finish(self) -> None:
        """Complete the files."""
        ...


_DATASETS: dict[FormatName, Callable[[Path, DemoConfig, int], DemoDataset]] = {
    "lerobot": LeRobotDataset, "hdf5": RobomimicFile,
}  # fmt: skip
_PICTURES: dict[FormatName, Callable[[Path, DemoConfig], PictureFiles]] = {
    "lerobot": VideoFiles, "hdf5": PictureDatasets,
}  # fmt: skip


class Collection:
    """Data set of demonstrations in a folder, and the recording of what it lacks.

    Args:
        path: folder of the data set; one that was begun with the same options is continued.
        format: `lerobot` or `hdf5`.
        pieces: pieces of furniture; episode `i` shows piece `i` modulo their number, or one after it.
        fingerprint: hash of the pieces.
        config: what is recorded.
        max_parts: padding of the state.

    Raises:
        MissingExtraError: a package is not installed.
        InputError: the folder holds something else.
    """

    def __init__(
        self,
        path: Path,
        format: FormatName,
        pieces: Sequence[DemoPiece],
        fingerprint: str,
        config: DemoConfig,
        max_parts: int,
    ) -> None:
        check_format(format)
        about: dict[str, Any] = {"format": format, "furniture": [piece.name for piece in pieces]}
        about |= {"fingerprint": fingerprint, "max_parts": max_parts, **config.to_json()}
        self._folder = DemoFolder(path, about)
        self._open_dataset = partial(_DATASETS[format], path, config, max_parts)
        self._recorder = Recorder(path, tuple(pieces), config, max_parts, _PICTURES[format])

    def record(self, episodes: int, jobs: int) -> Iterator[EpisodeRecord | None]:
        """Record the episodes that are missing up to a number of them; yields each as it is added.

        Those that were there already are yielded first, as None.

        Args:
            episodes: number of episodes that the data set is to have at least.
            jobs: number of processes; 1 records in this one.

        Raises:
            InputError: another process writes to the folder, or the only piece does not suit the cell.
            RenderingUnavailableError: this machine cannot draw off screen.
            RoboAssemblyError: an episode cannot be recorded, or a process died.
            OSError: the disk is full. What was recorded stays.
        """
        with self._folder.open() as folder:
            dataset = self._open_dataset()
            yield from [None] * min(dataset.count, episodes)
            waiting = set(folder.staged())
            missing = [index for index in range(dataset.count, episodes) if index not in waiting]
            for _ in self._recorded(missing, jobs):
                while dataset.count < episodes and folder.staged_path(dataset.count).is_dir():
                    yield dataset.add(folder.staged_path(dataset.count))
            dataset.finish()

    def _recorded(self, missing: Sequence[int], jobs: int) -> Iterator[None]:
        """Yield once at the beginning, then whenever an episode is recorded."""
        yield
        if not missing:
            return
        module = context_module() if self._recorder.config.cameras else None
        try:
            yield from map_unordered(
                partial(_record, self._recorder, module, jobs > 1), missing, min(jobs, len(missing))
            )
        except BrokenProcessPool:
            raise RoboAssemblyError(
                "a worker process died (out of memory?); run the same command again to continue, with fewer --jobs"
            ) from None
        finally:
            close_envs()


def _record(recorder: Recorder, gl_module: str | None, crowded: bool, index: int) -> None:
    """Record an episode, in any process."""
    if crowded:
        # Else Mesa's software renderer starts a thread for each core in each process.
        os.environ["LP_NUM_THREADS"] = "0"
        if gl_module is not None:
            skip_trial(gl_module)
    recorder.record(index)
