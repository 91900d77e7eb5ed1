"""LeRobot data sets, version 3.0, written and read without LeRobot and without PyTorch.

    meta/info.json                                   features, counts, paths
    meta/stats.json                                  statistics of each feature
    meta/tasks.parquet                               tasks in words
    meta/episodes/chunk-000/file-000.parquet         facts and statistics of an episode
    data/chunk-000/file-000.parquet                  its frames
    videos/observation.images.NAME/chunk-000/...     its pictures

Each episode has files of its own, so that nothing that is complete is ever written again. An episode counts once its
file in `meta/episodes` is there, which comes after frames and videos; then `tasks`, `stats` and `info` are replaced.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from roboassembly.atomic_file import atomic_write
from roboassembly.control.controls import ActionCodec
from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.feature_statistics import Statistics, of_rows, together
from roboassembly.demonstrations.features import environment_state_names, robot_state_names
from roboassembly.demonstrations.staging import EpisodeRecord, read_staged, staging_folder
from roboassembly.demonstrations.video import DEPTH_INFO, RGB_INFO, Video
from roboassembly.errors import InputError
from roboassembly.simulation.control_physics import CONTROL_RATE

CHUNK = 1000
"""Files of a folder at most."""
ROBOT = "two_mobile_pandas"
"""`robot_type` of the data sets."""
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODE = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_COUNTERS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Features that LeRobot itself adds to each frame."""


def picture_key(camera: str, *, depth: bool) -> str:
    """Return the feature of a camera's colours or distances."""
    return f"observation.images.{camera}{'_depth' * depth}"


class VideoFiles:
    """Videos of one episode, a file for each camera.

    Args:
        folder: where they are made.
        config: cameras and sizes.
    """

    def __init__(self, folder: Path, config: DemoConfig) -> None:
        self._videos: dict[tuple[str, str], Video] = {}
        for camera in config.cameras:
            for depth in (False, True)[: 1 + config.depth]:
                key = picture_key(camera, depth=depth)
                seen = f"{'depth' if depth else 'rgb'}_{camera}"
                self._videos[key, seen] = Video(folder / f"{key}.mp4", config.width, config.height, depth=depth)

    def add(self, observation: Mapping[str, np.ndarray]) -> None:
        """Append the pictures of an observation."""
        for (_, seen), video in self._videos.items():
            video.add(observation[seen])

    def close(self) -> dict[str, Statistics]:
        """Complete the files; returns the statistics of each feature."""
        return {key: video.close() for (key, _), video in self._videos.items()}

    def abandon(self) -> None:
        """Stop writing; harmless after `close`."""
        for video in self._videos.values():
            video.abandon()


def features_of(config: DemoConfig, max_parts: int) -> dict[str, dict[str, Any]]:
    """Return the features of `info.json`.

    Args:
        config: what is recorded.
        max_parts: padding of the state.
    """

    def numbers(names: list[str]) -> dict[str, Any]:
        return {"dtype": "float32", "shape": [len(names)], "names": names}

    def scalar(dtype: str) -> dict[str, Any]:
        return {"dtype": dtype, "shape": [1], "names": None}

    out = {
        "observation.state": numbers(robot_state_names()),
        "observation.environment_state": numbers(environment_state_names(max_parts)),
        "action": numbers(ActionCodec(config.control).names),
        "next.reward": scalar("float32"), "next.done": scalar("bool"), "next.success": scalar("bool"),
    }  # fmt: skip
    size = {"video.height": config.height, "video.width": config.width}
    for camera in config.cameras:
        for depth in (False, True)[: 1 + config.depth]:
            info = DEPTH_INFO if depth else RGB_INFO
            out[picture_key(camera, depth=depth)] = {
                "dtype": "video", "shape": [config.height, config.width, info["video.channels"]],
                "names": ["height", "width", "channels"], "info": {**size, **info},
            }  # fmt: skip
    return out | {name: scalar("float32" if name == "timestamp" else "int64") for name in _COUNTERS}


