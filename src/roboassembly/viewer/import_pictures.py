"""Pictures for the report of an import: the piece and each part, before and after repair."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import fast_simplification
import imageio.v3 as iio
import numpy as np
from jaxtyping import Float, Int, UInt8

from roboassembly.errors import FurnitureError
from roboassembly.furniture.model import Furniture, RawPart
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points
from roboassembly.geometry.triangles import scaled_normals
from roboassembly.rendering.camera import (
    AZIMUTH,
    ELEVATION,
    Camera,
    box_corners,
    boxes_corners,
    fit_camera,
    project,
    view_axes,
)
from roboassembly.rendering.colors import MOVING, WOOD, Color, distinct_colors
from roboassembly.rendering.renderer import FAST, STILL, OffscreenRenderer
from roboassembly.repair import PartRepair
from roboassembly.repair.proximity import Shell
from roboassembly.repair.surface import Surface

WIDTH, HEIGHT = 800, 600
"""Size of the pictures of the whole piece [pixels]."""
PART_WIDTH, PART_HEIGHT = 320, 240
"""Size of the pictures of parts [pixels]."""
CHANGED = 0.0005
"""Distance from the delivered surface above which a surface counts as changed [m]."""
EXPLODED = 0.5
"""Distance that parts move apart in the exploded picture, as a share of their distance from the middle."""
MAX_FACES = 20_000
"""Largest number of triangles of a delivered part in a picture."""
_OVER = np.diag([1.0, -1.0, -1.0])
"""Rotation that turns a part upside down."""
_CLEARLY = 1.2
"""Ratio of shown surfaces from which another view is taken."""
DELIVERED: Color = (0.72, 0.74, 0.77)
"""Colour of parts as delivered."""
CUT = MOVING
"""Colour of changed surfaces."""
MARKED: Color = (0.78, 0.16, 0.14)
"""Colour of the parts that a refusal is about."""


@dataclass(frozen=True)
class PartPictures:
    """Pictures of one part, as data addresses."""

    before: str
    after: str
    turned_over: bool
    """Whether both show the part upside down."""


@dataclass(frozen=True, eq=False)
class ImportPictures:
    """Pictures of one import, as data addresses."""

    before: str
    after: str
    exploded: str
    joints: Float[np.ndarray, "c 2 2"]
    """Ends of each connection in the exploded picture [pixels]."""
    parts: tuple[PartPictures, ...]


def take_pictures(raw: Sequence[RawPart], furniture: Furniture, repairs: Sequence[PartRepair]) -> ImportPictures:
    """Return the pictures of an import.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
    """
    before = [_light(part.mesh) for part in raw]
    after = [part.mesh.transformed(pose) for part, pose in zip(furniture.parts, furniture.assembled, strict=True)]
    overview = _overview(before, after, furniture)
    halves = [_halves(new, old.mesh, repair) for new, old, repair in zip(after, raw, repairs, strict=True)]
    return ImportPictures(*overview, _parts(before, halves, [mesh.bounds for mesh in after]))


def take_delivered(meshes: Sequence[Mesh], marked: Sequence[bool]) -> tuple[str, str]:
    """Return pictures of parts as delivered, together and pulled apart, as data addresses.

    Args:
        meshes: meshes of the parts in the furniture's frame.
        marked: whether each part is shown in red.

    Raises:
        RenderingUnavailableError: this machine cannot render off screen.
    """
    meshes = [_light(mesh) for mesh in meshes]
    assembled, exploded = [SE3.Identity()] * len(meshes), _exploded(meshes)
    wide = _camera(meshes, exploded, WIDTH / HEIGHT)
    colors = [MARKED if mark else DELIVERED for mark in marked]
    radius = _radius(meshes, exploded, wide)
    with OffscreenRenderer(meshes, WIDTH, HEIGHT, center=wide.target, radius=radius, quality=STILL) as renderer:
        near = _camera(meshes, assembled, WIDTH / HEIGHT)
        assembled_picture, exploded_picture = (
            _encoded(renderer.picture(poses, colors, camera)) for poses, camera in ((assembled, near), (exploded, wide))
        )
    return assembled_picture, exploded_picture


def _exploded(meshes: Sequence[Mesh]) -> list[SE3]:
    """Return poses of parts that were pulled apart; the lowest one stays on the ground."""
    centers = np.array([mesh.bounds.mean(axis=0) for mesh in meshes])
    shifts = EXPLODED * (centers - centers.mean(axis=0))
    lows = np.array([mesh.bounds[0, 2] for mesh in meshes])
    shifts[:, 2] -= (lows + shifts[:, 2]).min()
    return [SE3(np.eye(3), shift) for shift in shifts]


def _radius(meshes: Sequence[Mesh], poses: Sequence[SE3], camera: Camera) -> float:
    """Return the largest distance of a corner from the middle of the picture along an axis [m]."""
    return float(max(np.abs(box_corners(m, p) - camera.target).max() for m, p in zip(meshes, poses, strict=True)))


def _overview(
    before: Sequence[Mesh], after: Sequence[Mesh], furniture: Furniture
) -> tuple[str, str, str, Float[np.ndarray, "c 2 2"]]:
    count = len(after)
    colors = distinct_colors(furniture.class_of)
    assembled, none = [SE3.Identity()] * count, [None] * count
    exploded = _exploded(after)
    near = _camera([*before, *after], [*assembled, *assembled], WIDTH / HEIGHT)
    wide = _camera(after, exploded, WIDTH / HEIGHT)
    radius = _radius(after, exploded, wide)
    with OffscreenRenderer(
        [*before, *after], WIDTH, HEIGHT, center=wide.target, radius=radius, quality=STILL
    ) as renderer:
        pictures = [
            _encoded(renderer.picture(poses, [*[DELIVERED] * count, *colors], camera))
            for poses, camera in (([*assembled, *none], near), ([*none, *assembled], near), ([*none, *exploded], wide))
        ]
    ends = [
        [
            transform_points(
                exploded[part] * furniture.assembled[part], furniture.parts[part].points[point].position[None]
            )[0]
            for part, point in ((c.part_a, c.point_a), (c.part_b, c.point_b))
        ]
        for c in furniture.connections
    ]
    joints = project(np.array(ends).reshape(-1, 3), wide, WIDTH, HEIGHT).reshape(-1, 2, 2)
    return pictures[0], pictures[1], pictures[2], joints


def _parts(
    before: Sequence[Mesh],
    halves: Sequence[tuple[Mesh | None, Mesh | None]],
    bounds: Sequence[Float[np.ndarray, "2 3"]],
) -> tuple[PartPictures, ...]:
    """Return the pictures of each part, which stands alone on the ground."""
    meshes = [*before, *(half for pair in halves for half in pair if half is not None)]
    colors: list[Color] = [DELIVERED] * len(before)
    owners = list(range(len(before)))
    for part, pair in enumerate(halves):
        for half, color in zip(pair, (WOOD, CUT), strict=True):
            if half is not None:
                colors.append(color)
                owners.append(part)
    radius = max(0.5 * float(np.linalg.norm(np.ptp(box, axis=0))) for box in bounds)
    out: list[PartPictures] = []
    with OffscreenRenderer(
        meshes, PART_WIDTH, PART_HEIGHT, center=np.array([0.0, 0.0, radius]), radius=radius, quality=FAST
    ) as renderer:
        for part, box in enumerate(bounds):
            turn, azimuth = _view(halves[part][1])
            corners = np.concatenate([_corners(before[part].bounds), _corners(box)]) @ turn.T
            low, high = corners.min(axis=0), corners.max(axis=0)
            place = SE3(turn, -np.array([*(0.5 * (low + high))[:2], low[2]]))
            camera = fit_camera(corners + place.translation, PART_WIDTH / PART_HEIGHT, azimuth)
            poses_of = [
                [place if owner == part and (k < len(before)) == old else None for k, owner in enumerate(owners)]
                for old in (True, False)
            ]
            first, second = (_encoded(renderer.picture(poses, colors, camera)) for poses in poses_of)
            out.append(PartPictures(first, second, turn is _OVER))
    return tuple(out)


def _view(changed: Mesh | None) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Return the rotation of a part and the azimuth of the camera that show the most of its changed surface."""
    choices = [(turn, azimuth) for turn in (np.eye(3), _OVER) for azimuth in (AZIMUTH, AZIMUTH + np.pi)]
    if changed is None:
        return choices[0]
    normals = scaled_normals(changed.vertices[changed.faces])
    shown = [np.maximum(0.0, -normals @ turn.T @ view_axes(azimuth, ELEVATION)[2]).sum() for turn, azimuth in choices]
    # The usual view stays unless another one shows clearly more.
    best = int(np.argmax(shown))
    return choices[best] if shown[best] > _CLEARLY * shown[0] else choices[0]


