"""Geometry of one group in a frame of its own: its free points and the surface around them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import KDTree

from roboassembly.geometry.poses import rotations_from_euler
from roboassembly.learning.relational.depth_images import PointImages

PATCH_STEPS = (0.010, 0.040, 0.150)
"""Steps of the grids that sample the surface around a point, at the scale of a joint, a part and a whole piece [m]."""
PATCH_GRID = np.stack(np.meshgrid(*[np.arange(-2.0, 3.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Points of a grid in the connection point's frame, in steps: five a side."""
PATCH_SIZE = len(PATCH_STEPS) * len(PATCH_GRID)
"""Number of distances in a patch."""
_SAME_DISTANCE, _SAME_DEVIATION = 0.002, 0.03
"""Difference of coordinates [m], and share of the deviation, up to which two parts have one shape."""


_DIRECTIONS = np.array(
    [
        np.array(signs) * order
        for base in ((1, 0, 0), (1, 1, 0), (1, 1, 1), (2, 1, 0), (2, 1, 1), (2, 2, 1), (3, 2, 1))
        for order in sorted(set(permutations(base)))
        for signs in product((1, -1), repeat=3)
        if all(sign == 1 for sign, entry in zip(signs, order, strict=True) if entry == 0)
    ],
    float,
)
"""Directions in which the outermost points of a cloud are looked for; turned furniture has the same."""


@dataclass(frozen=True, eq=False)
class PartShapes:
    """The shapes of P parts."""

    digests: Sequence[bytes]
    """Hash of each part's cloud."""
    sides: Float[np.ndarray, "P 3"]
    """Extent of each part along its axes [m]."""
    shape: Int[np.ndarray, "P"]
    """Number of each part's shape."""
    copies: Int[np.ndarray, "P"]
    """Number of parts of the same shape, the part itself included."""

    @staticmethod
    def of_clouds(
        clouds: Float[np.ndarray, "P c 3"], digests: Sequence[bytes], points: Float[np.ndarray, "P K 9"]
    ) -> PartShapes:
        """Return the shapes of some parts.

        Parts of one shape have the same cloud, or clouds of equal deviations and points in the same places: two clouds
        of one surface differ, and so do parts that may take each other's places.

        Args:
            clouds: cloud of each part in its frame [m].
            digests: hash of each cloud.
            points: connection points of each part.
        """
        first = {digest: index for index, digest in reversed(list(enumerate(digests)))}
        of_first = {index: _Measures.of_part(clouds[index], points[index]) for index in first.values()}
        shapes: list[_Measures] = []
        shape_of: dict[int, int] = {}
        for index in sorted(of_first):
            same = next((i for i, other in enumerate(shapes) if of_first[index].same(other)), len(shapes))
            if same == len(shapes):
                shapes.append(of_first[index])
            shape_of[index] = same
        of_part = [shape_of[first[digest]] for digest in digests]
        count = Counter(of_part)
        copies = np.array([count[shape] for shape in of_part])
        return PartShapes(digests, np.ptp(clouds, axis=1), np.array(of_part), copies)


