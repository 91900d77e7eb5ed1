"""Teaches the paper's policy from lessons: imitation of Q-values with `L1 + 50 L2`, resumable at any moment.

The teacher is a chair's expert where a lesson has its Q-values, else the oracle, whose answers give the best
undiscounted return-to-go exactly (`targets`). Both are returns: 1 for each merge, 4 more for the whole.
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
from jaxtyping import Bool, Float, Float16, Float32, Int16

from roboassembly.errors import InputError
from roboassembly.furniture.model import MAX_POINTS
from roboassembly.learning.augmentation import FrameChange, augmented
from roboassembly.learning.batches import padded_length
from roboassembly.learning.datasets import LabeledState, SampleSet, group_labels
from roboassembly.learning.layers import Params
from roboassembly.learning.paper import autoencoder, heads
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.autoencoder import CLOUD_POINTS
from roboassembly.learning.paper.network import PaperConfig, PaperState
from roboassembly.learning.training_run import Run
from roboassembly.parallel.processes import prefetch
from roboassembly.task.rules.connections import UP_AXES

LAMBDA = 50.0
"""The paper's weight of L2."""
WHOLE = 4.0
"""Reward for the whole furniture, besides 1 for the last merge."""
_ENCODED = 32
"""Clouds at a time."""
_SORTED = 8
"""Batches among which examples of like size are put together: padding costs time."""
_NORMALISED_BY = 4096
"""States, at most, that the mean and deviation of the inputs are taken from."""


@dataclass(frozen=True)
class Training:
    """How to train."""

    steps: int = 20_000
    learning_rate: float = 1.5e-3
    warmup: int = 200
    weight_decay: float = 5e-2
    batch: int = 64
    """States."""
    scatter: bool = True
    """Let groups lie elsewhere in every state that is taught, at random (not in the paper)."""
    seed: int = 0
    keep_every: float = 60.0
    """Seconds between checkpoints."""


@dataclass(frozen=True)
class Augmentation:
    """What is made of each course before training."""

    copies: int = 4
    """Noisy clouds of each part, besides the clean one."""
    noise: float = 0.003
    """Metres: standard deviation of the noise along each axis."""
    changes: int = 0
    """Versions of each chair besides itself: mirrored, turned, of another size (not in the paper)."""
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Example:
    """A state ready for the network, small enough to keep a hundred thousand."""

    course: int
    features: Float32[np.ndarray, "c P 48"]
    """Of the parts' clouds: clean, then noisy copies. Shared by the states of a chair."""
    points: Float16[np.ndarray, "P K 9"]
    poses: Float16[np.ndarray, "P 6"]
    connections: Float16[np.ndarray, "P P 6"]
    part: Int16[np.ndarray, "n"]
    """Of each free point."""
    point: Int16[np.ndarray, "n"]
    group: Int16[np.ndarray, "n"]
    joints: Int16[np.ndarray, "j 2"]
    """Rows and columns of right pairs."""
    worth: Float32[np.ndarray, "j 6"]
    """Exact Q-values of right pairs; all others' are 0."""
    values: Float16[np.ndarray, "n n h"] | None
    """An expert's Q-values as in `LabeledState`, taught in place of `worth` if there are any."""
    grasps: Float32[np.ndarray, "P 8 6"] | None
    """The hand at each grasp, with robots."""

    @property
    def parts(self) -> int:
        """How many."""
        return len(self.poses)

    def state(self, copy: int) -> PaperState:
        """With one of the copies of the features."""
        return PaperState(self.features[copy], self.points, self.poses, self.connections, self.grasps)

    def taught(self) -> Float[np.ndarray, "n n h"]:
        """What each choice adds to the Q-values to imitate, one after another: the expert's, or exact ones."""
        return self.exact() if self.values is None else self.values

    @property
    def most(self) -> float:
        """Of what is taught no more than this counts: what is left to be had, which experts overrate."""
        return np.inf if self.values is None else len(np.unique(group_labels(self.connections))) - 1 + WHOLE

    def exact(self) -> Float32[np.ndarray, "n n 6"]:
        """Exact Q-values."""
        n = len(self.part)
        out = np.zeros((n, n, len(UP_AXES)), np.float32)
        out[self.joints[:, 0], self.joints[:, 1]] = self.worth
        return out


