"""Imitation of the oracle: trains the relational network on labelled states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.learning import checkpoint
from roboassembly.learning.augmentation import AUGMENTATIONS
from roboassembly.learning.batches import padded_length
from roboassembly.learning.fit import AdamWConfig, Batch, Fit
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.augmentation import augment_tokens, permutation_of
from roboassembly.learning.relational.examples import TokenExample
from roboassembly.learning.relational.tokens import pad

_VALIDATION_BATCH = 8
"""Number of states in a batch of validation."""
_TOKENS_IN_CACHE = 96
"""Number of tokens that go through the network at a time on a CPU, so that the arrays over all pairs of tokens between
its layers stay in the cache. Whole batches take twice as long."""


@dataclass(frozen=True)
class RelationalTraining(AdamWConfig):
    """Settings of the training of the relational network."""

    learning_rate: float = 2e-3
    """Largest learning rate."""
    batch: int = 16
    """States of 48 tokens in a batch; fewer of larger ones, more of smaller ones."""
    augment: bool = True
    """Whether each state is mirrored and turned by quarter turns at random, anew each time."""
    hide_surface: float = 0.15
    """Share of the states in which the surface around the points is hidden, so that not all rests on it."""


def batch_of(
    examples: Sequence[TokenExample], length: int, rng: np.random.Generator | None = None, hide_surface: float = 0.0
) -> dict[str, np.ndarray]:
    """Return a batch of states, padded, with the targets `fits` and `viable`.

    Args:
        examples: states.
        length: number of tokens that each state is padded to.
        rng: draws an augmentation of each state; none if None.
        hide_surface: share of the states in which the surface around the points is hidden.
    """
    changes = [
        AUGMENTATIONS[0] if rng is None else AUGMENTATIONS[int(rng.integers(len(AUGMENTATIONS)))] for _ in examples
    ]
    batch = pad([augment_tokens(e.tokens, change) for e, change in zip(examples, changes, strict=True)], length)
    batch["fits"] = np.zeros((len(examples), length, length), np.uint8)
    batch["viable"] = np.zeros((len(examples), length, length, 6), np.uint8)
    for row, (e, change) in enumerate(zip(examples, changes, strict=True)):
        n = len(e.fits)
        batch["fits"][row, :n, :n] = e.fits
        batch["viable"][row, :n, :n, permutation_of(e.tokens, change)] = np.moveaxis(e.viable, 2, 0)
        if rng is not None and rng.random() < hide_surface:
            batch["patch"][row] = 255
    return batch


def epoch(
    examples: Sequence[TokenExample], rng: np.random.Generator, training: RelationalTraining, first: int = 0
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the batches of one pass over all examples, states of similar size together.

    Args:
        examples: states.
        rng: shuffles the examples.
        training: settings of the training.
        first: number of the batch to begin with.
    """
    chunks: list[tuple[int, list[int]]] = []
    for length, indices in _by_length(examples).items():
        count = _states_in(training.batch, length)
        shuffled = rng.permutation(indices)
        if len(shuffled) % count:
            shuffled = np.concatenate([shuffled, rng.choice(indices, -len(shuffled) % count)])
        chunks.extend((length, chunk.tolist()) for chunk in shuffled.reshape(-1, count))
    order: list[int] = rng.permutation(len(chunks))[first:].tolist()
    for index in order:
        length, chunk = chunks[index]
        changes = np.random.default_rng([training.seed, index, chunk[0]]) if training.augment else None
        yield batch_of([examples[i] for i in chunk], length, changes, training.hide_surface)


