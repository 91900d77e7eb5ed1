"""Options that several commands share, such as `jobs: Jobs = CORES`."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.cli.flags import SharedHelp
from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef

CORES = os.cpu_count() or 1
Jobs = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: one per core)")]
"""Number of processes; its help is the same on every machine."""
Ray = Annotated[
    str | None,
    tyro.conf.arg(
        help="Run on a Ray cluster: HOST:PORT of its head node, `auto`, or `local`. All machines need this package and "
        "the same folders at the same paths.",
        metavar="ADDRESS",
    ),
]
"""Address of a Ray cluster; None to use this machine only."""
Setting = Annotated[
    Literal["object-centric", "full"],
    SharedHelp(
        "Setting of the task. object-centric: parts move by themselves. full: two mobile Franka robots move them."
    ),
]
"""Setting, like `task.setting.SettingName`, which is slow to import."""
Frames = Literal["aligned", "own"]
"""Frames of observations, like `task.part_frames.FramesName`, which is slow to import."""
Clouds = Literal["shared", "resampled"]
"""Clouds of observations, like `envs.observation.CloudsName`."""
Execution = Annotated[
    Literal["kinematic", "dynamic"],
    SharedHelp(
        "Execution by the robots of --setting full. kinematic: their paths are planned and checked for collisions. "
        "dynamic: actuated robots also execute the plan in a physics simulation."
    ),
]
"""Execution of a full plan."""


def require_at_least(least: int, **values: int | None) -> None:
    """Check options against a smallest value; a value of None passes.

    Args:
        least: smallest value.
        values: values by the name of the option, with underscores.

    Raises:
        InputError: a value is smaller.
    """
    for name, value in values.items():
        if value is not None and value < least:
            raise InputError(f"--{name.replace('_', '-')} {value} is too small; it must be {least} or more")


@contextmanager
def workers(ray: str | None, jobs: int) -> Generator[int]:
    """Take the workers that `--ray` and `--jobs` select inside the block; yields their number."""
    from roboassembly.parallel.processes import use_cluster

    with use_cluster(ray, jobs) as count:
        yield count


def selected_furniture(name: str, limit: int | None, sample: int | None, seed: int) -> list[FurnitureRef]:
    """Return the furniture that `--set`, `--limit`, `--sample` and `--seed` select.

    Raises:
        InputError: both counts are given, a count is below 1, or the set does not exist or is empty.
    """
    if limit is not None and sample is not None:
        raise InputError("--limit and --sample exclude each other; give only one of them")
    require_at_least(1, limit=limit, sample=sample)
    from roboassembly.datasets.sets import furniture_refs, sample_refs

    return sample_refs(furniture_refs(name)[:limit], sample, seed)
