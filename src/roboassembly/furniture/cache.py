"""Where things are kept that can be made again."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """`$ROBOASSEMBLY_CACHE`, else the system's place for the user's caches."""
    own = os.environ.get("ROBOASSEMBLY_CACHE")
    return Path(own) if own else Path(platformdirs.user_cache_dir("roboassembly"))
