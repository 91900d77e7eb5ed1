"""Double DQN (van Hasselt et al. 2016) for many experts at once: losses and one compiled update.

Three things are added that a memory of whole states makes possible. All that is known to fail in a state is a target of
0 in every update, not one action at a time. A target is never below the best return that was ever lived through from
there (optimality tightening, He et al. 2017, with the bound itself as the target). And where an action has led to the
whole chair, all others have to be worth less by a margin (the large-margin loss of Hester et al. 2018, "Deep Q-learning
from Demonstrations"; here a learner's own plays are the demonstrations): most actions of a state are never tried, and
one of thousands that Q thinks too much of ends a play.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.learning.experts import apply, existing
from roboassembly.learning.layers import Array, Params

_CLIP = 5.0
_MARGIN = 0.1
"""In shares of the best return."""


def double_q_target(reward: Array, done: Array, next_online: Array, next_target: Array, exists: Array) -> Array:
    """What an action's Q should be: `r + Q_target(s', argmax_a' Q_online(s', a'))`, no discount, `r` if it is over.

    Args:
        reward: (...,).
        done: (...,) whether the episode ended.
        next_online: (..., a) by the network that learns.
        next_target: (..., a) by the target network.
        exists: (..., a) which actions exist in the next state.
    """
    xp = reward.__array_namespace__()
    best = xp.argmax(xp.where(exists, next_online, -xp.inf), axis=-1)
    ahead = xp.take_along_axis(next_target, best[..., None], axis=-1)[..., 0]
    return reward + xp.where(done, 0.0, ahead)


def loss(p: Params, target: Params, batch: dict[str, Array]) -> Array:
    """Of one expert.

    Args:
        p: of the network that learns.
        target: of the target network.
        batch: `features` and `part` of the chair; `joined`, `free`, `fails` (b, n, n, w) of states; of some merges
            known in each, `actions` (b, k, 3), `rewards`, `done`, `bound` and `real` (b, k), and the states that they
            lead to, `next_joined` (b * k, ...) and `next_free`. Rewards and bounds in shares of the best return.
            `whole` (b, n, n, w): actions that have led to the whole chair.
    """
    fixed = batch["features"], batch["part"]
    q = apply(p, *fixed, batch["joined"], batch["free"])
    b, n, _, ways = q.shape
    fails = batch["fails"].astype(jnp.float32)
    # Wrong pairs are by far the most; what matters is not to rank one of them first, so the largest count most.
    wrong = (jnp.maximum(q, 0.0) ** 2 + 0.05 * q**2) * fails
    wrong = wrong.sum((1, 2, 3)) / jnp.maximum(fails.sum((1, 2, 3)), 1.0) + 0.2 * wrong.max((1, 2, 3))
    row, column, way = (batch["actions"][..., i] for i in range(3))
    chosen = q[jnp.arange(b)[:, None], row, column, way]
    after = batch["next_joined"], batch["next_free"]
    online = jax.lax.stop_gradient(apply(p, *fixed, *after)).reshape(-1, n * n * ways)
    there = jnp.repeat(existing(batch["part"], *after).reshape(-1, n * n), ways, axis=1)
    ahead = double_q_target(
        batch["rewards"].ravel(), batch["done"].ravel(), online, apply(target, *fixed, *after).reshape(online.shape),
        there,
    ).reshape(chosen.shape)  # fmt: skip
    ahead = jnp.clip(jnp.maximum(ahead, batch["bound"]), 0.0, 1.0)
    right = (chosen - ahead) ** 2 * batch["real"]
    exists = existing(batch["part"], batch["joined"], batch["free"])
    short = margin_loss(q, exists[..., None], batch["whole"])
    return (wrong + 2.0 * right.sum(1) / jnp.maximum(batch["real"].sum(1), 1.0) + short).mean()


def margin_loss(q: Array, exists: Array, whole: Array) -> Array:
    """By how much the best of some actions falls short of all others and a margin; 0 where there are no such actions.

    Args:
        q: (b, n, n, w).
        exists: (b, n, n, 1) or more.
        whole: (b, n, n, w) the actions.
    """
    xp = q.__array_namespace__()
    best = xp.max(xp.where(whole, q, -xp.inf), axis=(1, 2, 3))
    others = xp.max(xp.where(exists & ~whole, q, -xp.inf), axis=(1, 2, 3)) + _MARGIN
    return xp.where(xp.any(whole, axis=(1, 2, 3)) & (others > best), others - best, 0.0)


def optimiser(rate: float) -> optax.GradientTransformation:
    """Adam with clipped gradients."""
    return optax.chain(optax.clip_by_global_norm(_CLIP), optax.adam(rate))


def update(rate: float, params: Any, target: Any, moments: Any, batch: Any) -> tuple[Any, Any, Any]:
    """One step of Adam for each of several experts; all arrays have an expert's number as their first axis."""
    experts = params, target, moments, batch
    if jax.default_backend() != "cpu":
        return _update_all(rate, *experts)
    # On a CPU one after another: all at once would go through memory, not through the cache, which takes twice as long,
    # and would be compiled anew for every number of experts.
    several = [_update(rate, *one_of(experts, i)) for i in range(len(batch["part"]))]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *several)


def _updated(rate: float, params: Any, target: Any, moments: Any, batch: Any) -> tuple[Any, Any, Any]:
    value, gradient = jax.value_and_grad(loss)(params, target, batch)
    change, moments = optimiser(rate).update(gradient, moments, params)
    return optax.apply_updates(params, change), moments, value


@partial(jax.jit, static_argnums=0)
def _update_all(rate: float, params: Any, target: Any, moments: Any, batch: Any) -> tuple[Any, Any, Any]:
    return jax.vmap(partial(_updated, rate))(params, target, moments, batch)


_update = jax.jit(_updated, static_argnums=0)


@jax.jit
def values(params: Any, features: Any, part: Any, joined: Any, free: Any) -> Any:
    """Q of one state for each of several experts."""
    return jax.vmap(lambda p, f, o, j, x: apply(p, f, o, j[None], x[None])[0])(params, features, part, joined, free)


def one_of(tree: Any, i: int) -> Any:
    """Of arrays over several experts those of one."""
    return jax.tree.map(lambda x: np.asarray(x)[i], tree)
