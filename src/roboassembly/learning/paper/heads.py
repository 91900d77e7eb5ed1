"""Factored Q-heads: what each action branch adds to the Q-value of a pair of points.

After the two points an action chooses `w`, or `g_a` and `g_b`. The value of choice w of one branch is

    value(u, v, w) = sum_d a[u, d] b[v, d] W[d, w] + A(u)[w] + B(v)[w]

with A and B affine, so that the best choice depends on the pair. The values of several branches are added: 64 outputs
of their own for the grasps of each pair of points would be too many.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from functools import reduce

import numpy as np

from roboassembly.learning.layers import Array, Params, init_linear, linear


def init(
    rng: np.random.Generator,
    inputs: int,
    rank: int,
    branches: Sequence[int],
    *,
    mean: float = 0.0,
    deviation: float = 1.0,
) -> Params:
    """Return fresh weights, a head for each branch.

    Args:
        rng: random numbers.
        inputs: number of inputs of A and B.
        rank: size of the embeddings a and b.
        branches: number of choices of each branch.
        mean: mean of W, in units of 1 / sqrt(rank).
        deviation: standard deviation of W, in the same unit.
    """
    unit = rank**-0.5
    return {
        str(i): {
            "w": rng.normal(mean * unit, deviation * unit, (rank, count)).astype(np.float32),
            "u": init_linear(rng, inputs, count),
            "v": init_linear(rng, inputs, count),
        }
        for i, count in enumerate(branches)
    }


def branch_values(p: Params, a: Array, b: Array, of_u: Array, of_v: Array) -> list[Array]:
    """Return what each branch adds, (s, n, n, w) each.

    Args:
        p: weights from `init`.
        a: (s, n, rank) embeddings of the points that move.
        b: (s, n, rank) embeddings of the points that wait.
        of_u: (s, n, inputs) inputs of A.
        of_v: (s, n, inputs) inputs of B.
    """
    return [_branch(p[str(i)], a, b, of_u, of_v) for i in range(len(p))]


def _branch(p: Params, a: Array, b: Array, of_u: Array, of_v: Array) -> Array:
    xp = a.__array_namespace__()
    s, n, rank = a.shape
    choices = p["w"].shape[1]
    moved = xp.reshape(a[:, :, None] * p["w"].T, (s, n * choices, rank))
    pairs = xp.reshape(moved @ xp.swapaxes(b, 1, 2), (s, n, choices, n))
    return xp.moveaxis(pairs, 2, 3) + linear(p["u"], of_u)[:, :, None] + linear(p["v"], of_v)[:, None]


def values_of(p: Params, a: Array, b: Array, of_u: Array, of_v: Array, actions: Array) -> Array:
    """Return (s,) the value of one action in each state: the sum over all branches.

    Args:
        p: see `branch_values`, as the next four.
        a: see there.
        b: see there.
        of_u: see there.
        of_v: see there.
        actions: (s, 3) numbers of the two points and of the combination of choices, in C order.
    """
    xp = a.__array_namespace__()
    state, (row, column, choice) = xp.arange(len(actions)), actions.T
    both = a[state, row] * b[state, column]
    branches = [p[str(i)] for i in range(len(p))]
    choices = xp.unravel_index(choice, tuple(head["w"].shape[1] for head in branches))
    each = [
        (both @ head["w"] + linear(head["u"], of_u[state, row]) + linear(head["v"], of_v[state, column]))[state, w]
        for head, w in zip(branches, choices, strict=True)
    ]
    return reduce(operator.add, each)


def split(values: Array, branches: Sequence[int]) -> list[Array]:
    """Return what each branch adds, (..., w_i), from (..., w) one branch after another."""
    ends = np.cumsum(branches).tolist()
    return [values[..., end - count : end] for count, end in zip(branches, ends, strict=True)]


def combined(branches: Sequence[Array]) -> Array:
    """Return (..., w) the sums of all combinations of choices, in C order, from (..., w_i) of each branch."""
    return reduce(_combined, branches)


def _combined(first: Array, second: Array) -> Array:
    xp = first.__array_namespace__()
    both = first[..., :, None] + second[..., None, :]
    return xp.reshape(both, (*both.shape[:-2], -1))