def worth_of(lesson: LabeledState) -> Float32[np.ndarray, "j 6"]:
    """Exact Q of the right pairs in `lesson.mates`: the best undiscounted return from the action on.

    Where the furniture can be finished after it, that is one for this and each later merge, and 4. A merge into a dead
    end counts 1: what more could be had there the oracle does not tell, so this is a lower bound. An action that
    cannot be carried out has 0, and so has every wrong pair.
    """
    merges = len(np.unique(lesson.group)) - 1
    solvable, ways = lesson.mates[:, 4:5], lesson.mates[:, 5:]
    return (ways * np.where(solvable, merges + WHOLE, 1.0)).astype(np.float32)


def examples_of(courses: Sequence[SampleSet], encoder: Params, augmentation: Augmentation) -> list[Example]:
    """All lessons of some courses, augmented: what the same seed draws does not depend on the other courses."""
    return [
        example
        for index, course in enumerate(courses)
        for example in _examples_of_one(course, index, encoder, augmentation)
    ]


def _examples_of_one(course: SampleSet, index: int, encoder: Params, a: Augmentation) -> Iterator[Example]:
    rng = np.random.default_rng([a.seed, index])
    for version in [course, *(augmented(course, FrameChange.draw(rng)) for _ in range(a.changes))]:
        clouds = version.clouds[:, :CLOUD_POINTS]
        noisy = [clouds + rng.normal(0.0, a.noise, clouds.shape).astype(np.float32) for _ in range(a.copies)]
        features = _features(encoder, np.concatenate([clouds, *noisy])).reshape(1 + a.copies, len(clouds), -1)
        for lesson in version.samples:
            yield _example(lesson, index, features, version.grasps)


