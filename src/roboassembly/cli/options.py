"""Options that several commands take, `jobs: Jobs = CORES` for instance."""

from __future__ import annotations

import os
from typing import Annotated, Literal

import tyro

CORES = os.cpu_count() or 1
Jobs = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: one a core)")]
"""Its help is the same on every machine."""
Ray = Annotated[
    str | None,
    tyro.conf.arg(
        help="Spread the work over a Ray cluster: HOST:PORT of its head, `auto`, or `local`. All machines need this "
        "package, and the same folders under the same paths."
    ),
]
"""Address of a Ray cluster."""
Setting = Literal["object-centric", "full"]
"""`task.setting.SettingName`, which takes a while to import."""
Execution = Literal["kinematic", "dynamic"]
"""`learning.players.ExecutionName`."""
