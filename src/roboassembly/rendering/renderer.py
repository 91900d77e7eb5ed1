"""Offscreen renderer of meshes at given poses: wood and paint on a ruled ground, under one lamp with soft shadows."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32, UInt8
from scipy.spatial.transform import Rotation

from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.rendering import shaders, wood
from roboassembly.rendering.camera import NEAREST, Camera, boxes_corners, clip_from_world, project, view_axes
from roboassembly.rendering.captions import draw_caption
from roboassembly.rendering.colors import BACKGROUND, FLOOR, FLOOR_LINES, Color, Finish
from roboassembly.rendering.edges import REACH, smooth_edges
from roboassembly.rendering.gl import PictureContext
from roboassembly.rendering.offscreen import check_size
from roboassembly.rendering.rectangles import Rectangle
from roboassembly.rendering.shading import shade
from roboassembly.rendering.shadow_map import ShadowMap, runs

WIDE = 1.0
"""Radius [m] above which a scene is a wide one."""
GRID_SPACING = 0.5
"""Distance between the lines on the ground [m]; doubled in a wide scene."""
FLOOR_REACH = 20.0
"""Half the width of the ground, in radii of the scene."""
FADE = (1.2, 9.0)
"""Distances from the middle at which the ground begins and ends to fade into the background, in radii of the scene."""
FULL_SHADE = 0.52
"""Brightness of a full shadow over that of the ground."""
_STEP = 64
"""Multiple of the sizes of buffers that parts of a picture are drawn into [pixels]."""
_BEHIND = 4e-6
"""Depth, from −1 to 1, by which ground without shadows is drawn behind that with them."""
_OUT_OF_SIGHT = (0.0, 0.0, -100.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Quality:
    """Quality settings of the renderer."""

    scale: int
    """Width and height at which a picture is drawn before it is made smaller, over those of the picture."""
    samples: int
    """Samples per pixel, against jagged edges; 0 for `smooth_edges`."""
    shadow_size: int
    """Width and height of the shadow map [pixels]."""
    shadow_taps: tuple[int, int]
    """Samples of the map for a point: of what casts a shadow there, and of the shadow's edge."""


STILL = Quality(scale=2, samples=4, shadow_size=4096, shadow_taps=(16, 32))
FAST = Quality(scale=1, samples=0, shadow_size=1536, shadow_taps=(8, 12))
"""Quality of films without a graphics card; `STILL` takes five times as long there."""