class LeRobotDataset:
    """LeRobot data set that grows episode by episode.

    Args:
        folder: of the data set.
        config: what is recorded.
        max_parts: padding of the state.

    Raises:
        InputError: a file of the data set is broken.
    """

    def __init__(self, folder: Path, config: DemoConfig, max_parts: int) -> None:
        self._folder = folder
        self._features = features_of(config, max_parts)
        self._tasks: list[str] = []
        self._statistics: list[dict[str, Statistics]] = []
        self._frames = 0
        for row in _episode_rows(folder):
            self._take_in(row)

    @property
    def count(self) -> int:
        """Number of episodes."""
        return len(self._statistics)

    def add(self, staged: Path) -> EpisodeRecord:
        """Add the next episode, which waits in a folder; returns the facts on it.

        Adding one again that was added half is harmless.

        Raises:
            OSError: the disk is full.
        """
        record, numbers = read_staged(staged)
        index, place = self.count, _place(self.count)
        assert record.index == index
        for key in record.pictures:
            with self._replaced(_VIDEO.format(video_key=key, **place)) as unfinished:
                _link(staged / f"{key}.mp4", unfinished)
        columns = self._columns(record, numbers)
        with self._replaced(_DATA.format(**place)) as unfinished:
            _write_frames(unfinished, columns, self._features)
        statistics = {name: of_rows(rows) for name, rows in columns.items()}
        statistics |= {
            key: {name: np.array(value) for name, value in each.items()} for key, each in record.pictures.items()
        }
        row = self._episode_row(record, statistics)
        with self._replaced(_EPISODE.format(**place)) as unfinished:
            _write_row(unfinished, row)
        self._take_in(row)
        self.write_meta()
        shutil.rmtree(staged, ignore_errors=True)
        return record

    def finish(self) -> None:
        """Replace what depends on all episodes; a stopped process may have missed that."""
        if self.count:
            self.write_meta()

    def write_meta(self) -> None:
        """Replace `tasks.parquet`, `stats.json` and `info.json`."""
        with self._replaced("meta/tasks.parquet") as unfinished:
            _write_tasks(unfinished, self._tasks)
        merged = {name: together([each[name] for each in self._statistics]) for name in self._statistics[0]}
        lists = {name: {key: value.tolist() for key, value in each.items()} for name, each in merged.items()}
        with self._replaced("meta/stats.json") as unfinished:
            unfinished.write_text(json.dumps(lists, indent=4) + "\n")
        has_videos = any(feature["dtype"] == "video" for feature in self._features.values())
        info = {
            "codebase_version": "v3.0", "robot_type": ROBOT, "total_episodes": self.count,
            "total_frames": self._frames, "total_tasks": len(self._tasks), "chunks_size": CHUNK,
            "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": CONTROL_RATE,
            "splits": {"train": f"0:{self.count}"}, "data_path": _DATA, "video_path": _VIDEO if has_videos else None,
            "features": self._features,
        }  # fmt: skip
        with self._replaced("meta/info.json") as unfinished:
            unfinished.write_text(json.dumps(info, indent=4) + "\n")

    def _replaced(self, name: str) -> AbstractContextManager[Path]:
        """Return the block that writes a file; readers of the data set never see the unfinished one."""
        return atomic_write(self._folder / name, staging_folder(self._folder))

    def _columns(self, record: EpisodeRecord, numbers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the rows of each feature in the table of frames."""
        n = record.frames
        task = self._tasks.index(record.task) if record.task in self._tasks else len(self._tasks)
        counters = {
            "timestamp": (np.arange(n) / CONTROL_RATE).astype(np.float32), "frame_index": np.arange(n),
            "episode_index": np.full(n, record.index), "index": self._frames + np.arange(n),
            "task_index": np.full(n, task),
        }  # fmt: skip
        return {name: rows[:n] for name, rows in numbers.items()} | counters

    def _episode_row(self, record: EpisodeRecord, statistics: dict[str, Statistics]) -> dict[str, Any]:
        """Return the row of an episode in `meta/episodes`; `seed` and what follows are this package's own."""
        place, seconds = _place(record.index), record.frames / CONTROL_RATE
        row: dict[str, Any] = {"episode_index": record.index, "tasks": [record.task], "length": record.frames}
        row |= {f"data/{name}": value for name, value in place.items()}
        row |= {"dataset_from_index": self._frames, "dataset_to_index": self._frames + record.frames}
        for key in record.pictures:
            row |= {f"videos/{key}/{name}": value for name, value in place.items()}
            row |= {f"videos/{key}/from_timestamp": 0.0, f"videos/{key}/to_timestamp": seconds}
        row |= {f"meta/episodes/{name}": value for name, value in place.items()}
        row |= {"seed": record.seed, "furniture": record.furniture, "merge": record.merge}
        row["failures"] = list(record.failures)
        for feature, each in statistics.items():
            row |= {f"stats/{feature}/{name}": value.tolist() for name, value in each.items()}
        return row

    def _take_in(self, row: Mapping[str, Any]) -> None:
        statistics: dict[str, Statistics] = {}
        for column, value in row.items():
            if column.startswith("stats/"):
                _, feature, name = column.split("/")
                statistics.setdefault(feature, {})[name] = np.array(value)
        self._statistics.append(statistics)
        self._frames += row["length"]
        self._tasks += [task for task in row["tasks"] if task not in self._tasks]


def read_episodes(folder: Path) -> list[tuple[EpisodeRecord, np.ndarray]]:
    """Return the facts and the actions of all episodes.

    Raises:
        InputError: a file of the data set is broken.
    """
    import pyarrow.parquet as pq

    out: list[tuple[EpisodeRecord, np.ndarray]] = []
    for index, row in enumerate(_episode_rows(folder)):
        path = folder / _DATA.format(**_place(index))
        try:
            column = pq.read_table(str(path), columns=["action"]).column("action")
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"'{path}' is broken: {str(error).partition(chr(10))[0]:.120}") from None
        facts = EpisodeRecord(
            index, row["seed"], row["furniture"], row["merge"], row["tasks"][0], row["length"], tuple(row["failures"])
        )
        out.append((facts, np.array(column.to_pylist(), np.float32)))
    return out


