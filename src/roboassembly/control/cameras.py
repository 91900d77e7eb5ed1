"""Cameras of the workcell: one on each wrist and two that look at the whole cell; colour, depth and segmentation.

A camera's frame has z forward, x to the right and y down. Each wrist camera sits beside its hand and looks past the
finger tips; `overview` and `overview_back` look at the middle of the cell from opposite corners.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16

from roboassembly.control.looks import Looks
from roboassembly.errors import ArgumentError
from roboassembly.furniture.model import Furniture
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, pose_to_seven
from roboassembly.rendering.camera import AZIMUTH, view_axes
from roboassembly.rendering.gl import OffscreenContext, import_mujoco
from roboassembly.rendering.offscreen import add_shaded_mesh, check_size
from roboassembly.robots.body import hand_links, links
from roboassembly.task.full.posts import post_mesh

CAMERAS = ("wrist_a", "wrist_b", "overview", "overview_back")
"""Names of the cameras."""
WRIST_FIELD, OVERVIEW_FIELD = float(np.radians(75.0)), float(np.radians(45.0))
"""Vertical fields of view [rad]."""
NEAR, FAR = 0.02, 40.0
"""Distances between which a camera sees [m]."""
NOTHING, FLOOR, POSTS, ROBOT_A, ROBOT_B, FIRST_PART = 0, 1, 2, 3, 4, 5
"""Values of a segmentation: background, floor, posts, robots, and part 0; part p is `FIRST_PART + p`."""
_ELEVATION = float(np.radians(-38.0))
_MARGIN = 0.45
"""Distance by which an overview sees beyond the ring of posts [m]."""
_OUT_OF_SIGHT = np.array([0.0, 0.0, -100.0, 1.0, 0.0, 0.0, 0.0])
_WRIST_PLACE, _WRIST_TARGET = np.array([0.12, 0.0, -0.08]), np.array([0.0, 0.0, 0.10])
"""Place of a wrist camera and the point in the middle of its picture, in the frame of the finger tips [m]."""


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of one camera."""

    rgb: UInt8[np.ndarray, "height width 3"]
    depth: Float32[np.ndarray, "height width"] | None
    """Distance along the camera's z axis [m]; `FAR` where there is nothing."""
    segmentation: UInt16[np.ndarray, "height width"] | None
    """Number of the thing that each pixel shows: `FLOOR`, `POSTS` and so on."""


@dataclass(frozen=True, eq=False)
class CellView:
    """Poses of all that a picture shows."""

    parts: Float[np.ndarray, "p 7"]
    """World pose of each part: x, y, z, qw, qx, qy, qz."""
    links: tuple[tuple[SE3, ...], tuple[SE3, ...]]
    """World pose of each link of both robots, as of `drawn_links`."""
    posts: Sequence[Float[np.ndarray, "3"]]
    """Tops of the posts [m]."""
    tips: tuple[SE3, SE3]
    """World poses of both hands' finger tips."""


@cache
def drawn_links() -> tuple[Mesh, ...]:
    """Return the meshes of a robot: platform and arm, then palm and fingers."""
    return (*(link.mesh for link in links()), *(link.mesh for link, _ in hand_links(0.0)))


def camera_matrix(field: float, width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """Return the matrix that projects points of a camera's frame to pixels.

    Args:
        field: vertical field of view [rad].
        width: of the picture [pixels].
        height: of the picture [pixels].
    """
    focal = 0.5 * height / np.tan(0.5 * field)
    return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])


def field_of(camera: str) -> float:
    """Return the vertical field of view of a camera [rad]."""
    return WRIST_FIELD if camera.startswith("wrist") else OVERVIEW_FIELD


