"""Double DQN (van Hasselt et al. 2016) for many experts at once: losses and one compiled update.

Three things are added that a memory of whole states makes possible. All that is known to fail in a state is a target of
0 in every update, not one action at a time. A target is never below the best return that was ever lived through from
there (optimality tightening, He et al. 2017, with the bound itself as the target). And where an action has led to the
whole chair, all others have to be worth less by a margin (the large-margin loss of Hester et al. 2018, "Deep Q-learning
from Demonstrations"; here a learner's own plays are the demonstrations): most actions of a state are never tried, and
one of thousands that Q thinks too much of ends a play.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from roboassembly.learning.layers import Array, Params
from roboassembly.learning.paper import heads
from roboassembly.learning.paper.dqn.network import added, apply, existing

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
    each = added(p, *fixed, batch["joined"], batch["free"])
    n, fails = each[0].shape[1], batch["fails"]
    # Wrong pairs are by far the most; what matters is not to rank one of them first, so the largest count most.
    wrong = jnp.where(fails, _wrong(heads.together(each)), 0.0).sum((1, 2, 3))
    wrong = wrong / jnp.maximum(fails.sum((1, 2, 3)), 1.0)
    worst = _first(_wrong(heads.together(jax.lax.stop_gradient(each))), fails)
    wrong = wrong + 0.2 * _wrong(_at(each, worst)) * fails.any((1, 2, 3))
    chosen = _at(each, batch["actions"])
    after = batch["next_joined"], batch["next_free"]
    online, there = best_ways(jax.lax.stop_gradient(added(p, *fixed, *after)), added(target, *fixed, *after))
    exists_after = existing(batch["part"], *after)
    ahead = double_q_target(
        batch["rewards"].ravel(), batch["done"].ravel(),
        *(x.reshape(-1, n * n) for x in (online, there, exists_after)),
    ).reshape(chosen.shape)  # fmt: skip
    ahead = jnp.clip(jnp.maximum(ahead, batch["bound"]), 0.0, 1.0)
    right = (chosen - ahead) ** 2 * batch["real"]
    exists = existing(batch["part"], batch["joined"], batch["free"])
    short = margin_loss(each, exists[..., None], batch["whole"])
    return (wrong + 2.0 * right.sum(1) / jnp.maximum(batch["real"].sum(1), 1.0) + short).mean()


def _wrong(q: Array) -> Array:
    """What an action that fails costs by its Q."""
    return jnp.maximum(q, 0.0) ** 2 + 0.05 * q**2


def _first(x: Array, of: Array) -> Array:
    """(b, 3): where a (b, n, n, w) is largest, of where `of` is true."""
    b, n, _, ways = x.shape
    x = jnp.where(of, x, -jnp.inf).reshape(b, n * n, ways)
    # The largest of each pair of points first: on a CPU half the time of one search.
    pair = x.max(-1).argmax(-1)
    return jnp.stack([pair // n, pair % n, x[jnp.arange(b), pair].argmax(-1)], axis=-1)


def _at(each: Sequence[Array], actions: Array) -> Array:
    """(b, ...) Q of some actions (b, ..., 3), from what each choice adds: its gradient is that of a few numbers, where
    that of a largest Q is as large as all of them."""
    row, column, way = (actions[..., i] for i in range(3))
    state = jnp.arange(len(actions)).reshape(-1, *[1] * (row.ndim - 1))
    ways = jnp.unravel_index(way, tuple(x.shape[-1] for x in each))
    return reduce(jnp.add, (x[state, row, column, w] for x, w in zip(each, ways, strict=True)))


def margin_loss(each: Sequence[Array], exists: Array, whole: Array) -> Array:
    """By how much the best of some actions falls short of all others and a margin; 0 where there are no such actions.

    Args:
        each: (b, n, n, w_i) what each choice adds to Q; w is all of their combinations.
        exists: (b, n, n, 1) or more.
        whole: (b, n, n, w) the actions.
    """
    q = heads.together(jax.lax.stop_gradient(each))
    rest = exists & ~whole
    best, others = _at(each, _first(q, whole)), _at(each, _first(q, rest)) + _MARGIN
    both = whole.any((1, 2, 3)) & rest.any((1, 2, 3))
    return jnp.where(both & (others > best), others - best, 0.0)


def best_ways(online: Sequence[Array], target: Sequence[Array]) -> tuple[Array, Array]:
    """Of each two points the highest Q over all ways, and what the target network thinks of the way that has it.

    Choices add up, so each has its best by itself: no array over all their combinations is needed.

    Args:
        online: (..., w_i) what each choice adds, by the network that learns.
        target: (..., w_i) by the target network.

    Returns:
        (...) both.
    """
    xp = online[0].__array_namespace__()
    best = [xp.argmax(x, axis=-1, keepdims=True) for x in online]
    highest = [xp.take_along_axis(x, i, axis=-1)[..., 0] for x, i in zip(online, best, strict=True)]
    there = [xp.take_along_axis(x, i, axis=-1)[..., 0] for x, i in zip(target, best, strict=True)]
    return reduce(xp.add, highest), reduce(xp.add, there)


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