class OffscreenRenderer:
    """Renderer of meshes on the ground under one lamp.

    Args:
        meshes: meshes to draw; a mesh that occurs twice is stored once.
        width: width of pictures [pixels].
        height: height of pictures [pixels].
        center: middle of the scene [m]; shadows are computed around it.
        radius: radius of the scene [m].
        quality: quality of pictures. If None, `STILL` with a graphics card and `FAST` without one.
        finishes: finish of each mesh; paint if None.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
        ArgumentError: a width or height is not between 1 and 8192.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        width: int,
        height: int,
        *,
        center: Float[np.ndarray, "3"],
        radius: float,
        quality: Quality | None = STILL,
        finishes: Sequence[Finish] | None = None,
    ) -> None:
        check_size(width, height)
        self.width, self.height = width, height
        self._center, self._radius = center, radius
        with ExitStack() as stack:
            self._context = stack.enter_context(PictureContext(width, height))
            if quality is None:
                quality = FAST if self._context.is_software else STILL
            self._quality = quality
            self._rows = _object_rows(len(meshes), finishes)
            self._set_up(meshes)
            self._stack = stack.pop_all()

    def __enter__(self) -> OffscreenRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the resources of the graphics driver. A closed renderer cannot draw; closing it twice is harmless."""
        self._stack.close()

    def picture(
        self, poses: Sequence[SE3 | None], colors: Sequence[Color], camera: Camera, caption: str = ""
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture of the meshes, with a caption in the upper left corner.

        Args:
            poses: `world_from_mesh` of each mesh; None hides it.
            colors: colour of each mesh.
            camera: camera of the picture.
            caption: text.
        """
        out = self.draw(placements([poses])[0], np.array(colors), camera)
        draw_caption(out, caption)
        return out

    def draw(
        self,
        world_from_mesh: Float[np.ndarray, "n 7"],
        colors: Float[np.ndarray, "n 3"],
        camera: Camera,
        within: Rectangle | None = None,
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return a picture without a caption, or a part of it.

        Args:
            world_from_mesh: a row of `placements`.
            colors: colour of each mesh.
            camera: camera of the picture.
            within: part of the picture that is drawn and returned; the whole if None.
        """
        if within is not None and self._quality.samples == 0:
            wider = within.grown(REACH, self.width, self.height)
            left, top = within.left - wider.left, within.top - wider.top
            out = self._drawn(world_from_mesh, colors, camera, wider)
            return out[top : top + within.height, left : left + within.width]
        return self._drawn(world_from_mesh, colors, camera, within or Rectangle(0, 0, self.width, self.height))

    def _drawn(
        self,
        world_from_mesh: Float[np.ndarray, "n 7"],
        colors: Float[np.ndarray, "n 3"],
        camera: Camera,
        area: Rectangle,
    ) -> UInt8[np.ndarray, "height width 3"]:
        gl, scale = self._context.activate(), self._quality.scale
        self._rows[:, :3, :3] = Rotation.from_quat(world_from_mesh[:, [4, 5, 6, 3]]).as_matrix()
        self._rows[:, :3, 3] = world_from_mesh[:, :3]
        self._rows[:, 3, :3] = colors**2
        self._objects.write(self._rows.tobytes())
        self._objects.use(0)
        gl.enable_only(gl.DEPTH_TEST)
        corners = np.einsum("nij,ncj->nci", self._rows[:, :3, :3], self.boxes) + self._rows[:, None, :3, 3]
        self._shadows.draw(self._rows[:, :3], corners, self._cast, self._ranges)
        self._shadows.bind()
        self._wood.use(3)
        width, height = scale * self.width, scale * self.height
        size = scale * area.width, scale * area.height
        projection = _matrix_bytes(clip_from_world(camera, width, height, 20.0 * FLOOR_REACH * self._radius))
        for program in (self._object_program, self._shaded_program, self._plain_program):
            program["clip_from_world"].write(projection)
        self._object_program["eye"] = tuple(camera.position)
        frame, resolved = self._frames(*size)
        frame.use()
        frame.viewport = (-scale * area.left, frame.height - height + scale * area.top, width, height)
        frame.clear(*BACKGROUND, 1.0, depth=1.0)
        for first, count in runs(self._visible(corners, camera, area), self._ranges):
            self._stand.render(vertices=count, first=first)
        if camera.position[2] > 0.0:
            tiles = self._shadows.shaded_ground()
            if len(tiles):
                self._tiles.orphan(max(tiles.nbytes, 8))
                self._tiles.write(tiles.tobytes())
                self._shaded.render(vertices=len(tiles))
            self._plain.render()
        if resolved is not frame:
            gl.copy_framebuffer(resolved, frame)
        data = resolved.read(viewport=(0, frame.height - size[1], *size), components=3, alignment=1)
        out = np.frombuffer(data, np.uint8).reshape(size[1], size[0], 3)[::-1]
        if scale == 1:
            out = out.copy()
            if self._samples == 0:
                smooth_edges(out)
            return out
        blocks = out.reshape(area.height, scale, area.width, scale, 3)
        return ((blocks.sum(axis=(1, 3), dtype=np.uint16) + scale * scale // 2) // (scale * scale)).astype(np.uint8)

    def _frames(self, width: int, height: int) -> tuple[Any, Any]:
        """Return a buffer to draw into that has at least this size, and the one that it is read from."""
        gl = self._context.activate()
        size = tuple(min(-(-n // _STEP) * _STEP, most) for n, most in ((width, 8192), (height, 8192)))
        if size not in self._buffers:
            plain = gl.framebuffer([gl.renderbuffer(size, 4)], gl.depth_renderbuffer(size))
            frame = plain
            if self._samples > 1:
                color = gl.renderbuffer(size, 4, samples=self._samples)
                frame = gl.framebuffer([color], gl.depth_renderbuffer(size, samples=self._samples))
            self._buffers[size] = frame, plain
        return self._buffers[size]

    def _visible(self, corners: Float[np.ndarray, "n 8 3"], camera: Camera, area: Rectangle) -> Bool[np.ndarray, "n"]:
        """Return which objects can be seen in a part of the picture."""
        points = corners.reshape(-1, 3)
        near = NEAREST * camera.distance
        depth = (points - camera.position) @ view_axes(camera.azimuth, camera.elevation)[2]
        behind = (depth < near).reshape(-1, 8)
        shifted = points + np.maximum(near - depth, 0.0)[:, None] * view_axes(camera.azimuth, camera.elevation)[2]
        pixels = project(shifted, camera, self.width, self.height).reshape(-1, 8, 2)
        low, high = pixels.min(axis=1) - 1.0, pixels.max(axis=1) + 1.0
        beside = (high < [area.left, area.top]).any(axis=1) | (low > [area.right, area.bottom]).any(axis=1)
        return ~behind.all(axis=1) & (behind.any(axis=1) | ~beside)

    def _set_up(self, meshes: Sequence[Mesh]) -> None:
        gl, quality = self._context.activate(), self._quality
        self._samples = min(quality.samples, gl.max_samples)
        self._buffers: dict[tuple[int, ...], tuple[Any, Any]] = {}
        self._object_program = gl.program(shaders.OBJECT_VERTEX, shaders.OBJECT_FRAGMENT)
        self._shaded_program = gl.program(shaders.GROUND_VERTEX, shaders.SHADED_GROUND_FRAGMENT)
        self._plain_program = gl.program(shaders.GROUND_VERTEX, shaders.PLAIN_GROUND_FRAGMENT)
        self._shadows = ShadowMap(gl, quality.shadow_size, self._center, self._radius)
        vertices, faces, self._ranges = _vertices_of(meshes)
        vertex_buffer, index_buffer = gl.buffer(vertices.tobytes()), gl.buffer(faces.tobytes())
        self._stand = gl.vertex_array(
            self._object_program,
            [(vertex_buffer, "3f 3f 3f 1f", "position", "normal", "grain", "item")],
            index_buffer,
        )
        self._cast = gl.vertex_array(
            self._shadows.program, [(vertex_buffer, "3f 24x 1f", "position", "item")], index_buffer
        )
        reach = FLOOR_REACH * self._radius
        corners = self._center[:2] + reach * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
        ground = gl.buffer(corners.astype(np.float32).tobytes())
        self._plain = gl.vertex_array(self._plain_program, [(ground, "2f", "position")], mode=gl.TRIANGLE_STRIP)
        self._tiles = gl.buffer(reserve=8, dynamic=True)
        self._shaded = gl.vertex_array(self._shaded_program, [(self._tiles, "2f", "position")])
        self._objects = gl.texture((_TEXELS, max(1, len(meshes))), 4, dtype="f4")
        self._objects.filter = (gl.NEAREST, gl.NEAREST)
        grain = wood.wood_texture()
        self._wood = gl.texture(grain.shape[::-1], 1, grain.tobytes())
        self._wood.build_mipmaps()
        self._wood.filter = (gl.LINEAR_MIPMAP_NEAREST, gl.LINEAR)
        self.boxes = np.stack(
            [boxes_corners(mesh.bounds[:1], mesh.bounds[1:]) for mesh in meshes] or [np.empty((8, 3))]
        )
        self._set_uniforms()

    def _set_uniforms(self) -> None:
        radius = self._radius
        light = _matrix_bytes(self._shadows.lamp_from_world)
        values: dict[str, object] = {
            **self._shadows.uniforms(), "objects": 0, "wood": 3, "taps": self._quality.shadow_taps,
            "wood_size": (wood.LENGTH, wood.DEPTH), "middle": tuple(self._center[:2]),
            "ground": FLOOR, "lines": FLOOR_LINES, "background": BACKGROUND,
            "fade": (FADE[0] * radius, FADE[1] * radius), "shade": FULL_SHADE,
            "spacing": GRID_SPACING if radius < WIDE else 2.0 * GRID_SPACING,
        }  # fmt: skip
        for program in (self._object_program, self._shaded_program, self._plain_program, self._shadows.program):
            if "light_from_world" in program:
                program["light_from_world"].write(light)
            for name, value in values.items():
                if name in program:
                    program[name] = value
        self._plain_program["behind"] = _BEHIND


def placements(frames: Sequence[Sequence[SE3 | None]]) -> Float[np.ndarray, "frames n 7"]:
    """Return `[x, y, z, qw, qx, qy, qz]` of each pose in each frame; out of sight for None."""
    return np.array([[_OUT_OF_SIGHT if pose is None else pose_to_seven(pose) for pose in poses] for poses in frames])


_TEXELS = 5
"""Texels of an object: three rows of its placement, its colour and finish, and where its wood was cut."""


def _object_rows(count: int, finishes: Sequence[Finish] | None) -> Float32[np.ndarray, "n 5 4"]:
    rows = np.zeros((max(1, count), _TEXELS, 4), np.float32)
    if finishes is not None:
        rows[:, 3, 3] = [finish is Finish.WOOD for finish in finishes]
    rows[:, 4] = wood.grain_offsets(len(rows))
    return rows


def _vertices_of(
    meshes: Sequence[Mesh],
) -> tuple[Float32[np.ndarray, "v 10"], Int32[np.ndarray, "f 3"], Int[np.ndarray, "n 2"]]:
    """Return the vertices of all meshes, as the shaders have them, the faces, and where each mesh's indices are."""
    shaded = {mesh: shade(mesh) for mesh in dict.fromkeys(meshes)}
    vertices: list[np.ndarray] = [np.zeros((0, 10))]
    faces: list[np.ndarray] = [np.zeros((0, 3), int)]
    first = 0
    for index, mesh in enumerate(meshes):
        shape = shaded[mesh]
        item = np.full((len(shape.vertices), 1), float(index))
        grain = wood.grain_coordinates(shape.vertices)
        vertices.append(np.concatenate([shape.vertices, shape.normals, grain, item], axis=1))
        faces.append(shape.faces + first)
        first += len(shape.vertices)
    counts = 3 * np.array([len(part) for part in faces])
    ranges = np.stack([np.cumsum(counts)[:-1], counts[1:]], axis=1)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32), ranges


def _matrix_bytes(matrix: Float[np.ndarray, "4 4"]) -> bytes:
    return np.ascontiguousarray(matrix.T, np.float32).tobytes()
