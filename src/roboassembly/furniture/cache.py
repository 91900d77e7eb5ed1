"""Folder of cached results."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """Return `$ROBOASSEMBLY_CACHE`, or else the system's folder for the user's caches."""
    own = os.environ.get("ROBOASSEMBLY_CACHE")
    return Path(own) if own else Path(platformdirs.user_cache_dir("roboassembly"))
