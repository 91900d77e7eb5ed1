"""JAX's compilation cache, kept from run to run."""

from __future__ import annotations

import hashlib
import os
import platform
import re
from pathlib import Path

from roboassembly.furniture.cache import cache_folder

_CPU_INFO = Path("/proc/cpuinfo")


def keep_compiled() -> None:
    """Keep what JAX compiles, here and in processes started from here, in the cache folder.

    Call it before JAX is imported. `$JAX_COMPILATION_CACHE_DIR` names another folder.
    """
    flags = re.search(r"^(flags|Features)\s*:(.*)$", _CPU_INFO.read_text(), re.M) if _CPU_INFO.is_file() else None
    # One folder for each kind of processor: several machines may share a home folder.
    kind = f"{platform.machine()} {flags[2] if flags else platform.processor()}"
    folder = cache_folder() / "jax" / hashlib.sha256(kind.encode()).hexdigest()[:12]
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
