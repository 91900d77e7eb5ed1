"""Double DQN targets and losses (van Hasselt et al. 2016), pure functions; and one compiled update of many experts.

A replay buffer of whole states allows three additions. All actions that are known to fail in a state have the target 0
in every update, not one action at a time. A target is never below the best return that was ever reached from there
(optimality tightening, He et al. 2017, with the bound itself as the target). And where an action has led to the whole
chair, all others must be worth less by a margin (the large-margin loss of Hester et al. 2018, "Deep Q-learning from
Demonstrations"; the agent's own episodes are the demonstrations): most actions of a state are never tried, and a single
one of thousands that Q overestimates ends an episode.

Sources: H. van Hasselt, A. Guez, D. Silver, "Deep Reinforcement Learning with Double Q-learning", AAAI 2016, eq. 4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.learning.layers import Array, Params
from roboassembly.learning.paper import heads
from roboassembly.learning.paper.dqn.network import branch_values, existing_pairs, values_of

_CLIP = 5.0
"""Largest norm of the gradient."""
_MARGIN = 0.1
"""Margin of `margin_loss`, as a share of the largest return."""


def bounded_target(target: Array, reached: Array) -> Array:
    """Return a target raised to the best return that was reached from there, within 0 and 1 (He et al. 2017).

    Args:
        target: (...,) targets, as shares of the largest return.
        reached: (...,) best returns that were reached, in the same unit.
    """
    xp = target.__array_namespace__()
    return xp.clip(xp.maximum(target, reached), 0.0, 1.0)


def loss(p: Params, target: Params, batch: Mapping[str, Array]) -> Array:
    """Return the loss of one expert.

    Args:
        p: weights of the network in training.
        target: weights of the target network.
        batch: arrays of `ReplayBuffer.sample`: `features` and `part` of the chair; `joined`, `free` and `fails`
            (b, n, n, w) of states; for k known merges of each state `actions` (b, k, 3), `rewards`, `done`, `bound` and
            `real` (b, k), and the next states, `next_joined` (b * k, ...) and `next_free`; `whole` (b, n, n, w), which
            actions have led to the whole chair. Rewards and bounds are shares of the largest return.
    """
    fixed = batch["features"], batch["part"]
    each = branch_values(p, *fixed, batch["joined"], batch["free"])
    fails = batch["fails"]
    q = heads.combined(each)
    # Most known actions fail. What matters is that none of them ranks first, so the highest of them counts most.
    wrong = jnp.where(fails, failure_loss(q), 0.0).sum((1, 2, 3)) / jnp.maximum(fails.sum((1, 2, 3)), 1.0)
    worst = _highest(jax.lax.stop_gradient(q), fails)
    wrong = wrong + 0.2 * failure_loss(_q_of(each, worst)) * fails.any((1, 2, 3))
    chosen = _q_of(each, batch["actions"])
    after = batch["next_joined"], batch["next_free"]
    online = jax.lax.stop_gradient(branch_values(p, *fixed, *after))
    best = best_actions(online, existing_pairs(batch["part"], *after))
    # The online network selects the action and the target network evaluates it (van Hasselt et al. 2016, eq. 4).
    ahead = values_of(target, *fixed, *after, best).reshape(chosen.shape)
    # Returns are not discounted, because an episode has as many merges as the chair has parts but one.
    ahead = batch["rewards"] + jnp.where(batch["done"], 0.0, ahead)
    right = (chosen - bounded_target(ahead, batch["bound"])) ** 2 * batch["real"]
    exists = existing_pairs(batch["part"], batch["joined"], batch["free"])
    short = margin_loss(each, exists[..., None], batch["whole"])
    return (wrong + 2.0 * right.sum(1) / jnp.maximum(batch["real"].sum(1), 1.0) + short).mean()


def failure_loss(q: Array) -> Array:
    """Return the loss of an action that fails: the square of its Q, a twentieth of it if Q is negative."""
    return jnp.maximum(q, 0.0) ** 2 + 0.05 * q**2


def _highest(x: Array, among: Array) -> Array:
    """Return (b, 3) the index of the largest of (b, n, n, w) values among some."""
    b, n, _, choices = x.shape
    x = jnp.where(among, x, -jnp.inf).reshape(b, n * n, choices)
    # The largest of each pair of points first: on a CPU half the time of one search.
    pair = x.max(-1).argmax(-1)
    return jnp.stack([pair // n, pair % n, x[jnp.arange(b), pair].argmax(-1)], axis=-1)


def _q_of(each: Sequence[Array], actions: Array) -> Array:
    """Return (b, ...) the Q of some actions (b, ..., 3), from what each branch adds.

    The gradient touches a few numbers only, where that of a maximum over Q would be as large as all of them.
    """
    row, column, choice = (actions[..., i] for i in range(3))
    state = jnp.arange(len(actions)).reshape(-1, *[1] * (row.ndim - 1))
    choices = jnp.unravel_index(choice, tuple(x.shape[-1] for x in each))
    return reduce(jnp.add, (x[state, row, column, w] for x, w in zip(each, choices, strict=True)))


def margin_loss(each: Sequence[Array], exists: Array, whole: Array) -> Array:
    """Return how much the best of some actions falls short of all others and a margin (Hester et al. 2018).

    0 where there are no such actions.

    Args:
        each: (b, n, n, w_i) what each branch adds to Q; w counts all of their combinations.
        exists: (b, n, n, 1) or more.
        whole: (b, n, n, w) which actions have led to the whole chair.
    """
    q = heads.combined(jax.lax.stop_gradient(each))
    rest = exists & ~whole
    best, others = _q_of(each, _highest(q, whole)), _q_of(each, _highest(q, rest)) + _MARGIN
    both = whole.any((1, 2, 3)) & rest.any((1, 2, 3))
    return jnp.where(both & (others > best), others - best, 0.0)


def best_actions(each: Sequence[Array], exists: Array) -> Array:
    """Return (b, 3) the action with the highest Q in each state: rows of the two points, and number of the choice.

    Branches are added, so that each has its best choice by itself, and no array over all combinations is needed.

    Args:
        each: (b, n, n, w_i) what each branch adds to Q.
        exists: (b, n, n) which pairs of points exist.
    """
    b, n = exists.shape[:2]
    highest = reduce(jnp.add, (x.max(-1) for x in each))
    pair = jnp.where(exists, highest, -jnp.inf).reshape(b, n * n).argmax(-1)
    row, column = pair // n, pair % n
    there = [x[jnp.arange(b), row, column].argmax(-1) for x in each]
    choice = there[0]
    for x, more in zip(each[1:], there[1:], strict=True):
        choice = choice * x.shape[-1] + more
    return jnp.stack([row, column, choice], axis=-1)


def optimiser(rate: float) -> optax.GradientTransformation:
    """Return Adam with clipped gradients."""
    return optax.chain(optax.clip_by_global_norm(_CLIP), optax.adam(rate))


def update(rate: float, params: Any, target: Any, opt_state: Any, batch: Any) -> tuple[Any, Any, Any]:
    """Make one step of Adam for each of several experts; the first axis of all arrays counts experts."""
    experts = params, target, opt_state, batch
    if jax.default_backend() != "cpu":
        return _update_all(rate, *experts)
    # On a CPU one after another: all at once would not fit the cache, take twice as long, and be compiled anew for
    # every number of experts.
    several = [_update(rate, *slice_of(experts, i)) for i in range(len(batch["part"]))]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *several)


def _updated(rate: float, params: Any, target: Any, opt_state: Any, batch: Any) -> tuple[Any, Any, Any]:
    value, gradient = jax.value_and_grad(loss)(params, target, batch)
    change, opt_state = optimiser(rate).update(gradient, opt_state, params)
    return optax.apply_updates(params, change), opt_state, value


@partial(jax.jit, static_argnums=0)
def _update_all(rate: float, params: Any, target: Any, opt_state: Any, batch: Any) -> tuple[Any, Any, Any]:
    return jax.vmap(partial(_updated, rate))(params, target, opt_state, batch)


_update = jax.jit(_updated, static_argnums=0)


def slice_of(tree: Any, i: int) -> Any:
    """Return the arrays of one expert from arrays over several."""
    return jax.tree.map(lambda x: np.asarray(x)[i], tree)
