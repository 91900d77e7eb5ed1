"""Imitation learning of the paper's policy: the experts' Q-values with the loss `L1 + 50 L2`.

The label of a state is an expert's Q-values if it has some, else the oracle's answers, which give the best
undiscounted return-to-go exactly. Both are returns: 1 for each merge, 4 more for the whole.

Many actions of a state are equally good. The one to imitate is the first of them, in the order of parts, points and
choices, as for experts (`dqn.network.first_best`). A policy that may take any of them meets groups that no sample has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Bool, Float, Float16, Float32, Int, Int16
from scipy.spatial.transform import Rotation

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.geometry.poses import euler_from_rotations, rotations_from_euler
from roboassembly.learning.augmentation import FrameChange, augmented
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import LabeledState, SampleSet, group_labels
from roboassembly.learning.fit import AdamWConfig, Batch, Fit
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.missing_parts import reduced, without_some
from roboassembly.learning.paper import autoencoder, heads
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.dqn.network import TIE, first_best
from roboassembly.learning.paper.network import PaperConfig, PaperState
from roboassembly.task.rules.connections import UP_AXES

LAMBDA = 50.0
"""The paper's weight of L2."""
COMPLETION_REWARD = 4.0
"""Reward for the whole furniture, in addition to 1 for the last merge."""
_ENCODED = 32
"""Clouds that are encoded at a time."""
_SORTED = 8
"""Number of batches among which examples of like size are grouped: padding costs time."""
_LEAST_L1 = 1e-3
"""Least norm of the difference of Q-values, where its gradient is still finite."""
_NORMALISED_BY = 4096
"""Largest number of states that give the mean and deviation of the inputs."""


@dataclass(frozen=True)
class PaperTraining(AdamWConfig):
    """Settings of the training of the paper's policy."""

    learning_rate: float = 1.5e-3
    """Largest learning rate."""
    weight_decay: float = 5e-2
    """Decoupled weight decay."""
    batch: int = 64
    """States in a batch."""
    clip: float = 10.0
    """Largest norm of the gradient."""
    scatter: bool = True
    """Whether the groups of each state are placed at random anew (not in the paper)."""


@dataclass(frozen=True)
class Augmentation:
    """Copies that are made of each sample set before training."""

    copies: int = 4
    """Noisy clouds of each part, in addition to the clean one."""
    noise: float = 0.003
    """Standard deviation of the noise along each axis [m]."""
    changes: int = 0
    """Versions of each chair in addition to itself: mirrored, turned, scaled (not in the paper)."""
    reductions: int = 3
    """Copies of each state, without some parts of the chair (not in the paper; see `missing_parts`)."""
    seed: int = 0
    """Random seed."""


@dataclass(frozen=True, eq=False)
class PaperExample:
    """A state ready for the network, small enough to keep a hundred thousand."""

    furniture: int
    """Number of the sample set that the state belongs to."""
    features: Float32[np.ndarray, "c P 48"]
    """Features of the parts' clouds: clean, then noisy copies. Shared by the states of a chair."""
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
        """Return the state with one of the copies of the features."""
        free = self.free[..., None].astype(np.float32)
        return PaperState(self.features[copy], self.points, free, self.poses, self.connections, self.grasps)

    def branch_targets(self) -> Float[np.ndarray, "n n h"]:
        """Return what each branch adds to the Q-values to imitate, one branch after another."""
        return self.exact() if self.q_values is None else self.q_values

    @property
    def max_return(self) -> float:
        """Bound of the targets: the largest return that is left, which experts overestimate."""
        if self.q_values is None:
            return np.inf
        return len(np.unique(group_labels(self.connections))) - 1 + COMPLETION_REWARD

    def first_best(self) -> tuple[int, int, int]:
        """Return row, column and choice of the action to imitate; -1 each if none leads to the whole furniture."""
        values = np.minimum(self._values(), np.float32(self.max_return))
        # An expert's samples all lead to the whole; its values are estimates, and may say less.
        if not values.size or (self.q_values is None and values.max() < COMPLETION_REWARD):
            return -1, -1, -1
        return first_best(values, self.tie)

    def highest(self) -> float:
        """Return the highest value of an action that exists."""
        return float(self._values().max(initial=-np.inf))

    def _values(self) -> Float32[np.ndarray, "n n w"]:
        """Return the Q-values to imitate, without their bound; -inf where the action does not exist."""
        branches = np.split(self.branch_targets().astype(np.float32), _ends(self.grasps is not None), axis=2)
        values = heads.combined(branches)
        values[self.group[:, None] == self.group[None]] = -np.inf
        return values

    def exact(self) -> Float32[np.ndarray, "n n 6"]:
        """Return the exact Q-values."""
        n = len(self.part)
        out = np.zeros((n, n, len(UP_AXES)), np.float32)
        out[self.mates[:, 0], self.mates[:, 1]] = self.returns
        return out


