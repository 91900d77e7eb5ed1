"""Offscreen renderer of meshes at given poses, which uses MuJoCo's renderer without simulation."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from roboassembly.errors import ArgumentError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.rendering.camera import FIELD_OF_VIEW, Camera, view_axes
from roboassembly.rendering.colors import BACKGROUND, FLOOR, FLOOR_LINES, Color
from roboassembly.rendering.gl import OffscreenContext, import_mujoco
from roboassembly.rendering.shading import shade

LIGHT_DIRECTION = np.array([-0.22, 0.16, -1.0]) / np.linalg.norm([-0.22, 0.16, -1.0])
SHADOW_REACH = 2.5
"""Half the width, height and depth of the shadow map, in radii of the scene. A larger map makes shadows coarser; the
ground beyond the map looks speckled."""
WIDE = 1.0
"""Radius [m] above which a scene is a wide one."""
LARGEST_PICTURE = 8192
"""Largest width and height of a picture [pixels]."""
GRID_SPACING = 0.5
"""Distance between the lines on the ground [m]; doubled in a wide scene."""
LINE_WIDTH = 1.0
"""Width of the lines on the ground [pixels]."""
GRID_REACH = 1.8
"""Half the width of the ruled ground, in radii of the scene."""
FOG = (4.0, 14.0)
"""Distances from the camera at which the ground begins and ends to fade into the background, in radii of the scene."""
FLOOR_REACH = 20.0
"""Half the width of the ground, in radii of the scene. It is one rectangle: MuJoCo divides an infinite plane into
40,000, which cost a processor more than all that stands on it."""
FLAT_SHADE = 0.62
"""Brightness of flat shadows over that of the ground."""
_FLAT_HEIGHT = 1e-3
"""Height of flat shadows above the ground [m]; lower ones would flicker in it."""
_FLATNESS = 1e-4
"""Height of a flat shadow over that of its object. It is not zero, because normals are transformed by the inverse."""
_OUT_OF_SIGHT = (0.0, 0.0, -100.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Quality:
    """Quality settings of the renderer."""

    samples: int
    """Samples per pixel, against jagged edges; 0 for a cheaper filter."""
    shadow_size: int
    """Width and height of the shadow map [pixels]; 0 for flat shadows, which fall on the ground alone. Their edges are
    sharp at any size, and they take a tenth of the time of a shadow map."""


STILL = Quality(samples=4, shadow_size=4096)
FAST = Quality(samples=0, shadow_size=0)
"""Quality of films without a graphics card; `STILL` takes eight times as long there."""


class OffscreenRenderer:
    """Renderer of meshes on a floor under one light.

    Args:
        meshes: meshes to draw; a mesh that occurs twice is stored once.
        width: width of pictures [pixels].
        height: height of pictures [pixels].
        center: middle of the scene [m]; shadows are computed around it.
        radius: radius of the scene [m].
        quality: quality of pictures. If None, `STILL` with a graphics card and `FAST` without one.

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
    ) -> None:
        check_size(width, height)
        self._mujoco = import_mujoco()
        self.width, self.height = width, height
        with ExitStack() as stack:
            self._context = stack.enter_context(OffscreenContext(width, height))
            if quality is None:
                quality = FAST if self._context.is_software else STILL
            self._quality = quality
            self._model = self._compile(meshes, center, radius, quality)
            self._data = self._mujoco.MjData(self._model)
            self._grid = floor_grid(center, radius)
            self._center, self._radius = center, radius
            self._scene = self._mujoco.MjvScene(self._model, maxgeom=2 * len(meshes) + len(self._grid) + 16)
            self._scene.flags[self._mujoco.mjtRndFlag.mjRND_FOG.value] = 1
            self._options = self._mujoco.MjvOption()
            self._render = self._mujoco.MjrContext(self._model, self._mujoco.mjtFontScale.mjFONTSCALE_100.value)
            stack.callback(self._render.free)
            stack.callback(self._context.make_current)
            self._mujoco.mjr_setBuffer(self._mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._render)
            self._rectangle = self._mujoco.MjrRect(0, 0, width, height)
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
            caption: ASCII text.
        """
        return self.draw(placements([poses])[0], np.array(colors), camera, caption)

    def draw(
        self,
        world_from_mesh: Float[np.ndarray, "n 7"],
        colors: Float[np.ndarray, "n 3"],
        camera: Camera,
        caption: str = "",
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return the same picture as `picture`, from rows of `placements` and an array of colours."""
        self._context.make_current()
        self._data.mocap_pos[:] = world_from_mesh[:, :3]
        self._data.mocap_quat[:] = world_from_mesh[:, 3:]
        self._model.geom_rgba[1:, :3] = colors
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)
        mj_camera = self._mujoco.MjvCamera()
        mj_camera.lookat[:] = camera.target
        mj_camera.distance = camera.distance
        mj_camera.azimuth, mj_camera.elevation = np.degrees(camera.azimuth), np.degrees(camera.elevation)
        everything = self._mujoco.mjtCatBit.mjCAT_ALL.value
        self._mujoco.mjv_updateScene(self._model, self._data, self._options, None, mj_camera, everything, self._scene)
        # Drawing the sky costs time even where the ground hides it.
        self._scene.flags[self._mujoco.mjtRndFlag.mjRND_SKYBOX.value] = not self._is_floor_everywhere(camera)
        # Decoration casts no shadow. A ground that does is speckled where it is far from the light.
        self._scene.geoms[0].category = self._mujoco.mjtCatBit.mjCAT_DECOR.value
        if self._quality.shadow_size == 0:
            self._add_flat_shadows()
        self._add_grid()
        self._mujoco.mjr_render(self._rectangle, self._scene, self._render)
        if caption:
            # MuJoCo's fonts have ASCII only.
            text = caption.encode("ascii", "replace").decode()
            font, corner = self._mujoco.mjtFont.mjFONT_NORMAL, self._mujoco.mjtGridPos.mjGRID_TOPLEFT
            self._mujoco.mjr_overlay(font.value, corner.value, self._rectangle, text, "", self._render)
        out = np.empty((self.height, self.width, 3), dtype=np.uint8)
        self._mujoco.mjr_readPixels(out, None, self._rectangle, self._render)
        out = np.ascontiguousarray(out[::-1])
        if self._quality.samples == 0:
            soften_edges(out)
        return out

    def vertices(self, index: int) -> Float[np.ndarray, "n 3"]:
        """Return the world coordinates [m] of a mesh's vertices in the last picture."""
        geom = index + 1
        mesh = self._model.geom_dataid[geom]
        first, count = self._model.mesh_vertadr[mesh], self._model.mesh_vertnum[mesh]
        local = self._model.mesh_vert[first : first + count].astype(float)
        return local @ self._data.geom_xmat[geom].reshape(3, 3).T + self._data.geom_xpos[geom]

    def _is_floor_everywhere(self, camera: Camera) -> bool:
        """Whether the ground, without what stands on it, would fill the picture."""
        right, up, forward = view_axes(camera.azimuth, camera.elevation)
        slope = np.tan(0.5 * FIELD_OF_VIEW)
        aside = slope * self.width / self.height * right
        rays = forward + slope * up + np.stack([-aside, aside])
        if camera.position[2] <= 0.0 or (rays[:, 2] >= 0.0).any():
            return False
        ends = camera.position + rays * (camera.position[2] / -rays[:, 2:])
        return bool(np.abs(ends - self._center)[:, :2].max() < FLOOR_REACH * self._radius)

    def _add_flat_shadows(self) -> None:
        """Add each mesh once more, flattened onto the ground along the light, as dark as its shadow would be."""
        flatten = np.array([
            [1.0, 0.0, -LIGHT_DIRECTION[0] / LIGHT_DIRECTION[2]],
            [0.0, 1.0, -LIGHT_DIRECTION[1] / LIGHT_DIRECTION[2]],
            [0.0, 0.0, _FLATNESS],
        ])  # fmt: skip
        positions = (self._data.geom_xpos[1:] @ flatten.T + [0.0, 0.0, _FLAT_HEIGHT])[..., None]
        turns = (flatten @ self._data.geom_xmat[1:].reshape(-1, 3, 3)).reshape(-1, 9, 1)
        color = np.array([*(FLAT_SHADE * c for c in FLOOR), 1.0], dtype=np.float32)
        kind, size = self._mujoco.mjtGeom.mjGEOM_MESH, np.ones(3)
        for geom, position, turn in zip(range(1, self._scene.ngeom), positions, turns, strict=True):
            shadow = self._scene.geoms[self._scene.ngeom]
            self._mujoco.mjv_initGeom(shadow, kind, size, position, turn, color)
            shadow.dataid, shadow.specular = self._scene.geoms[geom].dataid, 0.0
            self._scene.ngeom += 1

    def _add_grid(self) -> None:
        # A floor texture would look the same, but costs a processor as much as the rest of the picture.
        line = self._mujoco.mjtGeom.mjGEOM_LINE
        # A map's second pass would draw opaque lines twice.
        color = np.array([*FLOOR_LINES, 0.99 if self._quality.shadow_size else 1.0], dtype=np.float32)
        for start, end in self._grid:
            geom = self._scene.geoms[self._scene.ngeom]
            self._mujoco.mjv_initGeom(geom, line, np.zeros(3), np.zeros(3), np.eye(3).reshape(-1), color)
            self._mujoco.mjv_connector(geom, line, LINE_WIDTH, start, end)
            self._scene.ngeom += 1

    def _compile(self, meshes: Sequence[Mesh], center: Float[np.ndarray, "3"], radius: float, quality: Quality):
        mj = self._mujoco
        spec = mj.MjSpec()
        spec.stat.center, spec.stat.extent = center, radius
        visual = spec.visual
        visual.global_.offwidth, visual.global_.offheight = self.width, self.height
        visual.global_.fovy = np.degrees(FIELD_OF_VIEW)
        visual.quality.offsamples, visual.quality.shadowsize = quality.samples, quality.shadow_size
        visual.map.znear, visual.map.zfar, visual.map.shadowclip = 0.02, 20.0, SHADOW_REACH
        # The floor fades into the background before it ends.
        visual.map.fogstart, visual.map.fogend = FOG
        visual.rgba.fog = [*BACKGROUND, 1.0]
        visual.headlight.ambient, visual.headlight.diffuse = [0.5] * 3, [0.2] * 3
        visual.headlight.specular = [0.0] * 3
        flat = mj.mjtBuiltin.mjBUILTIN_FLAT
        spec.add_texture(
            name="sky", type=mj.mjtTexture.mjTEXTURE_SKYBOX, builtin=flat, rgb1=BACKGROUND, rgb2=BACKGROUND,
            width=16, height=16,
        )  # fmt: skip
        spec.add_material(name="part", specular=0.25, shininess=0.35)
        light = spec.worldbody.add_light(
            pos=center - 2.0 * radius * LIGHT_DIRECTION, dir=LIGHT_DIRECTION, castshadow=quality.shadow_size > 0,
            ambient=[0.0] * 3, diffuse=[0.4] * 3, specular=[0.2] * 3,
        )  # fmt: skip
        light.type = mj.mjtLightType.mjLIGHT_DIRECTIONAL
        reach = FLOOR_REACH * radius
        spec.worldbody.add_geom(
            type=mj.mjtGeom.mjGEOM_PLANE, pos=[center[0], center[1], 0.0], size=[reach] * 3, rgba=[*FLOOR, 1.0]
        )
        names: dict[Mesh, str] = {}
        for index, mesh in enumerate(meshes):
            if mesh not in names:
                names[mesh] = f"mesh{index}"
                add_shaded_mesh(spec, names[mesh], mesh, mj)
            body = spec.worldbody.add_body(name=f"part{index}", mocap=True)
            # Without contacts MuJoCo needs no convex hull, which a flat mesh does not have.
            body.add_geom(
                type=mj.mjtGeom.mjGEOM_MESH, meshname=names[mesh], material="part", contype=0, conaffinity=0, mass=0.0
            )
        return spec.compile()


