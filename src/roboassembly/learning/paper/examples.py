"""Training examples of the paper's policy: states with the Q-values to imitate, and their augmentation.

The label of a state is an expert's Q-values if it has some, else the oracle's answers, which give the best
undiscounted return-to-go exactly. Both are returns: 1 for each merge, 4 more for the whole.

Many actions of a state are equally good. The one to imitate is the first of them, in the order of parts, points and
choices, as for experts (`dqn.network.first_best`). A policy that may take any of them meets groups that no sample has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, Int, Int16
from scipy.spatial.transform import Rotation

from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.augmentation import FrameChange, augmented, stretch_axes, stretched
from roboassembly.learning.datasets import LabeledState, SampleSet, group_labels
from roboassembly.learning.layers import Params
from roboassembly.learning.missing_parts import reduced, without_some
from roboassembly.learning.paper import autoencoder, heads
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.dqn.network import TIE, first_best
from roboassembly.learning.paper.network import PaperConfig, PaperState
from roboassembly.settings import SETTINGS
from roboassembly.task.rules.connections import UP_AXES
from roboassembly.task.setting import SettingName

COMPLETION_REWARD = 4.0
"""Reward for the whole furniture, in addition to 1 for the last merge."""
_ENCODED = 32
"""Clouds that are encoded at a time."""


@dataclass(frozen=True)
class Augmentation:
    """Copies that are made of each sample set before training."""

    copies: int = 16
    """Noisy and stretched clouds of each part, in addition to the clean one."""
    noise: float = 0.003
    """Standard deviation of the noise along each axis [m]."""
    stretch: float = 0.15
    """Largest change of the furniture's size along each axis in a copy, as a logarithm (not in the paper, whose copies
    of chairs differ in size as well)."""
    changes: int = 0
    """Versions of each chair in addition to itself: mirrored, turned, scaled (not in the paper)."""
    reductions: int = 3
    """Copies of each state, without some parts of the chair (not in the paper; see `missing_parts`)."""
    seed: int = 0
    """Random seed."""


@dataclass(frozen=True, eq=False)
class PaperExample:
    """A state ready for the network, small enough to keep a hundred thousand."""

    features: Float32[np.ndarray, "c P 48"]
    """Features of the parts' clouds: clean, then noisy and stretched copies. Shared by the states of a chair."""
    stretches: Float32[np.ndarray, "c 3"]
    """Factors by which each copy is stretched along the axes of the furniture's frame."""
    points: Float16[np.ndarray, "P K 9"]
    free: Bool[np.ndarray, "P K"]
    poses: Float16[np.ndarray, "P 6"]
    connections: Float16[np.ndarray, "P P 6"]
    part: Int16[np.ndarray, "n"]
    """Part of each free point."""
    point: Int16[np.ndarray, "n"]
    """Number of each free point in its part."""
    group: Int16[np.ndarray, "n"]
    """Group of each free point."""
    mates: Int16[np.ndarray, "j 2"]
    """Rows and columns of the pairs that fit."""
    returns: Float32[np.ndarray, "j 6"]
    """Exact Q-values of the pairs that fit; those of all others are 0."""
    q_values: Float16[np.ndarray, "n n h"] | None
    """Expert's Q-values as in `LabeledState`; imitated in place of `returns` if there are any."""
    grasps: Float32[np.ndarray, "P 8 6"] | None
    """Gripper pose of each grasp; None in the object-centric setting."""
    tie: float
    """Difference of Q-values below which two actions are equally good."""

    def state(self, copy: int) -> PaperState:
        """Return the state in one of its copies."""
        free = self.free[..., None].astype(np.float32)
        factors, grasps = self.stretches[copy], self.grasps
        if grasps is not None:
            grasps = np.concatenate([grasps[..., :3] * factors, grasps[..., 3:]], axis=-1)
        points, poses, connections = stretched(
            self.points.astype(np.float32), self.poses.astype(np.float32), self.connections.astype(np.float32),
            self.group_of_part, factors,
        )  # fmt: skip
        return PaperState(self.features[copy], points, free, poses, connections, grasps)

    def branch_targets(self) -> Float[np.ndarray, "n n h"]:
        """Return what each branch adds to the Q-values to imitate, one branch after another."""
        return self.exact() if self.q_values is None else self.q_values

    @cached_property
    def group_of_part(self) -> Int[np.ndarray, "P"]:
        """First part of the group of each part."""
        return group_labels(self.connections)

    @cached_property
    def max_return(self) -> float:
        """Bound of the targets: the largest return that is left, which experts overestimate."""
        if self.q_values is None:
            return np.inf
        return len(np.unique(self.group_of_part)) - 1 + COMPLETION_REWARD

    @cached_property
    def best(self) -> tuple[int, int, int]:
        """Row, column and choice of the action to imitate; -1 each if none leads to the whole furniture."""
        # Without the bound of the targets, which would make all values above it equal.
        values = self._values()
        # An expert's samples all lead to the whole; its values are estimates, and may say less.
        if not values.size or (self.q_values is None and values.max() < COMPLETION_REWARD):
            return -1, -1, -1
        return first_best(values, self.tie)

    @cached_property
    def highest(self) -> float:
        """Highest value of an action that exists."""
        return float(self._values().max(initial=-np.inf))

    def _values(self) -> Float32[np.ndarray, "n n w"]:
        """Return the Q-values to imitate, without their bound; -inf where the action does not exist."""
        branches = PaperConfig(full=self.grasps is not None).branches
        values = heads.combined(heads.split(self.branch_targets().astype(np.float32), branches))
        values[self.group[:, None] == self.group[None]] = -np.inf
        return values

    def exact(self) -> Float32[np.ndarray, "n n 6"]:
        """Return the exact Q-values."""
        n = len(self.part)
        out = np.zeros((n, n, len(UP_AXES)), np.float32)
        out[self.mates[:, 0], self.mates[:, 1]] = self.returns
        return out


