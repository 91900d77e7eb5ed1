"""On what a benchmark ran."""

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
    """That this process may use."""
    system: str
    python: str
    load: float | None
    """Mean number of running processes in the last minute, where the system tells: above `cores`, times are noisy."""
    versions: dict[str, str]
    """Of the packages that are installed."""

    @classmethod
    def here(cls) -> Machine:
        """This one, now."""
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
