"""What all visitors of the studio share; light, so that the page can be served before anything else is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roboassembly.task.setting import SettingName

LARGEST_UPLOAD = 50_000_000
"""Bytes of a file, packed or unpacked."""


@dataclass(frozen=True)
class House:
    """What all visitors share."""

    folders: tuple[Path, ...]
    """Of furniture folders, to choose from."""
    policies: tuple[str, ...]
    """As `roboassembly assemble --policy` takes them; the first is chosen at first."""
    furniture: str
    """Opened at first, as `wares.open_path` takes it, or a `plan.json`."""
    scale: float | None
    """Of 3D files, metres per unit."""
    setting: SettingName
    """At first."""
    seed: int
    """At first."""
    roots: tuple[Path, ...] = ()
    """Folders of this machine that visitors may open folders in, by name; none if they may not."""
