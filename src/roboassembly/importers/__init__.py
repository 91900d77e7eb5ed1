"""Importers of furniture: one for each file format, all with the functions `find` and `read`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from roboassembly.furniture.model import RawFurniture
from roboassembly.importers import folder, furniture_bench, ikea_env, ikea_manual, partnet

__all__ = ["IMPORTERS", "Importer", "Reader"]


class Reader(Protocol):
    """Function that reads one piece of furniture that `find` returned."""

    def __call__(self, path: Path, *, scale: float | None = None) -> RawFurniture:
        """Return the parts at their assembled poses, z up, in metres; `scale` is in metres per unit of the files.

        Raises:
            FurnitureError: the files are missing, broken or unsupported.
        """
        ...


@dataclass(frozen=True)
class Importer:
    """File format that furniture is read from."""

    name: str
    description: str
    find: Callable[[Path], list[Path]]
    """Function that lists the pieces at or below a path; raises `FurnitureError` if there are none."""
    read: Reader
    reads: Callable[[Path], Path] = lambda piece: piece
    """Function that returns the file or folder with everything that `read` may open for a piece."""


IMPORTERS: Mapping[str, Importer] = MappingProxyType(
    {
        importer.name: importer
        for importer in (
            Importer("partnet", "PartNet v0 folders: leaves of the merged hierarchy", partnet.find, partnet.read),
            Importer(
                "ikea-manual", "IKEA-Manuals-at-Work: NN.obj in assembled poses", ikea_manual.find, ikea_manual.read
            ),
            Importer(
                "ikea-env",
                "IKEA Furniture Assembly Environment: MJCF with connection sites",
                ikea_env.find,
                ikea_env.read,
                lambda piece: piece.resolve().parent,
            ),
            Importer(
                "furniture-bench",
                "FurnitureBench: OBJ and assembled_poses.json",
                furniture_bench.find,
                furniture_bench.read,
                furniture_bench.reads,
            ),
            Importer(
                "folder",
                "your own files: parts in assembled poses (OBJ, STL, PLY), or a scene (STEP, 3MF, glTF)",
                folder.find,
                folder.read,
                folder.reads,
            ),
        )
    }
)
"""Importers by the format name that `roboassembly import` accepts."""
