"""Machine that a benchmark ran on."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from dataclasses import dataclass
from pathlib import Path

_PACKAGES = ("roboassembly", "numpy", "pin", "coal", "ompl", "mujoco", "pybullet", "python-fcl")


@dataclass(frozen=True)
class Machine:
    """Processor, system and versions."""

    cpu: str
    cores: int
    """Number of cores that this process may use."""
    system: str
    python: str
    load: float | None
    """Mean number of running processes in the last minute; None if unknown. Times are noisy if it exceeds `cores`."""
    versions: dict[str, str]
    """Versions of the installed packages."""

    @classmethod
    def here(cls) -> Machine:
        """Return this machine and its present load."""
        versions: dict[str, str] = {}
        for package in _PACKAGES:
            try:
                versions[package] = importlib.metadata.version(package)
            except importlib.metadata.PackageNotFoundError:
                continue
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        return cls(_cpu(), cores, platform.platform(), platform.python_version(), load, versions)


def _cpu() -> str:
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
