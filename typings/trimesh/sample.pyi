import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh import Trimesh

def sample_surface(
    mesh: Trimesh, count: int, face_weight: ArrayLike | None = None, *, seed: int | np.random.Generator | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
