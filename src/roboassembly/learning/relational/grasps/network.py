"""The grasp network: with which grasps two robots can carry out a pair that fits.

It answers four questions: of each grasp, whether its robot can pick the group from where it waits; and of each two
grasps, whether they fit at their parts and at the mate, whether the arms then reach the mate, and whether all else then
works. The probability that an action works is the product of the answers.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32

from roboassembly.learning.layers import Array, Params, gelu, init_linear, init_mlp, linear, mlp
from roboassembly.learning.relational.clearance import CUTOFF
from roboassembly.learning.relational.grasps.features import PAIR_FEATURES, SINGLE_FEATURES, GraspFeatures

KIND = "grasping"
"""Kind of the network's checkpoints."""
_WIDTH = 64
"""Width of the hidden layers."""


_OUT_OF_REACH = 5.0
"""Number subtracted from the log-probability of a pick that no arm reaches."""
_TOUCHES = 5.0
"""Number subtracted from the log-probability of a grasp whose gripper touches something."""
_LEAST_CLEARANCE = np.array([0.6, 0.0, -0.5, -99.0, -0.3, -0.5]) * 1e-3 / CUTOFF
"""Features 0 to 5 of a grasp, below which the gripper touches something."""


def init(rng: np.random.Generator) -> Params:
    """Return fresh weights."""
    return {
        "pick": init_mlp(rng, SINGLE_FEATURES, _WIDTH, _WIDTH, 1),
        "grasp_a": init_mlp(rng, SINGLE_FEATURES, _WIDTH, _WIDTH),
        "grasp_b": init_mlp(rng, SINGLE_FEATURES, _WIDTH, _WIDTH),
        "grasp_pair": init_linear(rng, PAIR_FEATURES, _WIDTH),
        "mate": init_mlp(rng, _WIDTH, _WIDTH, 3),
    }


def apply(p: Params, single: Array, pair: Array) -> tuple[Array, Array]:
    """Return logits for the grasps at b mates.

    Args:
        p: weights of `init`.
        single: (b, 2, 8, 43) features of each grasp.
        pair: (b, 8, 8, 9) features of each two grasps.

    Returns:
        pick: (b, 2, 8) whether R_a can pick u's group, and R_b v's.
        mate: (b, 8, 8, 3) whether two grasps fit, whether the arms reach the mate if so, and whether all else works
            then.
    """
    a, b = mlp(p["grasp_a"], single[:, 0]), mlp(p["grasp_b"], single[:, 1])
    mate = mlp(p["mate"], gelu(a[:, :, None] + b[:, None] + linear(p["grasp_pair"], pair)))
    return mlp(p["pick"], single)[..., 0], mate


def touches(features: GraspFeatures) -> Bool[np.ndarray, "2 8"]:
    """Return whether each gripper reaches into a cloud at its part or at the mate, so that it cannot be there."""
    clearance: Float32[np.ndarray, "2 8 6"] = features.single[..., :6]
    return np.min(clearance - _LEAST_CLEARANCE, axis=-1) < 0.0


def log_probability(p: Params, features: GraspFeatures) -> Float32[np.ndarray, "8 8"]:
    """Return the log-probability that each two grasps can carry out the pair; -inf where a grasp does not exist."""
    pick, mate = (-np.logaddexp(0.0, -x[0]) for x in apply(p, features.single[None], features.pair[None]))
    pick = pick - _OUT_OF_REACH * ~features.in_reach - _TOUCHES * touches(features)
    both = pick[0, :, None] + pick[1] + mate.sum(axis=2)
    return np.where(features.exists, both, -np.inf).astype(np.float32)
