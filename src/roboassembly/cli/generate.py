"""`roboassembly generate`: save a built-in chair as a furniture folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.output import DONE, check_writable, print_json, refuse_existing, show


@dataclass(frozen=True)
class Generate:
    """Make one piece of a built-in family and save it as a furniture folder."""

    family: Annotated[str, tyro.conf.Positional]
    """Name of the family, `stool` for instance; a name that is not known is answered with all that are."""
    seed: int = 0
    """Another seed makes another piece of the family."""
    out: Path | None = None
    """Folder to write. Without it: FAMILY-SEED."""
    force: bool = False
    """Replace furniture that is there already."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        from roboassembly.datasets import catalogue
        from roboassembly.errors import InputError
        from roboassembly.furniture import storage

        if self.seed < 0:
            raise InputError(f"--seed {self.seed} is negative; 0 or more would do")
        target = self.out or Path(f"{self.family}-{self.seed}")
        if self.out is not None:
            check_writable(target)
        furniture = catalogue.make(self.family, self.seed)
        check_writable(target)
        if not self.force:
            refuse_existing(target)
        folder = storage.save(furniture, target)
        if self.json:
            print_json(
                {
                    "furniture": furniture.name,
                    "parts": len(furniture.parts),
                    "connections": len(furniture.connections),
                    "outputs": {"furniture": str(folder)},
                }
            )
        else:
            show(folder)
        return DONE
