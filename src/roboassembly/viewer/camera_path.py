"""Path of a film's camera, which keeps the parts of each step in the picture."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from roboassembly.rendering.camera import AZIMUTH, Camera, boxes_corners, fit_camera
from roboassembly.rendering.colors import Role
from roboassembly.viewer.timeline import Phase, Timeline

ORBIT_RATE = float(np.radians(3.0))
"""Angular speed of the camera around the scene [rad/s]."""
CAMERA_SECONDS = 2.0
"""Time [s] over which the motion of the camera is averaged."""


def follow(timeline: Timeline, aspect: float) -> list[Camera]:
    """Return one camera per frame, which orbits slowly and keeps the parts of the current step in the picture.

    These are the parts that move or wait during the step. Before the first step and after the last, all parts are
    kept in the picture.

    Args:
        timeline: frames of the film.
        aspect: width over height of the picture.
    """
    points = _points_to_show(timeline, timeline.box_corners)
    window = max(1, round(CAMERA_SECONDS * timeline.frames_per_second))
    middle = np.array([0.5 * (p.min(axis=0) + p.max(axis=0)) for p in points])
    targets: Float[np.ndarray, "frames 3"] = uniform_filter1d(middle, window, axis=0, mode="nearest")
    time = np.arange(len(points)) / timeline.frames_per_second
    azimuths = AZIMUTH + ORBIT_RATE * (time - 0.5 * time[-1])
    cameras = [fit_camera(p, aspect, float(azimuths[i]), target=targets[i]) for i, p in enumerate(points)]
    # Maxima over a window, averaged over the same window, are nowhere below the distance that a frame needs.
    needed: Float[np.ndarray, "frames"] = maximum_filter1d(
        np.array([c.distance for c in cameras]), 2 * (window // 2) + 1, mode="nearest"
    )
    distances: Float[np.ndarray, "frames"] = uniform_filter1d(needed, 2 * (window // 2) + 1, mode="nearest")
    return [Camera(c.target, float(d), c.azimuth) for c, d in zip(cameras, distances, strict=True)]


def _points_to_show(
    timeline: Timeline, corners: Float[np.ndarray, "frames objects 8 3"]
) -> list[Float[np.ndarray, "n 3"]]:
    """Return, for each frame, the points that the picture must contain [m]."""
    frames = timeline.frames
    swept: dict[int, Float[np.ndarray, "n 3"]] = {}
    for step in {frame.step for frame in frames if frame.step is not None}:
        own = [i for i, frame in enumerate(frames) if frame.step == step]
        first = next((i for i in own if frames[i].phase is not Phase.PAUSE), own[0])
        active = [
            i for i, role in enumerate(frames[first].roles) if role is not Role.IDLE and timeline.objects[i].framed
        ]
        # A box around the volume that each object sweeps: eight points instead of eight per frame.
        lows, highs = corners[own][:, active].min(axis=(0, 2)), corners[own][:, active].max(axis=(0, 2))
        swept[step] = boxes_corners(lows, highs)
    return [corners[i].reshape(-1, 3) if f.step is None else swept[f.step] for i, f in enumerate(frames)]
