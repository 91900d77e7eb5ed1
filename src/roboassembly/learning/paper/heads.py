"""What a choice adds to the worth of two points: `w`, or `g_a` and `g_b`, each read off the points' embeddings.

    added(u, v, w) = sum_d a[u, d] b[v, d] W[d, w] + A(u)[w] + B(v)[w]

with A and B affine, so that the best choice depends on the pair. Several choices add up; 64 outputs of their own for
the grasps of every two points would not be sensible.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from roboassembly.learning.layers import Array, Params, init_linear, linear


def init(
    rng: np.random.Generator, inputs: int, rank: int, ways: Sequence[int], *, mean: float = 0.0, spread: float = 1.0
) -> Params:
    """Fresh weights, a head for each choice.

    Args:
        rng: draws them.
        inputs: numbers that A and B see of a point.
        rank: numbers in an embedding.
        ways: of each choice.
        mean: of W, in units of 1 / sqrt(rank).
        spread: its standard deviation, in the same.
    """
    unit = rank**-0.5
    return {
        str(i): {
            "ways": rng.normal(mean * unit, spread * unit, (rank, count)).astype(np.float32),
            "u": init_linear(rng, inputs, count),
            "v": init_linear(rng, inputs, count),
        }
        for i, count in enumerate(ways)
    }


def added(p: Params, a: Array, b: Array, of_u: Array, of_v: Array) -> list[Array]:
    """What each choice adds, (s, n, n, w) each.

    Args:
        p: of `init`.
        a: (s, n, rank) embeddings of points that move.
        b: (s, n, rank) embeddings of points that wait.
        of_u: (s, n, inputs) what A sees.
        of_v: (s, n, inputs) what B sees.
    """
    return [_added(p[str(i)], a, b, of_u, of_v) for i in range(len(p))]


def _added(p: Params, a: Array, b: Array, of_u: Array, of_v: Array) -> Array:
    xp = a.__array_namespace__()
    s, n, rank = a.shape
    ways = p["ways"].shape[1]
    moved = xp.reshape(a[:, :, None] * p["ways"].T, (s, n * ways, rank))
    pairs = xp.reshape(moved @ xp.swapaxes(b, 1, 2), (s, n, ways, n))
    return xp.moveaxis(pairs, 2, 3) + linear(p["u"], of_u)[:, :, None] + linear(p["v"], of_v)[:, None]


def together(each: Sequence[Array]) -> Array:
    """(..., w) of all combinations of the choices, numbered through, from (..., w_i) of each."""
    return reduce(_combined, each)


def _combined(one: Array, other: Array) -> Array:
    xp = one.__array_namespace__()
    both = one[..., :, None] + other[..., None, :]
    return xp.reshape(both, (*both.shape[:-2], -1))
