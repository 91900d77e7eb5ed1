"""The relational policy's input: free connection points as tokens, and how any two of them would mate.

Everything follows from the observation (clouds, points, connections) and the mask of the actions that exist, nothing
from the furniture itself. World poses do not matter to what fits what and are left out, so the policy is exactly
invariant to where the parts lie and how they are numbered.

An aligned part's frame is parallel to the furniture's, as in the paper (equal parts share the frame of the first of
them); this shows a policy which way the furniture stands. All that says so stands apart from the other features, and is
0 where parts are described in frames of their own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Float32, Int, Int8, UInt8

from roboassembly.geometry.mating import mating_rotations, point_frames
from roboassembly.learning.datasets import LabeledState, SampleSet
from roboassembly.learning.relational.cycles import closed_3_cycles, closed_4_cycles
from roboassembly.learning.relational.depth_images import EXIT_COUNTS
from roboassembly.learning.relational.features import ALIGNED, frames_parallel, plausible_pairs
from roboassembly.learning.relational.group_geometry import (
    PATCH_SIZE,
    GroupFrames,
    GroupGeometry,
    PartShapes,
)
from roboassembly.learning.relational.joint_fit import FIT_FEATURES, PartJoints, exchanged, joint_fit
from roboassembly.learning.relational.mesh_tests import GroupMeshes, PartMeshes
from roboassembly.learning.relational.pair_geometry import PairGeometry
from roboassembly.learning.relational.policy_view import PolicyView

POINT_FEATURES = 37
"""Number of features of a point."""
_OF_PAIRS = ("matches", "bounds", "exits", "fit", "cycles_3", "cycles_4")
"""Token arrays over pairs of tokens."""
_PADDED = ("patch", "features", "frame", "position", "axes", "extent", *_OF_PAIRS)
"""Token arrays of a batch."""
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Tokens:
    """The n free connection points of a state.

    In arrays over pairs, the group of the row's point moves and the group of the column's point waits.

    | index of `features` | feature | unit |
    |---|---|---|
    | 0 | number of parts in the group | 5 parts |
    | 1 | number of free points of the group | 10 points |
    | 2–4 | middle of the part's cloud in the point's frame | 0.5 m |
    | 5–7, 8–10 | lower and upper bounds of the part in the point's frame | 0.5 m |
    | 11–13, 14–16 | lower and upper bounds of the group in the point's frame | 0.5 m |
    | 17 | number of parts with this shape | 4 parts |
    | 18 | 1 if no other part has this shape | |
    | 19 | number of free points of the part | 5 points |
    | 20 | 1 if part frames are aligned; else all below are 0 | |
    | 21–23 | position of the part's origin in the point's frame | 0.5 m |
    | 24–26 | extent of the part along its axes | 0.5 m |
    | 27–29 | position of the point in the part's frame | 0.5 m |
    | 30–32, 33–35 | normal and tangent in the part's frame | |
    | 36 | 1 if the group's frame is surely parallel to the furniture's | |
    """

    part: Int[np.ndarray, "n"]
    """Part of each point."""
    point: Int[np.ndarray, "n"]
    """Number of the point in its part."""
    group: Int[np.ndarray, "n"]
    """Group of each point: 0, 1, ... in the order of the groups' first parts."""
    patch: UInt8[np.ndarray, "n 375"]
    """Distances from the `PATCH_GRID` points around each point to the surface of its group, in units of 1.5 steps,
    times 255; 125 of each grid."""
    features: Float32[np.ndarray, "n 37"]
    """Features of the table."""
    frame: Float32[np.ndarray, "n 3 3"]
    """`group_from_point`; a group's frame is that of its most distinctive part (`GroupFrames`)."""
    position: Float32[np.ndarray, "n 3"]
    """Position in the group's frame [m]."""
    axes: Float32[np.ndarray, "n 3 3"]
    """Axes that `w` names where the point's part waits, as columns, in the group's frame: those of this frame if part
    frames are aligned, else those of the part."""
    extent: Float32[np.ndarray, "n 3"]
    """Extent of the point's group along these axes [m]."""
    matches: UInt8[np.ndarray, "n n 4"]
    """Number of other free points of the moving group that, once the pair is mated, mate as well, mate with equal
    tangents, miss a mate by at most 12 mm, and come within 40 mm of another point."""
    bounds: Float32[np.ndarray, "n n 6"]
    """Lower bounds of the mated moving group less those of the waiting group, along the `axes` of the waiting point,
    and the same of the upper bounds [m]."""
    exits: UInt8[np.ndarray, "n n 22"]
    """Counts of pixels in depth images that show the exits of the mate (`depth_images.exit_counts`)."""
    fit: Int8[np.ndarray, "n n 23"]
    """Codes of how the joints of the two parts fit each other (`joint_fit.joint_fit`)."""
    cycles_3: UInt8[np.ndarray, "n n"]
    """Number of groups that close a 3-cycle with the pair."""
    cycles_4: UInt8[np.ndarray, "n n"]
    """Number of groups that close a 4-cycle with the pair."""
    types: tuple[int, ...] = ()
    """Number of the first group that is alike, for each group. Training does without."""


