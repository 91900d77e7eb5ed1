"""Film in segments of equal length, which worker processes draw and encode independently of each other.

Where a segment begins depends on the film alone, so the file is the same whatever the number of processes.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, UInt8

from roboassembly.geometry.meshes import Mesh
from roboassembly.parallel.processes import one_thread_each, worker_pool
from roboassembly.rendering.camera import Camera
from roboassembly.rendering.captions import draw_caption
from roboassembly.rendering.colors import Finish
from roboassembly.rendering.gl import RenderingUnavailableError, context_module, skip_trial
from roboassembly.rendering.rectangles import Rectangle, changed_rectangle
from roboassembly.rendering.renderer import OffscreenRenderer, Quality
from roboassembly.rendering.shadow_map import SOFTEST
from roboassembly.rendering.video_file import VideoError, VideoFile, ffmpeg


class FilmStoppedError(Exception):
    """The film was stopped before its end."""


SEGMENT_FRAMES = 96
"""Number of frames in a segment."""


@dataclass(frozen=True, eq=False)
class FilmScene:
    """Objects and size of all pictures of a film."""

    meshes: tuple[Mesh, ...]
    width: int
    """Width of pictures [pixels]."""
    height: int
    """Height of pictures [pixels]."""
    center: Float[np.ndarray, "3"]
    """Middle of the scene [m]."""
    radius: float
    """Radius of the scene [m]."""
    quality: Quality | None
    """Quality of pictures; the renderer's choice if None."""
    finishes: tuple[Finish, ...] | None = None
    """Finish of each mesh; paint if None."""

    def renderer(self) -> OffscreenRenderer:
        """Return a new renderer."""
        return OffscreenRenderer(
            self.meshes, self.width, self.height,
            center=self.center, radius=self.radius, quality=self.quality, finishes=self.finishes,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shot:
    """Arguments of `OffscreenRenderer.draw` for one picture, and its caption."""

    world_from_mesh: Float[np.ndarray, "n 7"]
    colors: Float[np.ndarray, "n 3"]
    camera: Camera
    caption: str

    def same_view(self, other: Shot) -> bool:
        """Whether both have the same camera."""
        a, b = self.camera, other.camera
        return (a.distance, a.azimuth, a.elevation) == (b.distance, b.azimuth, b.elevation) and np.array_equal(
            a.target, b.target
        )

    def differs(self, other: Shot) -> Bool[np.ndarray, "n"]:
        """Return which objects have another placement or another colour."""
        return (self.world_from_mesh != other.world_from_mesh).any(axis=1) | (self.colors != other.colors).any(axis=1)


class Renderer(Protocol):
    """Object that draws pictures."""

    width: int
    height: int
    boxes: Float[np.ndarray, "n 8 3"]
    """Corners of each mesh's bounding box, in its own frame [m]."""

    def draw(
        self,
        world_from_mesh: Float[np.ndarray, "n 7"],
        colors: Float[np.ndarray, "n 3"],
        camera: Camera,
        within: Rectangle | None = None,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture, or a part of it."""
        ...


def draw_shots(renderer: Renderer, shots: Sequence[Shot]) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """Yield the picture of each shot.

    While the camera stands still, only the part of the picture that can have changed is drawn. A shot that looks like
    the one before it yields the same array again.
    """
    last: Shot | None = None
    plain = picture = np.empty((0, 0, 3), np.uint8)
    for shot in shots:
        drawn = True
        if last is None or not shot.same_view(last):
            plain = renderer.draw(shot.world_from_mesh, shot.colors, shot.camera)
        elif (changed := shot.differs(last)).any():
            area = changed_rectangle(
                renderer.boxes, last.world_from_mesh, shot.world_from_mesh, changed, shot.camera,
                (renderer.width, renderer.height), SOFTEST,
            )  # fmt: skip
            if area.width and area.height:
                part = renderer.draw(shot.world_from_mesh, shot.colors, shot.camera, area)
                plain[area.top : area.bottom, area.left : area.right] = part
        else:
            drawn = False
        if last is None or drawn or shot.caption != last.caption:
            picture = plain.copy()
            draw_caption(picture, shot.caption)
        last = shot
        yield picture


def encode_film(
    scene: FilmScene,
    shots: Sequence[Shot],
    path: Path,
    fps: float,
    jobs: int,
    watch: Callable[[float], bool] | None = None,
) -> None:
    """Draw the shots and write them as an H.264 film.

    Args:
        scene: what all pictures have in common.
        shots: one shot for each frame.
        path: file to write, `.mp4`.
        fps: frames per second.
        jobs: number of processes that draw; 1 draws in this process.
        watch: called before each picture with the share that is done, if one process draws.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen, or ffmpeg fails.
        FilmStoppedError: `watch` returned False.
    """
    with TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent, ignore_cleanup_errors=True) as name:
        film = _Film(scene, shots, fps, Path(name))
        jobs = min(jobs, len(film.files))
        if jobs == 1:
            with scene.renderer() as renderer:
                for index in range(len(film.files)):
                    film.encode(renderer, index, watch)
        else:
            # Workers read the shots from a file: what waits in the pipe of a pool blocks its end after an interrupt.
            (film.folder / _SHOTS).write_bytes(pickle.dumps(film))
            with worker_pool(jobs, _start_worker, (film.folder, context_module())) as pool:
                with one_thread_each(), _interrupts_held():
                    done = pool.map(_encode, range(len(film.files)))
                for _ in done:
                    pass
        _join(film.files, path)


_SHOTS = "film.pickle"
# One thread: the workers keep all cores busy, and the result depends on the number of threads.
_CODEC = ("-vcodec", "libx264", "-pix_fmt", "yuv420p", "-preset", "superfast", "-crf", "23", "-threads", "1")


@dataclass(frozen=True, eq=False)
class _Film:
    scene: FilmScene
    shots: Sequence[Shot]
    fps: float
    folder: Path
    """Folder of the segments."""

    @property
    def files(self) -> list[Path]:
        """One file for each segment."""
        return [self.folder / f"{k}.mp4" for k in range(-(-len(self.shots) // SEGMENT_FRAMES))]

    def encode(self, renderer: Renderer, index: int, watch: Callable[[float], bool] | None = None) -> None:
        """Draw and write a segment; see `encode_film`."""
        file = self.files[index]
        video = VideoFile(file, self.scene.width, self.scene.height, self.fps, "rgb24", _CODEC)
        try:
            first = index * SEGMENT_FRAMES
            for number, picture in enumerate(draw_shots(renderer, self.shots[first : first + SEGMENT_FRAMES]), first):
                if watch is not None and not watch(number / len(self.shots)):
                    raise FilmStoppedError
                video.add(picture)
            video.close()
        except (OSError, VideoError):
            raise RenderingUnavailableError(f"ffmpeg stopped; is there room in '{self.folder.parent}'?") from None
        finally:
            video.abandon()


_worker_film: list[_Film] = []
_worker_renderer: list[OffscreenRenderer] = []
"""Shots and renderer of a worker process, set at its first segment."""


@contextmanager
def _interrupts_held() -> Generator[None]:
    """Deliver interrupts after the block. Processes that start inside it get none: the one that waits stops them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(folder: Path, gl_module: str) -> None:
    # Else Mesa's software renderer starts a thread for each core in each process.
    os.environ["LP_NUM_THREADS"] = "0"
    skip_trial(gl_module)
    _worker_film.append(pickle.loads((folder / _SHOTS).read_bytes()))


def _encode(index: int) -> None:
    film = _worker_film[0]
    if not _worker_renderer:
        _worker_renderer.append(film.scene.renderer())
    film.encode(_worker_renderer[0], index)


def _join(files: Sequence[Path], path: Path) -> None:
    """Write one film of the segments, without encoding them again."""
    names = files[0].with_name("segments.txt")
    names.write_text("".join(f"file '{file.name}'\n" for file in files), encoding="utf-8")
    command = [ffmpeg(), "-y", "-v", "error", "-f", "concat", "-i", str(names)]
    command += ["-c", "copy", "-movflags", "+faststart", str(path)]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
    if done.returncode:
        raise RenderingUnavailableError(
            f"ffmpeg cannot write '{path}': {done.stderr.decode(errors='replace').strip()[-200:]}"
        )
