"""Features of pairs of connection points, and of the axes that may point up, from a batch of tokens.

They run on NumPy and on JAX arrays. The network computes them itself, because a state has thousands of pairs with about
a hundred numbers each: too much for a dataset.
"""

from __future__ import annotations

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.layers import Array
from roboassembly.task.rules.connections import UP_AXES

PAIR_FEATURES = 39
"""Number of features of an ordered pair of points."""
UP_AXIS_FEATURES = 7
"""Number of features of a pair with a `w`."""
_PARALLEL = 0.999
"""Cosine of the angle between two frames from which on they count as parallel."""
_SCALE = 0.01
"""Scale of the tanh features of heights [m]."""
_CUTOFF = 0.5
"""Value from which on heights are clipped [m]."""


def frames_parallel(rotation: Array) -> Array:
    """Return (..., n, n) whether two groups' frames are parallel once they are mated.

    Args:
        rotation: (..., n, n, 3, 3) `waiting_from_moving` of each pair of points.
    """
    return _cosine(rotation) > _PARALLEL


def plausible_pairs(parallel: Array, upright: Array, valid: Array) -> Array:
    """Return (..., n, n) which pairs leave no two upright groups standing in different directions.

    Args:
        parallel: (..., n, n) of `frames_parallel`.
        upright: (..., n) whether the frame of the token's group is surely parallel to the furniture's.
        valid: (..., n, n) whether both tokens exist and are in different groups.
    """
    return valid & (parallel | ~(upright[..., :, None] & upright[..., None, :]))


def pair_features(t: dict[str, Array], valid: Array) -> Array:
    """Return (b, n, n, 39) features of ordered pairs; rows are points of the moving group. Invalid pairs get zeros.

    | index | feature | unit |
    |---|---|---|
    | 0–3 | `matches` of the tokens | |
    | 4–7 | log(1 + `matches`) | |
    | 8, 9 | 1 if any other points mate as well, without and with equal tangents | |
    | 10 | cosine of the angle between the two groups' frames, once mated | |
    | 11–13 | diagonal of the rotation between these frames | |
    | 14–16 | translation of the moving group in the waiting group's frame | m |
    | 17 | 1 if the two frames are parallel | |
    | 18, 19 | number of parts of the moving and of the waiting group | 5 parts |
    | 20 | largest absolute entry of the rotation: 1 if an axis stays an axis | |
    | 21–23 | extent of the moving group along the waiting group's axes | m |
    | 24–38 | of `_cycle_features` | |

    Args:
        t: batch of tokens of `tokens.pad`.
        valid: (b, n, n) whether both tokens exist and are in different groups.
    """
    xp = t["frame"].__array_namespace__()
    rotation, translation = mating_poses(t["frame"], t["position"], t["frame"], t["position"])
    matches, sizes = t["matches"], t["features"][..., 0]
    parallel = frames_parallel(rotation)
    number = xp.float32
    parts = xp.broadcast_to(sizes[:, :, None], valid.shape), xp.broadcast_to(sizes[:, None, :], valid.shape)
    extent = t["bounds"][..., 3:] - t["bounds"][..., :3] + t["extent"][:, None]
    plausible = plausible_pairs(parallel, t["features"][..., -1] > 0, valid)
    features = [
        matches,
        xp.log1p(xp.maximum(matches, 0.0)),
        xp.astype(matches[..., :2] > 0, number),
        _cosine(rotation)[..., None],
        xp.stack([rotation[..., i, i] for i in range(3)], axis=-1),
        translation,
        xp.astype(parallel, number)[..., None],
        xp.stack(parts, axis=-1),
        xp.max(xp.abs(rotation), axis=(-2, -1))[..., None],
        extent,
        _cycle_features(xp, t["cycles_3"], t["cycles_4"], plausible),
    ]
    return xp.concatenate(features, axis=-1) * xp.astype(valid, number)[..., None]


