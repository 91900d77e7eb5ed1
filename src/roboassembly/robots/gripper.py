"""Collision model of the Franka hand: a palm and two fingers, each convex, in the frame between the finger tips.

In that frame (`panda_hand_tcp`) z points out of the palm, along the approach, and the fingers close along y. Shapes,
joint axes and frames are read from the Panda's URDF in the `example-robot-data` wheel.
"""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from roboassembly.errors import MissingRobotError
from roboassembly.geometry.meshes import Mesh
from roboassembly.geometry.poses import SE3, transform_points

MAX_OPENING = 0.08
"""Distance between the finger pads of the open hand, 40 mm per finger [m]."""
WIDER = 0.02
"""Distance that a hand opens wider than the part [m]."""
PALM_DEPTH = 0.0374
"""Distance from the frame of the finger tips back to the palm, which limits what fits between the fingers [m]."""
RETREAT = 0.10
"""Length of the straight approach of the open hand [m]."""
SHORT_RETREAT = 0.05
"""Length of it where the arm does not reach farther, or something is behind the hand [m]."""

_WHEEL = "example-robot-data"
_ROBOT = "cmeel.prefix/share/example-robot-data/robots/panda_description"
TIPS = "panda_hand_tcp"
_PALM, _FINGERS = "panda_hand", ("panda_leftfinger", "panda_rightfinger")
_SLIDES = ("panda_finger_joint1", "panda_finger_joint2")


@dataclass(frozen=True, eq=False)
class _Hand:
    """Convex bodies of the closed hand and unit vectors along which the fingers open, in the frame of the tips."""

    palm: Mesh
    fingers: tuple[Mesh, Mesh]
    opens: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def panda_folder() -> Path:
    """Return the wheel's folder of the Panda, which contains `urdf/panda.urdf` and `meshes/`.

    Raises:
        MissingRobotError: the wheel is not installed, or holds no Panda where it should.
    """
    try:
        folder = Path(str(importlib.metadata.distribution(_WHEEL).locate_file(_ROBOT)))
    except importlib.metadata.PackageNotFoundError:
        raise MissingRobotError(_WHEEL) from None
    if not (folder / "urdf/panda.urdf").is_file():
        raise MissingRobotError(_WHEEL, folder)
    return folder


def hand_bodies(opening: float) -> tuple[tuple[Mesh, SE3], ...]:
    """Return the convex palm, left and right finger, each with `tips_from_body`, the pads `opening` metres apart.

    The meshes are the same objects at every call.
    """
    hand = _hand()
    fingers = (
        (mesh, SE3(np.eye(3), 0.5 * opening * axis)) for mesh, axis in zip(hand.fingers, hand.opens, strict=True)
    )
    return ((hand.palm, SE3.Identity()), *fingers)


def hand_pose(
    position: Float[np.ndarray, "3"], closing: Float[np.ndarray, "3"], approach: Float[np.ndarray, "3"]
) -> SE3:
    """Return `part_from_tips` of a hand at a position, given the unit vectors of closing and approach."""
    return SE3(np.column_stack([np.cross(closing, approach), closing, approach]), position)


class HandAgainst:
    """Batched collision tests of the hand against one fixed mesh; touching counts.

    Args:
        mesh: the exact triangles; poses are given in its frame.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh

    @cached_property
    def _still(self) -> _Pool:
        return _Pool(self._mesh, _convex_shapes(0.0))

    @cached_property
    def _coming(self) -> _Pool:
        # A convex body that moves along a line sweeps the hull of its two ends: one test covers the whole approach.
        return _Pool(self._mesh, _convex_shapes(RETREAT))

    def touches(
        self,
        positions: Float[np.ndarray, "n 3"],
        closing: Float[np.ndarray, "n 3"],
        approach: Float[np.ndarray, "n 3"],
        opening: float | Float[np.ndarray, "n"],
        *,
        coming: bool = False,
    ) -> Bool[np.ndarray, "n"]:
        """Return whether the hand touches the mesh anywhere.

        Args:
            positions: points midway between the pads [m].
            closing: unit vectors.
            approach: unit vectors orthogonal to `closing`, from the palm to the finger tips.
            opening: distance between the pads [m].
            coming: whether to include the last `RETREAT` metres of the straight approach.
        """
        n = len(positions)
        turns = np.stack([np.cross(closing, approach), closing, approach], axis=-1)
        configurations = np.empty((9, n), order="F")
        configurations[:3] = positions.T
        configurations[3:7] = _quaternions(turns).T
        configurations[7:] = 0.5 * np.asarray(opening)
        return (self._coming if coming else self._still).collides(configurations)


class _Pool:
    """Batch of Pinocchio's collision tests of a free hand with a mesh."""

    def __init__(self, mesh: Mesh, shapes: tuple[coal.ConvexBase, ...]) -> None:
        model = pin.Model()
        palm = model.addJoint(0, pin.JointModelFreeFlyer(), SE3.Identity(), _PALM)
        joints = [palm]
        for name, axis in zip(_SLIDES, _hand().opens, strict=True):
            joints.append(model.addJoint(palm, pin.JointModelPrismaticUnaligned(axis), SE3.Identity(), name))
        geometry = pin.GeometryModel()
        part = geometry.addGeometryObject(pin.GeometryObject("part", 0, SE3.Identity(), mesh.bvh))
        for index, (joint, shape) in enumerate(zip(joints, shapes, strict=True)):
            body = geometry.addGeometryObject(pin.GeometryObject(f"body{index}", joint, SE3.Identity(), shape))
            geometry.addCollisionPair(pin.CollisionPair(part, body))
        self._pool = pin.GeometryPool(model, geometry, 1)
        for data in self._pool.getGeometryDatas():
            for request in data.collisionRequests:
                # By default Coal also computes distances of nearby shapes.
                request.break_distance = 0.0

    def collides(self, configurations: Float[np.ndarray, "9 n"]) -> Bool[np.ndarray, "n"]:
        stop_at_first_body = True
        touched = pin.computeCollisionsInParallel(1, self._pool, configurations, stop_at_first_body)
        return np.array(touched, dtype=bool)


