"""Furniture from elsewhere: one importer a format, all with the same two functions."""

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
    """Reads one piece that `find` found."""

    def __call__(self, path: Path, *, scale: float | None = None) -> RawFurniture:
        """Parts at their assembled poses, z up, metres; `scale` is metres per unit of the files.

        Raises:
            FurnitureError: whatever is wrong with the files.
        """
        ...


@dataclass(frozen=True)
class Importer:
    """A format that furniture can be read from."""

    name: str
    description: str
    find: Callable[[Path], list[Path]]
    """The pieces at or below a path; raises `FurnitureError` if there are none."""
    read: Reader
    reads: Callable[[Path], Path] = lambda piece: piece
    """The file or folder that holds all that reading a piece may look at."""


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
                "folder", "OBJ, STL, PLY or GLB parts in assembled poses, or a GLB scene", folder.find, folder.read
            ),
        )
    }
)
"""By the name that `roboassembly import` takes."""