def epoch_length(examples: Sequence[TokenExample], batch: int) -> int:
    """Return the number of batches in one pass over all examples."""
    return sum(-(-len(indices) // _states_in(batch, length)) for length, indices in _by_length(examples).items())


def _by_length(examples: Sequence[TokenExample]) -> dict[int, list[int]]:
    """Numbers of the examples, by their padded length."""
    by_length: dict[int, list[int]] = {}
    for index, e in enumerate(examples):
        by_length.setdefault(padded_length(len(e.fits)), []).append(index)
    return by_length


def _states_in(batch: int, length: int) -> int:
    """Number of states in a batch: fewer of long ones."""
    return max(2, batch * 48 // length)


def losses(params: Params, batch: Batch) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return the loss of a batch and its terms, means over the states.

    - `pairs`: binary cross-entropy of whether a pair fits.
    - `values`: binary cross-entropy of whether an action is viable.
    - `choice`: minus the log of the share that viable actions have of the softmax over all actions.
    - `chosen`: share of the states in which the best action is viable; no part of the loss.
    """
    fits, q, valid = relational.apply(params, dict(batch))
    known = valid.astype(jnp.float32)
    is_fit, is_viable = batch["fits"].astype(jnp.float32), batch["viable"].astype(jnp.float32)
    count = jnp.maximum((is_fit * known).sum((1, 2)), 1.0)
    pairs = (cross_entropy(fits, is_fit) * known * (1.0 + 4.0 * is_fit)).sum((1, 2)) / count
    weight = known[..., None] * (0.2 + is_fit[..., None])
    values = (cross_entropy(q, is_viable) * weight).sum((1, 2, 3)) / count / 6.0
    flat = jnp.where(valid[..., None], q, -1e9).reshape(len(q), -1)
    viable = is_viable.reshape(len(q), -1)
    # In a dead end no action is viable: there is nothing to choose, and the values alone are learnt.
    solvable = viable.any(1)
    choice = jax.nn.logsumexp(flat, 1) - jax.nn.logsumexp(jnp.where(viable > 0, flat, -1e9), 1)
    choice = jnp.where(solvable, choice, 0.0)
    chosen = jnp.where(solvable, jnp.take_along_axis(viable, jnp.argmax(flat, 1)[:, None], 1)[:, 0], 1.0)
    terms = {"pairs": pairs, "values": values, "choice": choice, "chosen": chosen}
    return (0.3 * pairs + values + choice).mean(), terms


def viable_share(params: Params, examples: Sequence[TokenExample]) -> float:
    """Return the share of the states in which the best action is viable; dead ends do not count."""
    examples = [e for e in examples if e.viable.any()]
    viable = 0.0
    for length, indices in _by_length(examples).items():
        of_length = [examples[i] for i in indices]
        for first in range(0, len(of_length), _VALIDATION_BATCH):
            chunk = of_length[first : first + _VALIDATION_BATCH]
            batch = batch_of([*chunk, *[chunk[-1]] * (_VALIDATION_BATCH - len(chunk))], length)
            viable += float(np.asarray(_best_is_viable(params, batch))[: len(chunk)].sum())
    return viable / len(examples)


@jax.jit
def _best_is_viable(params: Any, batch: dict[str, Any]) -> jax.Array:
    """(b,) 1 where the best action is viable."""
    _, q, valid = relational.apply(params, batch)
    flat = relational.ranked(batch, q, valid).reshape(len(q), -1)
    viable = batch["viable"].reshape(len(q), -1)
    return jnp.take_along_axis(viable, jnp.argmax(flat, 1)[:, None], 1)[:, 0]


def cross_entropy(logit: jax.Array, truth: jax.Array) -> jax.Array:
    """Return the binary cross-entropy of a logit, without overflow."""
    return jnp.maximum(logit, 0.0) - logit * truth + jnp.log1p(jnp.exp(-jnp.abs(logit)))


@jax.jit
def gradient_of(params: Any, batch: Batch) -> tuple[Any, dict[str, jax.Array]]:
    """Return the gradient of `losses` and the means of its terms.

    It is compiled once for each size of batch, whatever the training. On a CPU a batch is taken in pieces.
    """
    pieces = _pieces(*batch["group"].shape) if jax.default_backend() == "cpu" else 1

    def accumulated(total: Array, part: Array) -> Array:
        return total + part / pieces

    def add(gradient: Any, piece: Any) -> tuple[Any, dict[str, jax.Array]]:
        (loss, terms), part = jax.value_and_grad(losses, has_aux=True)(params, piece)
        return jax.tree.map(accumulated, gradient, part), {"loss": loss, **terms}

    split = {name: x.reshape(pieces, -1, *x.shape[1:]) for name, x in batch.items()}
    gradient, terms = jax.lax.scan(add, jax.tree.map(jnp.zeros_like, params), split)
    return gradient, {k: v.mean() for k, v in terms.items()}


def _pieces(states: int, tokens: int) -> int:
    """Number of equal pieces of a batch that each stay in the cache; a state is never divided."""
    least = min(states, -(-states * tokens // _TOKENS_IN_CACHE))
    return next(n for n in range(least, states + 1) if states % n == 0)


@partial(jax.jit, static_argnums=0)
def _applied(training: RelationalTraining, params: Any, opt_state: Any, gradient: Any) -> tuple[Any, Any]:
    updates, opt_state = training.optimiser().update(gradient, opt_state, params)
    return optax.apply_updates(params, updates), opt_state


def train(
    examples: Sequence[TokenExample],
    path: Path,
    training: RelationalTraining,
    config: relational.RelationalConfig,
    notes: dict[str, Any],
    initial: Path | None = None,
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    Args:
        examples: states to learn from.
        path: file of the checkpoint.
        training: settings of the training.
        config: sizes of the network.
        notes: origin of the examples, kept in the checkpoint.
        initial: checkpoint whose weights come first, if training starts anew.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """

    def init_params() -> Params:
        params = relational.init(np.random.default_rng(training.seed), config)
        if initial is not None:
            params = checkpoint.load(initial, relational.KIND).params
        return params

    def update(params: Params, opt_state: Any, batch: Batch) -> tuple[Params, Any, Mapping[str, Array]]:
        gradient, terms = gradient_of(params, batch)
        params, opt_state = _applied(training, params, opt_state, gradient)
        return params, opt_state, terms

    fit = Fit(path, relational.KIND, training, {"network": asdict(config), **notes})
    yield from fit.run(init_params, training.optimiser().init, update, partial(_batches, examples, training))


def _batches(examples: Sequence[TokenExample], training: RelationalTraining, step: int) -> Iterator[Batch]:
    """Yield the batches of all steps after `step`; each follows from its step's number."""
    per_epoch = epoch_length(examples, training.batch)
    while step < training.steps:
        rng = np.random.default_rng([training.seed, step // per_epoch])
        for batch in islice(epoch(examples, rng, training, first=step % per_epoch), training.steps - step):
            yield batch
            step += 1
