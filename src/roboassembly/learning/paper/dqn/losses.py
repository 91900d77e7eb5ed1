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
from roboassembly.learning.paper.dqn.network import branch_values, existing_pairs

_CLIP = 5.0
"""Largest norm of the gradient."""
_MARGIN = 0.1
"""Margin of `margin_loss`, as a share of the largest return."""


def double_q_target(reward: Array, done: Array, next_online: Array, next_target: Array, exists: Array) -> Array:
    """Return the Double DQN target `r + Q_target(s', argmax_a' Q_online(s', a'))`; `r` at the end of an episode.

    The online network selects the action and the target network evaluates it (van Hasselt et al. 2016, eq. 4). Returns
    are not discounted, because an episode has as many merges as the chair has parts but one.

    Args:
        reward: (...,) rewards.
        done: (...,) whether the episode ended.
        next_online: (..., a) Q of the network in training.
        next_target: (..., a) Q of the target network.
        exists: (..., a) which actions exist in the next state.
    """
    xp = reward.__array_namespace__()
    best = xp.argmax(xp.where(exists, next_online, -xp.inf), axis=-1)
    ahead = xp.take_along_axis(next_target, best[..., None], axis=-1)[..., 0]
    return reward + xp.where(done, 0.0, ahead)


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
    n, fails = each[0].shape[1], batch["fails"]
    # Most known actions fail. What matters is that none of them ranks first, so the highest of them counts most.
    wrong = jnp.where(fails, failure_loss(heads.combined(each)), 0.0).sum((1, 2, 3))
    wrong = wrong / jnp.maximum(fails.sum((1, 2, 3)), 1.0)
    worst = _highest(failure_loss(heads.combined(jax.lax.stop_gradient(each))), fails)
    wrong = wrong + 0.2 * failure_loss(_q_of(each, worst)) * fails.any((1, 2, 3))
    chosen = _q_of(each, batch["actions"])
    after = batch["next_joined"], batch["next_free"]
    online, evaluated = best_branches(
        jax.lax.stop_gradient(branch_values(p, *fixed, *after)), branch_values(target, *fixed, *after)
    )
    exists_after = existing_pairs(batch["part"], *after)
    ahead = double_q_target(
        batch["rewards"].ravel(), batch["done"].ravel(),
        *(x.reshape(-1, n * n) for x in (online, evaluated, exists_after)),
    ).reshape(chosen.shape)  # fmt: skip
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


def best_branches(online: Sequence[Array], target: Sequence[Array]) -> tuple[Array, Array]:
    """Return the highest Q of each pair of points over all choices, and the target network's Q of that choice.

    The values of branches are added, so that each branch has its best choice by itself; no array over all combinations
    is needed.

    Args:
        online: (..., w_i) what each branch adds, by the network in training.
        target: (..., w_i) the same by the target network.

    Returns:
        (...) both.
    """
    xp = online[0].__array_namespace__()
    best = [xp.argmax(x, axis=-1, keepdims=True) for x in online]
    highest = [xp.take_along_axis(x, i, axis=-1)[..., 0] for x, i in zip(online, best, strict=True)]
    evaluated = [xp.take_along_axis(x, i, axis=-1)[..., 0] for x, i in zip(target, best, strict=True)]
    return reduce(xp.add, highest), reduce(xp.add, evaluated)


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
