"""Pictures of steps for the time line, drawn off screen by one thread for all clients."""

from __future__ import annotations

import base64
import io
import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import imageio.v3 as iio
import numpy as np

from roboassembly.geometry.meshes import Mesh
from roboassembly.rendering.camera import box_corners, fit_camera
from roboassembly.rendering.colors import Role, part_colors
from roboassembly.rendering.gl import RenderingUnavailableError
from roboassembly.rendering.renderer import FAST, OffscreenRenderer
from roboassembly.studio.page_link import StepPicture
from roboassembly.viewer.timeline import Frame, Phase

WIDTH, HEIGHT = 224, 168
"""Size of a picture [pixels]."""
MOST_WAITING = 2000
"""Largest number of pictures that wait; further ones are not drawn."""


@dataclass(frozen=True, eq=False)
class PictureJob:
    """Picture to draw."""

    meshes: Sequence[Mesh]
    """Meshes of the parts, then those of robots."""
    parts: int
    """Number of parts."""
    frame: Frame
    done: Callable[[str], None]
    """Called in the drawing thread with the picture as a `data:` address; the text is empty if none can be drawn."""


def frame_of_step(frames: Sequence[Frame]) -> Frame:
    """Return the frame that shows a step best: the moving group in the middle of its way, or near it."""
    moving = [frame for frame in frames if frame.phase is Phase.MOVING]
    key = [frame for frame in moving if frame.key]
    chosen = key or moving or list(frames)
    return chosen[0] if key else chosen[(2 * len(chosen)) // 3]


class PictureDrawer:
    """Thread that draws pictures in turn. It starts with the first one."""

    def __init__(self) -> None:
        self._jobs: queue.Queue[PictureJob | None] = queue.Queue(MOST_WAITING)
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._meshes: list[Mesh] = []
        self._renderer: OffscreenRenderer | None = None
        self._works = True

    def add(self, job: PictureJob) -> None:
        """Draw a picture later; none if too many wait, or after `close`."""
        with self._lock:
            is_added = not self._closed and not self._jobs.full()
            if is_added:
                self._jobs.put_nowait(job)
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name="pictures", daemon=True)
                    self._thread.start()
        if not is_added:
            job.done("")

    def close(self) -> None:
        """Stop the thread; pictures that wait are not drawn."""
        with self._lock:
            # Clients may still work: a thread that they started now would take the request to stop from this one.
            self._closed = True
            while not self._jobs.empty():
                with suppress(queue.Empty):
                    self._jobs.get_nowait()
            self._jobs.put_nowait(None)
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            while (job := self._jobs.get()) is not None:
                job.done(self._draw(job))
        finally:
            self._forget()

    def _draw(self, job: PictureJob) -> str:
        if not self._works:
            return ""
        try:
            picture = self._picture(job)
        except RenderingUnavailableError:
            self._works = False
            return ""
        content = io.BytesIO()
        iio.imwrite(content, picture, extension=".jpg")
        return f"data:image/jpeg;base64,{base64.b64encode(content.getvalue()).decode()}"

    def _picture(self, job: PictureJob) -> np.ndarray:
        frame, meshes = job.frame, list(job.meshes)
        shown = [
            (mesh, pose)
            for mesh, pose, role in zip(meshes[: job.parts], frame.poses, frame.roles, strict=False)
            if pose is not None and (role is not Role.IDLE or frame.step is None)
        ]
        points = np.concatenate([box_corners(mesh, pose) for mesh, pose in shown])
        camera = fit_camera(points, WIDTH / HEIGHT)
        if self._renderer is None or self._meshes != meshes:
            self._forget()
            self._meshes = meshes
            self._renderer = OffscreenRenderer(meshes, WIDTH, HEIGHT, center=camera.target, radius=2.0, quality=FAST)
        # Objects that come later in the plan have no pose yet.
        missing = len(meshes) - len(frame.poses)
        poses, roles = [*frame.poses, *[None] * missing], [*frame.roles, *[Role.POST] * missing]
        return self._renderer.picture(poses, part_colors(roles), camera)

    def _forget(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


@dataclass(eq=False)
class _Entry:
    text: str
    picture: str = ""


class StepLine:
    """Time line of one piece: a picture and a text for the start and for each step.

    Args:
        drawer: draws the pictures.
        changed: called in the drawing thread when a picture is there.
    """

    def __init__(self, drawer: PictureDrawer, changed: Callable[[], None]) -> None:
        self._drawer, self._changed = drawer, changed
        self._entries: list[_Entry] = []

    def update(
        self, texts: Sequence[str], frames: Sequence[Sequence[Frame]], meshes: Sequence[Mesh], parts: int
    ) -> None:
        """Drop the steps that were undone, and add the new ones.

        Args:
            texts: text of the start and of each step.
            frames: frames of the start and of each step.
            meshes: meshes in the order of `Frame.poses`.
            parts: number of meshes that are parts.
        """
        same = 0
        while same < min(len(texts), len(self._entries)) and self._entries[same].text == texts[same]:
            same += 1
        del self._entries[same:]
        for index in range(same, len(texts)):
            entry = _Entry(texts[index])
            self._entries.append(entry)
            frame = frame_of_step(frames[index])
            self._drawer.add(PictureJob(tuple(meshes), parts, frame, lambda picture, e=entry: self._done(e, picture)))

    def pictures(self) -> list[StepPicture]:
        """Return the start and the steps as the page shows them."""
        return [StepPicture(entry.text, entry.picture) for entry in self._entries]

    def _done(self, entry: _Entry, picture: str) -> None:
        entry.picture = picture
        self._changed()
