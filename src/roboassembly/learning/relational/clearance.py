"""Clearance between a gripper and clouds of points, and the features of a part's grasps that follow from it.

Late in an assembly no gripper may reach the place where the next parts mate, and no merge can be undone. Which grasps a
group leaves free, and which of them the other group of a mate blocks, follows from the clouds in the observation. The
exact test on meshes is in `task.full`; this one is what a policy can know.

The gripper is three convex bodies, a palm and two fingers. All functions work in the tips frame of `robots.gripper`,
between the finger tips: z along the approach, y along the closing direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import ConvexHull

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.robots.gripper import MAX_OPENING, RETREAT, WIDER, hand_bodies

CUTOFF = 0.05
"""Value from which on clearances of a gripper are clipped [m]."""
SCALE = 0.01
"""Scale of the tanh features of clearances: within it, the exact distance matters [m]."""
ARM_SECTIONS = ((0.13, 0.30), (0.30, 0.50))
"""Distances from the tips at which wrist and forearm begin and end [m]."""
ARM_CUTOFF = 0.3
"""Value from which on clearances of wrist and forearm are clipped [m]."""
MATE_RETREATS = (0.0, 0.03, 0.10, 0.20)
"""Distances out of a mate at which a gripper is tested [m]."""
_UNKNOWN_OPENING = 0.03
"""Opening assumed where the cloud has no point between the pads [m]."""
_PAD_MARGIN = 0.003
"""Distance beyond an open pad at which points still count as between the pads [m]."""
_PAD_RADIUS = 0.011
"""Distance from a pad's middle to its rim [m]."""


