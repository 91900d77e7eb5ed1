"""Samples as an episode with own part frames shows them: principal axes, other clouds, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.datasets import LabeledState, SampleSet


def in_own_frames(
    samples: SampleSet, rng: np.random.Generator, noise: float = 0.0, imprecision: float = 0.0
) -> SampleSet:
    """Return samples with parts described along their principal axes, by clouds with points of their own.

    The network does not depend on which of a box's 24 rotations turns these axes, so none is drawn.

    Args:
        samples: samples in aligned frames, with `principal`, `resampled` and `own_w`.
        rng: draws noise.
        noise: standard deviation of each coordinate of the clouds [m].
        imprecision: standard deviation of each coordinate of the connection points [m].
    """
    assert samples.principal is not None
    assert samples.resampled is not None
    turns = samples.principal.astype(float)
    clouds = samples.resampled.astype(float)
    clouds = (clouds + rng.normal(0.0, noise, clouds.shape)) @ turns
    points = samples.samples[0].points.shape[:2] if samples.samples else (0, 0)
    offset = rng.normal(0.0, imprecision, (*points, 3))
    return replace(
        samples,
        clouds=clouds.astype(np.float32),
        samples=tuple(_sample(sample, turns, offset) for sample in samples.samples),
        frames="own",
    )


def _sample(
    sample: LabeledState, turns: Float[np.ndarray, "P 3 3"], offset: Float[np.ndarray, "P K 3"]
) -> LabeledState:
    assert sample.own_w is not None
    p, k, _ = sample.points.shape
    points = sample.points.reshape(p, k, 3, 3).astype(float)
    points = np.einsum("pji,pkaj->pkai", turns, points)
    points[:, :, 0] += offset * points[:, :, 1].any(axis=-1, keepdims=True)
    back = turns.transpose(0, 2, 1)
    return replace(
        sample,
        points=points.reshape(p, k, 9).astype(np.float32),
        connections=_described(sample.connections, back[:, None], turns[None]).astype(np.float32),
        mates=np.concatenate([sample.mates[:, :5], sample.own_w.astype(sample.mates.dtype)], axis=1),
    )


def _described(
    poses: Float[np.ndarray, "*n 6"], left: Float[np.ndarray, "*n 3 3"], right: Float[np.ndarray, "*n 3 3"]
) -> Float[np.ndarray, "*n 6"]:
    """Poses between frames that are turned; rows of zeros, "none", stay zeros.

    Args:
        poses: translations [m] and Euler angles.
        left: rotation that comes before each pose.
        right: rotation that comes after it.
    """
    turn = left @ rotations_from_euler(poses[..., 3:].reshape(-1, 3).astype(float)).reshape(*poses.shape[:-1], 3, 3)
    turn = turn @ right
    moved = (left @ poses[..., :3, None].astype(float))[..., 0]
    angles = euler_from_rotations(turn.reshape(-1, 3, 3)).reshape(moved.shape)
    return np.where((poses != 0).any(axis=-1, keepdims=True), np.concatenate([moved, angles], axis=-1), 0.0)
