"""Films in segments: the same for any number of processes, and nothing is drawn twice."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import trimesh

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3
from roboassembly.rendering.camera import Camera
from roboassembly.rendering.renderer import FAST, placements
from roboassembly.viewer.film_segments import SEGMENT_FRAMES, FilmScene, Shot, draw_shots, encode_film

SCENE = FilmScene((Mesh.from_trimesh(trimesh.creation.box((0.3, 0.2, 0.1))),), 96, 64, np.zeros(3), 1.0, FAST)
FRAMES = 2 * SEGMENT_FRAMES + 7


def shot(x: float) -> Shot:
    """An orange box at x [m]."""
    row = placements([[SE3(np.eye(3), np.array([x, 0.0, 0.4]))]])[0]
    return Shot(row, np.array([[1.0, 0.4, 0.0]]), Camera(np.array([0.0, 0.0, 0.3]), 3.0), "")


class CountingRenderer:
    """Renderer of pictures that show how many were drawn before."""

    width, height = 96, 64
    boxes = np.array([np.stack(np.meshgrid(*[[-0.1, 0.1]] * 3), axis=-1).reshape(8, 3)])

    def __init__(self) -> None:
        self.areas: list[int] = []

    def draw(self, world_from_mesh, colors, camera, within=None):
        height, width = (64, 96) if within is None else (within.height, within.width)
        self.areas.append(height * width)
        return np.full((height, width, 3), len(self.areas), dtype=np.uint8)


def test_unchanged_frames_are_drawn_once_and_changes_in_part() -> None:
    renderer = CountingRenderer()
    pictures = list(draw_shots(renderer, [shot(x) for x in (0.0, 0.0, 0.0, 0.1, 0.0, 0.0)]))
    assert len(renderer.areas) == 3
    assert renderer.areas[0] == 96 * 64
    assert max(renderer.areas[1:]) < 96 * 64 / 4
    assert [len(np.unique(picture)) for picture in pictures] == [1, 1, 1, 2, 2, 2]
    assert [int(picture.max()) for picture in pictures] == [1, 1, 1, 2, 3, 3]


def test_every_change_counts() -> None:
    still = shot(0.0)
    changed = [
        shot(1e-9),
        replace(still, colors=np.array([[1.0, 0.4, 0.01]])),
        replace(still, camera=Camera(np.array([0.0, 0.0, 0.31]), 3.0)),
        replace(still, camera=Camera(still.camera.target, 3.01)),
        replace(still, camera=Camera(still.camera.target, 3.0, azimuth=1.0)),
        replace(still, camera=Camera(still.camera.target, 3.0, elevation=-1.0)),
    ]
    for other in changed:
        renderer = CountingRenderer()
        list(draw_shots(renderer, [still, other]))
        assert len(renderer.areas) == 2
    renderer = CountingRenderer()
    plain, captioned = draw_shots(renderer, [still, replace(still, caption="step 1")])
    assert len(renderer.areas) == 1
    assert (plain != captioned).any()


@pytest.mark.slow
def test_one_and_two_processes_write_the_same_film(drawing: None, tmp_path: Path) -> None:
    shots = [shot(-1.0 + 2.0 * k / FRAMES) for k in range(FRAMES)]
    for jobs in (1, 2):
        encode_film(SCENE, shots, tmp_path / f"{jobs}.mp4", 24, jobs)
    assert (tmp_path / "1.mp4").read_bytes() == (tmp_path / "2.mp4").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["1.mp4", "2.mp4"]
    films = np.array(list(iio.imiter(tmp_path / "1.mp4", plugin="FFMPEG"))).astype(int)
    assert len(films) == FRAMES
    assert iio.immeta(tmp_path / "1.mp4", plugin="FFMPEG")["duration"] == pytest.approx(FRAMES / 24, abs=0.011)
    # Every frame is in its place: the box goes on at the ends of segments, too.
    columns = np.arange(96)
    orange = (films[..., 0] > films[..., 2] + 80).sum(axis=1)
    middle = (orange * columns).sum(axis=1) / orange.sum(axis=1)
    strides = np.diff(middle[10:-10])
    assert np.abs(strides).max() < 3.0
    assert abs(middle[-11] - middle[10]) > 30
    with SCENE.renderer() as renderer:
        for index in (0, SEGMENT_FRAMES - 1, SEGMENT_FRAMES, FRAMES - 1):
            picture = next(draw_shots(renderer, [shots[index]])).astype(int)
            assert np.abs(picture - films[index]).mean() < 4.0


def test_no_python_runs_between_fork_and_exec(drawing: None, tmp_path: Path) -> None:
    """It could wait for ever for a lock that a thread of JAX or of a server holds; hooks of forks would run then."""
    forks: list[int] = []
    os.register_at_fork(before=lambda: forks.append(1))
    encode_film(SCENE, [shot(0.0)], tmp_path / "film.mp4", 24, 1)
    assert (tmp_path / "film.mp4").stat().st_size > 0
    assert not forks


@pytest.mark.slow
def test_interrupted_film_leaves_plan_and_page(drawing: None, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "roboassembly.cli", "assemble", "ladder", "--out", str(tmp_path)]
    (tmp_path / "assembly.mp4").write_bytes(b"the film of an earlier plan")
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("rendering the film"):
            break
    deadline = time.monotonic() + 60.0
    while not any(tmp_path.glob(".*/*.mp4")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # what a terminal does
    _, rest = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert rest == "interrupted\n"
    assert sorted(os.listdir(tmp_path)) == ["assembly.html", "furniture", "plan.json", "timings.json"]