def _place(index: int) -> dict[str, int]:
    """Return the place of an episode's files."""
    return {"chunk_index": index // CHUNK, "file_index": index % CHUNK}


def _episode_rows(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of all episodes, up to the first that is not there."""
    import pyarrow.parquet as pq

    rows: list[dict[str, Any]] = []
    while (path := folder / _EPISODE.format(**_place(len(rows)))).is_file():
        try:
            (row,) = pq.read_table(str(path)).to_pylist()
        except (OSError, ValueError) as error:
            raise InputError(f"'{path}' is broken: {str(error).partition(chr(10))[0]:.120}") from None
        rows.append(row)
    return rows


def _link(source: Path, target: Path) -> None:
    """Give a file a second, new place."""
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def _write_frames(path: Path, columns: Mapping[str, np.ndarray], features: Mapping[str, dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays: dict[str, Any] = {}
    for name, rows in columns.items():
        kind = pa.type_for_alias(features[name]["dtype"])
        flat = pa.array(np.ascontiguousarray(rows).ravel(), kind)
        arrays[name] = pa.FixedSizeListArray.from_arrays(flat, rows.shape[1]) if rows.ndim == 2 else flat
    pq.write_table(pa.table(arrays), str(path))


def _write_row(path: Path, row: Mapping[str, Any]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {name: [value] for name, value in row.items()}
    types = {"failures": pa.list_(pa.string())}  # an empty list shows no type
    pq.write_table(pa.table({name: pa.array(value, types.get(name)) for name, value in columns.items()}), str(path))


def _write_tasks(path: Path, tasks: list[str]) -> None:
    """Write the table of tasks, whose index in pandas is the text: pandas reads that from the metadata of the file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def column(name: str, kind: str, numpy_kind: str) -> dict[str, Any]:
        return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy_kind, "metadata": None}

    about = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0",
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
    }  # fmt: skip
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(about)}), str(path))