def add_shaded_mesh(spec: Any, name: str, mesh: Mesh, mujoco: Any) -> None:
    """Add a mesh with the normals of its shading to a model that is drawn and not simulated.

    Args:
        spec: MuJoCo's specification of the model.
        name: name of the mesh there.
        mesh: the mesh.
        mujoco: the module, imported for rendering.
    """
    shaded = shade(mesh)
    faces = shaded.faces
    normals = shaded.normals
    vertices = shaded.vertices
    if not mesh.is_solid:
        # Open surfaces are drawn from both sides.
        faces = np.concatenate([faces, faces[:, ::-1] + len(vertices)])
        vertices, normals = np.concatenate([vertices, vertices]), np.concatenate([normals, -normals])
    spec.add_mesh(
        name=name,
        uservert=vertices.reshape(-1),
        userface=faces.reshape(-1).astype(np.int32),
        usernormal=normals.reshape(-1),
        userfacenormal=faces.reshape(-1).astype(np.int32),
        # Other inertia modes refuse meshes that are open, flat or inside out.
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )


def placements(frames: Sequence[Sequence[SE3 | None]]) -> Float[np.ndarray, "frames n 7"]:
    """Return `[x, y, z, qw, qx, qy, qz]` of each pose in each frame; out of sight for None."""
    return np.array([[_OUT_OF_SIGHT if pose is None else pose_to_seven(pose) for pose in poses] for poses in frames])