class TokenCache:
    """Geometry of groups and of pairs of groups: most of it stays the same from one state to the next.

    Args:
        max_entries: number of entries at which all are dropped.
    """

    def __init__(self, max_entries: int = 4096) -> None:
        self._max_entries = max_entries
        self._entries: dict[bytes, Any] = {}

    def get(self, key: bytes, compute: Callable[[], T]) -> T:
        """Return the entry of a key, computed if it is not there."""
        if key not in self._entries:
            if len(self._entries) >= self._max_entries:
                self._entries.clear()
            self._entries[key] = compute()
        return self._entries[key]


@dataclass(frozen=True, eq=False)
class GroupedPoints:
    """The n free points of a state in the frames of their groups; for the arrays see `Tokens`."""

    part: Int[np.ndarray, "n"]
    point: Int[np.ndarray, "n"]
    points: Float[np.ndarray, "n 9"]
    """Position, normal and tangent in the part's frame."""
    group: Int[np.ndarray, "n"]
    rows: list[Int[np.ndarray, "_"]]
    """Points of each group, as numbers in 0..n."""
    members: list[Int[np.ndarray, "_"]]
    """Parts of each group."""
    keys: list[bytes]
    """Hash of each group's parts and points."""
    shapes: PartShapes
    frames: GroupFrames
    frame: Float[np.ndarray, "n 3 3"]
    position: Float[np.ndarray, "n 3"]
    axes: Float[np.ndarray, "n 3 3"]
    arrays: list[list[Any]]
    """Arrays of each group that `GroupGeometry.build` takes after the clouds."""

    @staticmethod
    def of_view(view: PolicyView, cache: TokenCache) -> GroupedPoints:
        """Return the free points of a state; arguments as of `tokens_of`."""
        part, point = np.nonzero(view.free)
        points = view.points[part, point]
        shapes, frames = _shapes_and_frames(view, cache)
        aligned = view.frames == "aligned"
        frame = frames.rotation[part] @ point_frames(points)
        position = np.einsum("nij,nj->ni", frames.rotation[part], points[:, :3]) + frames.translation[part]
        axes = np.tile(np.eye(3), (len(part), 1, 1)) if aligned else frames.rotation[part]
        labels, group = np.unique(view.group[part], return_inverse=True)
        rows = [np.flatnonzero(group == index) for index in range(len(labels))]
        members = [np.flatnonzero(view.group == label) for label in labels]
        keys: list[bytes] = []
        arrays: list[list[Any]] = []
        for m, tokens in zip(members, rows, strict=True):
            own = [frames.rotation[m], frames.translation[m], position[tokens], frame[tokens], axes[tokens]]
            own.append(np.searchsorted(m, part[tokens]))
            arrays.append(own)
            hashed = b"".join([*(shapes.digests[int(i)] for i in m), *(a.tobytes() for a in own)])
            keys.append(hashlib.blake2b(hashed).digest())
        return GroupedPoints(
            part, point, points, group, rows, members, keys, shapes, frames, frame, position, axes, arrays
        )

    @property
    def group_types(self) -> list[int]:
        """Type of each group: number of the first group with the same key."""
        return [self.keys.index(key) for key in self.keys]

    @property
    def alike(self) -> tuple[int, ...]:
        """Number of the first group that is alike: with the same key or, if it is one part, of one shape."""
        keys: list[object] = list(self.keys)
        for index, (members, rows) in enumerate(zip(self.members, self.rows, strict=True)):
            if len(members) == 1:
                keys[index] = int(self.shapes.shape[members[0]]), self.point[rows].tobytes()
        return tuple(keys.index(key) for key in keys)

    def geometry(self, view: PolicyView, cache: TokenCache) -> list[GroupGeometry]:
        """Return the geometry of each group."""
        return [
            cache.get(key, partial(GroupGeometry.build, key, view.clouds[members], *arrays))
            for key, members, arrays in zip(self.keys, self.members, self.arrays, strict=True)
        ]


