import numpy as np
from numpy.typing import ArrayLike, NDArray

def closest_point(triangles: ArrayLike, points: ArrayLike) -> NDArray[np.float64]: ...
