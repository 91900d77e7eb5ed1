"""How many processes a command works with: `jobs: Jobs = CORES`."""

from __future__ import annotations

import os
from typing import Annotated

import tyro

CORES = os.cpu_count() or 1
Jobs = Annotated[int, tyro.conf.arg(help_behavior_hint="(default: one a core)")]
"""Its help is the same on every machine."""
