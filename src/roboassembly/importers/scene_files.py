"""Files that hold a whole piece, by suffix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from roboassembly.importers import glb, step, threemf
from roboassembly.importers.scene import FileScene


@dataclass(frozen=True)
class SceneFormat:
    """Format of files that hold a whole piece."""

    name: str
    read: Callable[[Path], FileScene]
    count_parts: Callable[[Path], int]
    """Function that counts the parts of a file, at least roughly; 0 if it cannot be read."""
    states_unit: bool
    """Whether files state their unit."""


_GLTF = SceneFormat("glTF", glb.read_gltf, glb.count_parts, states_unit=False)
_STEP = SceneFormat("STEP", step.read_step, step.count_parts, states_unit=True)
_3MF = SceneFormat("3MF", threemf.read_3mf, threemf.count_parts, states_unit=True)
SCENES = {".glb": _GLTF, ".gltf": _GLTF, ".step": _STEP, ".stp": _STEP, ".3mf": _3MF}
"""Formats by file suffix, in lower case."""


def scene_format(path: Path) -> SceneFormat | None:
    """Return the format of a file by its suffix; None if it is no scene."""
    return SCENES.get(path.suffix.lower())
