"""The camera of a film: calm, and all that moves in view."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.rendering.camera import project
from roboassembly.rendering.colors import Role
from roboassembly.task.plans.full_plan import FullPlan
from roboassembly.viewer.camera_path import follow
from roboassembly.viewer.film import key_frames
from roboassembly.viewer.playback import make_timeline
from roboassembly.viewer.timeline import Timeline

WIDTH, HEIGHT = 1280, 720


@pytest.fixture(scope="module")
def timeline(two_merges: FullPlan) -> Timeline:
    return make_timeline(two_merges, 15.0)


def test_all_that_moves_stays_in_view_and_large(timeline: Timeline) -> None:
    corners = timeline.box_corners
    cameras = follow(timeline, WIDTH / HEIGHT)
    assert len(cameras) == len(timeline.frames)
    sizes = []
    for k in range(1, len(cameras)):
        moved = np.abs(corners[k] - corners[k - 1]).max(axis=(1, 2)) > 1e-6
        if not moved.any():
            continue
        pixels = project(corners[k][moved].reshape(-1, 3), cameras[k], WIDTH, HEIGHT)
        assert (pixels >= 0).all()
        assert (pixels <= [WIDTH, HEIGHT]).all()
        if moved.sum() > 10:  # more than fingers
            sizes.append((np.ptp(pixels, axis=0) / [WIDTH, HEIGHT]).max())
    assert np.median(sizes) > 0.3
    for k, frame in ((0, timeline.frames[0]), (-1, timeline.frames[-1])):
        parts = [i for i, role in enumerate(frame.roles) if role is Role.IDLE]
        pixels = project(corners[k][parts].reshape(-1, 3), cameras[k], WIDTH, HEIGHT)
        assert (pixels >= [0, 0.1 * HEIGHT]).all(), "clear of the caption"
        assert (pixels <= [WIDTH, HEIGHT]).all()


def test_the_camera_is_calm(timeline: Timeline) -> None:
    cameras = follow(timeline, WIDTH / HEIGHT)
    assert {(c.azimuth, c.elevation) for c in cameras} == {(cameras[0].azimuth, cameras[0].elevation)}
    places = np.array([camera.position for camera in cameras])
    assert places[:, 2].min() > 0.2
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (speed > 0.0).mean() < 0.4, "it mostly stands still"
    # It starts and stops gently: no first stride as long as the longest.
    starts = np.flatnonzero((speed[1:] > 0.0) & (speed[:-1] == 0.0)) + 1
    assert len(starts)
    for start in starts:
        glide = speed[start : start + 9]
        assert glide[0] < 0.7 * glide.max()


def test_key_frames_of_a_storyboard(timeline: Timeline, two_merges: FullPlan) -> None:
    every = key_frames(timeline)
    assert len(every) == len(two_merges.steps) + 2
    assert key_frames(timeline, 6) == every
    few = key_frames(timeline, 3)
    assert few[0] == 0
    assert few[-1] == len(timeline.frames) - 1
    assert few[1] in every
    assert key_frames(timeline, 2) == [0, len(timeline.frames) - 1]
