# The part of Matplotlib that this project uses; its own types leave keywords open. tests/test_stubs.py compares it with
# the library.
from pathlib import Path

from matplotlib.axes import Axes

class Figure:
    def __init__(self, *, figsize: tuple[float, float], layout: str) -> None: ...
    def add_subplot(self, rows: int, columns: int, index: int, /) -> Axes: ...
    def savefig(self, fname: Path, *, dpi: float) -> None: ...
