# The part of imageio-ffmpeg that this project uses; the library's own types are incomplete. tests/test_stubs.py
# compares it with the library.
from collections.abc import Generator, Sequence

import numpy as np

def get_ffmpeg_exe() -> str: ...
def write_frames(
    path: str,
    size: tuple[int, int],
    pix_fmt_in: str = ...,
    pix_fmt_out: str = ...,
    fps: float = ...,
    quality: float | None = ...,
    *,
    codec: str | None = ...,
    macro_block_size: int = ...,
    ffmpeg_log_level: str = ...,
    output_params: Sequence[str] | None = ...,
) -> Generator[None, np.ndarray | None]: ...