def _corners(bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "8 3"]:
    return boxes_corners(bounds[:1], bounds[1:])


def _camera(meshes: Sequence[Mesh], poses: Sequence[SE3], aspect: float) -> Camera:
    return fit_camera(np.concatenate([box_corners(m, p) for m, p in zip(meshes, poses, strict=True)]), aspect)


def _halves(after: Mesh, before: Mesh, repair: PartRepair) -> tuple[Mesh | None, Mesh | None]:
    """Return the kept and the changed surface of a part; None for one without triangles."""
    untouched = repair.trimmed < 1e-6 and abs(repair.size_change) < CHANGED and repair.how == "as delivered"
    if untouched and not repair.depth_losses:
        return after, None
    delivered = Shell(Surface(before.vertices + np.array(repair.shift), before.faces))
    middles = after.vertices[after.faces].mean(axis=1)
    changed = delivered.distances_to(middles) > CHANGED
    return _some(after, np.flatnonzero(~changed)), _some(after, np.flatnonzero(changed))


def _some(mesh: Mesh, faces: Int[np.ndarray, "_"]) -> Mesh | None:
    try:
        return Mesh(mesh.vertices, mesh.faces[faces]) if len(faces) else None
    except FurnitureError:
        return None  # slivers without area


def _light(mesh: Mesh) -> Mesh:
    """Return a mesh with few enough triangles for a picture."""
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    # Copies: the library takes no read-only arrays, as those of a mesh are.
    points, faces = fast_simplification.simplify(mesh.vertices.copy(), mesh.faces.copy(), target_count=MAX_FACES)
    return Mesh(points, faces)


def _encoded(picture: UInt8[np.ndarray, "height width 3"]) -> str:
    data = BytesIO()
    iio.imwrite(data, picture, extension=".webp")
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode("ascii")
