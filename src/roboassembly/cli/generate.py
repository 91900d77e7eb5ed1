"""`roboassembly generate`: save a built-in chair as a furniture folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.output import DONE, print_json, show


@dataclass(frozen=True)
class Generate:
    """Make one chair of a built-in family and save it as a furniture folder."""

    family: Annotated[str, tyro.conf.Positional]
    """Its name; a wrong one lists those there are."""
    seed: int = 0
    """Another seed, another chair."""
    out: Path | None = None
    """Folder to write; FAMILY-SEED if not given."""
    json: bool = False
    """Print one JSON object on stdout, all else on stderr."""

    def run(self) -> int:
        """Do it; returns the exit status."""
        from roboassembly.furniture import catalogue, storage

        furniture = catalogue.make(self.family, self.seed)
        folder = storage.save(furniture, self.out or Path(furniture.name))
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
