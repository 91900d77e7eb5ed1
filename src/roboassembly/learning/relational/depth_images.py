"""Depth images around connection points, and the exits out of a mate that they show.

Whether a group can leave another one along a straight line shows in images of depth: seen along the way out, the moving
group leaves if nothing of the waiting group is in front of it. Each free point has images of its group along the three
axes of the point's frame, one fine and around the joint, one coarse and around all of a piece. Once two points mate,
their frames differ by a fixed turn, so the images of one need only be flipped to lie over those of the other.

All of this is an estimate from points on the surfaces: a pixel at the rim of a pocket shows both the rim and the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int16, Int64, UInt8
from scipy.ndimage import minimum_filter

EXIT_COUNTS = 22
"""Number of features of a mate."""
FINE_BLOCKED, FINE_SHARED, COARSE_BLOCKED, COARSE_SHARED = slice(0, 6), slice(6, 9), slice(13, 19), slice(19, 22)
"""Places of the counts of blocked pixels along the exits, and of those that may be blocked."""
MIRRORED_EXITS = np.array([0, 1, 3, 2, 4, 5, *range(6, 13), 13, 14, 16, 15, 17, 18, *range(19, 22)])
"""Place of each feature before a mirror that changes the sign of the frames' y axes."""
_UNIT = 1e-4
"""Unit of depths [m]."""
_EMPTY = np.iinfo(np.int16).max
_LARGEST = 3.0
"""Largest absolute depth [m]."""
_PLANE = 0.0006
"""Half the thickness of the plane of a joint [m]; what lies in it is in nobody's way along it."""
_TOUCHING = 0.0015
"""Largest distance of two surfaces that touch [m]."""
_OVERLAP = 0.003
"""Depth from which on two groups overlap [m]."""
_MOST_POINTS = 5_000
"""Largest number of points of a group in its coarse images."""


@dataclass(frozen=True)
class ImageScale:
    """Size of an image."""

    pixels: int
    """Number of pixels along each side."""
    step: float
    """Side of a pixel [m]."""
    tolerance: float
    """Depth by which a group may reach into another one without being blocked [m]."""

    @property
    def reach(self) -> float:
        """Half of the side of the image [m]."""
        return 0.5 * self.pixels * self.step


FINE, COARSE = ImageScale(16, 0.006, 0.0015), ImageScale(32, 0.025, 0.008)


@dataclass(frozen=True, eq=False)
class DepthImages:
    """Depths of one group seen from k points, along the axes x, y, z of each point's frame, in units of 0.1 mm.

    The image along x lies over y and z, that along y over x and z, that along z over x and y. Pixels without a surface
    have a least depth of 32767 and a greatest of -32768.
    """

    scale: ImageScale
    """Size of the images."""
    least: Int16[np.ndarray, "k 3 s s"]
    """Least depth in each pixel."""
    greatest: Int16[np.ndarray, "k 3 s s"]
    """Greatest depth in each pixel."""
    beyond: Int16[np.ndarray, "k s s"]
    """Greatest depth along z of what lies beyond the plane of the joint."""
    core: Int16[np.ndarray, "k s s"]
    """Least of `greatest` along z in each pixel and those around it: a pixel at the rim of a pocket shows its floor."""

    @cached_property
    def from_mate(self) -> SideImages:
        """Images as the frame of a mate sees them from the other side: y and z are opposite."""
        least, greatest = np.empty_like(self.least), np.empty_like(self.greatest)
        least[:, 0], greatest[:, 0] = self.least[:, 0, ::-1, ::-1], self.greatest[:, 0, ::-1, ::-1]
        for axis, flip in ((1, np.s_[:, :, ::-1]), (2, np.s_[:, :, ::-1])):
            # -32768 has no opposite; ~x = -x - 1 swaps the two marks of empty pixels, and is off by 0.1 mm.
            least[:, axis] = ~self.greatest[:, axis][flip]
            greatest[:, axis] = ~self.least[:, axis][flip]
        before = least.copy()
        before[:, 2] = ~self.core[:, :, ::-1]
        return SideImages.flat(least, greatest, before, greatest)

    @cached_property
    def waiting(self) -> SideImages:
        """Images as the points themselves see them, with the tolerance of the scale."""
        tolerance = np.int16(self.scale.tolerance / _UNIT)
        before = self.greatest.copy()
        before[:, 2] = self.beyond
        before = np.where(before > -_EMPTY - 1, before - tolerance, before)
        after = np.where(self.least < _EMPTY, self.least + tolerance, self.least)
        return SideImages.flat(self.least, self.greatest, before, after)


