"""Teaches the relational policy which hands can join a pair, from `grasp_lessons`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.errors import InputError
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import UNKNOWN, YES, GraspSamples
from roboassembly.learning.relational.grasps.features import grasp_features
from roboassembly.learning.relational.imitation import cross_entropy
from roboassembly.learning.training_run import Run
from roboassembly.parallel.processes import map_ordered

_TOGETHER = ("fit", "reach", "finish")
"""What is said of two hands, in this order."""


@dataclass(frozen=True)
class Training:
    """How to train."""

    steps: int = 12_000
    learning_rate: float = 2e-3
    weight_decay: float = 0.3
    """As much as this, because what arms can do is known of few actions only."""
    batch: int = 64
    """Pairs of points, with all their pairs of hands."""
    seed: int = 0
    keep_every: float = 60.0
    """Seconds between checkpoints."""


@dataclass(frozen=True, eq=False)
class Examples:
    """Pairs of points, ready for the network."""

    one: np.ndarray
    two: np.ndarray
    there: np.ndarray
    take: np.ndarray
    together: np.ndarray
    """`room`, `meet` and `rest` of `GraspLesson`, along the last axis."""


def examples_of(paths: Sequence[Path], jobs: int) -> Examples:
    """All lessons of some files.

    Raises:
        InputError: a file is broken, or there are no lessons.
    """
    rows = [row for some in map_ordered(_rows, paths, jobs, chunk=4) for row in some]
    if not rows:
        raise InputError("no lessons of grasps to learn from")
    return Examples(*(np.array(column) for column in zip(*rows, strict=True)))


def _rows(path: Path) -> list[tuple[np.ndarray, ...]]:
    course = GraspSamples.load(path)
    out = []
    for lesson in course.samples:
        seen = grasp_features(course.view(lesson), *lesson.pair)
        together = np.stack([lesson.fit, lesson.reach, lesson.finish], axis=-1)
        out.append((seen.single, seen.pair, seen.exists, lesson.pick, together))
    return out


def losses(params: Params, batch: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Binary cross-entropy of each answer, averaged over where it is known."""
    take, together = grasping.apply(params, batch["one"], batch["two"])
    terms = {"take": _mean(take, batch["take"])}
    there = batch["there"][..., None]
    known = jnp.where(there, batch["together"], UNKNOWN)
    terms |= {name: _mean(together[..., i], known[..., i]) for i, name in enumerate(_TOGETHER)}
    return sum(terms.values(), jnp.zeros(())), terms


def _mean(logits: Array, known: Array) -> Array:
    told = known != UNKNOWN
    return (cross_entropy(logits, known == YES) * told).sum() / jnp.maximum(told.sum(), 1)


def optimiser(t: Training) -> optax.GradientTransformation:
    """AdamW with cosine decay."""
    schedule = optax.cosine_decay_schedule(t.learning_rate, t.steps, 0.02)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=t.weight_decay))


@partial(jax.jit, static_argnums=0)
def _update(t: Training, params: Any, state: Any, batch: Any) -> tuple[Any, Any, dict[str, Array]]:
    (loss, terms), gradient = jax.value_and_grad(losses, has_aux=True)(params, batch)
    change, state = optimiser(t).update(gradient, state, params)
    return optax.apply_updates(params, change), state, {"loss": loss, **terms}


def train(
    examples: Examples, path: Path, training: Training, notes: dict[str, Any]
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    Raises:
        InputError: the checkpoint at `path` is of other training.
    """
    about = {"training": asdict(training), **notes}
    fresh: Any = grasping.init(np.random.default_rng(training.seed))
    run = Run(path, grasping.KIND, about, training.steps, training.keep_every)
    step, params, state = run.resume(fresh, optimiser(training).init(fresh))
    while step < training.steps:
        rng = np.random.default_rng([training.seed, step])
        chosen = rng.integers(len(examples.one), size=training.batch)
        batch = {name: array[chosen] for name, array in vars(examples).items()}
        params, state, terms = _update(training, params, state, batch)
        step += 1
        run.keep(step, params, state)
        yield step, {k: float(v) for k, v in terms.items()}


def quality(params: Params, examples: Examples) -> dict[str, float]:
    """What the network makes of lessons.

    Returns:
        For each answer the share of those known that it is on the right side of; and `first`, of pairs of points with
        hands known to have room, the share where the surest of all hands looked at have.
    """
    take, together = (np.asarray(x) for x in grasping.apply(params, examples.one, examples.two))
    out = {"take": _right(take, examples.take)}
    out |= {name: _right(together[..., i], examples.together[..., i]) for i, name in enumerate(_TOGETHER)}
    room = np.where(examples.there, examples.together[..., 0], UNKNOWN)
    hope = np.flatnonzero((room == YES).any(axis=(1, 2)))
    sure = np.where(room != UNKNOWN, together[..., 0], -np.inf)[hope].reshape(len(hope), -1)
    fits = (room[hope] == YES).reshape(len(hope), -1)
    return out | {"first": float(fits[np.arange(len(hope)), sure.argmax(axis=1)].mean())}


def _right(logits: np.ndarray, known: np.ndarray) -> float:
    told = known != UNKNOWN
    return float(((logits > 0.0) == (known == YES))[told].mean()) if told.any() else 1.0