@dataclass(frozen=True, eq=False)
class _Measures:
    """Measures of a part that are equal for all parts of its shape, in the frame that they share."""

    deviation: Float[np.ndarray, "3"]
    """Standard deviations of the cloud along its axes [m]."""
    position: Float[np.ndarray, "k 3"]
    """Connection points [m]."""

    @staticmethod
    def of_part(cloud: Float[np.ndarray, "c 3"], points: Float[np.ndarray, "K 9"]) -> _Measures:
        """Return the measures of a part; rows of zeros are no points."""
        return _Measures(cloud.std(axis=0), points[points.any(axis=1), :3])

    def same(self, other: _Measures) -> bool:
        """Return whether two parts count as equal."""
        return (
            len(self.position) == len(other.position)
            and bool((np.abs(self.position - other.position) < _SAME_DISTANCE).all())
            and bool(
                (np.abs(self.deviation - other.deviation) < _SAME_DEVIATION * self.deviation + _SAME_DISTANCE).all()
            )
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
        shapes: PartShapes, connections: Float[np.ndarray, "P P 6"], group: Int[np.ndarray, "P"], *, aligned: bool
    ) -> GroupFrames:
        """Return the frames of all groups.

        Args:
            shapes: shapes of the parts.
            connections: relative poses of joined parts.
            group: group of each part.
            aligned: whether part frames are parallel to the furniture's; no group is upright if they are not.

        An aligned part's frame is parallel to the furniture's if no other part has its shape; equal parts share the
        frame of the first of them. So a group takes the frame of the part with the fewest copies, of these the largest.
        """
        upright = np.zeros(len(group), bool)
        rotation, translation = np.tile(np.eye(3), (len(group), 1, 1)), np.zeros((len(group), 3))
        extent = shapes.sides.max(axis=1)
        reference = np.arange(len(group))
        for label in np.unique(group):
            members = np.flatnonzero(group == label)
            first = members[np.lexsort((members, -extent[members], shapes.copies[members]))[0]]
            reference[members] = first
            upright[members] = aligned and shapes.copies[first] == 1
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
    axes: Float[np.ndarray, "k 3 3"]
    """Axes that `w` names where the group waits with this point, as columns."""
    patch: UInt8[np.ndarray, "k 375"]
    """Surface around each free point, see `Tokens.patch`."""
    outline: Float[np.ndarray, "s 3"]
    """Outermost points of the group's surface [m]."""
    part_bounds: Float[np.ndarray, "k 6"]
    """Least and greatest coordinates of the point's part in the point's frame [m]."""
    group_bounds: Float[np.ndarray, "k 6"]
    """Least and greatest coordinates of the group in the point's frame [m]."""
    part_center: Float[np.ndarray, "k 3"]
    """Mean of the cloud of the point's part in the point's frame [m]."""
    images: PointImages
    """Depth images of the group around each point."""

    @staticmethod
    def build(
        key: bytes, clouds: Float[np.ndarray, "p c 3"], rotation: Float[np.ndarray, "p 3 3"],
        translation: Float[np.ndarray, "p 3"], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"],
        axes: Float[np.ndarray, "k 3 3"], member: Int[np.ndarray, "k"],
    ) -> GroupGeometry:  # fmt: skip
        """Put a group together from its p parts.

        Args:
            key: hash of all that follows.
            clouds: cloud of each part in the part's frame [m].
            rotation: `group_from_part` of each part.
            translation: `group_from_part` of each part [m].
            position: position of each free point in the group's frame [m].
            frame: `group_from_point` of each free point.
            axes: axes that `w` names where the group waits with this point, as columns.
            member: part of each free point, as a number in 0..p.
        """
        placed = clouds @ rotation.transpose(0, 2, 1) + translation[:, None]
        cloud = placed.reshape(-1, 3)
        outlines = [_outermost(part) for part in placed]
        outline = np.concatenate(outlines)
        own: list[int] = member.tolist()
        return GroupGeometry(
            key,
            position,
            frame,
            axes,
            _patches(cloud, position, frame),
            _outermost(outline),
            _bounds([outlines[i] for i in own], position, frame),
            _bounds([outline] * len(position), position, frame),
            np.einsum("nji,nj->ni", frame, placed.mean(axis=1)[member] - position),
            PointImages.of_cloud(cloud, position, frame),
        )


def _outermost(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """The points that are farthest in any of many directions."""
    return points[np.unique(np.argmax(_DIRECTIONS @ points.T, axis=1))]


def _bounds(
    clouds: Sequence[Float[np.ndarray, "_ 3"]], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k 6"]:
    """Least and greatest coordinates of a cloud for each connection point, in the point's frame [m]."""
    out = np.zeros((len(position), 6))
    for row, cloud in enumerate(clouds):
        local = (cloud - position[row]) @ frame[row]
        out[row] = [*local.min(axis=0), *local.max(axis=0)]
    return out


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