def looking_at(place: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> SE3:
    """Return the pose of a camera at a place that has a target in the middle of its picture.

    Args:
        place: position of the camera [m].
        target: point that it looks at [m].
        up: direction that is up in the picture.
    """
    forward = (target - place) / np.linalg.norm(target - place)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    return SE3(np.column_stack([right, np.cross(forward, right), forward]), place)


class CellCameras:
    """Draws the pictures of one piece of furniture.

    Args:
        furniture: the piece.
        radius: radius of the ring of posts [m].
        looks: light, colours, patterns and shifts of cameras.
        width: largest width of a picture [pixels].
        height: largest height of a picture [pixels].

    Raises:
        RenderingUnavailableError: this machine cannot draw off screen.
        ArgumentError: a size that no picture can have.
    """

    def __init__(self, furniture: Furniture, radius: float, looks: Looks, width: int, height: int) -> None:
        check_size(width, height)
        self._furniture, self._looks, self._radius = furniture, looks, radius
        self._most_posts = 2 * len(furniture.parts)
        self._mujoco = import_mujoco()
        mj = self._mujoco
        with ExitStack() as stack:
            self._context = stack.enter_context(OffscreenContext(width, height))
            self._model = self._compile(width, height)
            self._data = mj.MjData(self._model)
            self._scene = mj.MjvScene(self._model, maxgeom=self._model.ngeom + 16)
            self._options = mj.MjvOption()
            self._render = mj.MjrContext(self._model, mj.mjtFontScale.mjFONTSCALE_100.value)
            stack.callback(self._render.free)
            stack.callback(self._context.make_current)
            self._stack = stack.pop_all()
        robot = len(drawn_links())
        labels = [FLOOR, *(FIRST_PART + p for p in range(len(furniture.parts))), *[ROBOT_A] * robot, *[ROBOT_B] * robot]
        self._labels = np.array([*labels, *[POSTS] * self._most_posts], np.uint16)

    def close(self) -> None:
        """Free the graphics resources; closing twice is harmless."""
        self._stack.close()

    def poses(self, view: CellView) -> dict[str, SE3]:
        """Return `world_from_camera` of each camera."""
        distance = (self._radius + _MARGIN) / np.tan(0.5 * OVERVIEW_FIELD)
        target, wrist = np.array([0.0, 0.0, 0.4]), looking_at(_WRIST_PLACE, _WRIST_TARGET, np.array([1.0, 0.0, 0.0]))
        planned = [tips * wrist for tips in view.tips]
        for azimuth in (AZIMUTH, AZIMUTH + np.pi):
            place = target - distance * view_axes(azimuth, _ELEVATION)[2]
            planned.append(looking_at(place, target, np.array([0.0, 0.0, 1.0])))
        return {
            name: pose * moved for name, pose, moved in zip(CAMERAS, planned, self._looks.cameras, strict=True)
        }  # fmt: skip

    def draw(
        self, view: CellView, sizes: Mapping[str, tuple[int, int]], *, depth: bool = False, segmentation: bool = False
    ) -> dict[str, Picture]:
        """Return the pictures of some cameras.

        Args:
            view: poses of everything.
            sizes: width and height of each picture by the name of its camera [pixels].
            depth: whether distances are wanted.
            segmentation: whether it is wanted what each pixel shows.
        """
        mj, model, data = self._mujoco, self._model, self._data
        self._context.make_current()
        mj.mjr_setBuffer(mj.mjtFramebuffer.mjFB_OFFSCREEN.value, self._render)
        self._place(view)
        poses = self.poses(view)
        for name in sizes:
            index, seven = model.camera(name).id, pose_to_seven(poses[name] * _MUJOCO_CAMERA)
            model.cam_pos[index], model.cam_quat[index] = seven[:3], seven[3:]
        mj.mj_kinematics(model, data)
        mj.mj_camlight(model, data)
        out: dict[str, Picture] = {}
        for name, (width, height) in sizes.items():
            camera = mj.MjvCamera()
            camera.type, camera.fixedcamid = mj.mjtCamera.mjCAMERA_FIXED.value, model.camera(name).id
            everything = mj.mjtCatBit.mjCAT_ALL.value
            mj.mjv_updateScene(model, data, self._options, None, camera, everything, self._scene)
            rectangle = mj.MjrRect(0, 0, width, height)
            mj.mjr_render(rectangle, self._scene, self._render)
            rgb = np.empty((height, width, 3), np.uint8)
            distances = np.empty((height, width), np.float32) if depth else None
            mj.mjr_readPixels(rgb, distances, rectangle, self._render)
            shown = self._segment(rectangle, width, height) if segmentation else None
            metric = None if distances is None else _metres(distances[::-1])
            out[name] = Picture(np.ascontiguousarray(rgb[::-1]), metric, shown)
        return out

    def _segment(self, rectangle: Any, width: int, height: int) -> UInt16[np.ndarray, "height width"]:
        mj = self._mujoco
        flags = [mj.mjtRndFlag.mjRND_SEGMENT.value, mj.mjtRndFlag.mjRND_IDCOLOR.value]
        for flag in flags:
            self._scene.flags[flag] = 1
        mj.mjr_render(rectangle, self._scene, self._render)
        for flag in flags:
            self._scene.flags[flag] = 0
        pixels = np.empty((height, width, 3), np.uint8)
        mj.mjr_readPixels(pixels, None, rectangle, self._render)
        number = pixels[::-1].astype(np.int64) @ [1, 256, 65536]
        label_of = np.zeros(int(number.max()) + 1, np.uint16)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == mj.mjtObj.mjOBJ_GEOM.value and 0 <= geom.segid < len(label_of) - 1:
                label_of[geom.segid + 1] = self._labels[geom.objid]
        return label_of[number]

    def _place(self, view: CellView) -> None:
        rows = np.tile(_OUT_OF_SIGHT, (len(self._labels) - 1, 1))
        parts, robot = len(view.parts), len(drawn_links())
        rows[:parts] = view.parts
        for r, poses in enumerate(view.links):
            rows[parts + r * robot : parts + (r + 1) * robot] = [pose_to_seven(pose) for pose in poses]
        first = parts + 2 * robot
        for k, top in enumerate(view.posts):
            rows[first + k, :3] = top
        self._data.mocap_pos[:], self._data.mocap_quat[:] = rows[:, :3], rows[:, 3:]

    def _compile(self, width: int, height: int) -> Any:
        mj, looks = self._mujoco, self._looks
        spec = mj.MjSpec()
        spec.stat.center, spec.stat.extent = np.array([0.0, 0.0, 0.4]), 1.0
        visual = spec.visual
        visual.global_.offwidth, visual.global_.offheight = width, height
        visual.quality.offsamples, visual.quality.shadowsize = 0, 0
        visual.map.znear, visual.map.zfar = NEAR, FAR
        visual.headlight.ambient, visual.headlight.diffuse = [looks.ambient] * 3, [0.2] * 3
        visual.headlight.specular = [0.0] * 3
        spec.add_texture(
            name="sky", type=mj.mjtTexture.mjTEXTURE_SKYBOX, builtin=mj.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=looks.background, rgb2=looks.background, width=16, height=16,
        )  # fmt: skip
        light = spec.worldbody.add_light(
            pos=-4.0 * looks.light, dir=looks.light, castshadow=False, ambient=[0.0] * 3, diffuse=looks.diffuse,
            specular=[0.15] * 3,
        )  # fmt: skip
        light.type = mj.mjtLightType.mjLIGHT_DIRECTIONAL
        patterns = self._add_materials(spec)
        spec.worldbody.add_geom(
            type=mj.mjtGeom.mjGEOM_PLANE, size=[20.0, 20.0, 1.0], material="floor", rgba=[*looks.floor, 1.0]
        )
        names: dict[int, str] = {}
        patterned = bool(looks.textures)
        for p, (part, color) in enumerate(zip(self._furniture.parts, looks.parts, strict=True)):
            self._add_item(spec, names, part.mesh, color, f"part{p}" if patterned else "plain")
        for color in looks.robots:
            for mesh in drawn_links():
                self._add_item(spec, names, mesh, color, "plain")
        for _ in range(self._most_posts):
            self._add_item(spec, names, post_mesh(), looks.post, "plain")
        for name in CAMERAS:
            spec.worldbody.add_camera(name=name, fovy=float(np.degrees(field_of(name))))
        model = spec.compile()
        # Given to the specification, every byte would be a Python number.
        for name, pixels in patterns.items():
            texture = model.texture(name).id
            first, count = model.tex_adr[texture], model.tex_height[texture] // pixels.shape[0] * pixels.size
            model.tex_data[first : first + count] = np.tile(pixels.ravel(), count // pixels.size)
        return model

    def _add_materials(self, spec: Any) -> dict[str, UInt8[np.ndarray, "t t 3"]]:
        """Add the materials and return the pattern of each that has one; a cube has it on all six sides."""
        mj, looks = self._mujoco, self._looks
        spec.add_material(name="plain", specular=0.2, shininess=0.3)
        tiles = np.repeat(np.repeat(np.array([[255, 238], [238, 255]], np.uint8), 8, axis=0), 8, axis=1)
        floor = np.repeat(tiles[..., None], 3, axis=2)
        patterns = {"floor": floor}
        if looks.textures:
            patterns = {f"part{p}": t for p, t in enumerate(looks.textures[:-1])} | {"floor": looks.textures[-1]}
        for name, pixels in patterns.items():
            kind = mj.mjtTexture.mjTEXTURE_2D if name == "floor" else mj.mjtTexture.mjTEXTURE_CUBE
            spec.add_texture(
                name=name, type=kind, builtin=mj.mjtBuiltin.mjBUILTIN_FLAT, width=pixels.shape[1],
                height=pixels.shape[0],
            )  # fmt: skip
            material = spec.add_material(name=name, specular=0.1, shininess=0.2, texuniform=True)
            material.textures[mj.mjtTextureRole.mjTEXROLE_RGB.value] = name
            material.texrepeat = [1.0, 1.0] if name == "floor" else [5.0, 5.0]
        return patterns

    def _add_item(self, spec: Any, names: dict[int, str], mesh: Mesh, color: Sequence[float], material: str) -> None:
        if id(mesh) not in names:
            names[id(mesh)] = f"mesh{len(names)}"
            add_shaded_mesh(spec, names[id(mesh)], mesh, self._mujoco)
        node = spec.worldbody.add_body(name=f"item{len(spec.bodies)}", mocap=True)
        node.add_geom(
            type=self._mujoco.mjtGeom.mjGEOM_MESH, meshname=names[id(mesh)], material=material, contype=0,
            conaffinity=0, mass=0.0, rgba=[*color, 1.0],
        )  # fmt: skip


_MUJOCO_CAMERA = SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""Pose of MuJoCo's camera, which looks along −z with y up, in a camera's frame."""


def _metres(distances: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Return distances along the viewing direction from values of the depth buffer [m]."""
    metres = NEAR / (1.0 - distances * (1.0 - NEAR / FAR))
    return np.minimum(metres, FAR).astype(np.float32)


def checked_cameras(cameras: object, width: object, height: object) -> tuple[str, ...]:
    """Return the names of the cameras that are wanted.

    Raises:
        ArgumentError: an unknown name, a name twice, none, or a size that no picture can have.
        TypeError: no sequence of names, or a size that is no integer.
    """
    known = ", ".join(map(repr, CAMERAS))
    if isinstance(cameras, str) or not isinstance(cameras, Sequence):
        raise TypeError(f"cameras is {cameras!r}; expected a list of names of {known}")
    names: list[object] = list(cameras)  # pyright: ignore[reportUnknownArgumentType]
    for name in names:
        if name not in CAMERAS:
            raise ArgumentError(f"unknown camera {name!r}; known: {known}")
        if names.count(name) > 1:
            raise ArgumentError(f"camera {name!r} is named twice")
    if not names:
        raise ArgumentError(f"no cameras given; name at least one of {known}")
    for label, size in (("camera_width", width), ("camera_height", height)):
        if isinstance(size, bool) or not isinstance(size, int | np.integer):
            raise TypeError(f"{label} is {size!r}; expected an integer, in pixels")
    check_size(int(width), int(height))  # pyright: ignore[reportArgumentType]
    return tuple(map(str, names))
