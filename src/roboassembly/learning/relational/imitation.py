"""Teaches the relational policy from lessons: one pass after another over all states, resumable at any moment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.learning import checkpoint
from roboassembly.learning.augmentation import AUGMENTATIONS, up_axis_permutation
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import SampleSet, dataset_file
from roboassembly.learning.relational import network as relational
from roboassembly.learning.relational.augmentation import augment_tokens
from roboassembly.learning.relational.oracle_dataset import targets_of
from roboassembly.learning.relational.tokens import TokenCache, Tokens, pad, tokens_of_sample
from roboassembly.learning.training_run import Run
from roboassembly.parallel.processes import map_ordered, prefetch

_FEW = 8
"""Chairs that are not worth starting processes for."""
_VALIDATED = 8
"""States at a time."""
_IN_CACHE = 96
"""Tokens that are taken through the network at a time on a CPU: what lies between its layers, a number of arrays over
all pairs of tokens, then stays in the cache. All states at once take twice as long."""


@dataclass(frozen=True)
class Training:
    """How to train."""

    steps: int = 20_000
    learning_rate: float = 2e-3
    warmup: int = 200
    weight_decay: float = 1e-3
    batch: int = 16
    """States of 48 tokens; fewer of larger ones, more of smaller ones."""
    views: bool = True
    """Show every state another way round each time: mirrored, turned by quarter turns."""
    blind: float = 0.15
    """Share of the states in which the surface around the points is hidden, so that not all rests on it."""
    seed: int = 0
    keep_every: float = 60.0
    """Seconds between checkpoints."""


@dataclass(frozen=True, eq=False)
class Example:
    """A state ready for the network, small enough to keep a hundred thousand."""

    course: int
    tokens: Tokens
    right: np.ndarray
    good: np.ndarray


def examples_of(courses: Sequence[SampleSet]) -> list[Example]:
    """All lessons of some courses."""
    out = []
    for index, course in enumerate(courses):
        memory = TokenCache()
        for lesson in course.samples:
            tokens = tokens_of_sample(course, lesson, memory)
            small = replace(tokens, bounds=tokens.bounds.astype(np.float16))
            out.append(Example(index, small, *targets_of(tokens, lesson)))
    return out


def load_examples(folder: Path, names: Sequence[str], jobs: int) -> list[Example]:
    """All lessons of some chairs, made ready in parallel.

    Args:
        folder: of `gather`.
        names: of the chairs.
        jobs: chairs at a time.

    Raises:
        InputError: a file of lessons is broken.
    """
    paths = [dataset_file(folder, name) for name in names]
    batches = map_ordered(_examples_in, paths, 1 if len(paths) < _FEW else jobs, chunk=4)
    return [replace(e, course=index) for index, batch in enumerate(batches) for e in batch]


def _examples_in(path: Path) -> list[Example]:
    return examples_of([SampleSet.load(path)])


def batch_of(
    examples: Sequence[Example], size: int, rng: np.random.Generator | None = None, blind: float = 0.0
) -> dict[str, np.ndarray]:
    """Padded arrays with targets_of.

    Args:
        examples: states.
        size: tokens that all are padded to.
        rng: draws for each state which way the furniture faces and whether it is mirrored; as it is without.
        blind: share of the states in which nothing is seen of the surface around the points.
    """
    views = [
        AUGMENTATIONS[0] if rng is None else AUGMENTATIONS[int(rng.integers(len(AUGMENTATIONS)))] for _ in examples
    ]
    batch = pad([augment_tokens(e.tokens, view) for e, view in zip(examples, views, strict=True)], size)
    batch["right"] = np.zeros((len(examples), size, size), np.uint8)
    batch["good"] = np.zeros((len(examples), size, size, 6), np.uint8)
    for row, (e, view) in enumerate(zip(examples, views, strict=True)):
        n = len(e.right)
        batch["right"][row, :n, :n] = e.right
        batch["good"][row, :n, :n, up_axis_permutation(view)] = np.moveaxis(e.good, 2, 0)
        if rng is not None and rng.random() < blind:
            batch["patch"][row] = 255
    return batch


def batches(
    examples: Sequence[Example], rng: np.random.Generator, training: Training, first: int = 0
) -> Iterator[dict[str, np.ndarray]]:
    """One pass over all examples, those of like size together, from the batch with number `first` on."""
    batch = training.batch
    jobs = []
    for size, indices in _by_size(examples).items():
        count = _count(batch, size)
        shuffled = rng.permutation(indices)
        if len(shuffled) % count:
            shuffled = np.concatenate([shuffled, rng.choice(indices, -len(shuffled) % count)])
        jobs.extend((size, chunk) for chunk in shuffled.reshape(-1, count))
    for index in rng.permutation(len(jobs))[first:]:
        size, chunk = jobs[index]
        views = np.random.default_rng([training.seed, int(index), int(chunk[0])]) if training.views else None
        yield batch_of([examples[i] for i in chunk], size, views, training.blind)


def batches_in(examples: Sequence[Example], batch: int) -> int:
    """How many batches one pass has."""
    return sum(-(-len(indices) // _count(batch, size)) for size, indices in _by_size(examples).items())


def _by_size(examples: Sequence[Example]) -> dict[int, list[int]]:
    by_size: dict[int, list[int]] = {}
    for index, e in enumerate(examples):
        by_size.setdefault(padded_length(len(e.right)), []).append(index)
    return by_size


def _count(batch: int, size: int) -> int:
    """States of a size in a batch: fewer of larger ones."""
    return max(2, batch * 48 // size)


def losses(params: relational.Params, batch: dict[str, Any]) -> tuple[jax.Array, dict[str, jax.Array]]:
    """What is minimised, and its terms, averaged over a batch.

    `pairs`: is the pair right (binary cross-entropy). `values`: does the action lead on (the same). `choice`: minus
    the log of the share of the softmax over all actions that good ones have: the surest action must be a good one.
    `chosen` is how often it is.
    """
    right, q, valid = relational.apply(params, batch)
    known = valid.astype(jnp.float32)
    is_right, is_good = batch["right"].astype(jnp.float32), batch["good"].astype(jnp.float32)
    count = jnp.maximum((is_right * known).sum((1, 2)), 1.0)
    pairs = (cross_entropy(right, is_right) * known * (1.0 + 4.0 * is_right)).sum((1, 2)) / count
    weight = known[..., None] * (0.2 + is_right[..., None])
    values = (cross_entropy(q, is_good) * weight).sum((1, 2, 3)) / count / 6.0
    flat = jnp.where(valid[..., None], q, -1e9).reshape(len(q), -1)
    good = is_good.reshape(len(q), -1)
    # In a dead end no choice is good, and what is learnt is that.
    hope = good.any(1)
    choice = jax.nn.logsumexp(flat, 1) - jax.nn.logsumexp(jnp.where(good > 0, flat, -1e9), 1)
    choice = jnp.where(hope, choice, 0.0)
    chosen = jnp.where(hope, jnp.take_along_axis(good, jnp.argmax(flat, 1)[:, None], 1)[:, 0], 1.0)
    terms = {"pairs": pairs, "values": values, "choice": choice, "chosen": chosen}
    return (0.3 * pairs + values + choice).mean(), terms


def share_good(params: Any, examples: Sequence[Example]) -> float:
    """In what share of the states that are no dead ends the surest action is a good one."""
    examples = [e for e in examples if e.good.any()]
    good = 0.0
    for size, indices in _by_size(examples).items():
        of_size = [examples[i] for i in indices]
        for first in range(0, len(of_size), _VALIDATED):
            chunk = of_size[first : first + _VALIDATED]
            batch = batch_of([*chunk, *[chunk[-1]] * (_VALIDATED - len(chunk))], size)
            good += float(_chosen(params, batch)[: len(chunk)].sum())
    return good / len(examples)


@jax.jit
def _chosen(params: Any, batch: dict[str, Any]) -> jax.Array:
    _, q, valid = relational.apply(params, batch)
    flat = relational.ranked(batch, q, valid).reshape(len(q), -1)
    good = batch["good"].reshape(len(q), -1)
    return jnp.take_along_axis(good, jnp.argmax(flat, 1)[:, None], 1)[:, 0]


def cross_entropy(logit: jax.Array, truth: jax.Array) -> jax.Array:
    """Binary, of a logit, without overflow."""
    return jnp.maximum(logit, 0.0) - logit * truth + jnp.log1p(jnp.exp(-jnp.abs(logit)))


def optimiser(t: Training) -> optax.GradientTransformation:
    """AdamW with warm-up and cosine decay."""
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, t.learning_rate, min(t.warmup, t.steps // 10), t.steps, 0.02 * t.learning_rate
    )
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=t.weight_decay))


@jax.jit
def gradient_of(params: Any, batch: dict[str, Any]) -> tuple[Any, dict[str, jax.Array]]:
    """The gradient of `losses`, and its terms averaged.

    This takes long to compile: once for each size of batch, whatever the training. On a CPU a batch is taken in pieces.
    """
    pieces = _pieces(*batch["group"].shape) if jax.default_backend() == "cpu" else 1

    def add(gradient: Any, piece: Any) -> tuple[Any, dict[str, jax.Array]]:
        (loss, terms), more = jax.value_and_grad(losses, has_aux=True)(params, piece)
        return jax.tree.map(lambda a, b: a + b / pieces, gradient, more), {"loss": loss, **terms}

    split = jax.tree.map(lambda x: x.reshape(pieces, -1, *x.shape[1:]), batch)
    gradient, terms = jax.lax.scan(add, jax.tree.map(jnp.zeros_like, params), split)
    return gradient, {k: v.mean() for k, v in terms.items()}


def _pieces(states: int, tokens: int) -> int:
    """How many equal pieces of a batch stay in the cache; a state is never divided."""
    least = min(states, -(-states * tokens // _IN_CACHE))
    return next(n for n in range(least, states + 1) if states % n == 0)


@partial(jax.jit, static_argnums=0)
def _moved(t: Training, params: Any, state: Any, gradient: Any) -> tuple[Any, Any]:
    updates, state = optimiser(t).update(gradient, state, params)
    return optax.apply_updates(params, updates), state


def train(
    examples: Sequence[Example],
    path: Path,
    training: Training,
    config: relational.RelationalConfig,
    notes: dict[str, Any],
    initial: Path | None = None,
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    After every multiple of 1,000 steps, too, the checkpoint is up to date when the step is yielded.

    Args:
        examples: to learn from.
        path: of the checkpoint, written every `training.keep_every` seconds and at the end.
        training: how.
        config: of the network.
        notes: kept in the checkpoint: what it was trained on.
        initial: checkpoint whose weights are the first, if training starts anew.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """
    about = {"network": asdict(config), "training": asdict(training), **notes}
    params = relational.init(np.random.default_rng(training.seed), config)
    if initial is not None:
        params = checkpoint.load(initial, relational.KIND).params
    if examples and examples[0].tokens.grasps is not None and "grasp" not in params:
        params |= relational.init_grasp_inputs(np.random.default_rng([training.seed, 1]), config)
    run = Run(path, relational.KIND, about, training.steps, training.keep_every)
    step, params, state = run.resume(params, optimiser(training).init(params))
    for batch in prefetch(_shown(examples, training, step)):
        gradient, terms = gradient_of(params, batch)
        params, state = _moved(training, params, state, gradient)
        step += 1
        run.keep(step, params, state)
        yield step, {k: float(v) for k, v in terms.items()}


def _shown(examples: Sequence[Example], training: Training, step: int) -> Iterator[dict[str, np.ndarray]]:
    """What is shown in each step after `step`.

    That follows from the step's number, so that a resumed run ends as one that was never stopped.
    """
    per_pass = batches_in(examples, training.batch)
    while step < training.steps:
        rng = np.random.default_rng([training.seed, step // per_pass])
        for batch in islice(batches(examples, rng, training, first=step % per_pass), training.steps - step):
            yield batch
            step += 1
