"""Path of a film's camera: it stands still as long as it can, and glides from one place to the next.

The camera looks the same way in all frames. A point is in the picture if its position lies on the right side of four
planes through the camera, so what two cameras see is also seen from everywhere between them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter1d

from roboassembly.rendering.camera import AZIMUTH, FIELD_OF_VIEW, Camera, view_axes
from roboassembly.rendering.colors import Role
from roboassembly.viewer.motion_timing import ease
from roboassembly.viewer.timeline import Phase, Timeline

ELEVATION = float(np.radians(-27.0))
"""Elevation of the viewing direction [rad]."""
GLIDE = 0.6
"""Time that the camera takes from one place to the next [s]."""
SHORTEST = 1.2
"""Least time that it stands still [s]."""
LOOK_AHEAD = 0.6
"""Time before and after a motion during which what moves is kept in the picture [s]."""
MOVE_COST = 0.8
"""Cost of a glide: a picture twice as wide as needed for so many seconds costs as much."""
MARGINS = (0.16, 0.06, 0.06, 0.07)
"""Free parts of the picture above, below, left and right, over its height or width; captions stand above."""
CLOSEST = 0.9
"""Least width of what the picture shows [m]."""
NEAR = 0.8
"""Distance between the groups of a merge at which both are kept in the picture [m]."""
_STILL = 1e-6
"""Motion from frame to frame that does not count [m]."""
_SAMPLES = 6.0
"""Rate at which places are considered [Hz]."""


def follow(timeline: Timeline, aspect: float) -> list[Camera]:
    """Return one camera per frame. All that moves, and what it moves to, is in the picture and large.

    The times at which the camera stands still are those of least cost: how much wider the picture is than each frame
    needs, summed over time, and a cost for each glide.

    Args:
        timeline: frames of the film.
        aspect: width over height of the picture.
    """
    azimuth = _azimuth(timeline)
    axes = view_axes(azimuth, ELEVATION)
    low, high = _needed_boxes(timeline, axes)
    ends = _camera_changes(low, high, timeline.frames_per_second, aspect)
    half = round(0.5 * GLIDE * timeline.frames_per_second)
    places = [
        _place(low[max(0, a - half) : b + half].min(axis=0), high[max(0, a - half) : b + half].max(axis=0), aspect)
        for a, b in itertools.pairwise(ends)
    ]
    positions = np.concatenate([np.tile(p, (b - a, 1)) for p, a, b in zip(places, ends[:-1], ends[1:], strict=True)])
    for before, after, cut in zip(places[:-1], places[1:], ends[1:-1], strict=True):
        first, last = max(0, cut - half), min(len(positions), cut + half)
        for k in range(first, last):
            positions[k] = before + ease((k - first + 1) / (last - first + 1)) * (after - before)
    return [_camera(position, azimuth) for position in positions]


def close_ups(timeline: Timeline, indices: Sequence[int], aspect: float) -> list[Camera]:
    """Return a camera for each of these frames, which shows what `follow` keeps in view in this frame alone."""
    azimuth = _azimuth(timeline)
    low, high = _needed_boxes(timeline, view_axes(azimuth, ELEVATION))
    return [_camera(_place(low[k], high[k], aspect), azimuth) for k in indices]


def _camera(place: Float[np.ndarray, "3"], azimuth: float) -> Camera:
    """Return the camera at a place along its axes. It looks at the point before it that is as deep as the origin."""
    distance = max(-float(place[2]), 1e-3)
    target = view_axes(azimuth, ELEVATION).T @ (place + np.array([0.0, 0.0, distance]))
    return Camera(target, distance, azimuth, ELEVATION)


def _azimuth(timeline: Timeline) -> float:
    """Return the azimuth of the viewing direction: of eight, the first from which no robot hides the finished piece."""
    robots = _robots(timeline)
    if not robots:
        return AZIMUTH
    links = np.concatenate(robots)
    everything: Int[np.ndarray, "_"] = np.arange(len(timeline.box_corners[-1]))
    parts = np.setdiff1d(everything, links)
    azimuths = [AZIMUTH + k * np.pi / 4.0 for k in (0, -1, 1, -2, 2, -3, 3, 4)]
    hidden: list[float] = []
    for azimuth in azimuths:
        seen = timeline.box_corners[-1] @ view_axes(azimuth, ELEVATION).T
        low, high = seen.min(axis=1), seen.max(axis=1)
        left, right = low[parts].min(axis=0), high[parts].max(axis=0)
        shared = np.clip(np.minimum(high[links], right) - np.maximum(low[links], left), 0.0, None)[:, :2].prod(axis=1)
        hidden.append(float(shared[low[links, 2] < 0.5 * (left + right)[2]].sum()))
    return azimuths[int(np.argmin(hidden))]


def _camera_changes(
    low: Float[np.ndarray, "frames 3"], high: Float[np.ndarray, "frames 3"], rate: float, aspect: float
) -> list[int]:
    """Return the frames at which the camera's places change, the first frame and the number of frames among them."""
    stride = max(1, round(rate / _SAMPLES))
    count = -(-len(low) // stride)
    pad = count * stride - len(low)
    blocks_low = np.pad(low, ((0, pad), (0, 0)), mode="edge").reshape(count, stride, 3).min(axis=1)
    blocks_high = np.pad(high, ((0, pad), (0, 0)), mode="edge").reshape(count, stride, 3).max(axis=1)
    around, shortest = -(-round(0.5 * GLIDE * rate) // stride), max(1, round(SHORTEST * rate / stride))
    own = _widths(blocks_low, blocks_high, aspect)
    total = np.concatenate([[0.0], np.cumsum(1.0 / own)])
    best, since = np.full(count + 1, np.inf), np.zeros(count + 1, int)
    best[0] = -MOVE_COST * _SAMPLES
    for a in range(count):
        if not np.isfinite(best[a]):
            continue
        start = max(0, a - around)
        lows = np.minimum.accumulate(blocks_low[start:])
        highs = np.maximum.accumulate(blocks_high[start:])
        last = np.arange(a + min(shortest, count - a), count + 1)
        at = np.minimum(last - 1 + around, count - 1) - start
        width = _widths(lows[at], highs[at], aspect)
        cost = best[a] + MOVE_COST * _SAMPLES + width * (total[last] - total[a]) - (last - a)
        better = cost < best[last]
        best[last[better]], since[last[better]] = cost[better], a
    out = [count]
    while out[-1] > 0:
        out.append(int(since[out[-1]]))
    return [min(k * stride, len(low)) for k in out[::-1]]


def _slopes(aspect: float) -> tuple[float, float, float, float]:
    """Return the tangents of the angles up to which the picture is used: above, below, left and right."""
    half = float(np.tan(0.5 * FIELD_OF_VIEW))
    above, below, left, right = (1.0 - 2.0 * margin for margin in MARGINS)
    return half * above, half * below, half * aspect * left, half * aspect * right


def _place(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], aspect: float) -> Float[np.ndarray, "3"]:
    """Return the place of the camera, along its axes, from which a box along these axes fills the picture."""
    return _places(low[None], high[None], aspect)[0]


def _places(low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"], aspect: float) -> Float[np.ndarray, "n 3"]:
    above, below, left, right = _slopes(aspect)
    size = high - low
    # The nearest face of the box decides. Both sides of the picture touch it, or its upper and its lower edge do.
    distance = np.maximum(
        np.maximum(size[:, 0], CLOSEST) / (left + right), np.maximum(size[:, 1], CLOSEST / aspect) / (above + below)
    )
    middle = 0.5 * (low + high)
    across = middle[:, 0] - 0.5 * distance * (right - left)
    up = middle[:, 1] - 0.5 * distance * (above - below)
    return np.stack([across, up, low[:, 2] - distance], axis=1)


def _widths(low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"], aspect: float) -> Float[np.ndarray, "n"]:
    """Return the width of the picture at the middle of each box [m]."""
    depth = 0.5 * (low + high)[:, 2] - _places(low, high, aspect)[:, 2]
    return 2.0 * np.tan(0.5 * FIELD_OF_VIEW) * aspect * depth


def _needed_boxes(
    timeline: Timeline, axes: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames 3"]]:
    """Return the box along the camera's axes that each frame must show [m]: its lowest and its highest corner."""
    corners = timeline.box_corners @ axes.T
    lows, highs = corners.min(axis=2), corners.max(axis=2)
    needed = _needed(timeline)[..., None]
    return np.where(needed, lows, np.inf).min(axis=1), np.where(needed, highs, -np.inf).max(axis=1)


def _needed(timeline: Timeline) -> Bool[np.ndarray, "frames objects"]:
    """Return which framed objects each frame must show.

    These are the objects that move about that time, a robot with all its links, and the group that they move to. With
    robots, that group may stand far away until it is fetched; it and both robots count once it is near. A frame without
    motion shows what the frame before it shows, and those at both ends show everything.
    """
    frames, corners = timeline.frames, timeline.box_corners
    robots = _robots(timeline)
    moved = np.zeros(corners.shape[:2], dtype=bool)
    moved[1:] = np.abs(np.diff(corners, axis=0)).max(axis=(2, 3)) > _STILL
    window = round(LOOK_AHEAD * timeline.frames_per_second)
    out = maximum_filter1d(moved.astype(np.uint8), 2 * window + 1, axis=0, mode="nearest").astype(bool)
    for robot in robots:
        out[:, robot] |= out[:, robot].any(axis=1, keepdims=True)
    for index, frame in enumerate(frames):
        roles = frame.roles[: corners.shape[1]]
        moving = [i for i, role in enumerate(roles) if role is Role.MOVING]
        waiting = [i for i, role in enumerate(roles) if role is Role.WAITING]
        if frame.phase in (Phase.OVERTURE, Phase.FINALE):
            out[index] = True
        elif waiting and out[index, moving].any():
            between = corners[index, moving].mean(axis=(0, 1)) - corners[index, waiting].mean(axis=(0, 1))
            if not robots or np.linalg.norm(between) < NEAR:
                out[index, [*waiting, *(link for robot in robots for link in robot)]] = True
        if index and not out[index].any():
            out[index] = out[index - 1]
    return out


def _robots(timeline: Timeline) -> list[Int[np.ndarray, "n"]]:
    """Return the indices of the links of each robot."""
    owners = [item.name.split("/")[0] for item in timeline.objects if item.framed]
    names = sorted({owner for owner in owners if owner.startswith("robot")})
    return [np.array([i for i, owner in enumerate(owners) if owner == name]) for name in names]