@dataclass(frozen=True, eq=False)
class _SeenCloud:
    """Points of a group's surface in the frames of k points, and the pixels that they are in."""

    scale: ImageScale
    local: Float[np.ndarray, "k c 3"]
    """Positions in the frame of each point [m]."""
    pixel: Int64[np.ndarray, "k c 3"]
    """Number of the pixel along each axis."""
    depth: Int16[np.ndarray, "k c 3"]
    """Depth along each axis [0.1 mm]."""
    around: Bool[np.ndarray, "k c 1"]
    """Whether fine images show it."""

    @staticmethod
    def of(
        scale: ImageScale,
        cloud: Float[np.ndarray, "c 3"],
        position: Float[np.ndarray, "k 3"],
        frame: Float[np.ndarray, "k 3 3"],
    ) -> _SeenCloud:
        """Place the points.

        Args:
            scale: size of the images.
            cloud: points of the group's surface [m].
            position: position of each point [m].
            frame: `group_from_point` of each point.
        """
        local = (cloud[None] - position[:, None]) @ frame
        pixel = np.floor(local / scale.step).astype(np.int64) + scale.pixels // 2
        depth = np.clip(np.rint(local / _UNIT), -_LARGEST / _UNIT, _LARGEST / _UNIT).astype(np.int16)
        around = np.all(np.abs(local) < FINE.reach, axis=2, keepdims=True)
        return _SeenCloud(scale, local, pixel, depth, around)

    def images(self, counted: Bool[np.ndarray, "k c 1"] | None = None) -> DepthImages:
        """Take the images; of some of the points if it is given which."""
        k, s = len(self.local), self.scale.pixels
        pixel, depth, z = self.pixel, self.depth, self.local[..., 2]
        inside = (pixel >= 0) & (pixel < s)
        if counted is not None:
            inside &= counted
        off_plane = np.abs(z) > _PLANE
        least, greatest = np.full((3, k * s * s), _EMPTY, np.int16), np.full((3, k * s * s), -_EMPTY - 1, np.int16)
        base = np.arange(k)[:, None] * s * s
        for axis, (row, column) in enumerate(((1, 2), (0, 2), (0, 1))):
            seen = inside[..., row] & inside[..., column]
            if axis < 2:
                seen &= off_plane
            at = (base + pixel[..., row] * s + pixel[..., column])[seen]
            values = depth[..., axis][seen]
            np.minimum.at(least[axis], at, values)
            np.maximum.at(greatest[axis], at, values)
        seen = inside[..., 0] & inside[..., 1]
        if self.scale is FINE:
            seen &= z > _PLANE
        beyond = np.full(k * s * s, -_EMPTY - 1, np.int16)
        np.maximum.at(beyond, (base + pixel[..., 0] * s + pixel[..., 1])[seen], depth[..., 2][seen])
        shape = (3, k, s, s)
        core = minimum_filter(greatest[2].reshape(k, s, s), (1, 3, 3)) if k else np.zeros((0, s, s), np.int16)
        images = (least.reshape(shape).swapaxes(0, 1), greatest.reshape(shape).swapaxes(0, 1))
        return DepthImages(self.scale, *images, beyond.reshape(k, s, s), core)


@dataclass(frozen=True, eq=False)
class SideImages:
    """Depths of one of two mated groups along the axes of the waiting point."""

    least: Int16[np.ndarray, "k 3 p"]
    greatest: Int16[np.ndarray, "k 3 p"]
    before: Int16[np.ndarray, "k 3 p"]
    """Depth that decides whether the waiting group is in front: the greatest of that group, the least of the other."""
    after: Int16[np.ndarray, "k 3 p"]
    """The same for the opposite direction: the least of the waiting group, the greatest of the other."""

    @staticmethod
    def flat(*images: Int16[np.ndarray, "k 3 s s"]) -> SideImages:
        """Return images with all pixels in one row."""
        return SideImages(*(image.reshape(len(image), 3, -1) for image in images))


