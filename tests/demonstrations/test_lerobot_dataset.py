"""LeRobot data sets: what is in the files, and what happens when writing stops anywhere."""

from __future__ import annotations

import json
import resource
import subprocess
from collections import deque
from itertools import repeat
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from demonstrations.made_up import MAX_PARTS, PLAIN, SEEING, SIZE, contents, length, numbers, pictures, stage
from roboassembly.demonstrations import lerobot_dataset
from roboassembly.demonstrations.lerobot_dataset import LeRobotDataset, VideoFiles, read_episodes
from roboassembly.demonstrations.video import DEPTH_MAX, Video, level_distances, quantized
from roboassembly.errors import InputError

pq = pytest.importorskip("pyarrow.parquet")
EPISODES = 3


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of three episodes with two cameras and depth."""
    folder = tmp_path_factory.mktemp("lerobot")
    dataset = LeRobotDataset(folder, SEEING, MAX_PARTS)
    for index in range(EPISODES):
        dataset.add(stage(folder, index, SEEING, VideoFiles))
    dataset.finish()
    (folder / ".staging").rmdir()
    return folder


def read_json(path: Path) -> dict:
    return json.loads(path.read_text())


def test_the_frames_are_those_that_were_recorded(written: Path) -> None:
    tables = [pq.read_table(written / f"data/chunk-000/file-{e:03d}.parquet") for e in range(EPISODES)]
    first = 0
    for index, table in enumerate(tables):
        n = length(index)
        assert table.num_rows == n
        for name, rows in numbers(index).items():
            np.testing.assert_array_equal(np.array(table.column(name).to_pylist()), rows[:n])
        assert table.column("frame_index").to_pylist() == list(range(n))
        assert table.column("index").to_pylist() == list(range(first, first + n))
        assert set(table.column("episode_index").to_pylist()) == {index}
        assert set(table.column("task_index").to_pylist()) == {index % 2}
        np.testing.assert_allclose(table.column("timestamp").to_pylist(), np.arange(n) / 20.0, atol=1e-6)
        first += n
    info = read_json(written / "meta/info.json")
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (EPISODES, first, 2)
    assert (info["codebase_version"], info["fps"], info["splits"]) == ("v3.0", 20, {"train": "0:3"})
    feature = info["features"]["observation.environment_state"]
    assert feature["shape"] == [len(feature["names"])] == [tables[0].schema.field(1).type.list_size]
    assert feature["names"][:7] == [f"part0/{axis}" for axis in ("x", "y", "z", "qw", "qx", "qy", "qz")]


def test_statistics_are_those_of_all_frames(written: Path) -> None:
    stats = read_json(written / "meta/stats.json")
    for name in ("observation.state", "action", "next.reward"):
        rows = np.concatenate([numbers(e)[name][: length(e)] for e in range(EPISODES)]).astype(float)
        rows = rows.reshape(len(rows), -1)
        for key, expected in (("mean", rows.mean(0)), ("std", rows.std(0)), ("min", rows.min(0)), ("max", rows.max(0))):
            np.testing.assert_allclose(stats[name][key], expected, atol=1e-9)
        assert stats[name]["count"] == [len(rows)]
    drawn = [pictures(e, f) for e in range(EPISODES) for f in range(length(e))]
    colours = np.stack([each["rgb_wrist_a"] for each in drawn]).reshape(-1, 3) / 255.0
    found = stats["observation.images.wrist_a"]
    for key, expected in (("mean", colours.mean(0)), ("std", colours.std(0)), ("max", colours.max(0))):
        np.testing.assert_allclose(np.array(found[key]), expected.reshape(3, 1, 1), atol=1e-9)
    depth = np.stack([each["depth_overview"] for each in drawn])
    np.testing.assert_allclose(
        np.array(stats["observation.images.overview_depth"]["mean"]), [[[depth.mean()]]], atol=2e-3
    )


def test_tasks_have_their_text_as_index_for_pandas(written: Path) -> None:
    table = pq.read_table(written / "meta/tasks.parquet")
    assert table.to_pylist() == [
        {"task_index": 0, "task": "Join part 0."}, {"task_index": 1, "task": "Join part 1."},
    ]  # fmt: skip
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_episodes_say_where_their_frames_are_and_how_to_repeat_them(written: Path) -> None:
    (row,) = pq.read_table(written / "meta/episodes/chunk-000/file-001.parquet").to_pylist()
    assert (row["length"], row["tasks"]) == (length(1), ["Join part 1."])
    assert (row["dataset_from_index"], row["dataset_to_index"]) == (length(0), length(0) + length(1))
    assert (row["data/chunk_index"], row["data/file_index"]) == (0, 1)
    assert row["videos/observation.images.wrist_a/to_timestamp"] == length(1) / 20.0
    assert (row["seed"], row["furniture"], row["merge"], row["failures"]) == (1001, "stool", 1, ["dropped"])
    records = read_episodes(written)
    assert [record.seed for record, _ in records] == [1000, 1001, 1002]
    np.testing.assert_array_equal(records[2][1], numbers(2)["action"])


def frames_of(path: Path, pixels: str, dtype, channels: int) -> np.ndarray:
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-v",
        "error",
        "-i",
        str(path),
        "-f",
        "rawvideo",
        "-pix_fmt",
        pixels,
        "-",
    ]
    raw = subprocess.run(command, capture_output=True, check=True, stdin=subprocess.DEVNULL).stdout
    return np.frombuffer(raw, dtype).reshape(-1, SIZE, SIZE, channels)


def test_videos_show_the_pictures(written: Path) -> None:
    colour = frames_of(written / "videos/observation.images.overview/chunk-000/file-002.mp4", "rgb24", np.uint8, 3)
    depth = frames_of(
        written / "videos/observation.images.overview_depth/chunk-000/file-002.mp4", "gray12le", np.uint16, 1
    )
    assert len(colour) == len(depth) == length(2)
    for frame in (0, 7, length(2) - 1):
        drawn = pictures(2, frame)
        error = colour[frame].astype(float) - drawn["rgb_overview"]
        assert np.sqrt((error**2).mean()) < 6.0
        np.testing.assert_array_equal(depth[frame, ..., 0], quantized(drawn["depth_overview"]))


def test_distances_survive_quantization() -> None:
    """LeRobot's formula: 12 bits between 0.01 and 10 m, finer near by; what is farther becomes 10 m."""
    metres = np.array([0.01, 0.1, 0.5, 1.0, 3.0, 9.99, 10.0, 40.0], np.float32)
    back = level_distances()[quantized(metres)]
    np.testing.assert_allclose(back[:-1], metres[:-1], atol=2.5e-3)
    assert abs(back[1] - 0.1) < 1e-3
    assert (quantized(metres)[0], quantized(metres)[-1], back[-1]) == (0, 4095, pytest.approx(DEPTH_MAX))


