# The part of imageio that this project uses; the library's own types are incomplete. tests/test_stubs.py compares it
# with the library.
from io import BytesIO
from pathlib import Path

import numpy as np

def imread(uri: Path | str) -> np.ndarray: ...
def imwrite(uri: Path | str | BytesIO, image: np.ndarray, *, extension: str | None = ...) -> None: ...
