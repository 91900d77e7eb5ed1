"""Options that several commands take, `jobs: Jobs = CORES` for instance."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from roboassembly.errors import InputError

if TYPE_CHECKING:
    from roboassembly.datasets.sets import FurnitureRef

CORES = os.cpu_count() or 1
Jobs = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: one a core)")]
"""Its help is the same on every machine."""
Ray = Annotated[
    str | None,
    tyro.conf.arg(
        help="Spread the work over a Ray cluster: HOST:PORT of its head, `auto`, or `local`. All machines need this "
        "package and the same folders under the same paths.",
        metavar="ADDRESS",
    ),
]
"""Address of a Ray cluster."""
Setting = Literal["object-centric", "full"]
"""`task.setting.SettingName`, which takes a while to import."""
Execution = Literal["kinematic", "dynamic"]
"""`learning.players.ExecutionName`."""


def chosen(name: str, limit: int | None, sample: int | None, seed: int) -> list[FurnitureRef]:
    """What `--set`, `--limit`, `--sample` and `--seed` name.

    Raises:
        InputError: both of the counts are given, or one below 1; or no such set, or no furniture in the folder.
    """
    if limit is not None and sample is not None:
        raise InputError("--limit takes the first pieces and --sample draws some; only one of them would do")
    if min(n for n in (limit, sample, 1) if n is not None) < 1:
        raise InputError("--limit and --sample take 1 or more")
    from roboassembly.datasets.sets import furniture_refs, sample_refs

    return sample_refs(furniture_refs(name)[:limit], sample, seed)