def test_the_checker_has_no_objection(written: Path) -> None:
    pytest.importorskip("lerobot_doctor")
    from lerobot_doctor.dataset_loader import load_dataset
    from lerobot_doctor.runner import run_checks

    report = run_checks(load_dataset(str(written)))
    severities = {result.name: result.severity.value for result in report.results}
    assert "FAIL" not in severities.values(), report.results
    for name in ("Metadata & Format Compliance", "Temporal Consistency", "Video Integrity", "Feature Consistency"):
        assert severities[name] == "PASS", report.results
    assert severities["Portability"] == "PASS"


class Stopped(BaseException):
    """End of the process."""


@pytest.mark.parametrize("stop_at", range(5))
def test_an_addition_that_stops_anywhere_is_made_again(
    stop_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames, facts, tasks, statistics and info are five files; the second episode stops before one of them."""
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for folder in (whole, stopped):
        dataset = LeRobotDataset(folder, PLAIN, MAX_PARTS)
        dataset.add(stage(folder, 0, PLAIN, VideoFiles))
    LeRobotDataset(whole, PLAIN, MAX_PARTS).add(stage(whole, 1, PLAIN, VideoFiles))
    staged = stage(stopped, 1, PLAIN, VideoFiles)
    files, write = [], lerobot_dataset.atomic_write

    def failing(path: Path, scratch: Path):
        assert scratch == stopped / ".staging", "LeRobot reads every file of its folders, hidden ones too"
        if len(files) == stop_at:
            raise Stopped
        files.append(path)
        return write(path, scratch)

    monkeypatch.setattr(lerobot_dataset, "atomic_write", failing)
    with pytest.raises(Stopped):
        LeRobotDataset(stopped, PLAIN, MAX_PARTS).add(staged)
    monkeypatch.setattr(lerobot_dataset, "atomic_write", write)

    info = read_json(stopped / "meta/info.json")
    assert info["total_frames"] == length(0), "LeRobot reads as many frames as the last file says"
    again = LeRobotDataset(stopped, PLAIN, MAX_PARTS)
    if again.count == 1:
        again.add(staged)
    again.finish()
    for folder in (whole, stopped):
        for left in folder.glob(".staging/*/*"):
            left.unlink()
    assert contents(stopped) == contents(whole)


def test_a_broken_file_is_named(written: Path, tmp_path: Path) -> None:
    broken = tmp_path / "meta/episodes/chunk-000/file-000.parquet"
    broken.parent.mkdir(parents=True)
    broken.write_bytes((written / "meta/episodes/chunk-000/file-000.parquet").read_bytes()[:500])
    with pytest.raises(InputError, match=r"file-000.parquet' is broken"):
        LeRobotDataset(tmp_path, SEEING, MAX_PARTS)


def test_a_full_disk_while_a_video_grows_is_told(tmp_path: Path) -> None:
    """A limit on the size of files, which ffmpeg inherits, stands for the end of the disk."""
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, most))
    try:
        video = Video(tmp_path / "v.mp4", 64, 64, depth=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    with pytest.raises(OSError, match="No space left on device") as error:
        deque(map(video.add, repeat(noise, 200)), 0)
    assert error.value.filename == str(tmp_path / "v.mp4")
    video.abandon()


def test_a_video_that_is_abandoned_leaves_no_process(tmp_path: Path) -> None:
    video = Video(tmp_path / "v.mp4", SIZE, SIZE, depth=True)
    video.add(np.full((SIZE, SIZE), 1.0, np.float32))
    video.abandon()
    video.abandon()
    done = Video(tmp_path / "w.mp4", SIZE, SIZE, depth=True)
    done.add(np.full((SIZE, SIZE), 1.0, np.float32))
    statistics = done.close()
    done.abandon()
    assert statistics["mean"][0, 0, 0] == pytest.approx(1.0, abs=1e-3)
    assert statistics["std"][0, 0, 0] == pytest.approx(0.0, abs=1e-6)
