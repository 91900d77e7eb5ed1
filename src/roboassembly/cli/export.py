"""`roboassembly export`: furniture as MJCF or URDF."""

from __future__ import annotations

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


@dataclass(frozen=True)
class ExportCommand:
    """Export furniture as MJCF, the format of MuJoCo, or as URDF."""

    kind: Annotated[Literal["mjcf", "urdf"], tyro.conf.Positional]
    """Format of the file."""
    furniture: Annotated[str, tyro.conf.Positional] = "ladder"
    """A built-in piece (`FAMILY` or `FAMILY:SEED`) or a furniture folder."""
    out: Path = Path("export")
    """Folder for the file and its meshes."""
    force: bool = False
    """Replace an existing file."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        from roboassembly.datasets import catalogue
        from roboassembly.furniture.export import export_mjcf, export_urdf, exported_file

        check_writable(self.out)
        refuse_furniture_folder(self.out)
        furniture = catalogue.find(self.furniture)
        if not self.force:
            refuse_existing(exported_file(furniture, self.out, self.kind))
        write = export_mjcf if self.kind == "mjcf" else export_urdf
        path = write(furniture, writable_folder(self.out))
        if self.json:
            print_json({"furniture": furniture.name, "parts": len(furniture.parts), "outputs": {self.kind: str(path)}})
        else:
            show(path)
        return DONE
