"""Which hands can join a right pair: a small network on what `hands` sees, beside the one that values pairs.

It says four things: of each hand whether it can take its group from where that waits, and of each two whether they
have room at their parts and at the joint, whether the arms then reach it, and whether all else then works out. The
chance that an action works is the product of all.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp
from roboassembly.learning.relational.grasps.features import ONE, TWO, Handling

KIND = "grasping"
"""Of checkpoints."""
_WIDTH = 64


def init(rng: np.random.Generator) -> Params:
    """Fresh weights."""
    return {
        "take": init_mlp(rng, ONE, _WIDTH, _WIDTH, 1),
        "a": init_mlp(rng, ONE, _WIDTH, _WIDTH),
        "b": init_mlp(rng, ONE, _WIDTH, _WIDTH),
        "two": init_linear(rng, TWO, _WIDTH),
        "pair": init_mlp(rng, _WIDTH, _WIDTH, 3),
    }


def apply(p: Params, one: Array, two: Array) -> tuple[Array, Array]:
    """Logits of what is said of hands at some joints.

    Args:
        p: of `init`.
        one: (b, 2, 8, n) of `Handling`.
        two: (b, 8, 8, n) of `Handling`.

    Returns:
        (b, 2, 8) that R_a can take u's group, and R_b v's; (b, 8, 8, 3) that two hands have room, that the arms reach
        the joint if so, and that all else works out then.
    """
    a, b = mlp(p["a"], one[:, 0]), mlp(p["b"], one[:, 1])
    together = mlp(p["pair"], gelu(a[:, :, None] + b[:, None] + linear(p["two"], two)))
    return mlp(p["take"], one)[..., 0], together


def log_chance(p: Params, handling: Handling) -> Float32[np.ndarray, "8 8"]:
    """Logarithm of the chance that each pair of hands can join the pair; -inf where a grasp does not exist."""
    take, together = (-np.logaddexp(0.0, -logits[0]) for logits in apply(p, handling.one[None], handling.two[None]))
    chance = take[0, :, None] + take[1] + together.sum(axis=2)
    return np.where(handling.there, chance, -np.inf).astype(np.float32)
