"""Success of the policy in the package on chairs that no data set holds; training it anew must not lower it."""

from __future__ import annotations

import pytest

from roboassembly.datasets import catalogue
from roboassembly.evaluation.rollout import run_episode
from roboassembly.generate import CHAIRS
from roboassembly.learning.registry import load_policy

_FIRST = 2_000_000
"""First seed; data sets use lower ones, and extra pieces of training higher ones."""


@pytest.mark.slow
def test_the_shipped_policy_assembles_new_chairs() -> None:
    """Two chairs of each of 17 families. It solves 97 % of `chairs-412:test`; at most 5 of 34 may fail here."""
    policy = load_policy("relational")
    failed = [
        (family, seed)
        for family in CHAIRS
        for seed in (_FIRST, _FIRST + 1)
        if not run_episode(policy, catalogue.make(family, seed, with_grasps=False), 0).success
    ]
    assert len(failed) <= 5, failed
