from collections.abc import Sequence
from typing import Literal

from trimesh import Trimesh

def intersection(meshes: Sequence[Trimesh], engine: Literal["manifold", "blender"] | None = None) -> Trimesh: ...