def _ends(full: bool) -> list[int]:
    """Return where the values of each action branch end, but for the last."""
    return np.cumsum(PaperConfig(full=full).branches)[:-1].tolist()


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
        noisy = [clouds + rng.normal(0.0, a.noise, clouds.shape).astype(np.float32) for _ in range(a.copies)]
        features = _features(encoder, np.concatenate([clouds, *noisy])).reshape(1 + a.copies, len(clouds), -1)
        for sample in version.samples:
            example = _example(sample, index, features, version.grasps)
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
    out = replace(_example(smaller, example.furniture, features[:, left.parts], grasps), tie=example.tie)
    # What locks a missing part out is no dead end any more, but the labels do not say so.
    if sample.q_values is None:
        return out if out.first_best()[0] >= 0 else None
    return out if out.highest() >= example.highest() - example.tie else None


def _features(encoder: Params, clouds: Float32[np.ndarray, "b n 3"]) -> Float32[np.ndarray, "b 48"]:
    """Encode many clouds, some at a time, so that one shape is compiled."""
    padded = np.zeros((-(-len(clouds) // _ENCODED) * _ENCODED, *clouds.shape[1:]), np.float32)
    padded[: len(clouds)] = clouds
    chunks = np.split(padded, len(padded) // _ENCODED)
    return np.concatenate([np.asarray(_encode(encoder, chunk)) for chunk in chunks])[: len(clouds)]


_encode = jax.jit(autoencoder.encode)


def _example(
    sample: LabeledState,
    index: int,
    features: Float32[np.ndarray, "c P 48"],
    grasps: Float32[np.ndarray, "P 8 6"] | None,
) -> PaperExample:
    part, point = np.nonzero(sample.free)
    number = np.full(sample.free.shape, -1)
    number[part, point] = np.arange(len(part))
    u, k, v, l = sample.mates[:, :4].T  # noqa: E741
    return PaperExample(
        furniture=index,
        features=features,
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
    poses: Float[np.ndarray, "P 6"], connections: Float[np.ndarray, "P P 6"], rng: np.random.Generator
) -> Float[np.ndarray, "P 6"]:
    """Return world poses with each group turned at random and moved up to 0.5 m; Q depends on neither.

    Groups rest in any of their stable poses, and merged groups in others than their parts, so any turn may occur.
    """
    group = group_labels(connections)
    turns = Rotation.random(len(poses), rng).as_matrix()[group]
    shift = rng.uniform(-0.5, 0.5, (len(poses), 3))[group]
    center = poses[group, :3].astype(float)
    moved = np.einsum("pij,pj->pi", turns, poses[:, :3] - center) + center + shift
    rotations = turns @ rotations_from_euler(poses[:, 3:].astype(float))
    return np.concatenate([moved, euler_from_rotations(rotations)], axis=1).astype(np.float32)


def batch_of(
    examples: Sequence[PaperExample], rng: np.random.Generator | None, *, scatter: bool = False
) -> dict[str, np.ndarray]:
    """Return padded arrays with targets.

    Args:
        examples: at least one.
        rng: draws the noisy copies of features, and the places of groups; without it there is neither.
        scatter: whether groups are placed anew.

    Returns:
        `state` (b, s), `slot` (b, n), `exists` (b, n, n); `best` (b, 3), row, column and choice of the action to
        imitate, -1 if there is none; and what `targets` takes.
    """
    full = examples[0].grasps is not None
    b, n = len(examples), padded_length(max(len(e.part) for e in examples))
    batch = {
        "state": np.zeros((b, paper.state_size(full)), np.float32),
        "slot": np.zeros((b, n), np.int32),
        "exists": np.zeros((b, n, n), bool),
        # All combinations of branches would be four times as much in the full setting, and half precision suffices.
        "branch_targets": np.zeros((b, n, n, sum(PaperConfig(full=full).branches)), np.float16),
        "max_return": np.array([e.max_return for e in examples], np.float32),
        "best": np.array([e.first_best() for e in examples], np.int32),
    }
    for row, e in enumerate(examples):
        state = e.state(int(rng.integers(len(e.features))) if rng is not None else 0)
        if scatter and rng is not None:
            state = replace(state, poses=scattered(state.poses, state.connections, rng))
        state.write(batch["state"][row])
        free = slice(len(e.part))
        batch["slot"][row, free] = MAX_POINTS * e.part + e.point
        batch["exists"][row, free, free] = e.group[:, None] != e.group[None]
        batch["branch_targets"][row, free, free] = e.branch_targets()
    return batch


def targets(batch: Batch) -> Array:
    """Return (b, n, n, w) the Q-values to imitate, over all combinations of branches, from a batch of `batch_of`."""
    each, bound = batch["branch_targets"], batch["max_return"]
    xp = each.__array_namespace__()
    branches = next(c.branches for c in (PaperConfig(), PaperConfig(full=True)) if sum(c.branches) == each.shape[3])
    ends = np.cumsum(branches).tolist()
    values = [xp.astype(each[..., end - n : end], xp.float32) for n, end in zip(branches, ends, strict=True)]
    return xp.minimum(heads.combined(values), bound[:, None, None, None])


def imitation_losses(
    q: Float[jax.Array, "b a"],
    target: Float[jax.Array, "b a"],
    exists: Bool[jax.Array, "b a"],
    best: Int[jax.Array, "b"],
) -> tuple[Float[jax.Array, "b"], Float[jax.Array, "b"]]:
    """Return the paper's two losses of each state, over the actions that exist.

    L1 is the norm of `Q - Q_expert`, as the paper's formula has it. (The text calls it a mean square loss. With the
    square, thousands of actions outweigh 50 L2; with the mean, 50 L2 dominates, and that is least where all values are
    equal.)

    L2 is `max_a Q(a) - Q(argmax_a Q_expert(a))`, 0 where the network and the expert choose the same action.

    Args:
        q: values of the network.
        target: values of the expert.
        exists: which actions exist.
        best: number of the expert's action; negative if there is none.
    """
    l1 = ((jnp.where(exists, q - target, 0.0) ** 2).sum(1) + _LEAST_L1**2) ** 0.5
    chosen = jnp.take_along_axis(q, jnp.maximum(best, 0)[:, None], axis=1)[:, 0]
    highest = jnp.where(exists, q, -jnp.inf).max(1)
    return l1, jnp.where(best >= 0, highest - chosen, 0.0)


def losses(network: Any, inputs: Any, batch: Batch) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return `L1 + 50 L2` and its terms, averaged; `chosen` is the share of states with a best action."""
    each = paper.branch_values(network, inputs, batch["state"], batch["slot"])
    labels = {name: batch[name] for name in ("exists", "branch_targets", "max_return", "best")}
    if len(each) > 1:
        # State by state: all combinations of grasps of a whole batch would take hundreds of megabytes, several times.
        l1, l2 = jax.lax.map(jax.checkpoint(_losses_of_state), (each, labels))
    else:
        l1, l2 = _losses_of_states(each, labels)
    terms = {"l1": l1.mean(), "l2": l2.mean(), "chosen": (l2 <= 0.0).mean()}
    return (l1 + LAMBDA * l2).mean(), terms


def _losses_of_states(each: list[jax.Array], labels: Any) -> tuple[jax.Array, jax.Array]:
    q = heads.combined(each)
    b, n, _, choices = q.shape
    exists = jnp.broadcast_to(labels["exists"][..., None], q.shape)
    row, column, choice = labels["best"].T
    best = jnp.where(row < 0, -1, (row * n + column) * choices + choice)
    return imitation_losses(q.reshape(b, -1), targets(labels).reshape(b, -1), exists.reshape(b, -1), best)


def _losses_of_state(state: tuple[list[jax.Array], dict[str, jax.Array]]) -> tuple[jax.Array, jax.Array]:
    each, labels = jax.tree.map(lambda x: x[None], state)
    l1, l2 = _losses_of_states(each, labels)
    return l1[0], l2[0]


def viable_share(params: Params, examples: Sequence[PaperExample]) -> float:
    """Return the share of the states that are no dead ends where the furniture can be finished after the best action.

    Args:
        params: parameters of a checkpoint of kind `paper`.
        examples: states with exact labels.
    """
    examples = [e for e in examples if (e.returns >= COMPLETION_REWARD).any()]
    viable = np.zeros(len(examples), bool)
    for row, e in enumerate(examples):
        batch = batch_of([e], None)
        n = len(e.part)
        q = paper.apply(params["network"], params["inputs"], batch["state"], batch["slot"][:, :n])[0]
        q = np.where(batch["exists"][0, :n, :n, None], q, -np.inf)
        viable[row] = e.exact().ravel()[np.argmax(q)] >= COMPLETION_REWARD
    return float(viable.mean())


@partial(jax.jit, static_argnums=0, donate_argnums=(1, 3))
def _step(t: PaperTraining, network: Any, inputs: Any, opt_state: Any, batch: Any) -> tuple[Any, Any, dict[str, Array]]:
    (loss, terms), gradient = jax.value_and_grad(losses, has_aux=True)(network, inputs, batch)
    updates, opt_state = t.optimiser().update(gradient, opt_state, network)
    return optax.apply_updates(network, updates), opt_state, {"loss": loss, **terms}


def train(
    examples: Sequence[PaperExample],
    encoder: Params,
    path: Path,
    training: PaperTraining,
    config: PaperConfig,
    notes: dict[str, Any],
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    Args:
        examples: states to learn from.
        encoder: weights of the auto-encoder that made their features; kept in the checkpoint, unchanged.
        path: file of the checkpoint.
        training: settings of the training.
        config: sizes of the network; its setting follows from the examples.
        notes: origin of the examples, kept in the checkpoint.

    Raises:
        InputError: there are no examples, they are of both settings, or the checkpoint at `path` is of other training.
    """
    if not examples:
        raise InputError(f"no samples for '{path}'; collect some first")
    config = replace(config, full=examples[0].grasps is not None)
    if any((e.grasps is not None) != config.full for e in examples):
        raise InputError(f"the samples for '{path}' are of both settings; give those of one")

    def init_params() -> Params:
        network = paper.init(np.random.default_rng(training.seed), config)
        return {"encoder": encoder, "inputs": _inputs(examples, training.seed), "network": network}

    def init_opt_state(params: Params) -> Any:
        return training.optimiser().init(params["network"])

    def update(params: Params, opt_state: Any, batch: Batch) -> tuple[Params, Any, dict[str, Array]]:
        network, opt_state, terms = _step(training, params["network"], params["inputs"], opt_state, batch)
        return {**params, "network": network}, opt_state, terms

    fit = Fit(path, paper.KIND, training, {"network": asdict(config), **notes})
    yield from fit.run(init_params, init_opt_state, update, partial(_batches, examples, training))


def _batches(examples: Sequence[PaperExample], training: PaperTraining, first: int) -> Iterator[Batch]:
    """Yield the batches of all steps after the `first`; each follows from its step's number."""
    per_pass = -(-len(examples) // training.batch)
    pass_, order = -1, np.zeros(0, int)
    for number in range(first, training.steps):
        if number // per_pass != pass_:
            pass_ = number // per_pass
            order = _order(examples, training.batch, np.random.default_rng([training.seed, 0, pass_]))
        rng = np.random.default_rng([training.seed, 1, number])
        yield batch_of([examples[int(i)] for i in order[number % per_pass]], rng, scatter=training.scatter)


def _order(examples: Sequence[PaperExample], batch: int, rng: np.random.Generator) -> np.ndarray:
    """Return (batches, batch) numbers of examples for one pass: shuffled, those of like size within a few batches."""
    order = np.resize(rng.permutation(len(examples)), -(-len(examples) // batch) * batch)
    sizes = np.array([len(e.part) for e in examples])[order]
    windows = np.arange(len(order)) // (_SORTED * batch)
    batches = order[np.lexsort((sizes, windows))].reshape(-1, batch)
    return batches[rng.permutation(len(batches))]


def _inputs(examples: Sequence[PaperExample], seed: int) -> Params:
    """Return the normalisation of the inputs, from some of the examples."""
    some = np.random.default_rng([seed, 2]).permutation(len(examples))[:_NORMALISED_BY]
    states = np.zeros((len(some), paper.state_size(examples[0].grasps is not None)), np.float32)
    for row, i in zip(states, some, strict=True):
        examples[int(i)].state(0).write(row)
    return dict(paper.normalization(states))