@dataclass(frozen=True, eq=False)
class PlacedGrasps:
    """The eight grasps of a part, in the frame of its group."""

    exists: Bool[np.ndarray, "8"]
    """Whether the part has the grasp."""
    rotation: Float[np.ndarray, "8 3 3"]
    """`group_from_tips` rotations."""
    position: Float[np.ndarray, "8 3"]
    """Positions of the tips [m]."""
    opening: Float[np.ndarray, "8"]
    """Distance between the pads when closed on the part, as far as the cloud shows [m]."""

    @staticmethod
    def place(
        poses: Float[np.ndarray, "8 6"], rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"],
        own: Float[np.ndarray, "c 3"],
    ) -> PlacedGrasps:  # fmt: skip
        """Place the grasps of a part.

        Args:
            poses: `part_from_tips` of each grasp, translation [m] and Euler angles; zeros where there is none.
            rotation: `group_from_part`.
            translation: `group_from_part` [m].
            own: cloud of the part in the group's frame [m].
        """
        rotations, positions = rotation @ rotations_from_euler(poses[:, 3:]), poses[:, :3] @ rotation.T + translation
        return PlacedGrasps((poses != 0.0).any(axis=1), rotations, positions, _openings(rotations, positions, own))

    @property
    def approach_opening(self) -> Float[np.ndarray, "8"]:
        """Distance between the pads as the open gripper approaches [m]."""
        return np.minimum(MAX_OPENING, self.opening + WIDER)

    def moved(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> PlacedGrasps:
        """Return the grasps of the group in another pose, turned by `rotation` and moved by `translation` [m]."""
        return replace(self, rotation=rotation @ self.rotation, position=self.position @ rotation.T + translation)

    def near(self, points: Float[np.ndarray, "n 3"], reach: bool = True) -> NearPoints:
        """Return the points that a gripper at each grasp could touch as it approaches, or on its way out of a mate.

        Args:
            points: cloud [m].
            reach: whether points farther away are left out.
        """
        exists = np.flatnonzero(self.exists)
        local = _in_tips_frames(self.rotation[exists], self.position[exists], points)
        grasp, index = np.nonzero(_inside(local, *_reach()) if reach else np.ones(local.shape[1:], bool))
        return NearPoints(local[:, grasp, index], exists[grasp], index)


@dataclass(frozen=True, eq=False)
class NearPoints:
    """Points near grippers."""

    points: Float[np.ndarray, "3 m"]
    """Positions in the tips frame of their gripper [m]."""
    gripper: Int[np.ndarray, "m"]
    """Number of the gripper, ascending."""
    index: Int[np.ndarray, "m"]
    """Index in the cloud that they are from."""

    def between(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> NearPoints:
        """Return the points in a box in the tips frames [m]."""
        inside = np.flatnonzero(_inside(self.points, low, high))
        return NearPoints(self.points[:, inside], self.gripper[inside], self.index[inside])

    def shifted(self, offset: Float[np.ndarray, "g 3"]) -> NearPoints:
        """Return the points moved by an offset for each gripper, in its tips frame [m]."""
        return replace(self, points=self.points + offset.T.astype(self.points.dtype)[:, self.gripper])


def _openings(
    rotation: Float[np.ndarray, "8 3 3"], position: Float[np.ndarray, "8 3"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "8"]:
    """Distance between the pads of each grasp, from the points between them [m]."""
    local = np.abs(_in_tips_frames(rotation, position, points))
    between = (local[0] < _PAD_RADIUS) & (local[2] < _PAD_RADIUS) & (local[1] < 0.5 * MAX_OPENING + _PAD_MARGIN)
    opening = 2.0 * np.where(between, local[1], 0.0).max(axis=1).astype(float)
    return np.where(opening > 0.0, opening, _UNKNOWN_OPENING)


def _in_tips_frames(
    rotation: Float[np.ndarray, "g 3 3"], position: Float[np.ndarray, "g 3"], points: Float[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "3 g n"]:
    """Return points in the frame of each gripper [m], a micrometre exact: single precision takes half the time."""
    turn = rotation.transpose(2, 0, 1).reshape(-1, 3).astype(np.float32)
    offset = np.einsum("gji,gj->ig", rotation, position).astype(np.float32)
    local = (turn @ points.T.astype(np.float32)).reshape(3, len(rotation), -1)
    local -= offset[..., None]
    return local


@dataclass(frozen=True, eq=False)
class GripperShape:
    """Palm and fingers of the closed gripper, all convex, in the tips frame."""

    low: Float32[np.ndarray, "3 3"]
    """Lower corners of the bodies' bounding boxes [m]."""
    high: Float32[np.ndarray, "3 3"]
    """Upper corners of the bodies' bounding boxes [m]."""
    faces: tuple[tuple[Float32[np.ndarray, "f 3"], Float32[np.ndarray, "f 1"]], ...]
    """Outward normals of each body's faces, and the faces' distances from the origin [m]."""
    motion: Float32[np.ndarray, "3 3"]
    """Motion of each body for each metre between the pads."""


@cache
def gripper_shape(retreat: float = 0.0) -> GripperShape:
    """Return the gripper's bodies, swept along the last `retreat` metres of its approach."""
    corners: list[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]] = []
    faces: list[tuple[Float32[np.ndarray, "f 3"], Float32[np.ndarray, "f 1"]]] = []
    motion: list[Float[np.ndarray, "3"]] = []
    for (mesh, closed), (_, opened) in zip(hand_bodies(0.0), hand_bodies(1.0), strict=True):
        points = mesh.vertices @ closed.rotation.T + closed.translation
        hull = ConvexHull(np.concatenate([points, points - [0.0, 0.0, retreat]]))
        planes = np.unique(hull.equations.round(9), axis=0)
        corners.append((hull.min_bound, hull.max_bound))
        faces.append((planes[:, :3].astype(np.float32), -planes[:, 3:].astype(np.float32)))
        motion.append(opened.translation - closed.translation)
    low, high = np.array(corners, np.float32).transpose(1, 0, 2)
    return GripperShape(low, high, tuple(faces), np.array(motion, np.float32))


@cache
def _reach() -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Corners of a box around all that the gripper can touch, in the tips frame [m]."""
    shape, margin = gripper_shape(RETREAT), CUTOFF + MATE_RETREATS[-1]
    margin += 0.5 * MAX_OPENING
    return shape.low.min(axis=0) - margin, shape.high.max(axis=0) + margin


def _inside(
    points: Float[np.ndarray, "3 *n"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "*n"]:
    """Return which points are in a box. One axis after the other: NumPy is slow over short axes."""
    out = (points[0] > low[0]) & (points[0] < high[0])
    for axis in (1, 2):
        out &= (points[axis] > low[axis]) & (points[axis] < high[axis])
    return out


def hand_clearance(near: NearPoints, opening: Float[np.ndarray, "g"], retreat: float = 0.0) -> Float[np.ndarray, "g"]:
    """Return the distance from each gripper to its nearest point [m]: negative inside, `CUTOFF` at most.

    Args:
        near: points.
        opening: distance between each gripper's pads [m].
        retreat: distance that the grippers come from, straight along their approach; the whole way counts [m].
    """
    shape = gripper_shape(retreat)
    by_boxes, out = np.full(len(opening), CUTOFF), np.full(len(opening), CUTOFF)
    margin = CUTOFF + 0.5 * MAX_OPENING
    near = near.between(shape.low.min(axis=0) - margin, shape.high.max(axis=0) + margin)
    wide = opening.astype(near.points.dtype)[near.gripper]
    for low, high, motion, (normals, offsets) in zip(shape.low, shape.high, shape.motion, shape.faces, strict=True):
        points = near.points - motion[:, None] * wide
        outside = _beyond(points, 0.5 * (low + high), 0.5 * (high - low))
        # The boxes say which points are near, the bodies' faces how near they are.
        close = np.flatnonzero(outside < SCALE)
        _lower(out, near.gripper[close], (normals @ points[:, close] - offsets).max(axis=0))
        _lower(by_boxes, near.gripper, outside)
    return np.where(by_boxes < SCALE, out, by_boxes)


def _lower(least: Float[np.ndarray, "g"], gripper: Int[np.ndarray, "m"], values: Float[np.ndarray, "m"]) -> None:
    """Lower the least value of each gripper to its least one of `values`; `gripper` ascends."""
    if len(values):
        first = np.flatnonzero(np.concatenate([[True], gripper[1:] != gripper[:-1]]))
        least[gripper[first]] = np.minimum(least[gripper[first]], np.minimum.reduceat(values, first))


def _beyond(
    points: Float[np.ndarray, "3 *n"], middle: Float[np.ndarray, "3 ..."], half: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "*n"]:
    """Return the distance from each point to a box [m], negative inside.

    One axis after the other: NumPy takes five times as long over short axes.
    """
    out = np.abs(points[0] - middle[0]) - half[0]
    for axis in (1, 2):
        np.maximum(out, np.abs(points[axis] - middle[axis]) - half[axis], out=out)
    return out


def arm_clearance(near: NearPoints, grippers: int, begin: float, end: float) -> Float[np.ndarray, "g"]:
    """Return the distance from a section of each arm's axis to its nearest point [m], `ARM_CUTOFF` at most.

    Args:
        near: points.
        grippers: number of grippers.
        begin: distance from the tips to the section's beginning, against the approach [m].
        end: distance from the tips to the section's end [m].
    """
    x, y, z = near.points
    z = z - np.clip(z, -end, -begin)
    out = np.full(grippers, ARM_CUTOFF**2)
    _lower(out, near.gripper, x * x + y * y + z * z)
    return np.sqrt(out)
