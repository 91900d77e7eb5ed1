"""Films and pictures of assemblies and furniture, rendered off screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from jaxtyping import UInt8

from roboassembly.atomic_file import atomic_write
from roboassembly.errors import InputError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.rendering.camera import Camera, box_corners, fit_camera
from roboassembly.rendering.colors import BACKGROUND, Color, Finish, Role, finishes, part_colors, to_bytes, wood_colors
from roboassembly.rendering.gl import RenderingUnavailableError, context_module
from roboassembly.rendering.offscreen import check_size
from roboassembly.rendering.renderer import STILL, OffscreenRenderer, Quality, placements
from roboassembly.rendering.video_file import VideoError, ffmpeg
from roboassembly.viewer.camera_path import close_ups, follow
from roboassembly.viewer.film_segments import FilmScene, FilmStoppedError, Shot, encode_film
from roboassembly.viewer.playback import AnyPlan, make_timeline
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
    width: int = 1280,
    height: int = 720,
    fps: int = 30,
    seconds_per_step: float | None = None,
    quality: Quality | None = None,
    jobs: int = 1,
    watch: Callable[[float], bool] | None = None,
) -> bool:
    """Write an H.264 film (`.mp4`) of a plan.

    Args:
        plan: plan to show. A failed plan is shown as far as it got.
        path: file to write. An existing file is replaced once the new one is complete.
        width: width of the film [pixels], even.
        height: height of the film [pixels], even.
        fps: frames per second.
        seconds_per_step: approximate duration of a step [s]; the default of the plan's setting if None.
        quality: rendering quality. If None, `STILL` with a graphics card and `FAST` without one.
        jobs: number of processes that draw. The film is the same for any number. With more than one, a script needs
            the usual guard of its main part, `if __name__ == "__main__":`.
        watch: called with the share that is done, 0 to 1, now and then; if it returns False, no film is written. With
            more than one process it is not called.

    Returns:
        Whether the film was written.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen, or ffmpeg is missing or fails.
        InputError: the size or a rate is not valid.
    """
    if width % 2 or height % 2:
        raise InputError(f"film size {width} x {height}: H.264 needs an even width and height")
    check_size(width, height)
    timeline = make_timeline(plan, fps, seconds_per_step)
    cameras = follow(timeline, width / height)
    try:
        ffmpeg()
    except VideoError as error:
        raise RenderingUnavailableError(str(error)) from None
    path = Path(path)
    context_module()
    scene = film_scene(timeline, width, height, quality)
    with suppress(FilmStoppedError), atomic_write(path) as unfinished:
        encode_film(scene, shots(timeline, cameras), unfinished, fps, jobs, watch)
        return True
    return False


def shots(timeline: Timeline, cameras: Sequence[Camera]) -> list[Shot]:
    """Return the shot of each frame."""
    colors = {roles: np.array(part_colors(roles)) for roles in {frame.roles for frame in timeline.frames}}
    rows = placements([frame.poses for frame in timeline.frames])
    return [
        Shot(row, colors[frame.roles], camera, frame.caption)
        for row, frame, camera in zip(rows, timeline.frames, cameras, strict=True)
    ]


def render_pictures(
    plan: AnyPlan, count: int | None = None, *, width: int = 1280, height: int = 720, quality: Quality = STILL
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Return captioned pictures: the initial state, steps, and the end.

    Args:
        plan: plan to show.
        count: largest number of pictures, at least 2; one for each step and both ends if None.
        width: width of each picture [pixels].
        height: height of each picture [pixels].
        quality: rendering quality.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        InputError: the size or the number is not valid.
    """
    if count is not None and count < 2:
        raise InputError(f"{count} pictures; a plan needs at least 2, its beginning and its end")
    timeline = make_timeline(plan, 10.0, None)
    indices = key_frames(timeline, count)
    out: list[UInt8[np.ndarray, "height width 3"]] = []
    with film_scene(timeline, width, height, quality).renderer() as renderer:
        for index, camera in zip(indices, close_ups(timeline, indices, width / height), strict=True):
            frame = timeline.frames[index]
            out.append(renderer.picture(frame.poses, part_colors(frame.roles), camera, frame.caption))
    return out


def write_storyboard(
    plan: AnyPlan, path: Path, *, count: int = 6, columns: int = 2, width: int = 960, height: int = 540
) -> None:
    """Write the pictures of `render_pictures` as one file, row by row.

    Args:
        plan: plan to show.
        path: file to write, `.png` or `.webp`.
        count: number of pictures; fewer if the plan has fewer steps.
        columns: number of pictures in a row.
        width: width of each picture [pixels].
        height: height of each picture [pixels].

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        InputError: the size, the number or the ending of the file is not valid.
    """
    if path.suffix not in _ENCODINGS:
        raise InputError(f"'{path}': a storyboard is written as {' or '.join(_ENCODINGS)}")
    _write_picture(Path(path), _tile(render_pictures(plan, count, width=width, height=height), columns))


