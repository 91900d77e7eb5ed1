"""The relational policy: a small transformer over connection points that values every pair of them.

Three steps. First every pair is judged by itself: do the two surfaces look made for each other, and would the groups
meet as they should? Then tokens learn from each other what surrounds them: who else wants this place, what is already
joined. Last, for every two groups, it is asked whom they would lock out: for any two points of a third group that
belong to one of them each, a learned conflict says whether the third could still come to both at once. Q-values of
`(u, v, k, l, w)` are read off the pairs.

Indifferent to the numbering of parts and points, and to their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from roboassembly.learning.augmentation import AUGMENTATIONS, FrameChange, up_axis_permutation
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
from roboassembly.learning.relational.augmentation import seen
from roboassembly.learning.relational.batches import pad
from roboassembly.learning.relational.clearance import HOLD, ROOM
from roboassembly.learning.relational.features import PAIR, WAY, of_pairs, of_ways, possible, same_way, turns
from roboassembly.learning.relational.tokens import PATCH, POINT, Tokens

KIND = "relational"
"""Of checkpoints."""
MAX_GROUPS = 20
_DOUBT = 10.0
"""Taken off the logits of pairs after which two groups that are surely upright would not stand the same way."""
_REL = 13
"""Numbers of one token's frame in another's: rotation, translation, and whether there is any."""


@dataclass(frozen=True)
class RelationalConfig:
    """Sizes of the network."""

    token: int = 96
    pair: int = 48
    layers: int = 3
    heads: int = 4
    ends: int = 24
    """Of a point, for judging conflicts."""
    conflicts: int = 8


def init(rng: np.random.Generator, c: RelationalConfig) -> Params:
    """Fresh weights."""
    edge = c.pair + _REL + 3
    return {
        "patch": init_mlp(rng, PATCH, 128, c.token),
        "own": init_mlp(rng, POINT, 64, c.token),
        "pair_u": init_linear(rng, c.token, c.pair),
        "pair_v": init_linear(rng, c.token, c.pair),
        "pair_own": init_linear(rng, PAIR, c.pair),
        "judge": init_mlp(rng, c.pair, c.pair, c.pair),
        "right": init_linear(rng, c.pair, 1),
        "blocks": {str(i): init_block(rng, c.token, edge, c.heads) for i in range(c.layers)},
        "end": init_linear(rng, c.token, c.ends),
        "conflict_1": init_linear(rng, c.ends, 32),
        "conflict_2": init_linear(rng, c.ends, 32),
        "conflict_rel": init_linear(rng, _REL, 32),
        "conflict": init_linear(rng, 32, c.conflicts),
        "value_u": init_linear(rng, c.token, c.pair),
        "value_v": init_linear(rng, c.token, c.pair),
        "value_conflict": init_linear(rng, 2 * c.conflicts, c.pair),
        "value": init_mlp(rng, c.pair, c.pair, c.pair),
        "q_pair": init_linear(rng, c.pair, 32),
        "q_way": init_linear(rng, WAY, 32),
        "q": init_linear(rng, 32, 1),
    }


def init_hands(rng: np.random.Generator, c: RelationalConfig) -> Params:
    """Fresh weights besides, for a network that sees what room there is for hands; they change nothing yet."""
    return {
        "hold": init_mlp(rng, HOLD, 48, 48),
        "held": _silent(init_linear(rng, 48, c.token)),
        "room": {"0": init_linear(rng, 2 * ROOM, 32), "1": _silent(init_linear(rng, 32, c.pair))},
    }


def _silent(p: Params) -> Params:
    return {name: np.zeros_like(value) for name, value in p.items()}


def apply(p: Params, t: dict[str, Array]) -> tuple[Array, Array, Array]:
    """Values of all pairs.

    Args:
        p: of `init`, perhaps with those of `init_hands`.
        t: a batch of tokens, as `batches.pad` makes it; with what is told of hands where the weights ask for it.

    Returns:
        right: (b, n, n) logit that the ordered pair is right.
        q: (b, n, n, 6) logit of the share of the best possible return that the action leads to.
        valid: (b, n, n) whether the two tokens are there and in different groups.
    """
    xp = t["own"].__array_namespace__()
    t = {name: a if name in ("group", "patch") else xp.astype(a, xp.float32) for name, a in t.items()}
    group = t["group"]
    present = group >= 0
    both = present[:, :, None] & present[:, None, :]
    same_group = group[:, :, None] == group[:, None, :]
    valid, same = both & ~same_group, xp.astype(both & same_group, xp.float32)[..., None]
    token = mlp(p["patch"], 1.0 - xp.astype(t["patch"], xp.float32) / 255.0) + mlp(p["own"], t["own"])
    if "hold" in p:
        grasps = gelu(mlp(p["hold"], t["hold"])) * t["hold"][..., -1:]
        token = token + linear(p["held"], xp.max(grasps, axis=2))

    mates = linear(p["pair_u"], token)[:, :, None] + linear(p["pair_v"], token)[:, None]
    judged = mlp(p["judge"], gelu(mates + linear(p["pair_own"], of_pairs(t, valid))))
    if "room" in p:
        judged = judged + mlp(p["room"], xp.concatenate([t["room"], xp.swapaxes(t["room"], 1, 2)], axis=-1))
    right = linear(p["right"], judged)[..., 0]
    belief = sigmoid(right) * xp.astype(valid, xp.float32)
    belief = xp.maximum(belief, xp.swapaxes(belief, 1, 2))

    rel = _relative(xp, t["frame"], t["position"], same)
    known = xp.astype(valid, xp.float32)[..., None]
    identity = xp.broadcast_to(xp.eye(group.shape[1], dtype=xp.float32)[None, :, :, None], known.shape)
    edges = xp.concatenate([judged * known, rel, belief[..., None], known, identity], axis=-1)
    for i in range(len(p["blocks"])):
        token = block(p["blocks"][str(i)], token, edges, present)

    member = xp.astype(group[..., None] == xp.arange(MAX_GROUPS), xp.float32)
    wants = xp.minimum(belief @ member, 1.0)
    locked = _locked_out(p, token, rel, same, wants, member)
    value = linear(p["value_u"], token)[:, :, None] + linear(p["value_v"], token)[:, None]
    value = mlp(p["value"], gelu(judged + value + linear(p["value_conflict"], locked)))
    ways = gelu(linear(p["q_pair"], value)[..., None, :] + linear(p["q_way"], of_ways(t)))
    return right, linear(p["q"], ways)[..., 0], valid


def values(p: Params, tokens: Tokens, views: Sequence[FrameChange] = AUGMENTATIONS[:1]) -> Float32[np.ndarray, "n n 6"]:
    """Q of all actions in one state, on NumPy; -inf where two tokens are in one group.

    Args:
        p: of `init`.
        tokens: of the state.
        views: ways to look at it; what they say is averaged.
    """
    t = pad([seen(tokens, view) for view in views], len(tokens.part))
    _, q, valid = apply(p, t)
    told = np.asarray(ranked(t, q, valid))
    every = [q[..., up_axis_permutation(view)] for q, view in zip(told, views, strict=True)]
    return np.mean(np.stack(every), axis=0).astype(np.float32)


def ranked(t: dict[str, Array], q: Array, valid: Array) -> Array:
    """(b, n, n, 6) Q by which a policy chooses, from what `apply` says; -inf where two tokens are in one group.

    Lessons do not tell everything: where a part is symmetric, standing it the other way round is right as well. So
    pairs after which two upright groups would not stand the same way come last.
    """
    xp = q.__array_namespace__()
    can = possible(same_way(turns(xp.astype(t["frame"], xp.float32))), t["own"][..., -1] > 0, valid)
    doubt = xp.where(can | ~xp.any(can, axis=(1, 2), keepdims=True), 0.0, _DOUBT)
    return xp.where(valid[..., None], q - xp.astype(doubt, q.dtype)[..., None], -xp.inf)


def best(p: Params, tokens: Tokens) -> tuple[int, int, int]:
    """Rows of the two tokens, and the `w`, of the surest action."""
    q = values(p, tokens)
    row, column, w = np.unravel_index(np.argmax(q), q.shape)
    return int(row), int(column), int(w)


def _relative(xp: Array, frame: Array, position: Array, same: Array) -> Array:
    """Each token's frame in each other's, where they are in one group; zero elsewhere."""
    b, n = position.shape[:2]
    turn = xp.reshape(xp.einsum("bkji,bljm->bklim", frame, frame), (b, n, n, 9))
    shift = xp.einsum("bkji,bklj->bkli", frame, position[:, None] - position[:, :, None])
    return xp.concatenate([turn, 3.0 * shift, xp.ones_like(same)], axis=-1) * same


def _locked_out(p: Params, token: Array, rel: Array, same: Array, wants: Array, member: Array) -> Array:
    """(b, n, n, 2c): for the groups of two tokens, how much third groups would suffer from their merging."""
    xp = token.__array_namespace__()
    end = linear(p["end"], token)
    hidden = linear(p["conflict_1"], end)[:, :, None] + linear(p["conflict_2"], end)[:, None]
    conflict = softplus(linear(p["conflict"], gelu(hidden + linear(p["conflict_rel"], rel)))) * same
    half = xp.einsum("bxg,bxyc->bgyc", wants, conflict)
    between = xp.einsum("bgyc,byh->bghc", half, wants)
    per_token = xp.einsum("bkg,bghc->bkhc", member, between)
    locked = xp.einsum("bkhc,blh->bklc", per_token, member)
    return xp.concatenate([xp.log1p(locked), xp.tanh(locked)], axis=-1)