def floor_grid(center: Float[np.ndarray, "3"], radius: float) -> Float[np.ndarray, "lines 2 3"]:
    """Return the end points [m] of the lines on the ground, over a square around the scene."""
    spacing = GRID_SPACING if radius < WIDE else 2.0 * GRID_SPACING
    reach = int(np.ceil(GRID_REACH * radius / spacing))
    first = np.round(center[:2] / spacing) * spacing
    offsets = np.arange(-reach, reach + 1) * spacing
    lines = np.zeros((2, len(offsets), 2, 3))
    for axis in (0, 1):
        lines[axis, :, :, axis] = (first[axis] + offsets)[:, None]
        lines[axis, :, :, 1 - axis] = first[1 - axis] + offsets[[0, -1]]
    lines[..., 2] = 2e-3  # lower lines would flicker in the ground
    return lines.reshape(-1, 2, 3)


def soften_edges(picture: UInt8[np.ndarray, "height width 3"], contrast: int = 20) -> None:
    """Blend pixels that differ from a neighbour by more than `contrast` with their four neighbours, in place.

    This is a cheap antialiasing: without a graphics card it takes a tenth of the time of four samples per pixel.
    """
    height, width, _ = picture.shape
    green = np.ascontiguousarray(picture[:, :, 1])
    edge = np.zeros((height, width), dtype=bool)
    jumps = _differ(green[:, 1:], green[:, :-1], contrast)
    edge[:, 1:] |= jumps
    edge[:, :-1] |= jumps
    jumps = _differ(green[1:], green[:-1], contrast)
    edge[1:] |= jumps
    edge[:-1] |= jumps
    edge[[0, -1]] = edge[:, [0, -1]] = False
    here = np.flatnonzero(edge)
    flat = picture.reshape(-1, 3)
    around = sum(flat[here + offset].astype(np.uint16) for offset in (-1, 1, -width, width))
    flat[here] = (4 * flat[here].astype(np.uint16) + around) // 8


def _differ(
    a: UInt8[np.ndarray, "rows columns"], b: UInt8[np.ndarray, "rows columns"], contrast: int
) -> Bool[np.ndarray, "rows columns"]:
    # Bytes take half the time of signed numbers, which a plain difference would need.
    return np.maximum(a, b) - np.minimum(a, b) > contrast


def check_size(width: int, height: int) -> None:
    """Raise `ArgumentError` unless a picture can have this size in pixels."""
    if not (1 <= width <= LARGEST_PICTURE and 1 <= height <= LARGEST_PICTURE):
        raise ArgumentError(
            f"picture size {width} x {height}: width and height must be between 1 and {LARGEST_PICTURE} pixels"
        )
