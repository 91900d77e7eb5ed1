"""Features of pairs and of up axes on a case worked out by hand."""

from __future__ import annotations

import numpy as np

from roboassembly.learning.relational.features import pair_features, up_axis_features
from roboassembly.learning.relational.group_geometry import PATCH_SIZE
from roboassembly.learning.relational.tokens import POINT_FEATURES, Tokens, pad


def test_features_of_a_pair_by_hand() -> None:
    # A point on top of a group 1 m wide and 0.2 m high, and one below another, 0.4 m wide and high.
    frame = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])])
    features = np.zeros((2, POINT_FEATURES), np.float32)
    features[:, 0], features[:, -1] = (0.2, 0.4), 1.0
    tokens = Tokens(
        np.arange(2), np.zeros(2, int), np.arange(2), np.zeros((2, PATCH_SIZE), np.uint8), features,
        frame.astype(np.float32),
        np.array([[0.0, 0.0, 0.2], [0.1, 0.0, 0.0]], np.float32),
        np.array([[1.0, 1.0, 0.2], [0.4, 0.4, 0.4]], np.float32),
        np.zeros((2, 2, 4), np.uint8), np.array([[[0.0] * 6, [-0.4, -0.3, -0.2, 0.2, 0.3, -0.4]]] * 2, np.float32),
        np.array([[0, 2], [2, 0]], np.uint8), np.array([[0, 3], [3, 0]], np.uint8),
    )  # fmt: skip
    t = pad([tokens], 2)
    valid = ~np.eye(2, dtype=bool)[None]
    pair = pair_features({k: v.astype(np.float32) for k, v in t.items()}, valid)[0]
    assert not pair[0, 0].any()
    cosine, diagonal, shift, parallel, sizes = np.split(pair[0, 1, 10:20], [1, 4, 7, 8])
    assert (cosine, parallel) == (1.0, 1.0)
    assert np.allclose(diagonal, 1.0)
    assert np.allclose(shift, [0.1, 0.0, -0.2])  # of the moving group, that of the row
    assert np.allclose(sizes, [0.2, 0.4])
    assert np.allclose(pair[0, 1, 21:24], [1.0, 1.0, 0.2])  # the moving group's extent
    assert np.allclose(pair[0, 1, 24:], [1, 1, 1, 2 / 3, np.log(3), 1, 1, 1, 1, 0.1, np.log(4), 1, 1, 1, 1])
    axis = up_axis_features({k: v.astype(np.float32) for k, v in t.items()})[0, 0, 1]
    up = axis[0]  # with +z up, its bottom is 0.2 m lower than the waiting group's, its top 0.4 m
    assert np.allclose(up[[0, 2, 4, 5]], [-0.4, -0.8, -1.0, 2 * -0.5], atol=1e-6)
    assert np.allclose(axis[1, [0, 2]], [0.8, 0.4], atol=1e-6)  # upside down
