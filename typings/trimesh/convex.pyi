import numpy as np
from numpy.typing import NDArray
from trimesh import Trimesh

def convex_hull(obj: Trimesh | NDArray[np.float64]) -> Trimesh: ...
