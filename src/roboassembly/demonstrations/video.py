"""Videos of cameras, as LeRobot reads them: colour as H.264, depth as lossless 12-bit HEVC of quantized distances.

Distances are quantized by their logarithm: level `round(4095 (log(d + s) - log(a + s)) / (log(b + s) - log(a + s)))`,
with `a` = `DEPTH_MIN`, `b` = `DEPTH_MAX`, `s` = `DEPTH_SHIFT` in metres, the defaults of LeRobot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Shaped, UInt16

from roboassembly.demonstrations.feature_statistics import Statistics, of_histograms
from roboassembly.rendering.video_file import VideoFile
from roboassembly.simulation.control_physics import CONTROL_RATE

DEPTH_MIN, DEPTH_MAX, DEPTH_SHIFT = 0.01, 10.0, 3.5
"""Distances of the first and the last level, and shift before the logarithm [m]. Farther ones get the last level."""
LEVELS = 4096
"""Levels of quantized distances: 12 bit."""
# Every second picture is a key frame, so that any frame is decoded quickly; one thread, so that the bytes are the same
# on any machine.
_COMMON = ("-g", "2", "-bf", "0", "-threads", "1", "-map_metadata", "-1", "-fflags", "+bitexact")
_COLOUR = ("-vcodec", "libx264", "-pix_fmt", "yuv420p", "-preset", "veryfast", "-crf", "20")
_DEPTH = (
    "-vcodec", "libx265", "-pix_fmt", "gray12le", "-preset", "ultrafast", "-tag:v", "hvc1", "-x265-params",
    "lossless=1:log-level=none:pools=none:frame-threads=1",
)  # fmt: skip
_ENCODER = {"video.g": 2, "video.fast_decode": 0, "video.video_backend": "pyav"}
RGB_INFO: dict[str, Any] = {
    "video.fps": CONTROL_RATE, "video.codec": "h264", "video.pix_fmt": "yuv420p", "video.channels": 3,
    "has_audio": False, "is_depth_map": False, "video.crf": 20, "video.preset": "veryfast", **_ENCODER,
}  # fmt: skip
"""`info` of a colour feature but for the size."""
DEPTH_INFO: dict[str, Any] = {
    "video.fps": CONTROL_RATE, "video.codec": "hevc", "video.pix_fmt": "gray12le", "video.channels": 1,
    "has_audio": False, "is_depth_map": True, "depth_unit": "m", "video.depth_min": DEPTH_MIN,
    "video.depth_max": DEPTH_MAX, "video.shift": DEPTH_SHIFT, "video.use_log": True, "video.preset": "ultrafast",
    "video.extra_options": {"x265-params": "lossless=1"}, **_ENCODER,
}  # fmt: skip
"""`info` of a depth feature but for the size."""


def quantized(depth: Float32[np.ndarray, "height width"]) -> UInt16[np.ndarray, "height width"]:
    """Return the level of each distance [m]."""
    low, high = np.log(DEPTH_MIN + DEPTH_SHIFT), np.log(DEPTH_MAX + DEPTH_SHIFT)
    share = (np.log(depth + DEPTH_SHIFT) - low) / (high - low)
    return np.clip(np.rint(share * (LEVELS - 1)), 0, LEVELS - 1).astype(np.uint16)


def level_distances() -> Float[np.ndarray, "4096"]:
    """Return the distance that each level stands for [m]."""
    low, high = np.log(DEPTH_MIN + DEPTH_SHIFT), np.log(DEPTH_MAX + DEPTH_SHIFT)
    return np.exp(low + (high - low) * np.arange(LEVELS) / (LEVELS - 1)) - DEPTH_SHIFT


class Video:
    """Video file that grows picture by picture, and statistics of its pixels.

    Args:
        path: new file, `.mp4`.
        width: of the pictures [pixels], even.
        height: of the pictures [pixels], even.
        depth: whether it shows distances.

    Raises:
        VideoError: ffmpeg is missing.
    """

    def __init__(self, path: Path, width: int, height: int, *, depth: bool) -> None:
        self._depth, self._frames = depth, 0
        self._counts = np.zeros((1, LEVELS) if depth else (3, 256), np.int64)
        options = (*(_DEPTH if depth else _COLOUR), *_COMMON)
        self._file = VideoFile(path, width, height, CONTROL_RATE, "gray12le" if depth else "rgb24", options)

    def add(self, picture: Shaped[np.ndarray, "height width *channels"]) -> None:
        """Append a picture: bytes of red, green and blue, or distances [m].

        Raises:
            OSError: the disk is full.
            VideoError: ffmpeg fails.
        """
        pixels = quantized(picture)[..., None] if self._depth else picture
        for channel, counts in enumerate(self._counts):
            counts += np.bincount(pixels[..., channel].ravel(), minlength=len(counts))
        self._frames += 1
        self._file.add(pixels)

    def close(self) -> Statistics:
        """Complete the file; returns the statistics: of colours from 0 to 1, of distances in metres.

        Raises:
            OSError: the disk is full.
            VideoError: ffmpeg fails.
        """
        self._file.close()
        values = level_distances() if self._depth else np.arange(256) / 255.0
        return of_histograms(self._counts, values, self._frames)

    def abandon(self) -> None:
        """Stop writing; the file is of no use. Does nothing after `close`."""
        self._file.abandon()
