# The part of fast-simplification that this project uses; the library's own types leave out the decorator's.
# tests/test_stubs.py compares it with the library.
import numpy as np
from numpy.typing import NDArray

def simplify(
    points: NDArray[np.float64], triangles: NDArray[np.int64], *, target_count: int, agg: float = 7.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