def _features(encoder: Params, clouds: Float32[np.ndarray, "b n 3"]) -> Float32[np.ndarray, "b 48"]:
    """Of many clouds, some at a time, so that one shape is compiled."""
    room = np.zeros((-(-len(clouds) // _ENCODED) * _ENCODED, *clouds.shape[1:]), np.float32)
    room[: len(clouds)] = clouds
    chunks = np.split(room, len(room) // _ENCODED)
    return np.concatenate([np.asarray(_encode(encoder, chunk)) for chunk in chunks])[: len(clouds)]


_encode = jax.jit(autoencoder.encode)


def _example(
    lesson: LabeledState,
    index: int,
    features: Float32[np.ndarray, "c P 48"],
    grasps: Float32[np.ndarray, "P 8 6"] | None,
) -> Example:
    part, point = np.nonzero(lesson.free)
    number = np.full(lesson.free.shape, -1)
    number[part, point] = np.arange(len(part))
    u, k, v, l = lesson.mates[:, :4].T  # noqa: E741
    return Example(
        course=index,
        features=features,
        points=lesson.points.astype(np.float16),
        poses=lesson.poses.astype(np.float16),
        connections=lesson.connections.astype(np.float16),
        part=part.astype(np.int16),
        point=point.astype(np.int16),
        group=lesson.group[part].astype(np.int16),
        joints=np.stack([number[u, k], number[v, l]], axis=1).astype(np.int16),
        worth=worth_of(lesson),
        values=lesson.q_values,
        grasps=grasps,
    )


def scattered(
    poses: Float[np.ndarray, "P 6"], connections: Float[np.ndarray, "P P 6"], rng: np.random.Generator
) -> Float[np.ndarray, "P 6"]:
    """World poses after each group is turned about the vertical and moved up to half a metre: nothing depends on it."""
    joined = (connections != 0).any(axis=2) | np.eye(len(poses), dtype=bool)
    group = np.argmax(joined, axis=1)
    angle = rng.uniform(-np.pi, np.pi, len(poses))[group]
    shift = rng.uniform(-0.5, 0.5, (len(poses), 2))[group]
    center = poses[group, :2]
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = (poses[:, :2] - center).T
    out = poses.astype(np.float32)
    out[:, :2] = center + shift + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
    out[:, 5] = (poses[:, 5] + angle + np.pi) % (2.0 * np.pi) - np.pi  # yaw is turned last
    return out


def batch_of(
    examples: Sequence[Example], rng: np.random.Generator | None, *, scatter: bool = False
) -> dict[str, np.ndarray]:
    """Padded arrays with targets.

    Args:
        examples: at least one.
        rng: draws noisy copies of features, and what follows; without it there is neither.
        scatter: let groups lie elsewhere.

    Returns:
        `state` (b, s), `slot` (b, n), `exists` (b, n, n), and what `targets` takes.
    """
    hands = examples[0].grasps is not None
    b, n = len(examples), padded_length(max(len(e.part) for e in examples))
    batch = {
        "state": np.zeros((b, paper.size(hands)), np.float32),
        "slot": np.zeros((b, n), np.int32),
        "exists": np.zeros((b, n, n), bool),
        # All combinations of choices would be four times as much with robots, and half precision holds what is taught.
        "taught": np.zeros((b, n, n, sum(PaperConfig(hands=hands).ways)), np.float16),
        "most": np.array([e.most for e in examples], np.float32),
    }
    for row, e in enumerate(examples):
        state = e.state(int(rng.integers(len(e.features))) if rng is not None else 0)
        if scatter and rng is not None:
            state = replace(state, poses=scattered(state.poses, state.connections, rng))
        state.write(batch["state"][row])
        free = slice(len(e.part))
        batch["slot"][row, free] = MAX_POINTS * e.part + e.point
        batch["exists"][row, free, free] = e.group[:, None] != e.group[None]
        batch["taught"][row, free, free] = e.taught()
    return batch


def targets(batch: dict[str, Any]) -> Any:
    """(b, n, n, w) Q-values to imitate, of all ways, from what `batch_of` put together."""
    taught, most = batch["taught"], batch["most"]
    xp = taught.__array_namespace__()
    choices = next(c.ways for c in (PaperConfig(), PaperConfig(hands=True)) if sum(c.ways) == taught.shape[3])
    ends = np.cumsum(choices).tolist()
    each = [xp.astype(taught[..., end - n : end], xp.float32) for n, end in zip(choices, ends, strict=True)]
    return xp.minimum(heads.together(each), most[:, None, None, None])


def imitation_losses(
    q: Float[jax.Array, "b a"], target: Float[jax.Array, "b a"], exists: Bool[jax.Array, "b a"]
) -> tuple[Float[jax.Array, "b"], Float[jax.Array, "b"]]:
    """The paper's two losses of each state, over the actions that exist.

    L1 is the squared norm of `Q - Q_teacher`, a sum over actions. (The paper writes the norm and calls it a mean square
    loss. With the mean over actions, 50 L2 has its way, and that is least where all values are one.)

    L2 is `max_a Q(a) - Q(argmax_a Q_teacher(a))`, 0 where the student's choice is the teacher's. Where several actions
    are equally best for the teacher, that among them counts which the student values most: any would do, and if one
    were named, equal parts and equal ways would push each other down.
    """
    l1 = (jnp.where(exists, q - target, 0.0) ** 2).sum(1)
    best = exists & (target >= jnp.where(exists, target, -jnp.inf).max(1, keepdims=True))
    highest, chosen = (jnp.where(some, q, -jnp.inf).max(1) for some in (exists, best))
    return l1, jnp.where(exists.any(1), highest - chosen, 0.0)


def losses(network: Any, inputs: Any, batch: dict[str, Any]) -> tuple[jax.Array, dict[str, jax.Array]]:
    """`L1 + 50 L2`, and its terms, averaged over a batch; `chosen` is how often the student's choice is a best one."""
    each = paper.choices(network, inputs, batch["state"], batch["slot"])
    taught = {name: batch[name] for name in ("exists", "taught", "most")}
    # State by state: with robots all ways of a whole batch would take hundreds of megabytes, several times over.
    l1, l2 = jax.lax.map(jax.checkpoint(_losses_of_one), (each, taught))
    terms = {"l1": l1.mean(), "l2": l2.mean(), "chosen": (l2 <= 0.0).mean()}
    return (l1 + LAMBDA * l2).mean(), terms


def _losses_of_one(one: tuple[list[jax.Array], dict[str, jax.Array]]) -> tuple[jax.Array, jax.Array]:
    each, taught = jax.tree.map(lambda x: x[None], one)
    q = heads.together(each)
    exists = jnp.broadcast_to(taught["exists"][..., None], q.shape)
    l1, l2 = imitation_losses(*(x.reshape(1, -1) for x in (q, targets(taught), exists)))
    return l1[0], l2[0]


def share_good(params: Params, examples: Sequence[Example]) -> float:
    """In what share of the states that are no dead ends the furniture can be finished after the best-valued action.

    Args:
        params: of a checkpoint of kind `paper`.
        examples: the states.
    """
    examples = [e for e in examples if (e.worth >= WHOLE).any()]
    good = np.zeros(len(examples), bool)
    for row, e in enumerate(examples):
        batch = batch_of([e], None)
        n = len(e.part)
        q = paper.apply(params["network"], params["inputs"], batch["state"], batch["slot"][:, :n])[0]
        q = np.where(batch["exists"][0, :n, :n, None], q, -np.inf)
        exact = e.exact()
        good[row] = exact.ravel()[np.argmax(q)] >= WHOLE
    return float(good.mean())


def optimiser(t: Training) -> optax.GradientTransformation:
    """AdamW with warm-up and cosine decay."""
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, t.learning_rate, min(t.warmup, t.steps // 10), t.steps, 0.02 * t.learning_rate
    )
    return optax.chain(optax.clip_by_global_norm(10.0), optax.adamw(schedule, weight_decay=t.weight_decay))


@partial(jax.jit, static_argnums=0, donate_argnums=(1, 3))
def _update(t: Training, network: Any, inputs: Any, state: Any, batch: Any) -> tuple[Any, Any, dict[str, jax.Array]]:
    (loss, terms), gradient = jax.value_and_grad(losses, has_aux=True)(network, inputs, batch)
    updates, state = optimiser(t).update(gradient, state, network)
    return optax.apply_updates(network, updates), state, {"loss": loss, **terms}


def train(
    examples: Sequence[Example], encoder: Params, path: Path, training: Training, config: PaperConfig,
    notes: dict[str, Any],
) -> Iterator[tuple[int, dict[str, float]]]:  # fmt: skip
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    A run that was stopped and goes on ends with the same weights as one that was not: what a step sees follows from
    its number.

    Args:
        examples: to learn from.
        encoder: of the auto-encoder that made their features; kept in the checkpoint, unchanged.
        path: of the checkpoint, written every `training.keep_every` seconds, every 1,000 steps and at the end.
        training: how.
        config: of the network; whether it chooses grasps follows from the lessons.
        notes: kept in the checkpoint: what it was trained on.

    Raises:
        InputError: there is nothing to learn from, lessons are of both settings, or the checkpoint at `path` is of
            other training.
    """
    if not examples:
        raise InputError(f"no lessons for '{path}'; gather some first")
    config = replace(config, hands=examples[0].grasps is not None)
    if any((e.grasps is not None) != config.hands for e in examples):
        raise InputError(f"the lessons for '{path}' are of both settings; give those of one")
    about = {"network": asdict(config), "training": asdict(training), **notes}
    network: Any = paper.init(np.random.default_rng(training.seed), config)
    run = Run(path, paper.KIND, about, training.steps, training.keep_every)
    step, params, state = run.resume({"network": network}, optimiser(training).init(network))
    network = params["network"]
    inputs = params["inputs"] if step else _inputs(examples, training.seed)
    for batch in prefetch(_shown(examples, training, step)):
        network, state, terms = _update(training, network, inputs, state, batch)
        step += 1
        run.keep(step, {"encoder": encoder, "inputs": inputs, "network": network}, state)
        yield step, {k: float(v) for k, v in terms.items()}


def _shown(examples: Sequence[Example], training: Training, step: int) -> Iterator[dict[str, np.ndarray]]:
    """What is shown in each step after `step`; it follows from the step's number."""
    per_pass = -(-len(examples) // training.batch)
    pass_, order = -1, np.zeros(0, int)
    for number in range(step, training.steps):
        if number // per_pass != pass_:
            pass_ = number // per_pass
            order = _order(examples, training.batch, np.random.default_rng([training.seed, 0, pass_]))
        rng = np.random.default_rng([training.seed, 1, number])
        yield batch_of([examples[i] for i in order[number % per_pass]], rng, scatter=training.scatter)


def _order(examples: Sequence[Example], batch: int, rng: np.random.Generator) -> np.ndarray:
    """One pass: (batches, batch) numbers of examples, mixed, but those of like size together within a few batches."""
    order = np.resize(rng.permutation(len(examples)), -(-len(examples) // batch) * batch)
    sizes = np.array([len(e.part) for e in examples])[order]
    windows = np.arange(len(order)) // (_SORTED * batch)
    batches = order[np.lexsort((sizes, windows))].reshape(-1, batch)
    return batches[rng.permutation(len(batches))]


def _inputs(examples: Sequence[Example], seed: int) -> Params:
    some = np.random.default_rng([seed, 2]).permutation(len(examples))[:_NORMALISED_BY]
    states = np.zeros((len(some), paper.size(examples[0].grasps is not None)), np.float32)
    for row, i in zip(states, some, strict=True):
        examples[i].state(0).write(row)
    return dict(paper.standard(states))