@cache
def _convex_shapes(back: float) -> tuple[coal.ConvexBase, ...]:
    """Return the convex bodies of the closed hand, swept from `back` metres behind."""
    hand = _hand()
    shapes: list[coal.ConvexBase] = []
    for mesh in (hand.palm, *hand.fingers):
        swept = Mesh.from_trimesh(_hull(np.concatenate([mesh.vertices, mesh.vertices - [0.0, 0.0, back]])))
        shapes.append(swept.convex)
    return tuple(shapes)


@cache
def _hand() -> _Hand:
    folder = panda_folder()
    urdf = str(folder / "urdf/panda.urdf")
    model = pin.buildModelFromUrdf(urdf)
    # The `package://` paths begin above the folder with the wheel's own name.
    geometry = pin.buildGeomFromUrdf(
        model, urdf, pin.GeometryType.COLLISION, package_dirs=[str(folder.parent.parent.parent)]
    )
    data, tips = model.createData(), model.getFrameId(TIPS)

    def in_tips(link: str, configuration: Float[np.ndarray, "q"]) -> SE3:
        pin.framesForwardKinematics(model, data, configuration)
        return data.oMf[tips].actInv(data.oMf[model.getFrameId(link)])

    closed = pin.neutral(model)
    opens: list[Float[np.ndarray, "3"]] = []
    for link, slide in zip(_FINGERS, _SLIDES, strict=True):
        moved = pin.neutral(model)
        moved[model.joints[model.getJointId(slide)].idx_q] = 0.5 * MAX_OPENING
        way = in_tips(link, moved).translation - in_tips(link, closed).translation
        opens.append(way / np.linalg.norm(way))
    finger = np.array(trimesh.load_mesh(folder / "meshes/collision/finger.stl", process=False).vertices)
    bodies: list[Mesh] = []
    for link, axis in zip((_PALM, *_FINGERS), (None, *opens), strict=True):
        pose = in_tips(link, closed)
        corners: list[Float[np.ndarray, "n 3"]] = []
        if axis is not None:
            # The URDF models each finger by four boxes and the mesh file by one shape; they differ by up to 3 mm. The
            # file describes the finger that opens along y; the other finger is the same shape rotated.
            turn = np.diag([np.sign(axis[1]), np.sign(axis[1]), 1.0])
            corners.append(transform_points(pose, finger @ turn))
        for shape in geometry.geometryObjects:
            frame = model.frames[shape.parentFrame]
            if frame.name == link:
                placement = data.oMf[tips].actInv(data.oMi[frame.parentJoint] * shape.placement)
                corners.append(transform_points(placement, shape_corners(shape.geometry)))
        bodies.append(Mesh.from_trimesh(_hull(np.concatenate(corners))))
    return _Hand(bodies[0], (bodies[1], bodies[2]), (opens[0], opens[1]))


def shape_corners(shape: coal.CollisionGeometry) -> Float[np.ndarray, "n 3"]:
    """Return the corners of a box or the vertices of a mesh, in the shape's own frame."""
    if isinstance(shape, coal.Box):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * np.array(shape.halfSide)
    assert isinstance(shape, coal.BVHModelBase)
    return np.array(shape.vertices())


def _hull(points: Float[np.ndarray, "n 3"]) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(points)


def _quaternions(turns: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    """Return quaternions `(x, y, z, w)`, in the order of Pinocchio's configurations."""
    return Rotation.from_matrix(turns).as_quat()
