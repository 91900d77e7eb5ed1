"""Numbers about pairs of connection points and the ways to join them, from tokens; on NumPy and on JAX.

Made in the network rather than kept in lessons: there are a hundred of them for each of a state's thousands of pairs.
"""

from __future__ import annotations

from roboassembly.learning.layers import Array
from roboassembly.learning.mating import mating_rotations
from roboassembly.task.rules.connections import UP_AXES

PAIR, WAY = 39, 7
"""Numbers that describe an ordered pair of points, and a pair with a `w`."""
_SAME_WAY = 0.999
"""Cosine of the turn between two groups' frames from which on they stand the same way."""
_NEAR = 0.01
"""Metres."""
_FAR = 0.5


def turns(frame: Array) -> Array:
    """(b, n, n, 3, 3) turn that takes the group of each token onto the group of each other once they are joined."""
    return mating_rotations(frame, frame)


def same_way(turn: Array) -> Array:
    """(..., n, n) whether two groups' frames are parallel once they are joined."""
    return _cosine(turn) > _SAME_WAY


def possible(alike: Array, upright: Array, valid: Array) -> Array:
    """(..., n, n) pairs of different groups, but for those of two upright ones that would not stand the same way.

    Args:
        alike: of `same_way`.
        upright: (..., n) whether the frame of the token's group is surely parallel to the furniture's.
        valid: (..., n, n) whether both tokens are there and in different groups.
    """
    return valid & (alike | ~(upright[..., :, None] & upright[..., None, :]))


def of_pairs(t: dict[str, Array], valid: Array) -> Array:
    """(b, n, n, 39) for a batch of tokens, as `batches.pad` makes it; rows of pairs move onto columns."""
    xp = t["frame"].__array_namespace__()
    turn = turns(t["frame"])
    moved = xp.einsum("bklij,bkj->bkli", turn, t["position"])
    shift = t["position"][:, None] - moved
    meet = t["meet"]
    parallel = same_way(turn)
    number = xp.float32
    sizes = xp.broadcast_to(t["own"][:, :, None, 0], valid.shape), xp.broadcast_to(t["own"][:, None, :, 0], valid.shape)
    spread = t["beside"][..., 3:] - t["beside"][..., :3] + t["extent"][:, None]
    told = [
        meet,
        xp.log1p(xp.maximum(meet, 0.0)),
        xp.astype(meet[..., :2] > 0, number),
        _cosine(turn)[..., None],
        xp.stack([turn[..., i, i] for i in range(3)], axis=-1),
        shift,
        xp.astype(parallel, number)[..., None],
        xp.stack(sizes, axis=-1),
        xp.max(xp.abs(turn), axis=(-2, -1))[..., None],
        spread,
        _rivalry(xp, t["loops"], t["bridges"], possible(parallel, t["own"][..., -1] > 0, valid)),
    ]
    return xp.concatenate(told, axis=-1) * xp.astype(valid, number)[..., None]


def of_ways(t: dict[str, Array]) -> Array:
    """(b, n, n, 6, 7) how far the moving group would reach beyond the waiting one along each axis that may point up."""
    xp = t["frame"].__array_namespace__()
    low, high = t["beside"][..., :3], t["beside"][..., 3:]
    extent = t["extent"][:, None]
    under, over = _six(xp, low, -high), _six(xp, high, -low)
    normal = t["frame"][..., 2] @ xp.asarray(UP_AXES.T, dtype=t["frame"].dtype)
    heights = [
        2.0 * xp.clip(under, -_FAR, _FAR),
        xp.tanh(under / _NEAR),
        2.0 * xp.clip(over, -_FAR, _FAR),
        xp.tanh(over / _NEAR),
        xp.broadcast_to(normal[:, None], under.shape),
        2.0 * xp.clip(_six(xp, low - extent, -high - extent), -_FAR, _FAR),
        2.0 * xp.clip(_six(xp, -high - extent, low - extent), -_FAR, _FAR),
    ]
    return xp.stack(heights, axis=-1)


def _cosine(turn: Array) -> Array:
    return (turn[..., 0, 0] + turn[..., 1, 1] + turn[..., 2, 2] - 1.0) / 2.0


def _rivalry(xp: Array, loops: Array, bridges: Array, can: Array) -> Array:
    """Whether a pair is possible, how many loops of three and of four groups it closes, and how that compares."""
    number = xp.float32
    rivals = xp.maximum(xp.sum(xp.astype(can, number), axis=2), 1.0)
    told = [
        xp.astype(can, number),
        xp.broadcast_to(1.0 / rivals[:, :, None], loops.shape),
        xp.broadcast_to(1.0 / rivals[:, None], loops.shape),
    ]
    for count in (loops, bridges):
        most = xp.maximum(xp.max(count, axis=2), 1.0)
        told += [
            count / 3.0 if count is loops else count / 30.0,
            xp.log1p(count),
            xp.astype(count > 0, number),
            count / most[:, :, None],
            count / most[:, None],
            count / xp.max(most, axis=1)[:, None, None],
        ]
    return xp.stack(told, axis=-1)


def _six(xp: Array, up: Array, down: Array) -> Array:
    """Numbers along x, y, z and against them, in the order of `UP_AXES`: +z, -z, +x, -x, +y, -y."""
    return xp.stack([up[..., 2], down[..., 2], up[..., 0], down[..., 0], up[..., 1], down[..., 1]], axis=-1)
