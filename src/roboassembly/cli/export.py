"""`roboassembly export`: furniture for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from roboassembly.cli.output import DONE, print_json, show, writable_folder


@dataclass(frozen=True)
class Export:
    """Write furniture as MJCF, for MuJoCo, or as URDF."""

    kind: Annotated[Literal["mjcf", "urdf"], tyro.conf.Positional]
    """The format."""
    furniture: Annotated[str, tyro.conf.Positional] = "ladder"
    """A built-in piece or a furniture folder, as for `assemble`."""
    out: Path = Path("export")
    """Folder for the file and its meshes."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        from roboassembly.furniture import catalogue
        from roboassembly.furniture.export import export_mjcf, export_urdf

        furniture = catalogue.find(self.furniture)
        write = export_mjcf if self.kind == "mjcf" else export_urdf
        path = write(furniture, writable_folder(self.out))
        if self.json:
            print_json({"furniture": furniture.name, "parts": len(furniture.parts), "outputs": {self.kind: str(path)}})
        else:
            show(path)
        return DONE
