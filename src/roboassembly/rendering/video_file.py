"""Video files, encoded by ffmpeg in a process of its own."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import imageio_ffmpeg
import numpy as np
from jaxtyping import Shaped

from roboassembly.errors import RoboAssemblyError

PixelFormat = Literal["rgb24", "gray12le"]
"""Format of pictures: bytes of red, green and blue, or 12-bit numbers in 16 bits."""


class VideoError(RoboAssemblyError):
    """ffmpeg is missing or fails."""


def ffmpeg() -> str:
    """Return the path of ffmpeg.

    Raises:
        VideoError: ffmpeg is missing.
    """
    try:
        return imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        raise VideoError("ffmpeg is missing; install it with: pip install imageio-ffmpeg") from None


class VideoFile:
    """Video file that grows picture by picture.

    Args:
        path: new file, `.mp4`.
        width: of the pictures [pixels], even.
        height: of the pictures [pixels], even.
        fps: pictures per second.
        pixels: format of the pictures.
        options: ffmpeg's options for the codec.

    Raises:
        VideoError: ffmpeg is missing.
    """

    def __init__(
        self, path: Path, width: int, height: int, fps: float, pixels: PixelFormat, options: Sequence[str]
    ) -> None:
        self._path, self._over = path, False
        command = [ffmpeg(), "-y", "-v", "error", "-f", "rawvideo", "-s", f"{width}x{height}", "-pix_fmt", pixels]
        command += ["-r", str(fps), "-i", "-", *options, str(path)]
        # A session of its own: an interrupt stops this process first, which then stops ffmpeg. No Python code runs
        # between fork and exec, which could hang in a process with threads, such as those of JAX or of a server.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )

    def add(self, picture: Shaped[np.ndarray, "height width channels"]) -> None:
        """Append a picture.

        Raises:
            OSError: the disk is full.
            VideoError: ffmpeg fails.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(picture).tobytes())
        except OSError:
            self.close()
            raise VideoError(f"ffmpeg stopped while it wrote '{self._path}'") from None

    def close(self) -> None:
        """Complete the file.

        Raises:
            OSError: the disk is full.
            VideoError: ffmpeg fails.
        """
        text, status = self._end(), self._process.returncode
        if not status:
            return
        full = os.strerror(errno.ENOSPC)
        if full in text or os.strerror(errno.EFBIG) in text or status == -signal.SIGXFSZ:
            raise OSError(errno.ENOSPC, full, str(self._path))
        raise VideoError(f"ffmpeg cannot write '{self._path}': {text[-200:] or f'it ended with {status}'}")

    def abandon(self) -> None:
        """Stop writing; the file is of no use. Does nothing after `close`."""
        if not self._over:
            self._process.kill()
            self._end()

    def _end(self) -> str:
        """Wait for ffmpeg; returns its complaints."""
        self._over = True
        _, said = self._process.communicate()
        return said.decode(errors="replace").strip()