def _shapes_and_frames(view: PolicyView, cache: TokenCache) -> tuple[PartShapes, GroupFrames]:
    """Return the shapes of the parts of a state and the frames of its groups."""
    shapes = cache.get(
        b"".join([*view.digests, view.points.tobytes()]),
        partial(PartShapes.of_clouds, view.clouds, view.digests, view.points),
    )
    aligned = view.frames == "aligned"
    return shapes, GroupFrames.of_groups(shapes, view.connections, view.group, aligned=aligned)


def group_meshes_of(view: PolicyView, meshes: PartMeshes, cache: TokenCache) -> GroupMeshes:
    """Return the meshes of the groups of a state, numbered as in its tokens.

    Args:
        view: the state.
        meshes: meshes of its parts.
        cache: geometry of earlier states of the same furniture.
    """
    _, frames = _shapes_and_frames(view, cache)
    labels = np.unique(view.group[np.nonzero(view.free)[0]])
    members = [tuple(np.flatnonzero(view.group == label).tolist()) for label in labels]
    return GroupMeshes(meshes, members, frames.rotation, frames.translation)


def tokens_of_sample(samples: SampleSet, sample: LabeledState, cache: TokenCache | None = None) -> Tokens:
    """Return the tokens of a training sample, one of `samples`."""
    return tokens_of(PolicyView.from_sample(samples, sample), cache)


def tokens_of(view: PolicyView, cache: TokenCache | None = None) -> Tokens:
    """Return the tokens of a state.

    Args:
        view: the state.
        cache: geometry of earlier states of the same furniture.
    """
    cache = cache or TokenCache()
    p = GroupedPoints.of_view(view, cache)
    part, group, rows, frame, position, frames = p.part, p.group, p.rows, p.frame, p.position, p.frames
    geometry = p.geometry(view, cache)
    patch, extent = np.zeros((len(part), PATCH_SIZE), np.uint8), np.zeros((len(part), 3), np.float32)
    around = np.zeros((len(part), 15))
    for g, tokens in zip(geometry, rows, strict=True):
        patch[tokens], extent[tokens] = g.patch, np.ptp(g.outline @ g.axes, axis=1)
        around[tokens] = np.concatenate([g.part_center, g.part_bounds, g.group_bounds], axis=1)
    matches, bounds, exits = _pair_arrays(geometry, rows, cache)
    different = group[:, None] != group
    plausible = different
    if view.frames == "aligned":
        plausible = plausible_pairs(frames_parallel(mating_rotations(frame, frame)), frames.upright[part], different)
    of_groups = (rows, position, frame, plausible, p.group_types)
    cycles_3 = np.minimum(closed_3_cycles(*of_groups), 255).astype(np.uint8)
    cycles_4 = np.minimum(closed_4_cycles(*of_groups), 255).astype(np.uint8)
    return Tokens(
        part, p.point, group, patch, _point_features(view, p, around), frame.astype(np.float32),
        position.astype(np.float32), p.axes.astype(np.float32), extent, matches, bounds, exits,
        _fit_array(view, p, cache), cycles_3, cycles_4, p.alike,
    )  # fmt: skip


def _point_features(
    view: PolicyView, p: GroupedPoints, around: Float[np.ndarray, "n 15"]
) -> Float32[np.ndarray, "n 37"]:
    """Features of `Tokens.features`.

    Args:
        view: the state.
        p: its free points.
        around: middle and bounds of part and group in the frame of each point [m].
    """
    out = np.zeros((len(p.part), POINT_FEATURES), np.float32)
    parts_of_group = np.bincount(view.group, minlength=len(view.group))
    out[:, 0] = parts_of_group[view.group[p.part]] / 5.0
    out[:, 1] = np.bincount(p.group, minlength=1)[p.group] / 10.0
    out[:, 2:17] = 2.0 * around
    out[:, 17], out[:, 18] = p.shapes.copies[p.part] / 4.0, p.shapes.copies[p.part] == 1
    out[:, 19] = np.bincount(p.part, minlength=len(view.clouds))[p.part] / 5.0
    if view.frames == "aligned":
        out[:, ALIGNED] = 1.0
        out[:, 21:24] = -2.0 * np.einsum("nji,nj->ni", point_frames(p.points), p.points[:, :3])
        out[:, 24:27] = 2.0 * p.shapes.sides[p.part]
        out[:, 27:30] = 2.0 * p.points[:, :3]
        out[:, 30:36] = p.points[:, 3:]
        out[:, 36] = p.frames.upright[p.part]
    return out


