import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh import Trimesh

def oriented_bounds(obj: Trimesh | ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
