import numpy as np
from embreex.rtcore import EmbreeDevice
from numpy.typing import NDArray

class EmbreeScene:
    def __init__(self, device: EmbreeDevice, /) -> None: ...
    def run(self, origins: NDArray[np.float32], directions: NDArray[np.float32], /) -> NDArray[np.int32]: ...
