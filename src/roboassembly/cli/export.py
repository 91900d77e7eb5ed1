"""`roboassembly export`: furniture as MJCF, URDF or USD; plans of two robots as trajectories."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from roboassembly.cli.output import (
    DONE,
    check_writable,
    print_json,
    refuse_existing,
    refuse_furniture_folder,
    show,
    writable_folder,
)
from roboassembly.errors import InputError

RATE = 50.0
HIGHEST_RATE = 1000.0
"""Samples of a trajectory a second: by default, and at most [Hz]."""
TrajectoryFormat = Literal["mcap", "csv", "json"]


@dataclass(frozen=True)
class ExportCommand:
    """Export furniture as MJCF, URDF or USD, or a plan of two robots as a timed trajectory."""

    kind: Annotated[Literal["mjcf", "urdf", "usd", "trajectory"], tyro.conf.Positional]
    """Format of furniture (one of three), or `trajectory` for the timed motions of a plan."""
    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FURNITURE|PLAN")] = "ladder"
    """A built-in piece (`FAMILY` or `FAMILY:SEED`) or a furniture folder. For a trajectory: a plan.json of
    `roboassembly assemble --setting full`, with its `furniture/` folder beside it unless the piece is built in."""
    out: Path = Path("export")
    """Folder for the file and its meshes."""
    format: TrajectoryFormat | None = None
    """Format of a trajectory: `mcap` (ROS 2, Foxglove; the default), `csv` or `json`."""
    rate: float | None = None
    """Samples of a trajectory a second. Without it: 50."""
    force: bool = False
    """Replace an existing file."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        check_writable(self.out)
        refuse_furniture_folder(self.out)
        if self.kind == "trajectory":
            return self._export_trajectory()
        for option, value in (("--format", self.format), ("--rate", self.rate)):
            if value is not None:
                raise InputError(f"{option} is for trajectories; leave it out, or: roboassembly export trajectory PLAN")
        from roboassembly.datasets import catalogue
        from roboassembly.furniture.export import export_mjcf, export_urdf, exported_file
        from roboassembly.furniture.usd import check_usd, export_usd

        if self.kind == "usd":
            check_usd()
        furniture = catalogue.find(self.source)
        if not self.force:
            refuse_existing(exported_file(furniture, self.out, self.kind))
        write = {"mjcf": export_mjcf, "urdf": export_urdf, "usd": export_usd}[self.kind]
        path = write(furniture, writable_folder(self.out))
        if self.json:
            print_json({"furniture": furniture.name, "parts": len(furniture.parts), "outputs": {self.kind: str(path)}})
        else:
            show(path)
        return DONE

    def _export_trajectory(self) -> int:
        rate = RATE if self.rate is None else self.rate
        if not (math.isfinite(rate) and 1.0 <= rate <= HIGHEST_RATE):
            raise InputError(f"--rate {rate:g}: expected 1 to {HIGHEST_RATE:g} samples a second")
        from roboassembly.studio.sources import open_plan
        from roboassembly.task.plans.motion_record import decode_motions
        from roboassembly.task.trajectories.files import trajectory_file, write_trajectory
        from roboassembly.task.trajectories.mcap_file import check_mcap
        from roboassembly.task.trajectories.trajectory import time_plan

        name = self.format or "mcap"
        if name == "mcap":
            check_mcap()
        plan = Path(self.source)
        _, furniture = open_plan(plan)
        record = decode_motions(plan.read_bytes(), self.source)
        path = trajectory_file(record.furniture, self.out, name)
        if not self.force:
            refuse_existing(path)
        trajectory = time_plan(record, furniture)
        writable_folder(self.out)
        write_trajectory(trajectory, rate, path, name)
        if self.json:
            print_json(
                {
                    "furniture": record.furniture,
                    "parts": len(record.parts),
                    "motions": len(trajectory.segments),
                    "seconds": round(trajectory.seconds, 3),
                    "rate": rate,
                    "outputs": {name: str(path)},
                }
            )
        else:
            show(path)
        return DONE
