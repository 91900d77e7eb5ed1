"""Pictures and films of assemblies and furniture, drawn off screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
from jaxtyping import UInt8

from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.rendering.camera import box_corners, fit
from roboassembly.rendering.colors import BACKGROUND, Color, part_colors, to_bytes, wood_colors
from roboassembly.rendering.gl import RenderingUnavailableError
from roboassembly.rendering.offscreen import STILL, OffscreenRenderer, Quality, check_size
from roboassembly.viewer.files import replaced
from roboassembly.viewer.framing import follow
from roboassembly.viewer.playing import AnyPlan, timeline_of
from roboassembly.viewer.timeline import Phase, Timeline

__all__ = [
    "RenderingUnavailableError",
    "render_contact_sheet",
    "render_furniture",
    "render_meshes",
    "render_pictures",
    "write_film",
    "write_storyboard",
]


def write_film(
    plan: AnyPlan,
    path: Path,
    *,
    width: int = 960,
    height: int = 540,
    fps: int = 24,
    seconds_per_step: float | None = None,
    quality: Quality | None = None,
) -> None:
    """Write an H.264 film (`.mp4`, plays in browsers) of the whole plan, or of as much of it as there is.

    Args:
        plan: What to show.
        path: The file; one that is there is replaced, once the new one is whole.
        width: Pixels, even.
        height: Pixels, even.
        fps: Frames a second.
        seconds_per_step: About how long each step lasts; as long as suits the setting if not given.
        quality: If not given, the best where there is a graphics card, and a faster one where there is none.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: a size or rate that cannot be.
    """
    if width % 2 or height % 2:
        raise InputError(f"film of {width} x {height} pixels; H.264 asks for even numbers")
    check_size(width, height)
    timeline = timeline_of(plan, fps, seconds_per_step)
    views = follow(timeline, width / height)
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise RenderingUnavailableError("no ffmpeg to write a film with; pip install imageio-ffmpeg") from error
    path = Path(path)
    with _renderer(timeline, width, height, quality) as renderer, replaced(path) as unfinished:
        writer = imageio_ffmpeg.write_frames(
            str(unfinished),
            (width, height),
            fps=fps,
            codec="libx264",
            pix_fmt_in="rgb24",
            pix_fmt_out="yuv420p",
            quality=None,  # pyright: ignore[reportArgumentType]  # it is optional, says its own documentation
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=["-preset", "superfast", "-crf", "23", "-movflags", "+faststart"],
        )
        writer.send(None)
        try:
            for frame, view in zip(timeline.frames, views, strict=True):
                picture = renderer.picture(frame.poses, part_colors(frame.roles), view, frame.caption)
                writer.send(np.ascontiguousarray(picture))
        finally:
            writer.close()


def render_pictures(
    plan: AnyPlan, *, width: int = 1280, height: int = 720, quality: Quality = STILL
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Stills with captions: the parts as they lie, each step when half its path is played, and the end.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: a size that cannot be.
    """
    timeline = timeline_of(plan, 10.0, None)
    views = follow(timeline, width / height)
    out = []
    with _renderer(timeline, width, height, quality) as renderer:
        for index in key_frames(timeline):
            frame = timeline.frames[index]
            out.append(renderer.picture(frame.poses, part_colors(frame.roles), views[index], frame.caption))
    return out


def write_storyboard(plan: AnyPlan, path: Path, *, columns: int = 4, width: int = 480, height: int = 360) -> None:
    """Write `render_pictures` as one PNG, row by row; `width` and `height` are of each picture, in pixels.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: a size that cannot be.
    """
    _write_png(Path(path), _tiled(render_pictures(plan, width=width, height=height), columns))


def render_furniture(
    furniture: Furniture,
    path: Path | None = None,
    *,
    width: int = 800,
    height: int = 800,
    quality: Quality = STILL,
    caption: str = "",
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw furniture as it is when assembled, standing on the ground; write it to `path` (`.png`) if given.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: a size that cannot be.
    """
    check_size(width, height)
    meshes = [part.mesh for part in furniture.parts]
    lowest = min(
        transform_points(pose, mesh.vertices)[:, 2].min()
        for mesh, pose in zip(meshes, furniture.assembled, strict=True)
    )
    ground = SE3(np.eye(3), np.array([0.0, 0.0, -lowest]))
    poses = [ground * pose for pose in furniture.assembled]
    picture = render_meshes(meshes, poses, wood_colors(len(poses)), width, height, quality=quality, caption=caption)
    if path is not None:
        _write_png(Path(path), picture)
    return picture


def render_meshes(
    meshes: Sequence[Mesh], poses: Sequence[SE3], colors: Sequence[Color], width: int, height: int, *,
    quality: Quality = STILL, caption: str = "",
) -> UInt8[np.ndarray, "height width 3"]:  # fmt: skip
    """Draw meshes at their `world_from_mesh`, from where all of them are seen.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: a size that cannot be.
    """
    points = np.concatenate([box_corners(mesh, pose) for mesh, pose in zip(meshes, poses, strict=True)])
    view = fit(points, width / height)
    radius = float(np.linalg.norm(points - view.target, axis=1).max())
    with OffscreenRenderer(meshes, width, height, center=view.target, radius=radius, quality=quality) as renderer:
        return renderer.picture(poses, colors, view, caption)


def render_contact_sheet(
    furniture: Sequence[Furniture], path: Path, *, columns: int = 6, size: int = 320, names: bool = True
) -> None:
    """Write one PNG with a square picture of each piece, `size` pixels wide, row by row.

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        InputError: no furniture, or a size that cannot be.
    """
    pictures = [
        render_furniture(piece, width=size, height=size, caption=piece.name if names else "") for piece in furniture
    ]
    _write_png(Path(path), _tiled(pictures, columns))


def key_frames(timeline: Timeline) -> list[int]:
    """Indices of the first frame, for each step the one in the middle of its way to mating, and the last."""
    out = [0]
    for step in sorted({frame.step for frame in timeline.frames if frame.step is not None}):
        moving = [i for i, frame in enumerate(timeline.frames) if frame.step == step and frame.phase is Phase.MOVING]
        out.append(next((i for i in moving if timeline.frames[i].key), moving[len(moving) // 2]))
    return [*out, len(timeline.frames) - 1]


def _renderer(timeline: Timeline, width: int, height: int, quality: Quality | None) -> OffscreenRenderer:
    points = timeline.box_corners.reshape(-1, 3)
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - center, axis=1).max())
    meshes = [thing.mesh for thing in timeline.things]
    return OffscreenRenderer(meshes, width, height, center=center, radius=radius, quality=quality)


def _tiled(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], columns: int
) -> UInt8[np.ndarray, "all_height all_width 3"]:
    if not pictures:
        raise InputError("a sheet of no pictures; give at least one piece of furniture")
    columns = max(1, min(columns, len(pictures)))
    height, width, _ = pictures[0].shape
    rows = -(-len(pictures) // columns)
    out = np.empty((rows * height, columns * width, 3), dtype=np.uint8)
    out[:] = to_bytes(BACKGROUND)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        out[row * height : (row + 1) * height, column * width : (column + 1) * width] = picture
    return out


def _write_png(path: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    with replaced(path) as unfinished:
        iio.imwrite(unfinished, picture, extension=".png")
