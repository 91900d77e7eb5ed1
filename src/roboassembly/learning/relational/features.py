"""Features of pairs of connection points, and of the axes that may point up, from a batch of tokens.

They run on NumPy and on JAX arrays. The network computes them itself, because a state has thousands of pairs with about
a hundred numbers each: too much for a dataset.
"""

from __future__ import annotations

from roboassembly.geometry.mating import mating_poses
from roboassembly.learning.layers import Array
from roboassembly.learning.relational.depth_images import COARSE_BLOCKED, COARSE_SHARED, FINE_BLOCKED, FINE_SHARED
from roboassembly.learning.relational.joint_fit import CLEARANCES, decoded

PAIR_FEATURES = 153
"""Number of features of an ordered pair of points."""
UP_AXIS_FEATURES = 15
"""Number of features of a pair with a `w`."""
ALIGNED = 20
"""Index of the point feature that says whether part frames are aligned."""
_FEW_PIXELS, _FEW_BLOCKED = 1, 0.25
"""Number of blocked pixels, and their share, up to which a way counts as free."""
_PARALLEL = 0.999
"""Cosine of the angle between two frames from which on they count as parallel."""
_FAR = 10.0
"""Unit of long lengths at a joint [mm]."""
_SCALE = 0.01
"""Scale of the tanh features of heights [m]."""
_CUTOFF = 0.5
"""Value from which on heights are clipped [m]."""
_SUNK = 0.002
"""Depth below the ground from which on a group surely reaches into it [m]: clouds miss the lowest point."""


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
    """Return (b, n, n, 153) features of ordered pairs; rows are points of the moving group. Invalid pairs get zeros.

    | index | feature | unit |
    |---|---|---|
    | 0–3 | `matches` of the tokens | |
    | 4–7 | log(1 + `matches`) | |
    | 8, 9 | 1 if any other points mate as well, without and with equal tangents | |
    | 10, 11 | number of parts of the moving and of the waiting group | 5 parts |
    | 12–26 | of `_cycle_features` | |
    | 27–60 | of `_exit_features` | |
    | 61, 62 | mean and least of how parallel the axes of the two parts are, 1 if an axis stays an axis | |
    | 63–140 | of `_fit_features` | |
    | 141 | cosine of the angle between the two groups' frames, once mated | |
    | 142–144 | diagonal of the rotation between these frames | |
    | 145–147 | translation of the moving group in the waiting group's frame | m |
    | 148 | 1 if the two frames are parallel | |
    | 149 | largest absolute entry of the rotation: 1 if an axis stays an axis | |
    | 150–152 | extent of the moving group along the waiting group's axes | m |

    Those from 141 on are 0 where part frames are not aligned.

    Args:
        t: batch of tokens of `tokens.pad`.
        valid: (b, n, n) whether both tokens exist and are in different groups.
    """
    xp = t["frame"].__array_namespace__()
    rotation, translation = mating_poses(t["frame"], t["position"], t["frame"], t["position"])
    matches, sizes, aligned = t["matches"], t["features"][..., 0], t["features"][..., ALIGNED]
    parallel = frames_parallel(rotation)
    number = xp.float32
    parts = xp.broadcast_to(sizes[:, :, None], valid.shape), xp.broadcast_to(sizes[:, None, :], valid.shape)
    extent = t["bounds"][..., 3:] - t["bounds"][..., :3] + t["extent"][:, None]
    plausible = valid & (plausible_pairs(parallel, t["features"][..., -1] > 0, valid) | (aligned[:, :, None] == 0))
    between = xp.einsum("blji,bkljm,bkmo->bklio", t["axes"], rotation, t["axes"])
    kept = xp.max(xp.abs(between), axis=-1)
    of_frames = [
        _cosine(rotation)[..., None],
        xp.stack([rotation[..., i, i] for i in range(3)], axis=-1),
        translation,
        xp.astype(parallel, number)[..., None],
        xp.max(xp.abs(rotation), axis=(-2, -1))[..., None],
        extent,
    ]
    features = [
        matches,
        xp.log1p(xp.maximum(matches, 0.0)),
        xp.astype(matches[..., :2] > 0, number),
        xp.stack(parts, axis=-1),
        _cycle_features(xp, t["cycles_3"], t["cycles_4"], plausible),
        _exit_features(xp, t["exits"]),
        xp.stack([xp.mean(kept, axis=-1), xp.min(kept, axis=-1)], axis=-1),
        _fit_features(xp, t["fit"]),
        xp.concatenate(of_frames, axis=-1) * aligned[:, :, None, None],
    ]
    return xp.concatenate(features, axis=-1) * xp.astype(valid, number)[..., None]


