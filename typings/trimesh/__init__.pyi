# The part of trimesh that this project uses; the library's own types are incomplete. tests/test_stubs.py compares it
# with the library.
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh import boolean as boolean
from trimesh import bounds as bounds
from trimesh import convex as convex
from trimesh import creation as creation
from trimesh import sample as sample
from trimesh import triangles as triangles

class Trimesh:
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    face_normals: NDArray[np.float64]
    area_faces: NDArray[np.float64]
    triangles: NDArray[np.float64]
    triangles_center: NDArray[np.float64]
    face_adjacency: NDArray[np.int64]
    face_adjacency_edges: NDArray[np.int64]
    is_volume: bool
    volume: float
    center_mass: NDArray[np.float64]
    moment_inertia: NDArray[np.float64]
    convex_hull: Trimesh
    visual: object
    def __init__(self, vertices: ArrayLike, faces: ArrayLike | None = None, *, process: bool = True) -> None: ...
    def merge_vertices(self) -> None: ...
    def contains(self, points: ArrayLike) -> NDArray[np.bool_]: ...
    def apply_transform(self, matrix: ArrayLike) -> Trimesh: ...
    def apply_translation(self, translation: ArrayLike) -> Trimesh: ...
    def export(
        self, file_obj: Path, *, encoding: Literal["binary", "ascii"] = "binary", vertex_normal: bool | None = None
    ) -> bytes | str: ...

class Scene:
    def dump(self) -> list[Trimesh]: ...

def load_mesh(file_obj: Path, *, file_type: str | None = None, process: bool = True) -> Trimesh: ...
def load_scene(file_obj: Path) -> Scene: ...
