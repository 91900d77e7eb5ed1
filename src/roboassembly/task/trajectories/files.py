"""Files of trajectories, by format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError
from roboassembly.furniture.export import safe_name
from roboassembly.task.trajectories.mcap_file import write_mcap
from roboassembly.task.trajectories.tables import encode_csv, encode_json
from roboassembly.task.trajectories.trajectory import Trajectory

_ENCODERS: dict[str, Callable[[Trajectory, float], bytes]] = {"csv": encode_csv, "json": encode_json}


def trajectory_file(furniture: str, folder: Path, name: str) -> Path:
    """Return the file that `write_trajectory` is to write.

    Args:
        furniture: name of the furniture.
        folder: folder of the file.
        name: `mcap`, `csv` or `json`.
    """
    return folder / f"{safe_name(furniture)}.{name}"


def write_trajectory(trajectory: Trajectory, rate: float, path: Path, name: str) -> None:
    """Write a trajectory, whole or not at all.

    Args:
        trajectory: to be written.
        rate: samples a second [Hz].
        path: of the file.
        name: `mcap`, `csv` or `json`.

    Raises:
        MissingExtraError: the extra of the format is not installed.
        InputError: the file cannot be written.
    """
    try:
        with atomic_write(path) as unfinished:
            if name in _ENCODERS:
                unfinished.write_bytes(_ENCODERS[name](trajectory, rate))
            else:
                write_mcap(trajectory, rate, unfinished)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from None
