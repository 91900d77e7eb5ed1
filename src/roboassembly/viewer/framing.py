"""Where the camera stands so that what matters is in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from roboassembly.meshes import Mesh
from roboassembly.poses import SE3, transform_points
from roboassembly.viewer.timeline import Phase, Role, Timeline

AZIMUTH = float(np.radians(130.0))
ELEVATION = float(np.radians(-24.0))
FIELD_OF_VIEW = float(np.radians(36.0))
"""Vertical, radians."""
MARGIN = 1.06
ORBIT_RATE = float(np.radians(3.0))
"""Radians a second that the film's camera goes around."""
CAMERA_SECONDS = 2.0
"""How slowly the film's camera follows the action."""


@dataclass(frozen=True, eq=False)
class View:
    """A camera that looks at `target` from `distance` metres, z up.

    It looks along `(cos e cos a, cos e sin a, sin e)` for azimuth a and elevation e: a negative elevation looks down.
    """

    target: Float[np.ndarray, "3"]
    distance: float
    azimuth: float = AZIMUTH
    elevation: float = ELEVATION

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """Metres, in the world."""
        return self.target - self.distance * view_axes(self.azimuth, self.elevation)[2]


def view_axes(azimuth: float, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Rows: right, up and forward of the camera, in the world."""
    forward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(right, forward), forward])


def project(
    points: Float[np.ndarray, "n 3"], view: View, width: int, height: int, field_of_view: float = FIELD_OF_VIEW
) -> Float[np.ndarray, "n 2"]:
    """Pixel coordinates (x right, y down, the origin at the picture's upper left corner) of world points."""
    across, up, depth = view_axes(view.azimuth, view.elevation) @ (points - view.position).T
    scale = 0.5 * height / np.tan(0.5 * field_of_view)
    return np.column_stack([0.5 * width + scale * across / depth, 0.5 * height - scale * up / depth])


def fit(
    points: Float[np.ndarray, "n 3"],
    aspect: float,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    target: Float[np.ndarray, "3"] | None = None,
) -> View:
    """The nearest view that holds all points. `aspect` is width over height; `target` is their middle if not given."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0)) if target is None else target
    across, up, depth = view_axes(azimuth, elevation) @ (points - middle).T
    slope = np.tan(0.5 * FIELD_OF_VIEW) / MARGIN
    distance = np.maximum(np.abs(across) / (slope * aspect), np.abs(up) / slope) - depth
    return View(middle, max(float(distance.max()), 1e-3), azimuth, elevation)


def box_corners(mesh: Mesh, pose: SE3) -> Float[np.ndarray, "8 3"]:
    """Corners of the mesh's own bounding box, moved by `pose`."""
    return transform_points(pose, _between(mesh.bounds[:1], mesh.bounds[1:]))


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
        swept[step] = _between(lows, highs)
    return [corners[i].reshape(-1, 3) if f.step is None else swept[f.step] for i, f in enumerate(frames)]


def _between(lows: Float[np.ndarray, "n 3"], highs: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    return np.where(_CORNERS[None], highs[:, None], lows[:, None]).reshape(-1, 3)


_CORNERS = np.array([[(i >> k) & 1 for k in range(3)] for i in range(8)], dtype=bool)
