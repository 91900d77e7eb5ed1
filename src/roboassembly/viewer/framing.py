"""Where the camera of a film stands so that what matters is in the picture."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from roboassembly.rendering.camera import AZIMUTH, View, boxes_corners, fit
from roboassembly.rendering.colors import Role
from roboassembly.viewer.timeline import Phase, Timeline

ORBIT_RATE = float(np.radians(3.0))
"""Radians a second that the film's camera goes around."""
CAMERA_SECONDS = 2.0
"""How slowly the film's camera follows the action."""


def whole_scene(timeline: Timeline, aspect: float) -> View:
    """A fixed view that holds every part at all times."""
    return fit(timeline.box_corners.reshape(-1, 3), aspect)


def follow(timeline: Timeline, aspect: float) -> list[View]:
    """One view a frame: slowly around, near the parts of the current step, never losing them.

    The action of a frame is all that moves or waits during its step; before the first step and after the last it is
    every part.
    """
    corners = timeline.box_corners
    actions = _actions(timeline, corners)
    window = max(1, round(CAMERA_SECONDS * timeline.frames_per_second))
    middle = np.array([0.5 * (a.min(axis=0) + a.max(axis=0)) for a in actions])
    targets = uniform_filter1d(middle, window, axis=0, mode="nearest")
    time = np.arange(len(actions)) / timeline.frames_per_second
    azimuths = AZIMUTH + ORBIT_RATE * (time - 0.5 * time[-1])
    views = [fit(a, aspect, float(azimuths[i]), target=targets[i]) for i, a in enumerate(actions)]
    # The mean over a window of maxima over the same window is nowhere below what its own frame needs.
    needed = maximum_filter1d(np.array([v.distance for v in views]), 2 * (window // 2) + 1, mode="nearest")
    distances = uniform_filter1d(needed, 2 * (window // 2) + 1, mode="nearest")
    return [View(v.target, float(d), v.azimuth) for v, d in zip(views, distances, strict=True)]


def _actions(timeline: Timeline, corners: Float[np.ndarray, "frames parts 8 3"]) -> list[Float[np.ndarray, "n 3"]]:
    """For each frame, the corners that must be in the picture."""
    frames = timeline.frames
    swept: dict[int, np.ndarray] = {}
    for step in {frame.step for frame in frames if frame.step is not None}:
        own = [i for i, frame in enumerate(frames) if frame.step == step]
        first = next((i for i in own if frames[i].phase is not Phase.PAUSE), own[0])
        parts = [p for p, role in enumerate(frames[first].roles) if role is not Role.IDLE and timeline.things[p].framed]
        # The box around what each part sweeps: eight points instead of eight a frame.
        lows, highs = corners[own][:, parts].min(axis=(0, 2)), corners[own][:, parts].max(axis=(0, 2))
        swept[step] = boxes_corners(lows, highs)
    return [corners[i].reshape(-1, 3) if f.step is None else swept[f.step] for i, f in enumerate(frames)]
