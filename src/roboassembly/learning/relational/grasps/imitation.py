"""Imitation of fresh tests: trains the grasp network on labelled grasps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Bool, Float32, Int8

from roboassembly.errors import InputError
from roboassembly.learning.fit import Batch, Fit, FitConfig
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import UNKNOWN, YES, GraspSamples
from roboassembly.learning.relational.grasps.features import grasp_features
from roboassembly.learning.relational.imitation import cross_entropy
from roboassembly.parallel.processes import map_ordered

ANSWERS = ("fit", "reach", "finish")
"""Answers about two grasps, in the order of the network's output."""


@dataclass(frozen=True)
class GraspTraining(FitConfig):
    """Settings of the training of the grasp network."""

    steps: int = 12_000
    """Number of gradient steps."""
    learning_rate: float = 2e-3
    """Largest learning rate."""
    batch: int = 64
    """Pairs of points in a batch, each with all its pairs of grasps."""
    weight_decay: float = 0.3
    """Decoupled weight decay; as large as this because few actions tell what the arms can do."""


@dataclass(frozen=True, eq=False)
class GraspExamples:
    """Labelled grasps of m pairs of points, ready for the network."""

    single: Float32[np.ndarray, "m 2 8 43"]
    """Features of each grasp."""
    pair: Float32[np.ndarray, "m 8 8 9"]
    """Features of each two grasps."""
    exists: Bool[np.ndarray, "m 8 8"]
    """Whether both grasps exist."""
    pick: Int8[np.ndarray, "m 2 8"]
    """Labels `LabeledGrasps.pick`."""
    mate: Int8[np.ndarray, "m 8 8 3"]
    """Labels `fit`, `reach` and `finish`."""


def examples_of(paths: Sequence[Path], jobs: int) -> GraspExamples:
    """Return the examples of some files.

    Raises:
        InputError: a file is broken, or there are no samples.
    """
    rows = [row for of_file in map_ordered(_rows, paths, jobs, chunk=4) for row in of_file]
    if not rows:
        raise InputError("no grasp samples to learn from")
    return GraspExamples(*(np.array(column) for column in zip(*rows, strict=True)))


def _rows(path: Path) -> list[tuple[np.ndarray, ...]]:
    """Arrays of `GraspExamples` for each sample of a file."""
    samples = GraspSamples.load(path)
    out: list[tuple[np.ndarray, ...]] = []
    for sample in samples.samples:
        features = grasp_features(samples.view(sample), *sample.pair)
        mate = np.stack([sample.fit, sample.reach, sample.finish], axis=-1)
        out.append((features.single, features.pair, features.exists, sample.pick, mate))
    return out


def losses(params: Params, batch: Batch) -> tuple[Array, dict[str, Array]]:
    """Return the loss of a batch and its terms: the binary cross-entropy of each answer where its label is known."""
    pick, mate = grasping.apply(params, batch["single"], batch["pair"])
    terms = {"pick": _known_mean(pick, batch["pick"])}
    labels = jnp.where(batch["exists"][..., None], batch["mate"], UNKNOWN)
    terms |= {name: _known_mean(mate[..., i], labels[..., i]) for i, name in enumerate(ANSWERS)}
    return sum(terms.values(), jnp.zeros(())), terms


def _known_mean(logits: Array, labels: Array) -> Array:
    """Mean cross-entropy over the known labels."""
    known = labels != UNKNOWN
    return (cross_entropy(logits, labels == YES) * known).sum() / jnp.maximum(known.sum(), 1)


def optimiser(t: GraspTraining) -> optax.GradientTransformation:
    """Return the optimiser: AdamW (Loshchilov and Hutter 2019) with cosine decay and clipped gradients."""
    schedule = optax.cosine_decay_schedule(t.learning_rate, t.steps, 0.02)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=t.weight_decay))


@partial(jax.jit, static_argnums=0)
def _update(t: GraspTraining, params: Any, state: Any, batch: Any) -> tuple[Any, Any, dict[str, Array]]:
    (loss, terms), gradient = jax.value_and_grad(losses, has_aux=True)(params, batch)
    change, state = optimiser(t).update(gradient, state, params)
    return optax.apply_updates(params, change), state, {"loss": loss, **terms}


def train(
    examples: GraspExamples, path: Path, training: GraspTraining, notes: dict[str, Any]
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    Args:
        examples: grasps to learn from.
        path: file of the checkpoint.
        training: settings of the training.
        notes: origin of the examples, kept in the checkpoint.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """

    def batches(first: int) -> Iterator[Batch]:
        for step in range(first, training.steps):
            rng = np.random.default_rng([training.seed, step])
            chosen = rng.integers(len(examples.single), size=training.batch)
            yield {name: array[chosen] for name, array in vars(examples).items()}

    def init_params() -> Params:
        return grasping.init(np.random.default_rng(training.seed))

    fit = Fit(path, grasping.KIND, training, notes)
    yield from fit.run(init_params, optimiser(training).init, partial(_update, training), batches)


def accuracy(params: Params, examples: GraspExamples) -> dict[str, float]:
    """Return how well the network predicts labels.

    Returns:
        `pick`, `fit`, `reach`, `finish`: share of the known labels that are predicted. `first`: of the pairs of points
        with grasps known to fit, the share where the most probable of all labelled grasps do.
    """
    pick, mate = (np.asarray(x) for x in grasping.apply(params, examples.single, examples.pair))
    out = {"pick": _known_share(pick, examples.pick)}
    out |= {name: _known_share(mate[..., i], examples.mate[..., i]) for i, name in enumerate(ANSWERS)}
    fit = np.where(examples.exists, examples.mate[..., 0], UNKNOWN)
    solvable = np.flatnonzero((fit == YES).any(axis=(1, 2)))
    scores = np.where(fit != UNKNOWN, mate[..., 0], -np.inf)[solvable].reshape(len(solvable), -1)
    fits = (fit[solvable] == YES).reshape(len(solvable), -1)
    return out | {"first": float(fits[np.arange(len(solvable)), scores.argmax(axis=1)].mean())}


def _known_share(logits: np.ndarray, labels: np.ndarray) -> float:
    """Share of the known labels that logits predict; 1 if none is known."""
    known = labels != UNKNOWN
    return float(((logits > 0.0) == (labels == YES))[known].mean()) if known.any() else 1.0