def _cycle_features(xp: Array, cycles_3: Array, cycles_4: Array, plausible: Array) -> Array:
    """(b, n, n, 15): how much the cycles of groups speak for a pair, compared with its rivals.

    | index | feature |
    |---|---|
    | 0 | 1 if the pair is plausible |
    | 1, 2 | 1 / number of plausible pairs of the row's and of the column's point |
    | 3–8 | 3-cycles: count / 3, log(1 + count), 1 if any, count / the largest count of the row, of the column, of all |
    | 9–14 | 4-cycles: count / 30, then the same |
    """
    number = xp.float32
    rivals = xp.maximum(xp.sum(xp.astype(plausible, number), axis=2), 1.0)
    features = [
        xp.astype(plausible, number),
        xp.broadcast_to(1.0 / rivals[:, :, None], cycles_3.shape),
        xp.broadcast_to(1.0 / rivals[:, None], cycles_3.shape),
    ]
    for count, scale in ((cycles_3, 3.0), (cycles_4, 30.0)):
        most = xp.maximum(xp.max(count, axis=2), 1.0)
        features += [
            count / scale,
            xp.log1p(count),
            xp.astype(count > 0, number),
            count / most[:, :, None],
            count / most[:, None],
            count / xp.max(most, axis=1)[:, None, None],
        ]
    return xp.stack(features, axis=-1)


def up_axis_features(t: dict[str, Array]) -> Array:
    """Return (b, n, n, 6, 7) features of ordered pairs with each `w`, the axis that points up at the mate.

    Bottom and top are the lowest and the highest point of a group along that axis.

    | index | feature | unit |
    |---|---|---|
    | 0 | the moving group's bottom above the waiting group's, at most ±0.5 m | 0.5 m |
    | 1 | tanh of the same | 10 mm |
    | 2 | the moving group's top above the waiting group's, at most ±0.5 m | 0.5 m |
    | 3 | tanh of the same | 10 mm |
    | 4 | cosine between the waiting point's normal and the axis | |
    | 5 | the moving group's bottom above the waiting group's top, at most ±0.5 m | 0.5 m |
    | 6 | the waiting group's bottom above the moving group's top, at most ±0.5 m | 0.5 m |

    Args:
        t: batch of tokens of `tokens.pad`.
    """
    xp = t["frame"].__array_namespace__()
    low, high = t["bounds"][..., :3], t["bounds"][..., 3:]
    extent = t["extent"][:, None]
    bottom, top = _along_up_axes(xp, low, -high), _along_up_axes(xp, high, -low)
    normal = t["frame"][..., 2] @ xp.asarray(UP_AXES.T, dtype=t["frame"].dtype)
    features = [
        2.0 * xp.clip(bottom, -_CUTOFF, _CUTOFF),
        xp.tanh(bottom / _SCALE),
        2.0 * xp.clip(top, -_CUTOFF, _CUTOFF),
        xp.tanh(top / _SCALE),
        xp.broadcast_to(normal[:, None], bottom.shape),
        2.0 * xp.clip(_along_up_axes(xp, low - extent, -high - extent), -_CUTOFF, _CUTOFF),
        2.0 * xp.clip(_along_up_axes(xp, -high - extent, low - extent), -_CUTOFF, _CUTOFF),
    ]
    return xp.stack(features, axis=-1)


def _cosine(rotation: Array) -> Array:
    """Cosine of the angle of a rotation."""
    return (rotation[..., 0, 0] + rotation[..., 1, 1] + rotation[..., 2, 2] - 1.0) / 2.0


def _along_up_axes(xp: Array, positive: Array, negative: Array) -> Array:
    """Numbers along x, y, z and against them, in the order of `UP_AXES`: +z, -z, +x, -x, +y, -y."""
    order = ((positive, 2), (negative, 2), (positive, 0), (negative, 0), (positive, 1), (negative, 1))
    return xp.stack([values[..., axis] for values, axis in order], axis=-1)