def _fit_features(xp: Array, codes: Array) -> Array:
    """(b, n, n, 78): how the joints of the two parts fit.

    | index | feature |
    |---|---|
    | 0–22 | the numbers of `joint_fit.joint_fit` on the scale of their codes, 1 for 10 mm |
    | 23–34 | tanh of the clearances in units of 0.3 mm |
    | 35–46 | tanh of the clearances less 1 mm in units of 0.3 mm |
    | 47–58 | clearances in units of 10 mm |
    | 59–65 | other lengths in units of 10 mm |
    | 66, 67 | tanh of the least clearance of each tenon, plus 0.5 mm, in units of 0.3 mm |
    | 68, 69 | least clearance of each tenon in units of 10 mm |
    | 70–73 | tanh of the sums of opposite clearances of each tenon in units of 0.5 mm |
    | 74–77 | tanh of these sums less 2 mm in units of 0.5 mm |
    """
    numbers = decoded(codes)
    clearances = xp.concatenate([numbers[..., places] for places in CLEARANCES], axis=-1)
    tightest = [xp.min(numbers[..., places], axis=-1, keepdims=True) for places in CLEARANCES]
    # A tenon that does not sit in the middle of its pocket fits as well.
    sums = xp.stack(
        [numbers[..., i] + numbers[..., i + 1] for s in CLEARANCES for i in range(s.start + 1, s.stop - 1, 2)], axis=-1
    )
    features = [
        codes / 127.0,
        xp.tanh(clearances / 0.3),
        xp.tanh((clearances - 1.0) / 0.3),
        clearances / _FAR,
        numbers[..., 16:] / _FAR,
        *(xp.tanh((x + 0.5) / 0.3) for x in tightest),
        *(x / _FAR for x in tightest),
        xp.tanh(sums / 0.5),
        xp.tanh((sums - 2.0) / 0.5),
    ]
    return xp.concatenate(features, axis=-1)


def _exit_features(xp: Array, exits: Array) -> Array:
    """(b, n, n, 34): what depth images show of the exits.

    | index | feature |
    |---|---|
    | 0–12 | log(1 + count) / 5 of the fine images, in the order of `depth_images.exit_counts` |
    | 13–18 | share of the fine pixels with both groups that are blocked, for each direction |
    | 19–27 | log(1 + count) / 5 of the coarse images |
    | 28–33 | share of the coarse pixels with both groups that are blocked, for each direction |
    """
    fine, coarse = blocked_shares(xp, exits)
    logs = xp.log1p(exits) / 5.0
    return xp.concatenate([logs[..., :13], fine, logs[..., 13:], coarse], axis=-1)


def blocked_shares(xp: Array, exits: Array) -> tuple[Array, Array]:
    """Return (..., 6) shares of the pixels with both groups that are blocked along each way, fine and coarse."""
    shares: list[Array] = []
    for blocked, shared in ((FINE_BLOCKED, FINE_SHARED), (COARSE_BLOCKED, COARSE_SHARED)):
        both = xp.repeat(exits[..., shared], 2, axis=-1)
        shares.append(exits[..., blocked] / xp.maximum(both, 4.0))
    return shares[0], shares[1]


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
    """Return (b, n, n, 6, 15) features of ordered pairs with each `w`, the axis that points up at the mate.

    Bottom and top are the lowest and the highest point of a group along that axis.

    | index | feature | unit |
    |---|---|---|
    | 0 | the moving group's bottom above the waiting group's, at most ±0.5 m | 0.5 m |
    | 1 | tanh of the same | 10 mm |
    | 2 | the moving group's top above the waiting group's, at most ±0.5 m | 0.5 m |
    | 3 | tanh of the same | 10 mm |
    | 4, 5 | cosine between the waiting point's normal, and its tangent, and the axis | |
    | 6 | the moving group's bottom above the waiting group's top, at most ±0.5 m | 0.5 m |
    | 7 | the waiting group's bottom above the moving group's top, at most ±0.5 m | 0.5 m |
    | 8, 9 | extent of the moving and of the waiting group along the axis | m |
    | 10–12 | largest rise of a way out that is free in the fine, the coarse and both images, -1 if none is | |
    | 13, 14 | share of the pixels blocked along the exits that rise, fine and coarse | |

    Args:
        t: batch of tokens of `tokens.pad`.
    """
    xp = t["frame"].__array_namespace__()
    low, high = t["bounds"][..., :3], t["bounds"][..., 3:]
    extent = t["extent"][:, None]
    bottom, top = _bottoms(xp, t["bounds"]), _along_up_axes(xp, high, -low)
    # Rise of the axes of a waiting point's frame, along its part's axes: (b, l, 3, 3).
    rise = xp.einsum("blji,bljm->blim", t["frame"], t["axes"])
    normal, tangent = (_along_up_axes(xp, rise[:, :, axis], -rise[:, :, axis]) for axis in (2, 0))
    wide = _along_up_axes(xp, extent, extent)
    features = [
        2.0 * xp.clip(bottom, -_CUTOFF, _CUTOFF),
        xp.tanh(bottom / _SCALE),
        2.0 * xp.clip(top, -_CUTOFF, _CUTOFF),
        xp.tanh(top / _SCALE),
        xp.broadcast_to(normal[:, None], bottom.shape),
        xp.broadcast_to(tangent[:, None], bottom.shape),
        2.0 * xp.clip(_along_up_axes(xp, low - extent, -high - extent), -_CUTOFF, _CUTOFF),
        2.0 * xp.clip(_along_up_axes(xp, -high - extent, low - extent), -_CUTOFF, _CUTOFF),
        _along_up_axes(xp, high - low + extent, high - low + extent),
        xp.broadcast_to(wide, bottom.shape),
        *_rises(xp, t["exits"], rise),
    ]
    return xp.stack(features, axis=-1)


