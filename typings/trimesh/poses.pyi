import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh import Trimesh

def compute_stable_poses(
    mesh: Trimesh,
    center_mass: ArrayLike | None = None,
    sigma: float = 0.0,
    n_samples: int = 1,
    threshold: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
