"""Configuration of a studio. It imports little, so that the page can be served before anything else is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roboassembly.task.setting import SettingName

LARGEST_UPLOAD = 50_000_000
"""Largest size of an uploaded file, packed or unpacked [bytes]."""


@dataclass(frozen=True)
class StudioConfig:
    """Configuration that all clients of a studio share."""

    folders: tuple[Path, ...]
    """Folders of furniture folders that clients choose from."""
    policies: tuple[str, ...]
    """Policies that clients choose from, as for `roboassembly assemble --policy`; the first is the default."""
    furniture: str
    """Furniture that is open at first: a name for `sources.open_path`, or the path of a `plan.json`."""
    scale: float | None
    """Scale of 3D files [m per unit]; estimated if None."""
    setting: SettingName
    """Setting at first."""
    seed: int
    """Seed at first."""
    roots: tuple[Path, ...] = ()
    """Folders of this machine in which clients may open folders by name; none if empty."""