def exit_states(exits: Array) -> tuple[Array, Array]:
    """Return (..., 6) whether each exit of a mate is free in the fine and in the coarse images, and its blocked share.

    The share is that of the pixels with both groups, the larger one of the two images.
    """
    xp = exits.__array_namespace__()
    fine, coarse = blocked_shares(xp, exits)
    free_fine, free_coarse = _free_exits(exits, fine, coarse)
    return free_fine & free_coarse, xp.maximum(fine, coarse)


def _free_exits(exits: Array, fine: Array, coarse: Array) -> tuple[Array, Array]:
    """Return (..., 6) whether each way out of a mate is free in the fine and in the coarse images, by their shares."""
    free_fine = (exits[..., FINE_BLOCKED] <= _FEW_PIXELS) | (fine < _FEW_BLOCKED)
    free_coarse = (exits[..., COARSE_BLOCKED] <= _FEW_PIXELS) | (coarse < _FEW_BLOCKED)
    return free_fine, free_coarse


def sunk(bounds: Array) -> Array:
    """Return (..., 6) whether the moving group reaches into the ground on which the other waits, with each `w` up.

    Args:
        bounds: (..., 6) of the tokens.
    """
    return _bottoms(bounds.__array_namespace__(), bounds) < -_SUNK


def _bottoms(xp: Array, bounds: Array) -> Array:
    """Return (..., 6) the moving group's lowest point above the waiting group's, with each `w` up [m]."""
    return _along_up_axes(xp, bounds[..., :3], -bounds[..., 3:])


def _rises(xp: Array, exits: Array, rise: Array) -> list[Array]:
    """Five arrays (b, n, n, 6): how far the exits rise with each `w`, see `up_axis_features`.

    Args:
        xp: namespace of the arrays.
        exits: (b, n, n, 22) of the tokens.
        rise: (b, n, 3, 3) cosines between the axes of each point's frame and the axes that `w` names.
    """
    fine, coarse = blocked_shares(xp, exits)
    free_fine, free_coarse = _free_exits(exits, fine, coarse)
    best: dict[str, list[Array]] = {"fine": [], "coarse": [], "both": [], "of_fine": [], "of_coarse": []}
    for axis, sign in ((2, 1.0), (2, -1.0), (0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        along = sign * rise[:, None, :, :, axis]
        of_exits = xp.reshape(xp.stack([along, -along], axis=-1), (*along.shape[:-1], 6))
        for name, free in (("fine", free_fine), ("coarse", free_coarse), ("both", free_fine & free_coarse)):
            best[name].append(xp.max(xp.where(free, of_exits, -1.0), axis=-1))
        up = xp.maximum(of_exits, 0.0) ** 2
        best["of_fine"].append(xp.sum(up * fine, axis=-1))
        best["of_coarse"].append(xp.sum(up * coarse, axis=-1))
    return [xp.stack(values, axis=-1) for values in best.values()]


def _cosine(rotation: Array) -> Array:
    """Cosine of the angle of a rotation."""
    return (rotation[..., 0, 0] + rotation[..., 1, 1] + rotation[..., 2, 2] - 1.0) / 2.0


def _along_up_axes(xp: Array, positive: Array, negative: Array) -> Array:
    """Numbers along x, y, z and against them, in the order of `UP_AXES`: +z, -z, +x, -x, +y, -y."""
    order = ((positive, 2), (negative, 2), (positive, 0), (negative, 0), (positive, 1), (negative, 1))
    return xp.stack([values[..., axis] for values, axis in order], axis=-1)
