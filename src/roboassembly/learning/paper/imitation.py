"""Imitation learning of the paper's policy: the experts' Q-values with the loss `L1 + 50 L2`."""

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
from jaxtyping import Bool, Float, Int

from roboassembly.errors import InputError
from roboassembly.furniture.model import PAPER_POINTS
from roboassembly.learning import checkpoint
from roboassembly.learning.batches import padded_length
from roboassembly.learning.fit import AdamWConfig, Batch, Fit
from roboassembly.learning.layers import Array, Params
from roboassembly.learning.paper import heads
from roboassembly.learning.paper import network as paper
from roboassembly.learning.paper.examples import COMPLETION_REWARD, PaperExample, scattered
from roboassembly.learning.paper.network import PaperConfig

LAMBDA = 50.0
"""The paper's weight of L2."""
_SORTED = 8
"""Number of batches among which examples of like size are grouped: padding costs time."""
_LEAST_L1 = 1e-3
"""Least norm of the difference of Q-values, where its gradient is still finite."""
_NORMALISED_BY = 4096
"""Largest number of states that give the mean and deviation of the inputs."""


@dataclass(frozen=True)
class PaperTraining(AdamWConfig):
    """Settings of the training of the paper's policy."""

    steps: int = 30_000
    """Number of gradient steps."""
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
        "best": np.array([e.best for e in examples], np.int32),
    }
    states = [e.state(int(rng.integers(len(e.features))) if rng is not None else 0) for e in examples]
    if scatter and rng is not None:
        # All states at once: most of the time would go into the calls.
        ends = np.cumsum([len(state.poses) for state in states])
        begins = [0, *ends[:-1].tolist()]
        groups = np.concatenate([begin + e.group_of_part for begin, e in zip(begins, examples, strict=True)])
        poses = scattered(np.concatenate([s.poses for s in states]), groups, paper.setting_of(full), rng)
        poses = np.split(poses, ends[:-1])
        states = [replace(state, poses=moved) for state, moved in zip(states, poses, strict=True)]
    for row, (e, state) in enumerate(zip(examples, states, strict=True)):
        state.write(batch["state"][row])
        free = slice(len(e.part))
        batch["slot"][row, free] = PAPER_POINTS * e.part + e.point
        batch["exists"][row, free, free] = e.group[:, None] != e.group[None]
        batch["branch_targets"][row, free, free] = e.branch_targets()
    return batch


def targets(batch: Batch) -> Array:
    """Return (b, n, n, w) the Q-values to imitate, over all combinations of branches, from a batch of `batch_of`."""
    each, bound = batch["branch_targets"], batch["max_return"]
    xp = each.__array_namespace__()
    branches = next(c.branches for c in (PaperConfig(), PaperConfig(full=True)) if sum(c.branches) == each.shape[3])
    values = heads.split(xp.astype(each, xp.float32), branches)
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
    if len(each) > 1 and jax.default_backend() == "cpu":
        # State by state: all combinations of grasps of a whole batch would take hundreds of megabytes, several times,
        # and leave the cache.
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
    initial: Path | None = None,
) -> Iterator[tuple[int, dict[str, float]]]:
    """Train until `training.steps`, from the checkpoint at `path` if there is one; yields step and losses.

    Args:
        examples: states to learn from.
        encoder: weights of the auto-encoder that made their features; kept in the checkpoint, unchanged.
        path: file of the checkpoint.
        training: settings of the training.
        config: sizes of the network; its setting follows from the examples.
        notes: origin of the examples, kept in the checkpoint.
        initial: checkpoint whose weights come first, if training starts anew.

    Raises:
        InputError: there are no examples, they are of both settings, or the checkpoint at `path` is of other training.
    """
    if not examples:
        raise InputError(f"no samples for '{path}'; collect some first")
    config = replace(config, full=examples[0].grasps is not None)
    if any((e.grasps is not None) != config.full for e in examples):
        raise InputError(f"the samples for '{path}' are of both settings; give those of one")

    def init_params() -> Params:
        if initial is not None:
            return checkpoint.load(initial, paper.KIND).params
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
