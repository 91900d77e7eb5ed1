"""The relational network: a small transformer over connection points that values every pair of them.

The forward pass has four steps.

1. Each pair is judged by itself: do the two surfaces look made for each other, and do the groups meet as they should?
2. Tokens learn from each other what surrounds them: which others compete for the same place, what is joined already.
3. For each two groups, conflicts say which groups they would lock out: for any two points of a third group that fit one
   of them each, a learned conflict says whether the third could still come to both at once.
4. Q-values of `(u, v, k, l, w)` follow from the pairs and conflicts.

The network is equivariant to the numbering of parts and points, and works for any number of them. `apply` and the
functions that it calls are pure and run on NumPy and on JAX arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from roboassembly.geometry.mating import mating_rotations
from roboassembly.learning.augmentation import AUGMENTATIONS, FrameChange
from roboassembly.learning.layers import (
    Array,
    Params,
    block,
    gelu,
    init_block,
    init_linear,
    init_mlp,
    linear,
    mlp,
    sigmoid,
    softplus,
)
from roboassembly.learning.relational.augmentation import augment_tokens, permutation_of
from roboassembly.learning.relational.features import (
    PAIR_FEATURES,
    UP_AXIS_FEATURES,
    frames_parallel,
    pair_features,
    plausible_pairs,
    up_axis_features,
)
from roboassembly.learning.relational.group_geometry import PATCH_SIZE
from roboassembly.learning.relational.tokens import POINT_FEATURES, Tokens, pad

KIND = "relational"
"""Kind of the network's checkpoints."""
_IMPLAUSIBLE_PENALTY = 10.0
"""Number subtracted from the logits of pairs that leave two upright groups standing in different directions."""
_RELATIVE_POSE = 13
"""Numbers of one token's pose in another's frame: rotation, translation, and 1 if there is any."""


@dataclass(frozen=True)
class RelationalConfig:
    """Sizes of the network."""

    token: int = 96
    """Width of a token."""
    pair: int = 48
    """Width of a pair."""
    layers: int = 3
    """Number of transformer blocks."""
    heads: int = 4
    """Number of attention heads."""
    conflict_inputs: int = 24
    """Width of a token where conflicts are computed."""
    conflicts: int = 8
    """Number of kinds of conflicts."""


def init(rng: np.random.Generator, c: RelationalConfig) -> Params:
    """Return fresh weights."""
    edge = c.pair + _RELATIVE_POSE + 3
    return {
        "patch": init_mlp(rng, PATCH_SIZE, 128, c.token),
        "point": init_mlp(rng, POINT_FEATURES, 64, c.token),
        "pair_u": init_linear(rng, c.token, c.pair),
        "pair_v": init_linear(rng, c.token, c.pair),
        "pair_features": init_linear(rng, PAIR_FEATURES, c.pair),
        "pair": init_mlp(rng, c.pair, c.pair, c.pair),
        "fits": init_linear(rng, c.pair, 1),
        "blocks": {str(i): init_block(rng, c.token, edge, c.heads) for i in range(c.layers)},
        "conflict_input": init_linear(rng, c.token, c.conflict_inputs),
        "conflict_first": init_linear(rng, c.conflict_inputs, 32),
        "conflict_second": init_linear(rng, c.conflict_inputs, 32),
        "conflict_pose": init_linear(rng, _RELATIVE_POSE, 32),
        "conflict": init_linear(rng, 32, c.conflicts),
        "value_u": init_linear(rng, c.token, c.pair),
        "value_v": init_linear(rng, c.token, c.pair),
        "value_conflict": init_linear(rng, 2 * c.conflicts, c.pair),
        "value": init_mlp(rng, c.pair, c.pair, c.pair),
        "q_pair": init_linear(rng, c.pair, 32),
        "q_axis": init_linear(rng, UP_AXIS_FEATURES, 32),
        "q": init_linear(rng, 32, 1),
    }


def apply(p: Params, t: dict[str, Array]) -> tuple[Array, Array, Array]:
    """Value all pairs of a batch of b states with n tokens each.

    Args:
        p: weights of `init`.
        t: batch of `tokens.pad`.

    Returns:
        fits: (b, n, n) logit of the probability that the ordered pair fits.
        q: (b, n, n, 6) logit of the probability that the furniture can be finished after the action.
        valid: (b, n, n) whether the two tokens exist and are in different groups.
    """
    xp = t["features"].__array_namespace__()
    t = {name: a if name in ("group", "patch") else xp.astype(a, xp.float32) for name, a in t.items()}
    group = t["group"]
    present = group >= 0
    both = present[:, :, None] & present[:, None, :]
    same_group = group[:, :, None] == group[:, None, :]
    valid, same = both & ~same_group, xp.astype(both & same_group, xp.float32)[..., None]

    token = _embed_points(p, t)
    pair = _judge_pairs(p, t, token, valid)
    fits = linear(p["fits"], pair)[..., 0]
    belief = sigmoid(fits) * xp.astype(valid, xp.float32)
    belief = xp.maximum(belief, xp.swapaxes(belief, 1, 2))

    pose = _relative_poses(t["frame"], t["position"], same)
    known = xp.astype(valid, xp.float32)[..., None]
    identity = xp.broadcast_to(xp.eye(group.shape[1], dtype=xp.float32)[None, :, :, None], known.shape)
    edges = xp.concatenate([pair * known, pose, belief[..., None], known, identity], axis=-1)
    for i in range(len(p["blocks"])):
        token = block(p["blocks"][str(i)], token, edges, present)

    conflicts = _conflicts(p, token, pose, same, belief, group)
    value = linear(p["value_u"], token)[:, :, None] + linear(p["value_v"], token)[:, None]
    value = mlp(p["value"], gelu(pair + value + linear(p["value_conflict"], conflicts)))
    actions = gelu(linear(p["q_pair"], value)[..., None, :] + linear(p["q_axis"], up_axis_features(t)))
    return fits, linear(p["q"], actions)[..., 0], valid