def exact_returns(sample: LabeledState) -> Float32[np.ndarray, "j 6"]:
    """Return the exact Q of the pairs in `sample.mates`: the best undiscounted return from the action on.

    If the furniture can be finished after the action, that is 1 for this and each later merge, and 4. A merge into a
    dead end counts 1, a lower bound, because the oracle does not say what else could be joined. An action that cannot
    be carried out has 0, and so has every pair that does not fit.
    """
    merges = len(np.unique(sample.group)) - 1
    solvable, works = sample.mates[:, 4:5], sample.mates[:, 5:]
    return (works * np.where(solvable, merges + COMPLETION_REWARD, 1.0)).astype(np.float32)


def examples_of(sets: Sequence[SampleSet], encoder: Params, augmentation: Augmentation) -> list[PaperExample]:
    """Return the examples of some sample sets, augmented; the random numbers of a set do not depend on the others."""
    return [
        example for index, samples in enumerate(sets) for example in _examples(samples, index, encoder, augmentation)
    ]


def _examples(samples: SampleSet, index: int, encoder: Params, a: Augmentation) -> Iterator[PaperExample]:
    rng = np.random.default_rng([a.seed, index])
    for version in [samples, *(augmented(samples, FrameChange.draw(rng)) for _ in range(a.changes))]:
        clouds = version.clouds[:, :CLOUD_POINTS]
        stretches = np.exp(rng.uniform(-a.stretch, a.stretch, (1 + a.copies, 3))).astype(np.float32)
        stretches = stretches[:, stretch_axes(version)]
        stretches[0] = 1.0
        noise = rng.normal(0.0, a.noise, (1 + a.copies, *clouds.shape)).astype(np.float32)
        noise[0] = 0.0
        copies = clouds * stretches[:, None, None] + noise
        features = _features(encoder, copies.reshape(-1, *clouds.shape[1:])).reshape(1 + a.copies, len(clouds), -1)
        for sample in version.samples:
            example = _example(sample, features, stretches, version.grasps)
            yield example
            for _ in range(a.reductions if version.structure is not None else 0):
                smaller = _without_parts(example, sample, version, features, rng)
                if smaller is not None:
                    yield smaller


