"""The grasp network: its answers multiply to the probability of an action."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.dataset import YES, GraspSamples
from roboassembly.learning.relational.grasps.features import (
    PAIR_FEATURES,
    SINGLE_FEATURES,
    GraspFeatures,
    grasp_features,
)
from roboassembly.task.rules.connections import GRASPS


def test_probabilities_by_hand() -> None:
    params = grasping.init(np.random.default_rng(0))
    params["mate"]["1"]["w"][:], params["mate"]["1"]["b"][:] = 0.0, [0.0, np.log(3.0), 0.0]
    params["pick"]["2"]["w"][:], params["pick"]["2"]["b"][:] = 0.0, np.log(4.0)
    exists = np.ones((GRASPS, GRASPS), bool)
    exists[3] = False
    # All grippers are free, and nothing else matters here.
    single = np.ones((2, GRASPS, SINGLE_FEATURES), np.float32)
    pair = np.zeros((GRASPS, GRASPS, PAIR_FEATURES), np.float32)
    in_reach = np.ones((2, GRASPS), bool)
    log_probability = grasping.log_probability(params, GraspFeatures(single, pair, exists, in_reach))
    # 1/2 that both fit, 3/4 that the arms reach the mate, 1/2 that all else works; 4/5 for each pick.
    assert np.exp(log_probability[exists]) == pytest.approx(0.5 * 0.75 * 0.5 * 0.8 * 0.8)
    assert (log_probability[~exists] == -np.inf).all()
    # R_b's arm does not reach its grasp 5: all pairs with it come last, and none is ruled out.
    in_reach[1, 5] = False
    beyond = grasping.log_probability(params, GraspFeatures(single, pair, exists, in_reach))
    others = np.delete(np.arange(GRASPS), 5)
    assert np.array_equal(beyond[:, others], log_probability[:, others])
    assert beyond[exists[:, 5], 5] == pytest.approx(log_probability[exists[:, 5], 5] - 5.0)
    # R_a's gripper reaches 1 mm into the other group with its grasp 2, R_b's leaves its own part 0.1 mm with grasp 6.
    in_reach[1, 5] = True
    single[0, 2, 5], single[1, 6, 0] = -1.0 / 50.0, 0.1 / 50.0
    features = GraspFeatures(single, pair, exists, in_reach)
    assert np.argwhere(grasping.touches(features)).tolist() == [[0, 2], [1, 6]]
    touching = grasping.log_probability(params, features)
    assert touching[0, 0] == log_probability[0, 0]
    assert touching[2, 0] == pytest.approx(log_probability[2, 0] - 5.0)
    assert touching[2, 6] == pytest.approx(log_probability[2, 6] - 10.0)


def test_grasps_that_touch_never_fit(stand_grasps: GraspSamples) -> None:
    """The exact test on meshes agrees with the clouds, on every pair of an episode."""
    touching = free = 0
    for sample in stand_grasps.samples:
        features = grasp_features(stand_grasps.view(sample), *sample.pair)
        a, b = grasping.touches(features)
        either = (a[:, None] | b) & features.exists
        assert not (sample.fit[either] == YES).any()
        touching += int(either.sum())
        free += int((sample.fit[~either] == YES).sum())
    assert touching > 10
    assert free > 10