def _embed_points(p: Params, t: dict[str, Array]) -> Array:
    """(b, n, d) tokens: the surface around each point, and the point's features."""
    xp = t["features"].__array_namespace__()
    return mlp(p["patch"], 1.0 - xp.astype(t["patch"], xp.float32) / 255.0) + mlp(p["point"], t["features"])


def _judge_pairs(p: Params, t: dict[str, Array], token: Array, valid: Array) -> Array:
    """(b, n, n, d) pairs, each by itself: its two tokens and its features."""
    tokens = linear(p["pair_u"], token)[:, :, None] + linear(p["pair_v"], token)[:, None]
    return mlp(p["pair"], gelu(tokens + linear(p["pair_features"], pair_features(t, valid))))


def _relative_poses(frame: Array, position: Array, same: Array) -> Array:
    """(b, n, n, 13) pose of each token in each other's frame, translations in 1/3 m; zeros between two groups."""
    xp = position.__array_namespace__()
    b, n = position.shape[:2]
    rotation = xp.reshape(xp.einsum("bkji,bljm->bklim", frame, frame), (b, n, n, 9))
    translation = xp.einsum("bkji,bklj->bkli", frame, position[:, None] - position[:, :, None])
    return xp.concatenate([rotation, 3.0 * translation, xp.ones_like(same)], axis=-1) * same


def _conflicts(p: Params, token: Array, pose: Array, same: Array, belief: Array, group: Array) -> Array:
    """(b, n, n, 2c): for the groups of two tokens, how much third groups would suffer from their merge."""
    xp = token.__array_namespace__()
    # There are at most as many groups as points.
    member = xp.astype(group[..., None] == xp.arange(group.shape[1]), xp.float32)
    wants = xp.minimum(belief @ member, 1.0)
    inputs = linear(p["conflict_input"], token)
    hidden = linear(p["conflict_first"], inputs)[:, :, None] + linear(p["conflict_second"], inputs)[:, None]
    conflict = softplus(linear(p["conflict"], gelu(hidden + linear(p["conflict_pose"], pose)))) * same
    # Points x and y of a third group, wanted by groups g and h; then from groups to the tokens k and l.
    half = xp.einsum("bxg,bxyc->bgyc", wants, conflict)
    between = xp.einsum("bgyc,byh->bghc", half, wants)
    per_token = xp.einsum("bkg,bghc->bkhc", member, between)
    total = xp.einsum("bkhc,blh->bklc", per_token, member)
    return xp.concatenate([xp.log1p(total), xp.tanh(total)], axis=-1)


def ranked(t: dict[str, Array], q: Array, valid: Array) -> Array:
    """Return (b, n, n, 6) Q-values by which a policy chooses; -inf where two tokens are in one group.

    Samples do not label every viable action: a symmetric part may also stand the other way round. So pairs that leave
    two upright groups standing in different directions come last.

    Args:
        t: batch of `tokens.pad`.
        q: of `apply`.
        valid: of `apply`.
    """
    xp = q.__array_namespace__()
    frame = xp.astype(t["frame"], xp.float32)
    upright = t["features"][..., -1] > 0
    plausible = plausible_pairs(frames_parallel(mating_rotations(frame, frame)), upright, valid)
    any_plausible = xp.any(plausible, axis=(1, 2), keepdims=True)
    penalty = xp.where(plausible | ~any_plausible, 0.0, _IMPLAUSIBLE_PENALTY)
    return xp.where(valid[..., None], q - xp.astype(penalty, q.dtype)[..., None], -xp.inf)


def judged(
    p: Params, tokens: Tokens, augmentations: Sequence[FrameChange] = AUGMENTATIONS[:1]
) -> tuple[Float32[np.ndarray, "n n"], Float32[np.ndarray, "n n 6"]]:
    """Return for one state, on NumPy, logits of whether pairs fit, and Q-values of all actions.

    Both are -inf where two tokens are in one group.

    Args:
        p: weights of `init`.
        tokens: the state.
        augmentations: changes of the furniture over which both are averaged.
    """
    t = pad([augment_tokens(tokens, change) for change in augmentations], len(tokens.part))
    fits, q, valid = apply(p, t)
    changed = np.asarray(ranked(t, q, valid))
    penalty = np.where(valid, np.asarray(q)[..., 0] - changed[..., 0], np.inf)
    back = [q[..., permutation_of(tokens, change)] for q, change in zip(changed, augmentations, strict=True)]
    return (np.asarray(fits) - penalty).mean(axis=0).astype(np.float32), np.stack(back).mean(axis=0).astype(np.float32)


def values(
    p: Params, tokens: Tokens, augmentations: Sequence[FrameChange] = AUGMENTATIONS[:1]
) -> Float32[np.ndarray, "n n 6"]:
    """Return Q-values of all actions in one state, on NumPy; see `judged`."""
    return judged(p, tokens, augmentations)[1]


def best_action(p: Params, tokens: Tokens) -> tuple[int, int, int]:
    """Return the action of the greatest value: rows of the moving and the waiting token, and `w`."""
    q = values(p, tokens)
    row, column, w = np.unravel_index(np.argmax(q), q.shape)
    return int(row), int(column), int(w)