def _without_parts(
    example: PaperExample,
    sample: LabeledState,
    samples: SampleSet,
    features: Float32[np.ndarray, "c P 48"],
    rng: np.random.Generator,
) -> PaperExample | None:
    """Return a state without some parts; None if there is none, or if all that leads to the whole is gone."""
    assert samples.structure is not None
    left = without_some(samples.structure, rng)
    smaller = None if left is None else reduced(sample, left, samples.structure)
    if left is None or smaller is None:
        return None
    grasps = None if samples.grasps is None else samples.grasps[left.parts]
    out = _example(smaller, features[:, left.parts], example.stretches, grasps)
    out = replace(out, tie=example.tie)
    # The labels still call a merge that locks a missing part out a dead end.
    if sample.q_values is None:
        return out if out.best[0] >= 0 else None
    return out if out.highest >= example.highest - example.tie else None


def _features(encoder: Params, clouds: Float32[np.ndarray, "b n 3"]) -> Float32[np.ndarray, "b 48"]:
    """Encode many clouds, some at a time, so that one shape is compiled."""
    padded = np.zeros((-(-len(clouds) // _ENCODED) * _ENCODED, *clouds.shape[1:]), np.float32)
    padded[: len(clouds)] = clouds
    chunks = np.split(padded, len(padded) // _ENCODED)
    return np.concatenate([np.asarray(_encode(encoder, chunk)) for chunk in chunks])[: len(clouds)]


_encode = jax.jit(autoencoder.encode)


def _example(
    sample: LabeledState,
    features: Float32[np.ndarray, "c P 48"],
    stretches: Float32[np.ndarray, "c 3"],
    grasps: Float32[np.ndarray, "P 8 6"] | None,
) -> PaperExample:
    part, point = np.nonzero(sample.free)
    number = np.full(sample.free.shape, -1)
    number[part, point] = np.arange(len(part))
    u, k, v, l = sample.mates[:, :4].T  # noqa: E741
    return PaperExample(
        features=features,
        stretches=stretches,
        points=sample.points.astype(np.float16),
        free=sample.free,
        poses=sample.poses.astype(np.float16),
        connections=sample.connections.astype(np.float16),
        part=part.astype(np.int16),
        point=point.astype(np.int16),
        group=sample.group[part].astype(np.int16),
        mates=np.stack([number[u, k], number[v, l]], axis=1).astype(np.int16),
        returns=exact_returns(sample),
        q_values=sample.q_values,
        grasps=grasps,
        tie=0.0 if sample.q_values is None else TIE * (len(sample.poses) - 1 + COMPLETION_REWARD),
    )


def scattered(
    poses: Float[np.ndarray, "P 6"], group: Int[np.ndarray, "P"], setting: SettingName, rng: np.random.Generator
) -> Float[np.ndarray, "P 6"]:
    """Return world poses with each group turned and placed at random; Q depends on neither.

    Groups rest in any of their stable poses, and merged groups in others than their parts, so any turn may occur.

    Args:
        poses: of the parts of one state, or of several one after another.
        group: index of the first part of each part's group.
        setting: says where groups may lie.
        rng: draws turns and places.
    """
    turns = Rotation.random(len(poses), rng).as_matrix()[group]
    places = SETTINGS[setting].scatter(poses[:, :3].astype(float), rng)[group]
    moved = np.einsum("pij,pj->pi", turns, poses[:, :3] - poses[group, :3].astype(float)) + places
    rotations = turns @ rotations_from_euler(poses[:, 3:].astype(float))
    return np.concatenate([moved, euler_from_rotations(rotations)], axis=1).astype(np.float32)
