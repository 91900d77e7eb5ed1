"""`roboassembly generate`: save built-in furniture as a furniture folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.options import require_at_least
from roboassembly.cli.output import DONE, check_writable, print_json, refuse_existing, show


@dataclass(frozen=True)
class GenerateCommand:
    """Generate a piece of a built-in family and save it as a furniture folder."""

    family: Annotated[str, tyro.conf.Positional]
    """Name of the family, such as `stool`; an unknown name prints the list of families."""
    seed: int = 0
    """Random seed; each seed gives a different piece of the family."""
    out: Path | None = None
    """Folder for the furniture. Without it: FAMILY-SEED."""
    fasteners: bool = False
    """Put screws or dowels through the joints, by the seed."""
    force: bool = False
    """Replace existing furniture."""
    json: bool = False
    """Print one JSON object on stdout and everything else on stderr."""

    def run(self) -> int:
        """Run the command; returns the exit status."""
        from roboassembly.datasets import catalogue
        from roboassembly.furniture import storage

        require_at_least(0, seed=self.seed)
        target = self.out or Path(f"{self.family}-{self.seed}")
        if self.out is not None:
            check_writable(target)
        furniture = catalogue.make(self.family, self.seed, fasteners=self.fasteners)
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
                    **({"fasteners": len(furniture.fasteners)} if self.fasteners else {}),
                    "outputs": {"furniture": str(folder)},
                }
            )
        else:
            show(folder)
        return DONE
