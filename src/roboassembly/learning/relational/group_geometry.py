"""Geometry of one group in a frame of its own: its free points, the surface around them, its grasps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float16, Int, UInt8
from scipy.spatial import KDTree

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.relational.clearance import MAX_OTHER_POINTS, PartGrasps

PATCH_STEPS = (0.010, 0.040, 0.150)
"""Steps of the grids that sample the surface around a point, at the scale of a joint, a part and a whole piece [m]."""
PATCH_GRID = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Points of a grid in the connection point's frame, in steps: five a side."""
PATCH_SIZE = len(PATCH_STEPS) * len(PATCH_GRID)
"""Number of distances in a patch."""
_EXTENT_POINTS = 160
"""Largest number of points of a group's cloud that its bounds are computed from."""


@dataclass(frozen=True, eq=False)
class PartShapes:
    """The shapes of P parts."""

    digests: Sequence[bytes]
    """Hash of each part's cloud."""
    sides: Float[np.ndarray, "P 3"]
    """Extent of each part along its axes [m]."""
    copies: Int[np.ndarray, "P"]
    """Number of parts with the same cloud, the part itself included."""

    @staticmethod
    def of_clouds(clouds: Float[np.ndarray, "P c 3"], digests: Sequence[bytes]) -> PartShapes:
        """Return the shapes of some clouds.

        Args:
            clouds: cloud of each part in its frame [m].
            digests: hash of each cloud.
        """
        sides = {digest: np.ptp(cloud, axis=0) for digest, cloud in dict(zip(digests, clouds, strict=True)).items()}
        count = Counter(digests)
        return PartShapes(
            digests, np.array([sides[digest] for digest in digests]), np.array([count[digest] for digest in digests])
        )


@dataclass(frozen=True, eq=False)
class GroupFrames:
    """`group_from_part` of P parts: the frame of a group is that of its most distinctive part."""

    rotation: Float[np.ndarray, "P 3 3"]
    translation: Float[np.ndarray, "P 3"]
    """Translation [m]."""
    upright: Bool[np.ndarray, "P"]
    """Whether the frame of the part's group is surely parallel to the furniture's."""

    @staticmethod
    def of_groups(
        shapes: PartShapes, connections: Float[np.ndarray, "P P 6"], group: Int[np.ndarray, "P"]
    ) -> GroupFrames:
        """Return the frames of all groups.

        A part's frame is parallel to the furniture's if no other part has its shape; equal parts share the frame of the
        first of them. So a group takes the frame of the part with the fewest copies, of these the largest.
        """
        upright = np.zeros(len(group), bool)
        rotation, translation = np.tile(np.eye(3), (len(group), 1, 1)), np.zeros((len(group), 3))
        extent = shapes.sides.max(axis=1)
        reference = np.arange(len(group))
        for label in np.unique(group):
            members = np.flatnonzero(group == label)
            first = members[np.lexsort((members, -extent[members], shapes.copies[members]))[0]]
            reference[members] = first
            upright[members] = shapes.copies[first] == 1
        rest = np.flatnonzero(reference != np.arange(len(group)))
        if len(rest):
            poses = connections[reference[rest], rest]
            rotation[rest], translation[rest] = rotations_from_euler(poses[:, 3:]), poses[:, :3]
        return GroupFrames(rotation, translation, upright)


@dataclass(frozen=True, eq=False)
class GroupGeometry:
    """One group with k free points, in its own frame."""

    key: bytes
    """Hash of all that the geometry is computed from."""
    position: Float[np.ndarray, "k 3"]
    """Position of each free point [m]."""
    frame: Float[np.ndarray, "k 3 3"]
    """`group_from_point` of each free point."""
    patch: UInt8[np.ndarray, "k 375"]
    """Surface around each free point, see `Tokens.patch`."""
    cloud: Float[np.ndarray, "s 3"]
    """Some points of the group's surface [m]."""
    grasps: GroupGrasps | None
    """Grasps of the group; None if the tokens have no grasps."""

    @staticmethod
    def build(
        key: bytes, clouds: Float[np.ndarray, "p c 3"], rotation: Float[np.ndarray, "p 3 3"],
        translation: Float[np.ndarray, "p 3"], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"],
        member: Int[np.ndarray, "k"] | None = None, poses: Float[np.ndarray, "p 8 6"] | None = None,
    ) -> GroupGeometry:  # fmt: skip
        """Put a group together from its p parts.

        Args:
            key: hash of all that follows.
            clouds: cloud of each part in the part's frame [m].
            rotation: `group_from_part` of each part.
            translation: `group_from_part` of each part [m].
            position: position of each free point in the group's frame [m].
            frame: `group_from_point` of each free point.
            member: part of each free point, as a number in 0..p; only with grasps.
            poses: `part_from_tips` of each part's grasps; only with grasps.
        """
        placed = clouds @ rotation.transpose(0, 2, 1) + translation[:, None]
        cloud = placed.reshape(-1, 3)
        grasps = None
        if member is not None and poses is not None:
            of_part = {
                i: PartGrasps(
                    poses[i], placed[i], np.delete(placed, i, axis=0).reshape(-1, 3), rotation[i], translation[i]
                )
                for i in np.unique(member).tolist()
            }
            of_point = tuple(of_part[i] for i in member.tolist())
            features = np.stack([g.features(*point) for g, *point in zip(of_point, position, frame, strict=True)])
            grasps = GroupGrasps(of_point, features, _thinned(cloud, MAX_OTHER_POINTS))
        patch = _patches(cloud, position, frame)
        return GroupGeometry(key, position, frame, patch, _thinned(cloud, _EXTENT_POINTS), grasps)


@dataclass(frozen=True, eq=False)
class GroupGrasps:
    """Grasps of a group with k free points."""

    of_point: tuple[PartGrasps, ...]
    """Grasps of the part of each free point."""
    features: Float16[np.ndarray, "k 8 16"]
    """Features of these grasps, seen from the point."""
    cloud: Float[np.ndarray, "m 3"]
    """Points of the group's surface that grippers of another group may touch [m]."""


def _thinned(points: Float[np.ndarray, "n 3"], most: int) -> Float[np.ndarray, "m 3"]:
    """Every so many of the points, `most` at most."""
    return points[:: -(-len(points) // most)]


def _patches(
    cloud: Float[np.ndarray, "c 3"], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"]
) -> UInt8[np.ndarray, "k 375"]:
    """Distances from the grids around each point to the cloud."""
    # Such a tree is built in half the time, and on the points of surfaces it answers sooner, too.
    tree = KDTree(cloud, leafsize=24, compact_nodes=False, balanced_tree=False)
    out: list[Float[np.ndarray, "k 125"]] = []
    for step in PATCH_STEPS:
        queries = position[:, None] + np.einsum("nij,qj->nqi", frame, PATCH_GRID * step)
        distance = np.asarray(tree.query(queries.reshape(-1, 3), distance_upper_bound=1.5 * step)[0])
        out.append(np.minimum(distance / (1.5 * step), 1.0).reshape(len(position), -1))
    return (255.0 * np.concatenate(out, axis=1)).astype(np.uint8)
