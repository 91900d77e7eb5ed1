"""Staged episodes with numbers drawn at random, for tests of files: no robot moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roboassembly.demonstrations.config import DemoConfig
from roboassembly.demonstrations.features import environment_state_names, robot_state_names
from roboassembly.demonstrations.recording import PictureFiles
from roboassembly.demonstrations.staging import EpisodeRecord, new_part, write_staged

SIZE = 32
MAX_PARTS = 2
PLAIN = DemoConfig(task="merge")
SEEING = DemoConfig(task="merge", cameras=("wrist_a", "overview"), width=SIZE, height=SIZE, depth=True)


def length(index: int) -> int:
    """Frames of an episode."""
    return 25 + 3 * index


def numbers(index: int) -> dict[str, np.ndarray]:
    """Rows of an episode, as `recording` hands them over."""
    rng, n = np.random.default_rng([7, index]), length(index)
    return {
        "observation.state": rng.normal(size=(n + 1, len(robot_state_names()))).astype(np.float32),
        "observation.environment_state": rng.normal(size=(n + 1, len(environment_state_names(MAX_PARTS)))).astype(
            np.float32
        ),
        "action": rng.uniform(-1.0, 1.0, (n, 22)).astype(np.float32),
        "next.reward": (np.arange(n) == n - 1).astype(np.float32),
        "next.done": np.arange(n) == n - 1,
        "next.success": np.arange(n) == n - 1,
    }


def pictures(index: int, frame: int) -> dict[str, np.ndarray]:
    """Smooth pictures that differ from frame to frame."""
    row, column = np.mgrid[:SIZE, :SIZE] / SIZE
    shade = (200.0 * row + 2.0 * frame) % 256
    rgb = np.stack([shade, 200.0 * column, np.full_like(row, 8.0 * index)], axis=2).astype(np.uint8)
    depth = (0.05 + 6.0 * row + 0.01 * frame).astype(np.float32)
    return {f"{kind}_{c}": each for c in SEEING.cameras for kind, each in (("rgb", rgb), ("depth", depth))}


def stage(folder: Path, index: int, config: DemoConfig, open_pictures) -> Path:
    """Write an episode into its staging folder, and return that."""
    with new_part(folder, index) as part:
        files: PictureFiles = open_pictures(part, config)
        for frame in range(length(index)):
            files.add(pictures(index, frame))
        statistics = {
            name: {key: value.tolist() for key, value in each.items()} for name, each in files.close().items()
        }
        task = f"Join part {index % 2}."
        record = EpisodeRecord(index, 1000 + index, "stool", index, task, length(index), ("dropped",), statistics)
        write_staged(part, record, numbers(index))
    return folder / ".staging" / f"episode-{index:06d}"


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a data set."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
