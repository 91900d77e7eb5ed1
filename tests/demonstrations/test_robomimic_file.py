"""HDF5 files in robomimic's layout: contents, continuation, and what happens when the disk is full."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from demonstrations.made_up import MAX_PARTS, PLAIN, SEEING, length, numbers, pictures, stage
from roboassembly.demonstrations import robomimic_file
from roboassembly.demonstrations.robomimic_file import FILE, PictureDatasets, RobomimicFile, read_episodes
from roboassembly.errors import InputError

h5py = pytest.importorskip("h5py")


def test_demos_are_laid_out_as_robomimic_reads_them(tmp_path: Path) -> None:
    dataset = RobomimicFile(tmp_path, SEEING, MAX_PARTS)
    for index in range(2):
        dataset.add(stage(tmp_path, index, SEEING, PictureDatasets))
    assert not (tmp_path / FILE).exists()
    dataset.finish()
    with h5py.File(tmp_path / FILE) as file:
        data = file["data"]
        assert list(data) == ["demo_0", "demo_1"]
        assert data.attrs["total"] == length(0) + length(1)
        env = json.loads(data.attrs["env_args"])
        assert (env["env_name"], env["type"]) == ("RoboAssembly/Control-v0", 2)
        assert env["env_kwargs"]["furniture"] == "stool"
        assert env["env_kwargs"]["cameras"] == ["wrist_a", "overview"]
        for index in range(2):
            demo, rows = data[f"demo_{index}"], numbers(index)
            assert demo.attrs["num_samples"] == length(index)
            assert (demo.attrs["seed"], demo.attrs["task"]) == (1000 + index, f"Join part {index}.")
            np.testing.assert_array_equal(demo["actions"], rows["action"])
            np.testing.assert_array_equal(demo["rewards"], rows["next.reward"])
            np.testing.assert_array_equal(demo["dones"], rows["next.done"])
            np.testing.assert_array_equal(demo["obs/state"], rows["observation.state"][:-1])
            np.testing.assert_array_equal(demo["next_obs/state"], rows["observation.state"][1:])
            np.testing.assert_array_equal(demo["next_obs/environment_state"], rows["observation.environment_state"][1:])
            for frame in (0, length(index) - 1):
                drawn = pictures(index, frame)
                np.testing.assert_array_equal(demo["obs/wrist_a_image"][frame], drawn["rgb_wrist_a"])
                np.testing.assert_array_equal(demo["obs/overview_depth"][frame, ..., 0], drawn["depth_overview"])


def test_a_file_is_continued_and_a_full_disk_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = RobomimicFile(tmp_path, PLAIN, MAX_PARTS)
    first.add(stage(tmp_path, 0, PLAIN, PictureDatasets))
    first.finish()
    before = (tmp_path / FILE).read_bytes()
    second = RobomimicFile(tmp_path, PLAIN, MAX_PARTS)
    assert second.count == 1
    staged = stage(tmp_path, 1, PLAIN, PictureDatasets)
    second.add(staged)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(robomimic_file, "_write_demo", full)
        with pytest.raises(OSError, match="No space left"):
            second.finish()
    assert (tmp_path / FILE).read_bytes() == before
    assert staged.is_dir()
    assert [p.name for p in tmp_path.iterdir() if p.name.endswith(".hdf5")] == [FILE]
    third = RobomimicFile(tmp_path, PLAIN, MAX_PARTS)
    third.add(staged)
    third.finish()
    assert not staged.exists()
    records = read_episodes(tmp_path)
    assert [record.seed for record, _ in records] == [1000, 1001]
    np.testing.assert_array_equal(records[1][1], numbers(1)["action"])


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"\x89HDF\r\n\x1a\n and no more")
    with pytest.raises(InputError, match=r"demos.hdf5' is broken"):
        RobomimicFile(tmp_path, PLAIN, MAX_PARTS)