@dataclass(frozen=True, eq=False)
class PointImages:
    """Fine and coarse images of one group."""

    fine: DepthImages
    coarse: DepthImages
    """Coarse images of all of the group."""
    far: DepthImages
    """Coarse images of what the fine ones do not show."""

    @staticmethod
    def of_cloud(
        cloud: Float[np.ndarray, "c 3"], position: Float[np.ndarray, "k 3"], frame: Float[np.ndarray, "k 3 3"]
    ) -> PointImages:
        """Take the images of a group.

        Args:
            cloud: points of the group's surface [m].
            position: position of each point [m].
            frame: `group_from_point` of each point.
        """
        thinned = cloud[:: -(-len(cloud) // _MOST_POINTS)]
        # Joints are looked at closely, so all points near any of them count.
        near = np.zeros(len(cloud), bool)
        for point in position:
            near |= (np.abs(cloud - point) < 1.75 * FINE.reach).all(axis=1)
        fine = _SeenCloud.of(FINE, cloud[near], position, frame)
        coarse = _SeenCloud.of(COARSE, thinned, position, frame)
        return PointImages(fine.images(fine.around), coarse.images(), coarse.images(~coarse.around))


def exit_counts(moving: PointImages, waiting: PointImages) -> UInt8[np.ndarray, "k l 22"]:
    """Return what the images show of each of k points of a moving group mated with each of l of a waiting group.

    Directions are the axes of the waiting point's frame: x, -x, y, -y, z, -z; z leads out of the joint. A pixel of the
    images along x and y is engaged where one group reaches through the plane of the joint; along z, where both are.

    | index | count of pixels, at most 255 |
    |---|---|
    | 0–5 | fine, in which the waiting group is in front of the moving one, for each direction |
    | 6–8 | fine, engaged, along x, y, z |
    | 9–11 | fine, in which the groups overlap by more than 3 mm, along x, y, z |
    | 12 | fine, in which their surfaces touch along z |
    | 13–18 | coarse, in which the waiting group is in front of the moving one, for each direction |
    | 19–21 | coarse, with both groups, along x, y, z |

    Coarse images leave out what happens between two surfaces around the joint: a coarse pixel at the rim of a pocket
    would always be blocked.

    Args:
        moving: images of the moving group.
        waiting: images of the waiting group.
    """
    out = np.zeros((len(moving.fine.least), len(waiting.fine.least), EXIT_COUNTS), np.uint8)
    mated, still = moving.fine.from_mate, waiting.fine.waiting
    rows = np.arange(FINE.pixels**2) % FINE.pixels >= FINE.pixels // 2
    moves, waits = _there(mated, still)
    engaged = np.where(rows, waits, moves)
    engaged[:, :, 2] = (moves & waits)[:, :, 2]
    overlap = np.minimum(mated.greatest[:, None], still.greatest).astype(np.int32)
    overlap -= np.maximum(mated.least[:, None], still.least)
    gap = np.abs(mated.least[:, None, 2].astype(np.int32) - still.greatest[:, 2])
    out[..., :6] = _counts(_blocked(mated, still)).reshape(*out.shape[:2], 6)
    out[..., 6:9] = _counts(engaged)
    out[..., 9:12] = _counts(overlap > _OVERLAP / _UNIT)
    out[..., 12] = _counts(gap <= _TOUCHING / _UNIT)
    coarse = [(u.from_mate, v.waiting) for u, v in ((moving.coarse, waiting.far), (moving.far, waiting.coarse))]
    first, second = (_blocked(*images) for images in coarse)
    out[..., 13:19] = _counts(first | second).reshape(*out.shape[:2], 6)
    shared = [np.logical_and(*_there(*images)) for images in coarse]
    out[..., 19:22] = _counts(shared[0] | shared[1])
    return out


def _counts(pixels: Bool[np.ndarray, "*n p"]) -> UInt8[np.ndarray, "*n"]:
    """Numbers of pixels, at most 255."""
    return np.minimum(pixels.sum(axis=-1), 255).astype(np.uint8)


def _blocked(moving: SideImages, waiting: SideImages) -> Bool[np.ndarray, "k l 3 2 p"]:
    """Return in which pixels the waiting group is in front of the moving one, along each axis and against it."""
    ahead = waiting.before[None] > moving.before[:, None]
    behind = waiting.after[None] < moving.after[:, None]
    return np.stack([ahead, behind], axis=3)


def _there(moving: SideImages, waiting: SideImages) -> tuple[Bool[np.ndarray, "k 1 3 p"], Bool[np.ndarray, "1 l 3 p"]]:
    """Return in which pixels each of the two groups has a surface."""
    return moving.least[:, None] < _EMPTY, waiting.least[None] < _EMPTY
