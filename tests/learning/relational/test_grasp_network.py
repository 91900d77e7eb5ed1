"""The grasp network: its answers multiply to the probability of an action."""

from __future__ import annotations

import numpy as np
import pytest

from roboassembly.learning.relational.grasps import network as grasping
from roboassembly.learning.relational.grasps.features import PAIR_FEATURES, SINGLE_FEATURES, GraspFeatures
from roboassembly.task.rules.connections import GRASPS


def test_probabilities_by_hand() -> None:
    params = grasping.init(np.random.default_rng(0))
    params["mate"]["1"]["w"][:], params["mate"]["1"]["b"][:] = 0.0, [0.0, np.log(3.0), 0.0]
    params["pick"]["2"]["w"][:], params["pick"]["2"]["b"][:] = 0.0, np.log(4.0)
    exists = np.ones((GRASPS, GRASPS), bool)
    exists[3] = False
    single = np.zeros((2, GRASPS, SINGLE_FEATURES), np.float32)
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
