"""Data augmentation: furniture that is turned, mirrored or scaled is assembled in the same way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.datasets import LabeledState, SampleSet
from roboassembly.task.rules.connections import UP_AXES

_SAME_AXIS = 0.02
"""Largest part of one axis along another where a turn keeps both."""
_SCALES = (0.7, 1.4)
"""Range of random scales."""


@dataclass(frozen=True)
class FrameChange:
    """Change of the furniture's frame, to which all part frames are parallel: mirror, then turn, then scale."""

    quarter_turns: int = 0
    """Number of counter-clockwise turns by 90° about z; up stays up."""
    mirrored: bool = False
    """Whether x changes its sign first."""
    scale: float = 1.0

    @staticmethod
    def draw(rng: np.random.Generator) -> FrameChange:
        """Draw a change; scales are uniform in their logarithm."""
        smallest, largest = (float(x) for x in np.log(_SCALES))
        scale = float(np.exp(rng.uniform(smallest, largest)))
        return FrameChange(int(rng.integers(4)), bool(rng.integers(2)), scale)

    @property
    def mirror(self) -> Float[np.ndarray, "3 3"]:
        """Mirror of the world frame."""
        return np.diag([-1.0 if self.mirrored else 1.0, 1.0, 1.0])

    @property
    def side(self) -> Float[np.ndarray, "3 3"]:
        """Mirror of the frame of a connection point or a gripper, which stays right-handed."""
        return np.diag([1.0, -1.0 if self.mirrored else 1.0, 1.0])

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """`new_from_old` of directions in a part's frame; its determinant is -1 if mirrored."""
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns % 4]
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return turn @ self.mirror


AUGMENTATIONS = tuple(FrameChange(turns, mirrored) for mirrored in (False, True) for turns in range(4))
"""The eight changes that keep the size; the first changes nothing."""


def up_axis_permutation(change: FrameChange) -> Int[np.ndarray, "6"]:
    """Return the new `w` of each old `w`."""
    return np.argmax(UP_AXES @ change.matrix.T @ UP_AXES.T, axis=1)


def augmented(samples: SampleSet, change: FrameChange) -> SampleSet:
    """Return the same samples about the changed furniture."""
    clouds = (change.scale * samples.clouds @ change.matrix.T).astype(np.float32)
    grasps = samples.grasps
    if grasps is not None:
        # A gripper is its own mirror image.
        grasps = _poses(grasps, change.matrix, change.side, change.scale).astype(np.float32)
    return replace(
        samples, clouds=clouds, grasps=grasps, samples=tuple(_sample(sample, change) for sample in samples.samples)
    )


def stretched(
    points: Float[np.ndarray, "P K 9"],
    poses: Float[np.ndarray, "P 6"],
    connections: Float[np.ndarray, "P P 6"],
    group: Int[np.ndarray, "P"],
    factors: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "P K 9"], Float[np.ndarray, "P 6"], Float[np.ndarray, "P P 6"]]:
    """Return a state of furniture that is stretched along the axes of its frame.

    Args:
        points: connection points, as in the observation.
        poses: world pose of each part; groups keep the place of their first part.
        connections: relative poses of joined parts.
        group: first part of the group of each part, as from `group_labels`.
        factors: factor along each axis; equal for axes that `stretch_axes` does not tell apart.
    """
    position, normal, tangent = (points[..., i : i + 3] for i in (0, 3, 6))
    out_points = np.concatenate([position * factors, _unit(normal / factors), _unit(tangent * factors)], axis=-1)
    out_connections = np.concatenate([connections[..., :3] * factors, connections[..., 3:]], axis=-1)
    turns = rotations_from_euler(poses[group, 3:].astype(float))
    local = np.einsum("pji,pj->pi", turns, poses[:, :3] - poses[group, :3])
    moved = poses[group, :3] + np.einsum("pij,pj->pi", turns, local * factors)
    return out_points, np.concatenate([moved, poses[:, 3:]], axis=-1), out_connections


def stretch_axes(samples: SampleSet) -> Int[np.ndarray, "3"]:
    """Return for each axis of the furniture's frame the first axis that it must be stretched as much as.

    Part frames are parallel to the furniture's, but equal parts may be turned in their places, like the legs of a round
    stool. Axes that such a turn mixes belong together.
    """
    first = np.arange(3)
    for sample in samples.samples:
        joined = sample.connections[(sample.connections != 0).any(axis=-1)]
        mixed = (np.abs(rotations_from_euler(joined[:, 3:].astype(float))) > _SAME_AXIS).any(axis=0)
        for a, b in np.argwhere(np.triu(mixed, 1) | np.triu(mixed.T, 1)).tolist():
            first[first == first[b]] = first[a]
    return first


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Return vectors of length one; zeros stay zeros."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _sample(sample: LabeledState, change: FrameChange) -> LabeledState:
    m, scale = change.matrix, change.scale
    points = sample.points.reshape(*sample.points.shape[:2], 3, 3) @ m.T
    points[:, :, 0] *= scale
    order = up_axis_permutation(change)
    mates = sample.mates.copy()
    mates[:, 5 + order] = sample.mates[:, 5:]
    q_values = sample.q_values
    if q_values is not None:
        moved = q_values.copy()
        moved[..., order] = q_values
        q_values = moved
    return replace(
        sample,
        points=points.reshape(sample.points.shape).astype(np.float32),
        connections=_poses(sample.connections, m, m, scale),
        poses=_poses(sample.poses, change.mirror, m, scale),
        mates=mates,
        q_values=q_values,
    )


def _poses(
    poses: Float[np.ndarray, "*n 6"], left: Float[np.ndarray, "3 3"], right: Float[np.ndarray, "3 3"], scale: float
) -> Float[np.ndarray, "*n 6"]:
    """Change poses of frames changed by `right` in frames changed by `left`; rows of zeros, "none", stay zeros."""
    out = np.zeros_like(poses)
    some = (poses != 0).any(axis=-1)
    turns = left @ rotations_from_euler(poses[some][:, 3:].astype(float)) @ right.T
    out[some] = np.concatenate([scale * poses[some][:, :3] @ left.T, euler_from_rotations(turns)], axis=-1)
    return out