def _pair_arrays(
    geometry: Sequence[GroupGeometry], rows: Sequence[Int[np.ndarray, "_"]], cache: TokenCache
) -> tuple[UInt8[np.ndarray, "n n 4"], Float32[np.ndarray, "n n 6"], UInt8[np.ndarray, "n n 22"]]:
    """`Tokens.matches`, `Tokens.bounds` and `Tokens.exits`."""
    n = sum(map(len, rows))
    matches, bounds = np.zeros((n, n, 4), np.uint8), np.zeros((n, n, 6), np.float32)
    exits = np.zeros((n, n, EXIT_COUNTS), np.uint8)
    blocks, place = _blocks(rows)
    for (first, here), (second, there) in combinations(zip(geometry, blocks, strict=True), 2):
        # In an order that does not depend on the state.
        (a, at), (b, on) = sorted([(first, here), (second, there)], key=lambda group: group[0].key)
        a_moves, b_moves = cache.get(a.key + b.key, partial(PairGeometry.both_ways, a, b))
        matches[at, on], bounds[at, on], exits[at, on] = a_moves.matches, a_moves.bounds, a_moves.exits
        matches[on, at], bounds[on, at], exits[on, at] = b_moves.matches, b_moves.bounds, b_moves.exits
    return matches[place][:, place], bounds[place][:, place], exits[place][:, place]


def _fit_array(view: PolicyView, p: GroupedPoints, cache: TokenCache) -> Int8[np.ndarray, "n n 23"]:
    """`Tokens.fit`; 0 within a group."""
    out = np.zeros((len(p.part), len(p.part), FIT_FEATURES), np.int8)
    joints: list[tuple[bytes, PartJoints, slice, np.ndarray, int]] = []
    names: list[int] = np.unique(p.part).tolist()
    rows = [np.flatnonzero(p.part == part) for part in names]
    blocks, place = _blocks(rows)
    for part, block, points in zip(names, blocks, rows, strict=True):
        key = view.digests[part] + view.points[part].tobytes() + b"joints"
        measured = cache.get(key, partial(_measured_joints, view, part))
        joints.append((key, measured, block, p.point[points], int(p.group[points[0]])))
    for (key, a, here, k, group), (other_key, b, there, l, other_group) in combinations(joints, 2):  # noqa: E741
        if group != other_group:
            moving, waiting = cache.get(key + other_key, partial(_both_fits, a, b))
            out[here, there], out[there, here] = moving[k][:, l], waiting[l][:, k]
    return out[place][:, place]


def _blocks(rows: Sequence[Int[np.ndarray, "_"]]) -> tuple[list[slice], Int[np.ndarray, "n"]]:
    """Return slices for blocks of rows one after another, and the index that puts the rows in their own order.

    Slices are quicker than lists of numbers.
    """
    ends = np.cumsum([len(block) for block in rows]).tolist()
    blocks = [slice(end - len(block), end) for end, block in zip(ends, rows, strict=True)]
    return blocks, np.argsort(np.concatenate([np.zeros(0, int), *rows]))


def _measured_joints(view: PolicyView, part: int) -> PartJoints:
    """Measure the joints of a part."""
    points = view.points[part]
    points = points[points.any(axis=1)]
    return PartJoints.of_part(view.clouds[part], points[:, :3], point_frames(points))


def _both_fits(a: PartJoints, b: PartJoints) -> tuple[Int8[np.ndarray, "k l 23"], Int8[np.ndarray, "l k 23"]]:
    """`joint_fit` where a moves, and where b does."""
    fit = joint_fit(a, b)
    return fit, exchanged(fit)


def pad(states: Sequence[Tokens], length: int) -> dict[str, np.ndarray]:
    """Return a batch of states, padded to `length` tokens each: token arrays by name.

    `group` is -1 at padding, everything else 0.
    """
    batch = {"group": np.full((len(states), length), -1, np.int32)}
    for name in _PADDED:
        like, axes = getattr(states[0], name), 2 if name in _OF_PAIRS else 1
        batch[name] = np.zeros((len(states), *[length] * axes, *like.shape[axes:]), like.dtype)
    for row, state in enumerate(states):
        n = len(state.group)
        batch["group"][row, :n] = state.group
        for name in _PADDED:
            batch[name][(row, *[slice(n)] * (2 if name in _OF_PAIRS else 1))] = getattr(state, name)
    return batch
