"""Features of pairs and of up axes on a case worked out by hand."""

from __future__ import annotations

import numpy as np

from roboassembly.learning.relational.depth_images import EXIT_COUNTS
from roboassembly.learning.relational.features import ALIGNED, pair_features, sunk, up_axis_features
from roboassembly.learning.relational.group_geometry import PATCH_SIZE
from roboassembly.learning.relational.joint_fit import FIT_FEATURES
from roboassembly.learning.relational.tokens import POINT_FEATURES, Tokens, pad


def test_features_of_a_pair_by_hand() -> None:
    # A point on top of a group 1 m wide and 0.2 m high, and one below another, 0.4 m wide and high.
    frame = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    features = np.zeros((2, POINT_FEATURES), np.float32)
    features[:, 0], features[:, ALIGNED], features[:, -1] = (0.2, 0.4), 1.0, 1.0
    exits = np.zeros((2, 2, EXIT_COUNTS), np.uint8)
    # Along the waiting point's x axis, half of the fine pixels and all coarse ones are blocked; no other way is.
    exits[0, 1, [0, 6, 13, 19]] = 10, 20, 8, 8
    # The moving part's tenon has 10 mm of room at its sides and none at its tip.
    fit = np.zeros((2, 2, FIT_FEATURES), np.int8)
    fit[0, 1, :6] = 127
    tokens = Tokens(
        np.arange(2), np.zeros(2, int), np.arange(2), np.zeros((2, PATCH_SIZE), np.uint8), features,
        frame.astype(np.float32),
        np.array([[0.0, 0.0, 0.2], [0.1, 0.0, 0.0]], np.float32), np.tile(np.eye(3, dtype=np.float32), (2, 1, 1)),
        np.array([[1.0, 1.0, 0.2], [0.4, 0.4, 0.4]], np.float32),
        np.zeros((2, 2, 4), np.uint8), np.array([[[0.0] * 6, [-0.4, -0.3, -0.2, 0.2, 0.3, -0.4]]] * 2, np.float32),
        exits, fit,
        np.array([[0, 2], [2, 0]], np.uint8), np.array([[0, 3], [3, 0]], np.uint8),
    )  # fmt: skip
    t = pad([tokens], 2)
    valid = ~np.eye(2, dtype=bool)[None]
    pair = pair_features({k: v.astype(np.float32) for k, v in t.items()}, valid)[0]
    assert not pair[0, 0].any()
    assert np.allclose(pair[0, 1, 10:12], [0.2, 0.4])  # parts of the moving and of the waiting group
    assert np.allclose(pair[0, 1, 12:27], [1, 1, 1, 2 / 3, np.log(3), 1, 1, 1, 1, 0.1, np.log(4), 1, 1, 1, 1])
    assert np.allclose(pair[0, 1, [27, 33, 46, 52]], np.log1p([10, 20, 8, 8]) / 5.0)
    assert np.allclose(pair[0, 1, 40:46], [0.5, 0, 0, 0, 0, 0])
    assert np.allclose(pair[0, 1, 55:61], [1, 0, 0, 0, 0, 0])
    assert np.allclose(pair[0, 1, 61:63], 1.0)  # axes stay axes
    assert np.allclose(pair[0, 1, 63:86], [1] * 6 + [0] * 17)  # codes
    assert np.allclose(pair[0, 1, 110:122], [1] * 5 + [0] * 7)  # clearances
    assert np.allclose(pair[0, 1, 131:133], 0.0)  # the least of them, that of the tip
    assert np.allclose(pair[0, 1, 133:141], np.tanh([40, 40, 0, 0, 36, 36, -4, -4]), atol=1e-6)  # sums of two sides
    cosine, diagonal, shift, parallel = np.split(pair[0, 1, 141:149], [1, 4, 7])
    assert (cosine, parallel) == (1.0, 1.0)
    assert np.allclose(diagonal, 1.0)
    assert np.allclose(shift, [0.1, 0.0, -0.2])  # of the moving group, that of the row
    assert np.allclose(pair[0, 1, 150:], [1.0, 1.0, 0.2])  # the moving group's extent
    axis = up_axis_features({k: v.astype(np.float32) for k, v in t.items()})[0, 0, 1]
    up = axis[0]  # with +z up, its bottom is 0.2 m lower than the waiting group's, its top 0.4 m
    assert np.allclose(up[[0, 2, 4, 6]], [-0.4, -0.8, -1.0, 2 * -0.5], atol=1e-6)
    assert np.allclose(axis[1, [0, 2]], [0.8, 0.4], atol=1e-6)  # upside down
    # The waiting point looks down, so its normal rises with -z up. Its tangent is blocked.
    assert np.allclose(axis[:, 12], [1.0, 1.0, -1.0 + 1.0, 1.0, 1.0, 1.0])
    assert np.allclose(axis[:, 13], [0, 0, 0.5, 0, 0, 0])
    in_own_frames = features.copy()
    in_own_frames[:, [ALIGNED, -1]] = 0.0
    numbers = {k: v.astype(np.float32) for k, v in t.items()}
    other = pair_features({**numbers, "features": in_own_frames[None]}, valid)[0, 0, 1]
    assert np.allclose(other[:141], pair[0, 1, :141])
    assert not other[141:].any()


def test_what_reaches_below_the_waiting_group_is_sunk() -> None:
    # The moving group begins 1.5 mm lower along x, 20 mm higher along y and 2.5 mm lower along z, and ends higher.
    bounds = np.array([-0.0015, 0.02, -0.0025, 0.3, 0.01, 0.5], np.float32)
    assert sunk(bounds).tolist() == [True, True, False, True, False, True]  # +z, -z, +x, -x, +y, -y
    assert not sunk(np.zeros((3, 6), np.float32)).any()
