"""Which hands can join a right pair: a small network on what `hands` sees, beside the one that values pairs.

It says two things of each `(g_a, g_b)`: whether both hands have room at their parts and at the joint, and whether the
arms then find a way. The chance that an action works is the product of both.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from roboassembly.learning.hands import ONE, TWO, Handling
from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp

KIND = "grasping"
"""Of checkpoints."""
_WIDTH = 64


def init(rng: np.random.Generator) -> Params:
    """Fresh weights."""
    return {
        "a": init_mlp(rng, ONE, _WIDTH, _WIDTH),
        "b": init_mlp(rng, ONE, _WIDTH, _WIDTH),
        "two": init_linear(rng, TWO, _WIDTH),
        "pair": init_mlp(rng, _WIDTH, _WIDTH, 2),
    }


def apply(p: Params, one: Array, two: Array) -> Array:
    """Logits (b, 8, 8, 2) that two hands have room, and that the arms find a way if so.

    Args:
        p: of `init`.
        one: (b, 2, 8, 27) of `Handling`.
        two: (b, 8, 8, 9) of `Handling`.
    """
    a, b = mlp(p["a"], one[:, 0]), mlp(p["b"], one[:, 1])
    return mlp(p["pair"], gelu(a[:, :, None] + b[:, None] + linear(p["two"], two)))


def log_chance(p: Params, handling: Handling) -> Float32[np.ndarray, "8 8"]:
    """Logarithm of the chance that each pair of hands can join the pair; -inf where a grasp does not exist."""
    logits = apply(p, handling.one[None], handling.two[None])[0]
    return np.where(handling.there, -np.logaddexp(0.0, -logits).sum(axis=2), -np.inf).astype(np.float32)