def render_furniture(
    furniture: Furniture,
    path: Path | None = None,
    *,
    width: int = 800,
    height: int = 800,
    quality: Quality = STILL,
    caption: str = "",
) -> UInt8[np.ndarray, "height width 3"]:
    """Return a picture of assembled furniture that stands on the ground; also write it to `path` (`.png`) if given.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        InputError: the size is not valid.
    """
    check_size(width, height)
    meshes = [part.mesh for part in furniture.parts]
    lowest = min(
        transform_points(pose, mesh.vertices)[:, 2].min()
        for mesh, pose in zip(meshes, furniture.assembled, strict=True)
    )
    ground = SE3(np.eye(3), np.array([0.0, 0.0, -lowest]))
    poses = [ground * pose for pose in furniture.assembled]
    picture = render_meshes(
        meshes, poses, wood_colors(len(poses)), width, height, quality=quality, caption=caption, finish=Finish.WOOD
    )
    if path is not None:
        _write_picture(Path(path), picture)
    return picture


def render_meshes(
    meshes: Sequence[Mesh], poses: Sequence[SE3], colors: Sequence[Color], width: int, height: int, *,
    quality: Quality = STILL, caption: str = "", finish: Finish = Finish.PAINT,
) -> UInt8[np.ndarray, "height width 3"]:  # fmt: skip
    """Return a picture of meshes at their `world_from_mesh`, with all of them in view.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        InputError: the size is not valid.
    """
    points = np.concatenate([box_corners(mesh, pose) for mesh, pose in zip(meshes, poses, strict=True)])
    camera = fit_camera(points, width / height)
    radius = float(np.linalg.norm(points - camera.target, axis=1).max())
    with OffscreenRenderer(
        meshes, width, height, center=camera.target, radius=radius, quality=quality, finishes=[finish] * len(meshes)
    ) as renderer:
        return renderer.picture(poses, colors, camera, caption)


def render_contact_sheet(
    furniture: Sequence[Furniture], path: Path, *, columns: int = 6, size: int = 320, names: bool = True
) -> None:
    """Write one PNG with a square picture of each piece, row by row.

    Args:
        furniture: pieces to show.
        path: file to write.
        columns: number of pictures in a row.
        size: width and height of each picture [pixels].
        names: write the name of each piece into its picture.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        InputError: the sequence is empty, or the size is not valid.
    """
    pictures = [
        render_furniture(piece, width=size, height=size, caption=piece.name if names else "") for piece in furniture
    ]
    _write_picture(Path(path), _tile(pictures, columns))


def key_frames(timeline: Timeline, count: int | None = None) -> list[int]:
    """Return the indices of the first frame, of one frame of each step's motion, and of the last frame.

    Args:
        timeline: frames of the film.
        count: largest number of frames. The steps between the ends are those after equal shares of all that changes,
            which is the number of parts that the steps put in motion.
    """
    steps: list[int] = []
    weights: list[int] = []
    for step in sorted({frame.step for frame in timeline.frames if frame.step is not None}):
        moving = [i for i, frame in enumerate(timeline.frames) if frame.step == step and frame.phase is Phase.MOVING]
        # Near the end of the motion both groups are close together.
        steps.append(next((i for i in moving if timeline.frames[i].key), moving[int(0.7 * (len(moving) - 1))]))
        roles = timeline.frames[steps[-1]].roles
        weights.append(min(roles.count(Role.MOVING), roles.count(Role.WAITING)))
    if count is not None and len(steps) > count - 2:
        steps = [steps[k] for k in _evenly(weights, count - 2)]
    return [0, *steps, len(timeline.frames) - 1]


def _evenly(weights: Sequence[int], count: int) -> list[int]:
    """Return `count` indices in order, near the middles of as many equal shares of the weights' sum."""
    reached = np.cumsum(weights) - 0.5 * np.array(weights)
    out: list[int] = []
    for k in range(count):
        first, last = (out[-1] + 1 if out else 0), len(weights) - (count - k)
        middle = (k + 0.5) / count * sum(weights)
        out.append(first + int(np.argmin(np.abs(reached[first : last + 1] - middle))))
    return out


def film_scene(timeline: Timeline, width: int, height: int, quality: Quality | None) -> FilmScene:
    """Return what all pictures of a film of this width and height [pixels] have in common."""
    points = timeline.box_corners.reshape(-1, 3)
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - center, axis=1).max())
    surfaces = tuple(finishes(timeline.frames[0].roles))
    return FilmScene(tuple(item.mesh for item in timeline.objects), width, height, center, radius, quality, surfaces)


def _tile(
    pictures: Sequence[UInt8[np.ndarray, "height width 3"]], columns: int
) -> UInt8[np.ndarray, "all_height all_width 3"]:
    if not pictures:
        raise InputError("the sheet has no pictures; give at least one piece of furniture")
    columns = max(1, min(columns, len(pictures)))
    height, width, _ = pictures[0].shape
    rows = -(-len(pictures) // columns)
    out = np.empty((rows * height, columns * width, 3), dtype=np.uint8)
    out[:] = to_bytes(BACKGROUND)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        out[row * height : (row + 1) * height, column * width : (column + 1) * width] = picture
    return out


_ENCODINGS: dict[str, dict[str, int]] = {".png": {}, ".webp": {"quality": 82, "method": 6}}


def _write_picture(path: Path, picture: UInt8[np.ndarray, "height width 3"]) -> None:
    with atomic_write(path) as unfinished:
        iio.imwrite(unfinished, picture, extension=path.suffix, **_ENCODINGS.get(path.suffix, {}))
