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
from roboassembly.learning import grasping
from roboassembly.learning.grasp_lessons import BLOCKED, FAILS, MERGES, UNKNOWN, GraspCourse
from roboassembly.learning.hands import handling_of
from roboassembly.learning.imitation import cross_entropy
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.runs import Run
from roboassembly.processes import in_order

_FIRM = 2.0
"""Weight of what the arms said, which is known of few, against what the cheap tests did."""


@dataclass(frozen=True)
class Training:
    """How to train."""

    steps: int = 12_000
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
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
    known: np.ndarray
    chair: np.ndarray
    """Number of the chair of each."""


def examples_of(paths: Sequence[Path], jobs: int) -> Examples:
    """All lessons of some files.

    Raises:
        InputError: a file is broken, or there are no lessons.
    """
    rows = [(i, row) for i, some in enumerate(in_order(_rows, paths, jobs, chunk=4)) for row in some]
    if not rows:
        raise InputError("no lessons of grasps to learn from")
    one, two, there, known = (np.array(column) for column in zip(*(row for _, row in rows), strict=True))
    return Examples(one, two, there, known, np.array([i for i, _ in rows]))


def _rows(path: Path) -> list[tuple[np.ndarray, ...]]:
    course = GraspCourse.load(path)
    out = []
    for lesson in course.lessons:
        seen = handling_of(course.situation(lesson), *lesson.pair)
        out.append((seen.one, seen.two, seen.there, lesson.known))
    return out


def losses(params: Params, batch: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Binary cross-entropy of both answers where they are known, averaged over pairs of points."""
    logits = grasping.apply(params, batch["one"], batch["two"])
    known, there = batch["known"], batch["there"]
    told = there & (known != UNKNOWN)
    room = _mean(cross_entropy(logits[..., 0], known != BLOCKED), told)
    tried = there & ((known == MERGES) | (known == FAILS))
    arms = _mean(cross_entropy(logits[..., 1], known == MERGES), tried)
    return room + _FIRM * arms, {"room": room, "arms": arms}


def _mean(values: Array, which: Array) -> Array:
    return (values * which).sum() / jnp.maximum(which.sum(), 1)


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
        names = ("one", "two", "there", "known")
        params, state, terms = _update(training, params, state, {k: getattr(examples, k)[chosen] for k in names})
        step += 1
        run.keep(step, params, state)
        yield step, {k: float(v) for k, v in terms.items()}


def quality(params: Params, examples: Examples) -> dict[str, float]:
    """How often the surest hands are good ones.

    Returns:
        `room`: share of pairs of points with hands that fit of which the surest fit; `arms`: of those that were tried,
        share that the network puts on the right side of a half.
    """
    logits = np.asarray(grasping.apply(params, examples.one, examples.two))
    told = examples.there & (examples.known != UNKNOWN)
    fits = told & (examples.known != BLOCKED)
    hope = np.flatnonzero(fits.any(axis=(1, 2)))
    first = np.where(told, logits.sum(axis=3), -np.inf)[hope].reshape(len(hope), -1).argmax(axis=1)
    tried = (examples.known == MERGES) | (examples.known == FAILS)
    arms = (logits[..., 1][tried] > 0.0) == (examples.known[tried] == MERGES)
    return {"room": float(fits[hope].reshape(len(hope), -1)[np.arange(len(hope)), first].mean()),
            "arms": float(arms.mean())}  # fmt: skip
